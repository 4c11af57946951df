//! The methods by name, and how each is made from a file.

use super::{AdmmConfig, Central, FloatNetwork, MethodError, Reconstruct, RichardsonLucyConfig, WienerConfig};
use crate::network_file::NetworkFile;
use crate::train::ArchitectureName;
use ommatidia_model::instrument::Instrument;
use ommatidia_session::artifact;
use ommatidia_session::kind::FileKind;
use serde::{Deserialize, Serialize};
use std::path::Path;

/// A method of reconstruction.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, clap::ValueEnum)]
#[serde(rename_all = "kebab-case")]
pub enum MethodKind {
    /// SV-FourierNet, from a checkpoint (single precision) or a network file (half precision, as on a device).
    #[value(name = "svfouriernet")]
    SvFourierNet,
    /// MultiWienerNet (PSFs learned in space), from a checkpoint.
    #[value(name = "multiwienernet")]
    MultiWienerNet,
    /// MultiFlatNet (filters learned in space), from a checkpoint.
    #[value(name = "multiflatnet")]
    MultiFlatNet,
    /// CM2Net (crops of the views, demixed and joined), from a checkpoint.
    #[value(name = "cm2net")]
    Cm2Net,
    /// Wiener deconvolution with the PSF of the field's centre, from an instrument.
    Wiener,
    /// ADMM with total variation and all PSFs, from an instrument; slow: seconds a frame.
    Admm,
    /// ADMM with total variation and the PSF of the field's centre, from an instrument.
    AdmmLsi,
    /// Richardson-Lucy deconvolution with all PSFs, from an instrument; slow: about a second a frame.
    RichardsonLucy,
    /// The view of the central lens alone, from an instrument.
    Central,
}

impl From<ArchitectureName> for MethodKind {
    fn from(architecture: ArchitectureName) -> Self {
        match architecture {
            ArchitectureName::SvFourierNet => Self::SvFourierNet,
            ArchitectureName::MultiWienerNet => Self::MultiWienerNet,
            ArchitectureName::MultiFlatNet => Self::MultiFlatNet,
            ArchitectureName::Cm2Net => Self::Cm2Net,
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

    /// Whether the method is made from an instrument; the others are made from a trained network.
    pub fn needs_instrument(self) -> bool {
        matches!(self, Self::Wiener | Self::Admm | Self::AdmmLsi | Self::RichardsonLucy | Self::Central)
    }

    /// Makes the method from a file. `seed` draws the synthetic scenes that the Wiener filter is tuned on; other
    /// methods do not use it.
    ///
    /// # Errors
    /// The file cannot be read, or is not of the kind that the method needs.
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
            (Self::SvFourierNet, FileKind::Blob) => Ok(Box::new(NetworkFile::read(path)?)),
            _ if is("checkpoint") => {
                let network = FloatNetwork::open(path)?;
                match Self::from(network.architecture()) {
                    of if of == self => Ok(Box::new(network)),
                    of => wrong("a checkpoint of this network", format!("a checkpoint of {}", of.name())),
                }
            }
            (Self::SvFourierNet, _) => wrong("a checkpoint or a network file (blob)", found.to_string()),
            _ => wrong("a checkpoint", found.to_string()),
        }
    }

    /// The default method for a file: its network for checkpoints and network files, Wiener for instruments.
    ///
    /// # Errors
    /// The file cannot be read, or no method is made from files of its kind.
    pub fn default_for(path: &Path) -> anyhow::Result<Self> {
        match FileKind::of(path)? {
            FileKind::Blob => Ok(Self::SvFourierNet),
            FileKind::Artifact(kind) if kind == "checkpoint" => {
                // Early checkpoints, all of SV-FourierNet, do not name their architecture.
                let name = artifact::inspect(path)?["body"]["network"]["family"]["name"].clone();
                let name: Option<ArchitectureName> = serde_json::from_value(name).unwrap_or_default();
                Ok(name.unwrap_or_default().into())
            }
            FileKind::Artifact(kind) if kind == "instrument" => Ok(Self::Wiener),
            found => Err(MethodError::NoMethod { path: path.into(), found: found.to_string() }.into()),
        }
    }
}
