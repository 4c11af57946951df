//! The PSFs of an instrument at a place, and where its lenses see the object.

use crate::http::Answer;
use ommatidia_model::forward::{Depth, Forward, PredictRequest, Predictor};
use ommatidia_model::instrument::Instrument;
use serde_json::{Value, json};
use std::path::Path;

/// An instrument that is ready to show PSFs.
pub struct PointSources {
    instrument: Instrument,
    /// The depth that was planned last, by its index, and its plan.
    planned: Option<(usize, Predictor)>,
}

impl PointSources {
    /// Reads an instrument.
    ///
    /// # Errors
    /// It cannot be read.
    pub fn open(path: &Path) -> anyhow::Result<Self> {
        Ok(Self { instrument: Instrument::read(path)?, planned: None })
    }

    /// What a page needs to draw the place of a source, and what every lens sees of the object.
    pub fn geometry(&self) -> Value {
        let i = &self.instrument;
        json!({
            "anchors_px": i.geometry.anchors_px, "dead": i.geometry.dead,
            "px_per_um": i.geometry.magnification / i.manifest.sensor.pixel_pitch_um,
            "object": [i.manifest.object.rows, i.manifest.object.cols], "object_um": i.manifest.object.pixel_um,
            "sensor": [i.manifest.sensor.rows, i.manifest.sensor.cols], "pitch_um": i.manifest.sensor.pixel_pitch_um,
            "array": [i.manifest.array.rows, i.manifest.array.cols], "window_px": i.manifest.optics.psf_window_px,
            "depths_um": i.psf.node_depths_um, "sensor_only": i.sensor_only(),
            "beads_px": i.diagnostics.positions_px.outer_iter().map(|p| p.to_vec()).collect::<Vec<_>>(),
        })
    }

    /// The PSFs of all lenses for a source at `at_um`, [y, x], at a calibrated depth: float32, [lens, row, col],
    /// electrons of a unit source; the header `Foci` gives chief rays and corners of the windows.
    ///
    /// # Errors
    /// The depth is not calibrated, or the place lies outside the object.
    pub fn foci(&mut self, depth: usize, at_um: [f64; 2]) -> anyhow::Result<Answer> {
        let depths = self.instrument.psf.node_depths_um.len();
        anyhow::ensure!(depth < depths, "depth {depth}: the instrument has depths 0 to {}", depths - 1);
        let (_, predictor) = match self.planned.take().filter(|(at, _)| *at == depth) {
            Some(planned) => self.planned.insert(planned),
            None => {
                let request = PredictRequest { depth: Depth::Index(depth), ..PredictRequest::default() };
                self.planned.insert((depth, Predictor::new(self.instrument.clone(), request)?))
            }
        };
        let forward: &Forward = predictor.forward();
        let foci = forward.foci(at_um, self.instrument.manifest.optics.psf_window_px)?;
        let bytes: Vec<u8> = foci.windows_e.iter().flat_map(|v| v.to_le_bytes()).collect();
        let (lenses, rows, cols) = foci.windows_e.dim();
        let header = json!({
            "shape": [lenses, rows, cols], "chief_rays_px": foci.chief_rays_px, "corners_px": foci.corners_px,
        });
        Ok(Answer::new("application/octet-stream", bytes).note("Foci", header))
    }
}
