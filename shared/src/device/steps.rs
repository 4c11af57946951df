//! Settings that a sensor counts in steps.

use crate::wire::{Limits, Setting, SettingError};

/// A setting whose register counts steps of `numer / denom` of the setting's unit.
#[derive(Clone, Copy, Debug)]
pub struct Steps {
    /// Which setting.
    pub setting: Setting,
    /// Numerator of a step, not 0.
    pub numer: u32,
    /// Denominator of a step, not 0.
    pub denom: u32,
    /// Least and largest count.
    pub counts: [u32; 2],
}

impl Steps {
    /// The value of a count, rounded to the nearest.
    pub fn value(&self, count: u32) -> u32 {
        let denom = u64::from(self.denom.max(1));
        ((u64::from(count) * u64::from(self.numer) + denom / 2) / denom).min(u32::MAX.into()) as u32
    }

    /// The count that is nearest to a value.
    pub fn count(&self, value: u32) -> u32 {
        let numer = u64::from(self.numer.max(1));
        let count = (u64::from(value) * u64::from(self.denom) + numer / 2) / numer;
        (count.min(u32::MAX.into()) as u32).min(self.counts[1]).max(self.counts[0])
    }

    /// The least and the largest value.
    pub fn limits(&self) -> Limits {
        Limits { least: self.value(self.counts[0]), most: self.value(self.counts[1]) }
    }

    /// The nearest value that the sensor has.
    ///
    /// # Errors
    /// [`SettingError`] where `value` is outside the limits.
    pub fn nearest(&self, value: u32) -> Result<u32, SettingError> {
        let Limits { least, most } = self.limits();
        if (least..=most).contains(&value) {
            return Ok(self.value(self.count(value)));
        }
        Err(SettingError { setting: self.setting, least, most, step: 1, found: value })
    }
}

/// Checks one number of a region.
///
/// # Errors
/// [`SettingError`] where `found` is no multiple of `step` from `least` to `most`.
pub fn check(setting: Setting, found: u16, [least, most]: [u16; 2], step: u16) -> Result<(), SettingError> {
    let fits = (least..=most).contains(&found) && found.checked_rem(step) == Some(0);
    let (least, most, step, found) = (least.into(), most.into(), step.into(), found.into());
    if fits { Ok(()) } else { Err(SettingError { setting, least, most, step, found }) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn the_nearest_value_is_one_that_the_sensor_has_and_at_most_half_a_step_away(
            numer in 1u32..5000, denom in 1u32..100, least in 0u32..50, more in 0u32..40_000, value: u32
        ) {
            let steps = Steps { setting: Setting::Exposure, numer, denom, counts: [least, least + more] };
            let Limits { least, most } = steps.limits();
            match steps.nearest(value) {
                Ok(nearest) => {
                    prop_assert_eq!(steps.value(steps.count(nearest)), nearest);
                    prop_assert_eq!(steps.nearest(nearest), Ok(nearest));
                    prop_assert!(2 * nearest.abs_diff(value) <= numer.div_ceil(denom) + 2, "{value} {nearest}");
                }
                Err(error) => {
                    prop_assert!(value < least || value > most);
                    prop_assert_eq!((error.least, error.most, error.found), (least, most, value));
                }
            }
        }
    }
}
