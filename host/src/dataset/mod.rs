//! The data set: training pairs (object, expected frame) in a folder of shards.
//!
//! ```text
//! dataset.json               what it holds and how it was made: the plan, written first
//! shard-00000.safetensors    `objects` [n, R, C], maximum 1; `frames_e` [n, rows, cols], expected electrons
//! shard-00001.safetensors    ...
//! ```
//! Each shard appears whole or not at all and depends only on the plan and its number, so a killed run is taken up
//! where it was, and machines share the work (`--shard I/N`) without talking to one another. Noise is not in it: training
//! draws it anew each time a pair is seen.

mod build;
mod plan;
mod reader;

pub use build::{Progress, Share, SimulateConfig, Simulation};
pub use plan::{DataSetError, DataSetPlan, PLAN_FILE};
pub use reader::DataSet;

#[cfg(test)]
mod tests;
