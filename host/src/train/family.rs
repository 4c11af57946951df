//! Which network: SV-FourierNet, and the peers that the paper holds it against.

use serde::{Deserialize, Serialize};

/// A family of networks. All but CM2Net are a bank of filters in front of the same enhancement.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase", tag = "name", deny_unknown_fields)]
pub enum Family {
    /// Filters are learned in frequency: `X = K Y`.
    #[default]
    SvFourierNet,
    /// PSFs are learned in space, and a regularisation K each (K. Yanny et al., Optica 9, 96 (2022)): `X = conj(H) Y / (|H|^2 + K)`.
    MultiWienerNet,
    /// Filters are learned in space, which start as the pseudo-inverses of PSFs (J. Wu et al., iScience 26, 108307 (2023)): `X = F(w) Y`.
    MultiFlatNet,
    /// The view of each lens is cut out, freed of the other views, and all are joined (Y. Xue et al., Light Sci. Appl. 11, 259 (2022)).
    /// Its blocks have no batch normalisation: a step here sees one frame.
    Cm2Net {
        /// Frame pixel of object pixel (0, 0) in the view of each living lens.
        crops: Vec<[i32; 2]>,
    },
}

/// The families by name.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, clap::ValueEnum)]
#[serde(rename_all = "lowercase")]
#[value(rename_all = "lower")]
pub enum FamilyName {
    /// Filters learned in frequency.
    #[default]
    SvFourierNet,
    /// PSFs learned in space, and a regularisation each.
    MultiWienerNet,
    /// Filters learned in space.
    MultiFlatNet,
    /// Views cut out, demixed and joined.
    Cm2Net,
}

impl FamilyName {
    /// As on the command line and in tables.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::SvFourierNet => "svfouriernet",
            Self::MultiWienerNet => "multiwienernet",
            Self::MultiFlatNet => "multiflatnet",
            Self::Cm2Net => "cm2net",
        }
    }
}

impl Family {
    /// Its name.
    pub fn name(&self) -> FamilyName {
        match self {
            Self::SvFourierNet => FamilyName::SvFourierNet,
            Self::MultiWienerNet => FamilyName::MultiWienerNet,
            Self::MultiFlatNet => FamilyName::MultiFlatNet,
            Self::Cm2Net { .. } => FamilyName::Cm2Net,
        }
    }
}
