//! Effect settings as text: `halo=0.05` or `halo=0.05,sigma_px=20`.

use super::{Effect, EffectError, EffectSetting, find, ids};
use std::fmt;
use std::str::FromStr;
use thiserror::Error;

/// Errors of [`EffectSetting::from_str`].
#[derive(Debug, Error)]
pub enum EffectParseError {
    /// The effect is not in the catalogue.
    #[error(transparent)]
    Effect(#[from] EffectError),
    /// The text is not of the form `ID=STRENGTH[,NAME=VALUE..]`.
    #[error("expected {0}; e.g. `halo=0.05` or `halo=0.05,sigma_px=20`")]
    Form(String),
}

/// Name of the first parameter of an effect, that of the first lens where each lens has its own.
fn first_name(effect: &dyn Effect) -> String {
    effect.descriptor().expanded(1).into_iter().next().map_or_else(String::new, |(name, _)| name)
}

/// The text that [`EffectSetting::from_str`] reads, without tables.
impl fmt::Display for EffectSetting {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let effect = find(&self.id);
        let (first, off) = effect.map(|e| (first_name(e), e.descriptor().params[0].off)).unwrap_or_default();
        write!(f, "{}={}", self.id, self.params.get(&first).copied().unwrap_or(off))?;
        self.params
            .iter()
            .filter(|(name, _)| **name != first)
            .try_for_each(|(name, value)| write!(f, ",{name}={value}"))
    }
}

impl FromStr for EffectSetting {
    type Err = EffectParseError;

    /// Parses `ID=STRENGTH` and, after commas, `NAME=VALUE` of further parameters. The strength is the first parameter
    /// of the effect. Names and ranges of parameters are checked when the effect is built.
    fn from_str(text: &str) -> Result<Self, EffectParseError> {
        let wanted = |what: &str| EffectParseError::Form(what.into());
        let (id, values) = text.split_once('=').ok_or_else(|| wanted("ID=STRENGTH"))?;
        let Some(effect) = find(id) else {
            return Err(EffectError::Unknown { found: id.into(), known: ids().join(", ") }.into());
        };
        let number = |value: &str| {
            value.trim().parse::<f64>().map_err(|_| {
                wanted(&format!(
                    "a number, found \
            `{value}`"
                ))
            })
        };
        let mut values = values.split(',');
        let mut params = vec![(first_name(effect), number(values.next().unwrap_or_default())?)];
        for pair in values {
            let (name, value) = pair.split_once('=').ok_or_else(|| wanted(&format!("NAME=VALUE, found `{pair}`")))?;
            let name = name.trim();
            if params.iter().any(|(known, _)| known == name) {
                return Err(wanted(&format!("`{name}` once")));
            }
            params.push((name.into(), number(value)?));
        }
        let params: Vec<(&str, f64)> = params.iter().map(|(name, value)| (name.as_str(), *value)).collect();
        Ok(Self::new(id, &params))
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    #[test]
    fn text_is_read_as_it_is_written() {
        for text in ["halo=0.05,sigma_px=20", "array_shift=-0.3,col_px=0.25", "lens_gain=0.1,change_3=-0.02"] {
            assert_eq!(text.parse::<EffectSetting>().unwrap().to_string(), text);
        }
    }
}
