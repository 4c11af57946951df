//! What a unit of an integer feature is worth, in networks with features of 8 bits.

use super::NetworkConfig;
use serde::{Deserialize, Serialize};

/// Features that share their steps.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Features {
    /// All that skip connections and attention add up: they have the same unit.
    Sums,
    /// Between the two convolutions of a block, counted over all groups.
    Inner(usize),
    /// Behind the pixel shuffle.
    Fine,
}

/// The value of a unit of the features of an enhancement network in integers, for each channel.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FeatureSteps {
    /// Of [`Features::Sums`].
    pub sums: Vec<f32>,
    /// Of [`Features::Inner`], for each block.
    pub inner: Vec<Vec<f32>>,
    /// Of [`Features::Fine`].
    pub fine: Vec<f32>,
}

impl FeatureSteps {
    /// The same step for all features of a network.
    pub fn even(network: &NetworkConfig, step: f32) -> Self {
        let each = vec![step; network.width];
        Self { sums: each.clone(), inner: vec![each.clone(); network.groups * network.blocks], fine: each }
    }

    /// The steps of some features; None where there is no such block.
    pub fn of(&self, features: Features) -> Option<&[f32]> {
        match features {
            Features::Sums => Some(&self.sums),
            Features::Inner(block) => self.inner.get(block).map(Vec::as_slice),
            Features::Fine => Some(&self.fine),
        }
    }

    /// The steps of some features, to be changed.
    pub fn of_mut(&mut self, features: Features) -> Option<&mut [f32]> {
        match features {
            Features::Sums => Some(&mut self.sums),
            Features::Inner(block) => self.inner.get_mut(block).map(Vec::as_mut_slice),
            Features::Fine => Some(&mut self.fine),
        }
    }

    /// Whether there is a positive, finite step for each channel of all features of a network.
    pub fn fits(&self, network: &NetworkConfig) -> bool {
        let all = self.inner.iter().chain([&self.sums, &self.fine]);
        let sound = |steps: &Vec<f32>| steps.len() == network.width && steps.iter().all(|s| s.is_normal() && *s > 0.0);
        self.inner.len() == network.groups * network.blocks && all.into_iter().all(sound)
    }
}
