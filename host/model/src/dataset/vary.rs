//! Effects that some pairs have: what may have changed in the instrument since it was calibrated.
//!
//! Their strengths hold at the light of the pair. Training draws light anew, and scales light of an effect with it.

use super::DataSetError;
use ommatidia_physics::effects::{Chain, EffectSetting, Kind, Layout, Stage, find};
use ommatidia_session::rng;
use rand::RngExt;

/// The parameter that draws the pattern of an effect, and the number of patterns.
const SEED: &str = "seed";
const SEEDS: u32 = 10_000;

/// Draws effects for pairs. Half of the pairs have none; each other one has one of the effects, with strengths drawn
/// evenly up to the largest ones, of either sign where the effect allows both.
#[derive(Clone, Debug, Default)]
pub(super) struct Vary {
    /// Effects at their largest strengths.
    largest: Vec<EffectSetting>,
    lenses: usize,
}

impl Vary {
    /// Effects at their largest strengths, which act before the Poisson draw: training draws noise of its own.
    ///
    /// # Errors
    /// An effect or parameter is unknown, a value is out of range, an effect has no strength, or it acts on charge,
    /// electronics or records.
    pub fn of(largest: &[EffectSetting], layout: Layout) -> Result<Self, DataSetError> {
        for setting in largest {
            if Chain::build(std::slice::from_ref(setting), layout)?.is_empty() {
                let expected = "a largest strength that changes the frames";
                return Err(DataSetError::Config { field: "vary", expected, found: setting.to_string() });
            }
            let stage = find(&setting.id).map_or(Stage::Record, |effect| effect.descriptor().stage);
            if stage >= Stage::Charge {
                let expected = "an effect on light: training draws the noise of charge and electronics itself";
                return Err(DataSetError::Config { field: "vary", expected, found: setting.id.clone() });
            }
        }
        Ok(Self { largest: largest.to_vec(), lenses: layout.lenses })
    }

    /// Whether any effect moves chief rays or sources, for which the optics of all depths are needed.
    pub fn moves(&self) -> bool {
        self.largest.iter().any(|s| find(&s.id).is_some_and(|e| e.descriptor().stage == Stage::Geometry))
    }

    /// The effects at their largest strengths.
    pub fn largest(&self) -> &[EffectSetting] {
        &self.largest
    }

    /// The effect of scene `scene` of `seed`, if it has one.
    pub fn draw(&self, seed: u64, scene: u64) -> Option<EffectSetting> {
        let mut rng = rng::stream(seed, "simulate/effect", scene);
        if self.largest.is_empty() || rng.random_bool(0.5) {
            return None;
        }
        let mut setting = self.largest[rng.random_range(0..self.largest.len())].clone();
        for (name, param) in find(&setting.id)?.descriptor().expanded(self.lenses) {
            let part: f64 = match param.kind {
                Kind::Strength => rng.random_range(-1.0..=1.0),
                Kind::Square => rng.random_range(0.0..=1.0),
                // A pattern of its own for each scene: a network would learn one that all share.
                Kind::Choice if name == SEED => {
                    setting.params.insert(name, f64::from(rng.random_range(0..SEEDS)));
                    continue;
                }
                Kind::Shape(_) | Kind::Choice => continue,
            };
            if let Some(value) = setting.params.get_mut(&name) {
                let size = *value - param.off;
                let drawn = param.off + part * size;
                // One side of `off` may be forbidden: the other one has the same size.
                let within = (param.min..=param.max).contains(&drawn);
                *value = if within { drawn } else { param.off - part * size };
            }
        }
        Some(setting)
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    const LAYOUT: Layout = Layout { lenses: 9, sensor: [20, 20] };

    #[test]
    fn half_of_the_scenes_have_an_effect_up_to_its_largest_strength() {
        let largest = [
            EffectSetting::new("array_shift", &[("row_px", 0.5)]),
            EffectSetting::new("veiling_glare", &[("beta", 0.02)]),
        ];
        let vary = Vary::of(&largest, LAYOUT).unwrap();
        assert!(vary.moves());
        let drawn: Vec<EffectSetting> = (0..400).filter_map(|scene| vary.draw(7, scene)).collect();
        assert!((160..240).contains(&drawn.len()), "{}", drawn.len());
        let of = |id: &str, name: &str| -> Vec<f64> {
            drawn.iter().filter(|s| s.id == id).map(|s| s.params[name]).collect()
        };
        let (shifts, glare) = (of("array_shift", "row_px"), of("veiling_glare", "beta"));
        assert_eq!(shifts.len() + glare.len(), drawn.len());
        let range = |v: &[f64]| v.iter().fold([f64::MAX, f64::MIN], |[a, b], v| [a.min(*v), b.max(*v)]);
        let ([low, high], [least, most]) = (range(&shifts), range(&glare));
        assert!((-0.5..-0.4).contains(&low) && (0.4..=0.5).contains(&high), "{low} {high}");
        assert!((0.0..0.002).contains(&least) && (0.018..=0.02).contains(&most), "{least} {most}");
        assert_eq!(vary.draw(7, 3), vary.draw(7, 3));
        assert!((0..400).all(|scene| Vary::default().draw(7, scene).is_none()));
    }

    #[test]
    fn each_scene_has_a_pattern_of_its_own() {
        let vary = Vary::of(&["dust=0.2".parse().unwrap()], LAYOUT).unwrap();
        let seeds = (0..40).filter_map(|scene| Some(vary.draw(1, scene)?.params["seed"].to_bits()));
        assert!(seeds.collect::<std::collections::BTreeSet<u64>>().len() > 10);
    }

    #[test]
    fn effects_that_noise_hides_and_effects_without_strength_are_refused() {
        let refused = |setting| Vary::of(&[setting], LAYOUT).err().unwrap().to_string();
        let text = refused(EffectSetting::new("row_noise", &[("sigma_dn", 2.0)]));
        assert!(text.contains("row_noise") && text.contains("light"), "{text}");
        let text = refused(EffectSetting::new("array_shift", &[]));
        assert!(text.contains("array_shift") && text.contains("strength"), "{text}");
        assert!(refused(EffectSetting::new("array_shfit", &[])).contains("array_shfit"));
    }
}
