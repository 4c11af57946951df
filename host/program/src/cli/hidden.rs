//! The hidden effect of a demo: the seed selects an effect of the virtual instrument that the search must find.

use ommatidia_closing::{Account, Closing, Effect, Value, account_path};
use ommatidia_session::rng::stream;
use ommatidia_session::with_error;
use rand::Rng;
use serde_json::{Value as Json, json};
use std::path::Path;

/// An effect with its strength.
#[derive(Clone, Debug, PartialEq)]
pub struct Hidden {
    /// Its id.
    pub id: &'static str,
    /// Name of the parameter that is changed.
    pub param: String,
    /// Its value.
    pub strength: f64,
}

/// Possible hidden effects: id, first parameter and strength. Each is far above the detection limit of the demo's
/// session.
const HIDDEN: [(&str, &str, f64); 7] = [
    ("array_shift", "row_px", 0.25),
    ("lens_gain", "change_0", 0.08),
    ("charge_diffusion", "sigma_px", 0.45),
    ("vignetting", "v", 0.06),
    ("nonlinearity", "beta", 0.03),
    ("veiling_glare", "beta", 0.02),
    ("pixel_mosaic", "checker", 0.01),
];
/// Lenses of the demo instrument.
const LENSES: u32 = 9;

impl Hidden {
    /// The hidden effect for a seed.
    pub fn draw(seed: u64) -> Self {
        let mut rng = stream(seed, "demo/hidden", 0);
        let (id, param, strength) = HIDDEN[rng.next_u32() as usize % HIDDEN.len()];
        let param = match id {
            "lens_gain" => format!("change_{}", rng.next_u32() % LENSES),
            _ => param.to_string(),
        };
        Self { id, param, strength }
    }

    /// The argument of `bench --effect`: the first parameter, then the changed one.
    pub fn option(&self) -> String {
        match HIDDEN.iter().find(|h| h.0 == self.id) {
            Some((_, first, _)) if *first != self.param => format!("{}=0,{}={}", self.id, self.param, self.strength),
            _ => format!("{}={}", self.id, self.strength),
        }
    }

    /// The result of the search for it, as a line of text and as JSON. `closed` is the file of the closed instrument.
    ///
    /// # Errors
    /// The account beside that file cannot be read.
    pub fn outcome(&self, closed: &Path) -> anyhow::Result<(String, Json)> {
        let closing = Account::read(&account_path(closed))?.closing;
        Ok((self.line(&closing), self.figures(&closing)))
    }

    fn line(&self, c: &Closing) -> String {
        // The first effect and the hidden one with their values, the others by name.
        let (main, rest): (Vec<_>, Vec<_>) =
            c.effects.iter().enumerate().partition(|(i, e)| *i == 0 || e.id == self.id);
        let mut found: Vec<String> = main.into_iter().map(|(_, e)| self.words(e)).collect();
        if found.is_empty() {
            found.push("nothing".into());
        }
        if !rest.is_empty() {
            let names: Vec<&str> = rest.iter().map(|(_, e)| e.id.as_str()).collect();
            found.push(format!("less of {}", names.join(", ")));
        }
        format!(
            "hidden effect: {} ({} = {}) -> found: {}, chi2 {:.3} -> {:.3}",
            self.id,
            self.param,
            self.strength,
            found.join("; "),
            c.before.chi2_ndf,
            c.after.chi2_ndf
        )
    }

    /// The value of the changed parameter, if the effect is the hidden one.
    fn own<'e>(&self, e: &'e Effect) -> Option<&'e Value> {
        e.params.iter().find(|v| e.id == self.id && v.name == self.param)
    }

    /// An effect with the value of the changed parameter, or with its most significant one.
    fn words(&self, e: &Effect) -> String {
        let stands_out = |v: &&Value| if v.sigma > 0.0 { (v.value / v.sigma).abs() } else { 0.0 };
        let most = || e.params.iter().max_by(|a, b| stands_out(a).total_cmp(&stands_out(b)));
        let value = |v: &Value| format!(": {} = {} {}", v.name, with_error(v.value, v.sigma, 4), v.unit);
        let or = if e.ambiguity.is_empty() { String::new() } else { format!(" (or {})", e.ambiguity.join(", ")) };
        format!("{}{}{or}", e.id, self.own(e).or_else(most).map_or(String::new(), value).trim_end_matches(" 1"))
    }

    fn figures(&self, c: &Closing) -> Json {
        let named = |e: &Effect| e.id == self.id || e.ambiguity.iter().any(|a| a == self.id);
        let own = c.effects.iter().find_map(|e| self.own(e));
        json!({
            "id": self.id, "param": self.param, "strength": self.strength,
            "value": own.map(|v| v.value), "sigma": own.map(|v| v.sigma), "unit": own.map(|v| &v.unit),
            "found": c.effects.first().map(|e| &e.id), "named": c.effects.iter().any(|e| e.id == self.id),
            "among": c.effects.iter().any(named), "chi2_before": c.before.chi2_ndf, "chi2_after": c.after.chi2_ndf,
        })
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use ommatidia_closing::Figures;
    use ommatidia_physics::effects;

    #[test]
    fn every_effect_is_drawn_and_its_option_names_what_exists() {
        let drawn: Vec<Hidden> = (0..200).map(Hidden::draw).collect();
        assert_eq!(drawn, (0..200).map(Hidden::draw).collect::<Vec<_>>());
        for (id, ..) in HIDDEN {
            assert!(drawn.iter().any(|h| h.id == id), "{id} is never drawn");
        }
        for h in &drawn {
            let params = effects::find(h.id).unwrap().descriptor().expanded(LENSES as usize);
            assert!(params.iter().any(|(name, _)| *name == h.param), "{h:?}");
            let (first, _) = &params[0];
            assert!(h.option().starts_with(&format!("{}=0,", h.id)) != (*first == h.param), "{}", h.option());
        }
    }

    #[test]
    fn the_line_gives_the_hidden_value() {
        let hidden = Hidden { id: "lens_gain", param: "change_2".into(), strength: 0.08 };
        assert_eq!(hidden.option(), "lens_gain=0,change_2=0.08");
        let value = |l: u8| Value {
            name: format!("change_{l}"),
            value: 0.01 + 0.035 * f64::from(l),
            sigma: 0.001,
            sigma_noise: 0.001,
            unit: "1".into(),
        };
        let effect = Effect {
            id: "lens_gain".into(),
            known: true,
            stage: "optics".into(),
            added: true,
            changed: false,
            z: 40.0,
            excess_explained: None,
            held_out_gain: 1.0,
            ambiguity: Vec::new(),
            overlap: 0.0,
            separate_by: None,
            params: (0..3).map(value).collect(),
            description: String::new(),
        };
        let figures = |chi2_ndf| Figures { chi2_ndf, ..Figures::default() };
        let mut c = Closing { effects: vec![effect], before: figures(1.5), after: figures(1.01), ..Closing::default() };
        assert_eq!(
            hidden.line(&c),
            "hidden effect: lens_gain (change_2 = 0.08) -> found: lens_gain: change_2 = 0.0800 +- 0.0010, chi2 1.500 \
             -> 1.010"
        );
        assert_eq!(hidden.figures(&c)["named"], true);
        assert_eq!(hidden.figures(&c)["value"].as_f64().map(|v| (v * 1e3).round()), Some(80.0));
        c.effects.push(Effect { id: "halo".into(), ..c.effects[0].clone() });
        assert!(hidden.line(&c).contains("0.0010; less of halo, chi2"), "{}", hidden.line(&c));
        c.effects.clear();
        assert!(hidden.line(&c).contains("found: nothing"));
    }
}
