//! Errors of the calibration in the frames of a session.

use super::model::Model;
use super::state::State;
use ndarray::Array2;
use ommatidia_physics::effects::TableUse;
use ommatidia_physics::noise::MapErrors;

/// Changes of the expected frames by errors of the calibration: independent directions, each of one standard deviation,
/// so that the covariance of the frames is the sum of their squares.
#[derive(Clone, Debug, Default)]
pub struct Errors {
    /// For each direction and frame the change, as far as the frame can show it, DN, [sensor rows, sensor cols]. None:
    /// the frame does not depend on the calibration.
    pub changes: Vec<Vec<Option<Array2<f32>>>>,
    /// Number of the first directions that are the scatter of replicates, which few of them show; the others are
    /// stated.
    pub scattered: usize,
}

/// Errors of the sensor maps: those of the calibration, or of the tables of a state, which refine them.
pub(crate) fn map_errors(model: &Model<'_>, state: &State) -> MapErrors {
    let of = |acts: TableUse, map: f64| {
        let mine = state.terms.iter().filter(|t| t.effect.table().is_some_and(|table| table.acts == acts));
        mine.map(|t| t.table_error).filter(|e| *e > 0.0).reduce(f64::min).unwrap_or(map)
    };
    MapErrors {
        response: of(TableUse::Response, model.maps.response),
        offset_dn: of(TableUse::Offset, model.maps.offset_dn),
        reading: model.maps.reading,
    }
}
