//! Pairs from data sets on disk, and pairs that are simulated when they are asked for.

use super::source::{Pair, PairSource};
use crate::dataset::{DataSet, DataSetPlan, Simulation};

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
