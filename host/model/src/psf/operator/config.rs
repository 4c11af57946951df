//! What an operator is planned from, and its settings.

use super::error::OperatorError;
use crate::psf::chief_rays::ChiefRays;
use crate::psf::low_rank::LowRankPsf;

/// The calibrated optics that an operator is planned from.
#[derive(Clone, Copy, Debug)]
pub struct CalibratedOptics<'a> {
    /// Basis PSFs and coefficient maps.
    pub psf: &'a LowRankPsf,
    /// Chief rays of the calibration.
    pub rays: &'a ChiefRays,
    /// Rows and columns of objects.
    pub object: [usize; 2],
    /// Rows and columns of frames.
    pub sensor: [usize; 2],
}

/// Settings of a planned operator.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct OperatorConfig {
    /// Index of the depth, in the order of `LowRankPsf::node_depths_um`.
    pub depth: usize,
    /// Largest side of a transform, pixels; a window that needs more overrides it.
    pub max_transform_px: usize,
    /// Memory limit for the spectra of the basis PSFs of all lenses, bytes. Above it they are recomputed at each
    /// application.
    pub most_spectra_bytes: usize,
    /// Most relative root-mean-square error of the PSFs of a lens in any block, where the lenses share functions: only
    /// where the spectra exceed `most_spectra_bytes`, and where it costs less. 0: the terms of each lens everywhere.
    pub most_error: f64,
}

impl Default for OperatorConfig {
    fn default() -> Self {
        Self { depth: 0, max_transform_px: 1536, most_spectra_bytes: 512 << 20, most_error: 1e-3 }
    }
}

impl OperatorConfig {
    /// All terms everywhere, at the depth with this index: for what is judged to parts in a thousand.
    pub fn exact(depth: usize) -> Self {
        Self { depth, most_error: 0.0, ..Self::default() }
    }
}

/// Checks that the tables agree in size, that the depth exists, and that the magnification is that of the calibration.
pub(super) fn check(
    optics: CalibratedOptics<'_>,
    rays: &ChiefRays,
    config: OperatorConfig,
) -> Result<(), OperatorError> {
    let CalibratedOptics { psf, rays: calibrated, .. } = optics;
    let lenses = calibrated.anchors_px.len();
    let (m_lenses, rank, depths, node_rows, node_cols) = psf.coefficients.dim();
    let expect = |field, expected, found| {
        if expected == found { Ok(()) } else { Err(OperatorError::Field { field, expected, found }) }
    };
    expect("geometry.anchors_px", lenses, rays.anchors_px.len())?;
    expect("geometry.dead", lenses, rays.dead.len())?;
    expect("psf.basis (lenses)", lenses, psf.basis.dim().0)?;
    expect("psf.coefficients (lenses)", lenses, m_lenses)?;
    expect("psf.coefficients (rank)", psf.basis.dim().1, rank)?;
    expect("psf.node_rows_px", node_rows, psf.node_rows_px.len())?;
    expect("psf.node_cols_px", node_cols, psf.node_cols_px.len())?;
    if config.depth >= depths {
        return Err(OperatorError::Depth { found: config.depth, depths });
    }
    let (expected, found) = (calibrated.magnification, rays.magnification);
    if expected != found {
        return Err(OperatorError::Magnification { expected, found });
    }
    Ok(())
}
