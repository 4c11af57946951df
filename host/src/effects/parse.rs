//! Effect settings as text: `halo=0.05` or `halo=0.05,sigma_px=20`.

use super::{EffectError, EffectSetting, find, ids};
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
        let first = effect.descriptor().expanded(1).into_iter().next().map_or_else(String::new, |(name, _)| name);
        let mut params = vec![(first, number(values.next().unwrap_or_default())?)];
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
