//! What the sensor of an instrument, with all that the loop added to it, does to darkness and to even light: the tables
//! that networks, devices and the classical methods correct raw frames with.

use super::{Forward, ForwardError};
use crate::effects::{Chain, Layout, Stage};
use crate::instrument::Instrument;
use ndarray::{Array2, Zip};

/// Share of full scale of the even light that responses are read at.
const EVEN: f64 = 0.25;

/// Correction tables, [sensor rows, sensor cols].
#[derive(Clone, Debug, Default, PartialEq)]
pub struct SensorTables {
    /// Dark signal above the black level, DN.
    pub offset_dn: Option<Array2<f32>>,
    /// One over the response to light.
    pub inverse_response: Option<Array2<f32>>,
}

impl Instrument {
    /// The tables: as calibrated, or, where effects act on the sensor, as darkness and even light come out of the
    /// model.
    ///
    /// # Errors
    /// The parts of the instrument disagree.
    pub fn sensor_tables(&self) -> Result<SensorTables, ForwardError> {
        let calibrated = SensorTables { offset_dn: self.offset_dn.clone(), inverse_response: self.inverse_response() };
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
        Ok(SensorTables { offset_dn: Some(dark.mapv(|d| d - black)), inverse_response: Some(inverse) })
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
        assert_eq!(i.sensor_tables().unwrap(), SensorTables::default());
        i.effects = vec![
            EffectSetting::new("pixel_mosaic", &[("checker", 0.02)]),
            EffectSetting::new("row_pattern", &[("amplitude_dn", 3.0), ("period_rows", 2.0)]),
        ];
        let tables = i.sensor_tables().unwrap();
        let (offset, inverse) = (tables.offset_dn.unwrap(), tables.inverse_response.unwrap());
        assert!((offset[[0, 0]] - 3.0).abs() < 1e-3 && (offset[[1, 0]] + 3.0).abs() < 1e-3);
        assert!((inverse[[0, 0]] * 1.02 - 1.0).abs() < 1e-3 && (inverse[[0, 1]] * 0.98 - 1.0).abs() < 1e-3);
        // An effect before the sensor is no property of it.
        i.effects = vec![EffectSetting::new("array_shift", &[("row_px", 0.5)])];
        assert_eq!(i.sensor_tables().unwrap(), SensorTables::default());
    }
}
