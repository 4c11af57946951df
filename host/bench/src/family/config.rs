//! Which family an instrument belongs to, and what the families are configured with.

use serde::{Deserialize, Serialize};

/// A family of instruments.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum FamilyName {
    /// Scalar diffraction at pupils with Zernike aberrations.
    #[default]
    Pupils,
    /// Relays with Seidel aberrations, by tracing rays.
    Relay,
    /// PSFs that were drawn at random or measured.
    Kernels,
}

impl FamilyName {
    /// All of them.
    pub const ALL: [Self; 3] = [Self::Pupils, Self::Relay, Self::Kernels];

    /// The name, as in a configuration.
    pub fn name(self) -> &'static str {
        match self {
            Self::Pupils => "pupils",
            Self::Relay => "relay",
            Self::Kernels => "kernels",
        }
    }
}

impl std::fmt::Display for FamilyName {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(self.name())
    }
}

impl std::str::FromStr for FamilyName {
    type Err = String;

    /// Parses the name.
    fn from_str(text: &str) -> Result<Self, String> {
        let known = Self::ALL.map(Self::name).join(", ");
        Self::ALL.into_iter().find(|f| f.name() == text).ok_or_else(|| format!("expected one of {known}"))
    }
}

/// Aberrations of the relays. Wavefront coefficients are those at the rim of the pupil, waves; terms that vary over the
/// field are given for the corner of the object and a lens on the optical axis.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct RelayConfig {
    /// W040.
    pub spherical: f64,
    /// W131.
    pub coma: f64,
    /// W222.
    pub astigmatism: f64,
    /// W220.
    pub field_curvature: f64,
    /// Displacement of a focus by W311 at the corner, pixels.
    pub distortion_px: f64,
    /// Manufacturing tolerance: rms over the lenses of defocus, coma and astigmatism that do not depend on the field.
    pub scatter: f64,
    /// Displacement of the second stop at the corner, pupil radii.
    pub stop_walk: f64,
    /// Radius of the second stop, pupil radii.
    pub stop_radius: f64,
    /// Rings of rays, and rays on each ring.
    pub rays: [usize; 2],
}

impl Default for RelayConfig {
    fn default() -> Self {
        Self {
            spherical: 0.05,
            coma: 0.1,
            astigmatism: 0.15,
            field_curvature: 0.16,
            distortion_px: -0.3,
            scatter: 0.03,
            stop_walk: 0.3,
            stop_radius: 1.05,
            rays: [7, 20],
        }
    }
}

/// What the frames of a stack of measured PSFs are.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum StackOf {
    /// One PSF at even steps of depth; each file is another PSF.
    #[default]
    Depths,
    /// PSFs on a square grid over the field, row by row, at one depth; each file is another such grid.
    Field,
}

impl std::str::FromStr for StackOf {
    type Err = String;

    /// Parses `depths` or `field`.
    fn from_str(text: &str) -> Result<Self, String> {
        match text {
            "depths" => Ok(Self::Depths),
            "field" => Ok(Self::Field),
            _ => Err("expected depths or field".into()),
        }
    }
}

/// The kernels and how they vary over the field. Terms that vary over the field are given for the corner of the object.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct KernelsConfig {
    /// Measured PSFs: files, or folders of files, one stack (`.npy`, `.tif`) a file, [frames, rows, cols]; empty: the
    /// kernels are drawn.
    pub psfs: Vec<String>,
    /// What the frames of such a stack are.
    pub stack_of: StackOf,
    /// Distance between the frames of a stack of depths, as the instrument shows them, um.
    pub slice_um: f64,
    /// Root mean square radius of the kernels (of the middle frame, of measured ones), pixels.
    pub rms_px: f64,
    /// Number of drawn kernels.
    pub count: usize,
    /// Lobes of a drawn kernel.
    pub lobes: usize,
    /// Standard deviation of the smallest lobe, pixels; the largest is twice as wide.
    pub lobe_px: f64,
    /// Turn of a drawn kernel with depth, rad per um.
    pub turn_rad_per_um: f64,
    /// How strongly the blend changes over the field: rms change of the logarithm of a weight.
    pub morph: f64,
    /// Turn over the field, rms over the lenses, rad.
    pub turn_rad: f64,
    /// Relative stretch over the field, rms over the lenses.
    pub stretch: f64,
    /// Distortion, rms over the lenses and terms, pixels.
    pub warp_px: f64,
    /// Light lost at the corner.
    pub falloff: f64,
}

impl Default for KernelsConfig {
    fn default() -> Self {
        Self {
            psfs: Vec::new(),
            stack_of: StackOf::Depths,
            slice_um: 4.0,
            rms_px: 2.0,
            count: 3,
            lobes: 5,
            lobe_px: 0.6,
            turn_rad_per_um: 0.006,
            morph: 0.6,
            turn_rad: 0.25,
            stretch: 0.08,
            warp_px: 0.2,
            falloff: 0.35,
        }
    }
}
