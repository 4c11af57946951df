//! Network architectures: SV-FourierNet, and the peers that its paper compares it with.

use serde::{Deserialize, Serialize};

/// A network architecture. All but CM2Net are a bank of filters followed by the same enhancement network.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase", tag = "name", deny_unknown_fields)]
pub enum Architecture {
    /// Filters K are learned in frequency, `X = K Y` (Yang et al. 2024).
    #[default]
    SvFourierNet,
    /// PSFs H are learned in space, with one regularisation K each: `X = conj(H) Y / (|H|^2 + K)` (K. Yanny et al.,
    /// Optica 9, 96 (2022)).
    MultiWienerNet,
    /// Filters w are learned in space and start as pseudo-inverses of PSFs: `X = F(w) Y` (J. Wu et al., iScience 26,
    /// 108307 (2023)).
    MultiFlatNet,
    /// The view of each lens is cropped, demixed from the others, and all are joined (Y. Xue et al., Light Sci. Appl.
    /// 11, 259 (2022)). Its blocks have no batch normalisation, because a batch here can be one frame.
    Cm2Net {
        /// Frame pixel of object pixel (0, 0) in the view of each living lens.
        crops: Vec<[i32; 2]>,
    },
}

/// The architectures by name.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, clap::ValueEnum)]
#[serde(rename_all = "lowercase")]
#[value(rename_all = "lower")]
pub enum ArchitectureName {
    /// Filters learned in frequency.
    #[default]
    SvFourierNet,
    /// PSFs learned in space, with one regularisation each.
    MultiWienerNet,
    /// Filters learned in space.
    MultiFlatNet,
    /// Views cropped, demixed and joined.
    Cm2Net,
}

impl ArchitectureName {
    /// The name on the command line and in tables.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::SvFourierNet => "svfouriernet",
            Self::MultiWienerNet => "multiwienernet",
            Self::MultiFlatNet => "multiflatnet",
            Self::Cm2Net => "cm2net",
        }
    }
}

impl Architecture {
    /// Name of the architecture.
    pub fn name(&self) -> ArchitectureName {
        match self {
            Self::SvFourierNet => ArchitectureName::SvFourierNet,
            Self::MultiWienerNet => ArchitectureName::MultiWienerNet,
            Self::MultiFlatNet => ArchitectureName::MultiFlatNet,
            Self::Cm2Net { .. } => ArchitectureName::Cm2Net,
        }
    }
}
