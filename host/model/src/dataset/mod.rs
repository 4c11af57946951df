//! The data set: training pairs (object, expected frame) in a folder of shards.
//!
//! ```text
//! dataset.json               what it holds and how it was made: the plan, written first
//! shard-00000.safetensors    `objects` [n, R, C], maximum 1; `frames_e` [n, rows, cols], expected electrons
//! shard-00001.safetensors    ...
//! ```
//! Each shard appears whole or not at all and depends only on the plan and its number. A killed run can therefore be
//! resumed, and several machines can share the work (`--shard I/N`) without communication. The frames are free of
//! noise: training draws new noise each time that it uses a pair.

mod build;
mod plan;
mod reader;
mod vary;

pub use build::{Progress, Share, SimulateConfig, Simulation};
pub use plan::{DataSetError, DataSetPlan, PLAN_FILE};
pub use reader::DataSet;

#[cfg(test)]
mod tests;
