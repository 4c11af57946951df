//! Every method by name, made from the file that it needs.

use super::{AdmmConfig, Blob, Central, FloatNetwork, MethodError, Reconstruct, RichardsonLucyConfig, WienerConfig};
use crate::artifact;
use crate::instrument::Instrument;
use crate::kind::FileKind;
use crate::train::FamilyName;
use serde::{Deserialize, Serialize};
use std::path::Path;

/// A way from a raw frame to an object.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, clap::ValueEnum)]
#[serde(rename_all = "kebab-case")]
pub enum MethodKind {
    /// The network, from a checkpoint (float) or a network file (blob).
    #[value(name = "svfouriernet")]
    SvFourierNet,
    /// PSFs learned in space and an enhancement, from a checkpoint.
    #[value(name = "multiwienernet")]
    MultiWienerNet,
    /// Filters learned in space and an enhancement, from a checkpoint.
    #[value(name = "multiflatnet")]
    MultiFlatNet,
    /// Views cut out, demixed and joined, from a checkpoint.
    #[value(name = "cm2net")]
    Cm2Net,
    /// Wiener deconvolution with the centre PSF, from an instrument.
    Wiener,
    /// ADMM with total variation and all PSFs, from an instrument; slow.
    Admm,
    /// ADMM with total variation and the centre PSF, from an instrument.
    AdmmLsi,
    /// Richardson-Lucy deconvolution with all PSFs, from an instrument; slow.
    RichardsonLucy,
    /// The central lens's view alone, from an instrument.
    Central,
}

impl From<FamilyName> for MethodKind {
    fn from(family: FamilyName) -> Self {
        match family {
            FamilyName::SvFourierNet => Self::SvFourierNet,
            FamilyName::MultiWienerNet => Self::MultiWienerNet,
            FamilyName::MultiFlatNet => Self::MultiFlatNet,
            FamilyName::Cm2Net => Self::Cm2Net,
        }
    }
}

impl MethodKind {
    /// Name on the command line and in tables.
    pub fn name(self) -> &'static str {
        match self {
            Self::SvFourierNet => "svfouriernet",
            Self::MultiWienerNet => "multiwienernet",
            Self::MultiFlatNet => "multiflatnet",
            Self::Cm2Net => "cm2net",
            Self::Wiener => "wiener",
            Self::Admm => "admm",
            Self::AdmmLsi => "admm-lsi",
            Self::RichardsonLucy => "richardson-lucy",
            Self::Central => "central",
        }
    }

    /// Whether it is made from an instrument, not from a network.
    pub fn needs_instrument(self) -> bool {
        matches!(self, Self::Wiener | Self::Admm | Self::AdmmLsi | Self::RichardsonLucy | Self::Central)
    }

    /// Makes the method from a file. `seed` draws the scenes on which it is tuned, where it is.
    ///
    /// # Errors
    /// The file cannot be read or is not of the kind that the method needs.
    pub fn open(self, path: &Path, seed: u64) -> anyhow::Result<Box<dyn Reconstruct>> {
        let found = FileKind::of(path)?;
        let wrong = |expected, found| {
            Err(MethodError::WrongFile { path: path.into(), method: self.name().into(), expected, found }.into())
        };
        let is = |kind: &str| matches!(&found, FileKind::Artifact(k) if k == kind);
        if self.needs_instrument() {
            if !is("instrument") {
                return wrong("an instrument", found.to_string());
            }
            let instrument = Instrument::read(path)?;
            return Ok(match self {
                Self::Wiener => Box::new(WienerConfig::default().build(&instrument, seed)?),
                Self::Admm => Box::new(AdmmConfig::low_rank().build_low_rank(&instrument)?),
                Self::AdmmLsi => Box::new(AdmmConfig::shift_invariant().build_shift_invariant(&instrument)?),
                Self::RichardsonLucy => Box::new(RichardsonLucyConfig::default().build(&instrument)?),
                _ => Box::new(Central::new(&instrument)?),
            });
        }
        match (self, &found) {
            (Self::SvFourierNet, FileKind::Blob) => Ok(Box::new(Blob::open(path)?)),
            _ if is("checkpoint") => {
                let network = FloatNetwork::open(path)?;
                match Self::from(network.family()) {
                    of if of == self => Ok(Box::new(network)),
                    of => wrong("a checkpoint of its own", format!("one of {}", of.name())),
                }
            }
            (Self::SvFourierNet, _) => wrong("a checkpoint or a network file (blob)", found.to_string()),
            _ => wrong("a checkpoint", found.to_string()),
        }
    }

    /// The method that a file is for where none is asked for: its network for checkpoints and blobs, Wiener for instruments.
    ///
    /// # Errors
    /// The file cannot be read or no method is made from its kind.
    pub fn default_for(path: &Path) -> anyhow::Result<Self> {
        match FileKind::of(path)? {
            FileKind::Blob => Ok(Self::SvFourierNet),
            FileKind::Artifact(kind) if kind == "checkpoint" => {
                // Checkpoints from before there were others do not say.
                let family = artifact::inspect(path)?["body"]["network"]["family"]["name"].clone();
                let family: Option<FamilyName> = serde_json::from_value(family).unwrap_or_default();
                Ok(family.unwrap_or_default().into())
            }
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
