//! The raw frames that an instrument delivers, for the methods that start from an instrument.

use super::MethodError;
use crate::network_file::NetworkFile;
use ommatidia_model::instrument::Instrument;
use ommatidia_physics::noise::NoiseModel;
use ommatidia_physics::sensor::{FrameInput, FrameRange};
use ommatidia_session::artifact;
use ommatidia_session::kind::FileKind;
use std::path::Path;

/// What a file knows of the frames that it is made for: an instrument, a checkpoint or a network file; `None` for files
/// of other kinds.
///
/// # Errors
/// The file cannot be read.
pub fn frame_range(path: &Path) -> anyhow::Result<Option<FrameRange>> {
    Ok(match FileKind::of(path)? {
        FileKind::Blob => {
            let sensor = NetworkFile::read(path)?.header()?.sensor;
            let (black_level_dn, saturation_dn) = (sensor.black_level_dn.into(), sensor.saturation_dn.into());
            Some(FrameRange { black_level_dn, saturation_dn })
        }
        FileKind::Artifact(_) => {
            let noise: Option<NoiseModel> =
                serde_json::from_value(artifact::inspect(path)?["body"]["noise"].clone()).ok();
            noise.map(|NoiseModel { black_level_dn, saturation_dn, .. }| FrameRange { black_level_dn, saturation_dn })
        }
        _ => None,
    })
}

/// Checks and corrects raw frames with the black level and sensor maps of an instrument, including the effects that
/// closing the loop added to it.
///
/// # Errors
/// The parts of the instrument disagree.
pub fn frame_input(instrument: &Instrument) -> Result<FrameInput, MethodError> {
    let sensor = &instrument.manifest.sensor;
    let maps = instrument.sensor_maps()?;
    Ok(FrameInput::new(instrument.noise.black_level_dn, maps, [sensor.rows, sensor.cols])?)
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use ndarray::Array2;
    use ommatidia_model::testing::square_array as instrument;
    use ommatidia_physics::sensor::FrameError;

    #[test]
    fn black_level_and_fixed_pattern_go() {
        let mut instrument = instrument(1, [20, 30], [10, 10]);
        let pattern = Array2::from_shape_fn((20, 30), |(r, c)| (r as f32 - c as f32) * 0.125);
        instrument.offset_dn = Some(pattern.clone());
        let frame = pattern + 64.0 + 5.0;
        let light = frame_input(&instrument).unwrap().light_dn(frame.view()).unwrap();
        assert!(light.iter().all(|&v| v == 5.0));
    }

    #[test]
    fn unlike_pixels_become_alike_and_a_dead_one_is_left() {
        let mut instrument = instrument(1, [20, 30], [10, 10]);
        let mut response = Array2::from_shape_fn((20, 30), |(r, _)| if r % 2 == 0 { 0.8 } else { 1.25 });
        response[[3, 3]] = 0.0;
        let mut frame = response.mapv(|r| 64.0 + 100.0 * r);
        frame[[3, 3]] = 64.0;
        instrument.response = Some(response);
        let light = frame_input(&instrument).unwrap().light_dn(frame.view()).unwrap();
        assert!(light.indexed_iter().all(|(at, v)| (v - if at == (3, 3) { 0.0 } else { 100.0 }).abs() < 1e-4));
    }

    #[test]
    fn bad_frames_are_refused() {
        let input = frame_input(&instrument(1, [20, 30], [10, 10])).unwrap();
        let wrong = input.light_dn(Array2::zeros((30, 20)).view()).unwrap_err();
        assert!(matches!(wrong, FrameError::Shape { expected: [20, 30], found: [30, 20] }));
        let mut frame = Array2::zeros((20, 30));
        frame[[1, 2]] = f32::NAN;
        assert!(matches!(input.light_dn(frame.view()), Err(FrameError::NotFinite { row: 1, col: 2, .. })));
    }
}
