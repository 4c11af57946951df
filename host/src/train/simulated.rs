//! Pairs from data sets on disk, and pairs that are simulated when they are asked for.

use super::source::{Pair, PairSource};
use crate::dataset::{DataSet, DataSetError, DataSetPlan, SimulateConfig, Simulation};
use crate::instrument::Instrument;
use std::path::Path;

/// Pairs that an instrument can show when no data set is made first.
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

/// A planned data set of which no shard is ever written.
#[derive(Debug)]
pub struct Simulated {
    simulation: Simulation,
}

impl Simulated {
    /// As many pairs of an instrument (the file of which is named) as any training asks for, each made when it is asked for.
    ///
    /// # Errors
    /// The file cannot be read, or its noise not be planned with.
    pub fn of(instrument: &Instrument, file: &Path, seed: u64) -> Result<Self, DataSetError> {
        let config = SimulateConfig { count: PAIRS, ..SimulateConfig::default() };
        Ok(Self::new(config.build(instrument, file, seed)?))
    }

    /// The pairs of a plan.
    pub fn new(simulation: Simulation) -> Self {
        Self { simulation }
    }

    /// What they are.
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
