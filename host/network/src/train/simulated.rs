//! Training pairs from a data set on disk, and pairs that are simulated when they are needed.

use super::pairs::{Pair, PairSource};
use ommatidia_model::dataset::{DataSet, DataSetError, DataSetPlan, SimulateConfig, Simulation};
use ommatidia_model::instrument::Instrument;
use ommatidia_physics::effects::EffectSetting;
use std::path::Path;

/// Number of pairs that an instrument provides where no data set was made: more than any training uses.
const PAIRS: usize = 100_000;

impl PairSource for DataSet {
    fn len(&self) -> usize {
        DataSet::len(self)
    }

    fn pair(&self, index: usize) -> Result<Pair, Box<dyn std::error::Error + Send + Sync>> {
        let (object, expected_e) = DataSet::pair(self, index)?;
        Ok(Pair { object, expected_e })
    }
}

/// A planned data set whose pairs are simulated when they are needed; nothing is written to disk.
#[derive(Debug)]
pub struct Simulated {
    simulation: Simulation,
}

impl Simulated {
    /// Pairs of an instrument, 100,000 of them, each simulated when it is needed. `file` is the instrument's file,
    /// `seed` draws the objects; half of the pairs have one of the effects of `vary`, as in [`SimulateConfig::vary`].
    ///
    /// # Errors
    /// The file cannot be read, no data set can be planned with the instrument, or an effect is invalid.
    pub fn of(instrument: &Instrument, file: &Path, seed: u64, vary: &[EffectSetting]) -> Result<Self, DataSetError> {
        let config = SimulateConfig { count: PAIRS, vary: vary.to_vec(), ..SimulateConfig::default() };
        Ok(Self::new(config.build(instrument, file, seed)?))
    }

    /// The pairs of a planned data set.
    pub fn new(simulation: Simulation) -> Self {
        Self { simulation }
    }

    /// The plan: sizes, noise, brightness.
    pub fn plan(&self) -> &DataSetPlan {
        self.simulation.plan()
    }
}

impl PairSource for Simulated {
    fn len(&self) -> usize {
        self.plan().count
    }

    fn pair(&self, index: usize) -> Result<Pair, Box<dyn std::error::Error + Send + Sync>> {
        let (object, expected_e) = self.simulation.pair(index)?;
        Ok(Pair { object, expected_e })
    }
}
