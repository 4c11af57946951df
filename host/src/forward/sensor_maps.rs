//! The sensor maps of an instrument, including the effects that closing the loop added: what networks, devices and the
//! classical methods correct raw frames with.

use super::{Forward, ForwardError};
use crate::effects::{Chain, Layout, Stage};
use crate::instrument::Instrument;
use crate::sensor::SensorMaps;
use ndarray::{Array2, Zip};

/// Uniform light at which responses are read, as a share of full scale.
const EVEN: f64 = 0.25;

impl Instrument {
    /// Offset and inverse response of the sensor's pixels: as calibrated, or, where effects act on the sensor, from the
    /// model's frames of darkness and of uniform light.
    ///
    /// # Errors
    /// The parts of the instrument disagree.
    pub fn sensor_maps(&self) -> Result<SensorMaps, ForwardError> {
        let calibrated =
            SensorMaps { offset_dn: self.offset_dn.clone(), inverse_response: self.inverse_response(), unusable: None };
        let chain = Chain::build(&self.effects, Layout::of(&self.manifest))?;
        if ![Stage::Light, Stage::Charge, Stage::Electronics].iter().any(|s| chain.acts_at(*s)) {
            return Ok(calibrated);
        }
        let forward = Forward::new(self)?;
        let cx = forward.context();
        let shape = (self.manifest.sensor.rows, self.manifest.sensor.cols);
        let even = EVEN * self.noise.full_scale_e();
        let show = |electrons: f64| {
            let light = forward.on_sensor(Array2::from_elem(shape, electrons as f32), forward.effects(), &cx);
            forward.frame_dn(light, forward.effects(), &cx)
        };
        let (dark, lit) = (show(0.0), show(even));
        let full = (even * self.noise.gain_dn_per_e) as f32;
        let black = self.noise.black_level_dn as f32;
        let inverse =
            Zip::from(&lit).and(&dark).map_collect(|l, d| if l - d > 0.01 * full { full / (l - d) } else { 1.0 });
        Ok(SensorMaps { offset_dn: Some(dark.mapv(|d| d - black)), inverse_response: Some(inverse), unusable: None })
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;
    use crate::effects::EffectSetting;
    use crate::testing::instrument;

    #[test]
    fn what_the_loop_found_of_the_sensor_reaches_the_tables() {
        let mut i = instrument([9, 11], [30, 33], 5, 3);
        assert_eq!(i.sensor_maps().unwrap(), SensorMaps::default());
        i.effects = vec![
            EffectSetting::new("pixel_mosaic", &[("checker", 0.02)]),
            EffectSetting::new("row_pattern", &[("amplitude_dn", 3.0), ("period_rows", 2.0)]),
        ];
        let tables = i.sensor_maps().unwrap();
        let (offset, inverse) = (tables.offset_dn.unwrap(), tables.inverse_response.unwrap());
        assert!((offset[[0, 0]] - 3.0).abs() < 1e-3 && (offset[[1, 0]] + 3.0).abs() < 1e-3);
        assert!((inverse[[0, 0]] * 1.02 - 1.0).abs() < 1e-3 && (inverse[[0, 1]] * 0.98 - 1.0).abs() < 1e-3);
        // An effect before the sensor is no property of it.
        i.effects = vec![EffectSetting::new("array_shift", &[("row_px", 0.5)])];
        assert_eq!(i.sensor_maps().unwrap(), SensorMaps::default());
    }
}
