//! Parts of the optics that have moved: what effects on chief rays say about the parts themselves.
//!
//! | effect | what has moved |
//! |---|---|
//! | `array_shift`, `lens_decentre` | lenses, in their plane |
//! | `array_rotation` | the array, about its centre, by the exact rotation, and its place |
//! | `magnification` | the gap behind the array |
//! | `radial_distortion` | the distortion of each lens |

use ommatidia_physics::effects::EffectSetting;

/// Parts that have moved.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct Change {
    /// Displacement of all anchors, (row, col) pixels.
    pub shift_px: [f64; 2],
    /// Displacement of the anchor of each lens, (row, col) pixels; empty: none.
    pub decentre_px: Vec<[f64; 2]>,
    /// Turn of the array, rad, positive from the column axis to the row axis.
    pub turn_rad: f64,
    /// Relative change of the gap between array and sensor.
    pub gap: f64,
    /// Distortion, mm^-2 on the sensor.
    pub k1_per_mm2: f64,
}

impl Change {
    /// Whether an effect is one of a part that moves.
    pub(crate) fn knows(id: &str) -> bool {
        ["array_shift", "lens_decentre", "array_rotation", "magnification", "radial_distortion"].contains(&id)
    }

    /// What the settings say about parts; those of other effects say nothing. `lenses`: number of lenses.
    pub(crate) fn of(settings: &[EffectSetting], lenses: usize) -> Self {
        let mut change = Self { decentre_px: vec![[0.0; 2]; lenses], ..Self::default() };
        for setting in settings {
            let value = |name: &str| setting.params.get(name).copied().unwrap_or(0.0);
            match setting.id.as_str() {
                // A shift has no angle.
                "array_shift" | "array_rotation" => {
                    change.turn_rad += 1e-3 * value("angle_mrad");
                    change.shift_px[0] += value("row_px");
                    change.shift_px[1] += value("col_px");
                }
                "lens_decentre" => {
                    for (l, at) in change.decentre_px.iter_mut().enumerate() {
                        at[0] += value(&format!("row_px_{l}"));
                        at[1] += value(&format!("col_px_{l}"));
                    }
                }
                "magnification" => change.gap += value("eps"),
                "radial_distortion" => change.k1_per_mm2 += value("k1_per_mm2"),
                _ => {}
            }
        }
        change
    }

    /// The anchor of lens `l` after the turn about `centre_px` and the displacements, (row, col) pixels.
    pub(crate) fn anchor_px(&self, l: usize, anchor_px: [f64; 2], centre_px: [f64; 2]) -> [f64; 2] {
        let (sin, cos) = self.turn_rad.sin_cos();
        let [row, col] = [anchor_px[0] - centre_px[0], anchor_px[1] - centre_px[1]];
        let turned = if self.turn_rad == 0.0 { [row, col] } else { [row * cos + col * sin, col * cos - row * sin] };
        let own = self.decentre_px.get(l).copied().unwrap_or_default();
        [0, 1].map(|k| centre_px[k] + turned[k] + self.shift_px[k] + own[k])
    }
}
