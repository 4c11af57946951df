//! Every method by name, made from the file that it needs.

use super::{Blob, Central, FloatNetwork, MethodError, Reconstruct, RichardsonLucyConfig, WienerConfig};
use crate::instrument::Instrument;
use crate::kind::FileKind;
use serde::{Deserialize, Serialize};
use std::path::Path;

/// A way from a raw frame to an object.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, clap::ValueEnum)]
#[serde(rename_all = "kebab-case")]
pub enum MethodKind {
    /// The network, from a checkpoint (float) or a network file (blob).
    #[value(name = "svfouriernet")]
    SvFourierNet,
    /// Wiener deconvolution with the centre PSF, from an instrument.
    Wiener,
    /// Richardson-Lucy deconvolution with all PSFs, from an instrument; slow.
    RichardsonLucy,
    /// The central lens's view alone, from an instrument.
    Central,
}

impl MethodKind {
    /// Name on the command line and in tables.
    pub fn name(self) -> &'static str {
        match self {
            Self::SvFourierNet => "svfouriernet",
            Self::Wiener => "wiener",
            Self::RichardsonLucy => "richardson-lucy",
            Self::Central => "central",
        }
    }

    /// Whether it is made from an instrument, not from a network.
    pub fn needs_instrument(self) -> bool {
        !matches!(self, Self::SvFourierNet)
    }

    /// Makes the method from a file. `seed` draws the scenes on which it is tuned, where it is.
    ///
    /// # Errors
    /// The file cannot be read or is not of the kind that the method needs.
    pub fn open(self, path: &Path, seed: u64) -> anyhow::Result<Box<dyn Reconstruct>> {
        let found = FileKind::of(path)?;
        match (self, &found) {
            (Self::SvFourierNet, FileKind::Blob) => Ok(Box::new(Blob::open(path)?)),
            (Self::SvFourierNet, FileKind::Artifact(kind)) if kind == "checkpoint" => {
                Ok(Box::new(FloatNetwork::open(path)?))
            }
            (Self::Wiener, FileKind::Artifact(kind)) if kind == "instrument" => {
                Ok(Box::new(WienerConfig::default().build(&Instrument::read(path)?, seed)?))
            }
            (Self::RichardsonLucy, FileKind::Artifact(kind)) if kind == "instrument" => {
                Ok(Box::new(RichardsonLucyConfig::default().build(&Instrument::read(path)?)?))
            }
            (Self::Central, FileKind::Artifact(kind)) if kind == "instrument" => {
                Ok(Box::new(Central::new(&Instrument::read(path)?)?))
            }
            _ => {
                let expected = match self {
                    Self::SvFourierNet => "a checkpoint or a network file (blob)",
                    Self::Wiener | Self::RichardsonLucy | Self::Central => "an instrument",
                };
                let method = self.name().to_string();
                Err(MethodError::WrongFile { path: path.into(), method, expected, found: found.to_string() }.into())
            }
        }
    }

    /// The method that a file is for where none is asked for: the network for checkpoints and blobs, Wiener for instruments.
    ///
    /// # Errors
    /// The file cannot be read or no method is made from its kind.
    pub fn default_for(path: &Path) -> anyhow::Result<Self> {
        match FileKind::of(path)? {
            FileKind::Blob => Ok(Self::SvFourierNet),
            FileKind::Artifact(kind) if kind == "checkpoint" => Ok(Self::SvFourierNet),
            FileKind::Artifact(kind) if kind == "instrument" => Ok(Self::Wiener),
            found => Err(MethodError::WrongFile {
                path: path.into(),
                method: "any".into(),
                expected: "a checkpoint, a network file (blob) or an instrument",
                found: found.to_string(),
            }
            .into()),
        }
    }
}
