//! Reads pairs of a data set, one at a time.

use super::plan::{SHARD_KIND, VERSION};
use super::{DataSetError, DataSetPlan};
use ndarray::{Array2, ArrayD, Ix2};
use ommatidia_session::artifact::Index;
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};

/// The header of a shard.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct ShardBody {
    /// Index of the shard.
    pub shard: usize,
    /// SHA-256 of the plan.
    pub plan: String,
}

/// A complete data set, read pair by pair; it can be shared between threads.
#[derive(Clone, Debug)]
pub struct DataSet {
    dir: PathBuf,
    plan: DataSetPlan,
    shards: Vec<Index<ShardBody>>,
}

impl DataSet {
    /// Opens the data set in folder `dir`; all its shards must be there.
    ///
    /// # Errors
    /// The plan or a shard is missing, damaged, or belongs to another data set.
    pub fn open(dir: impl AsRef<Path>) -> Result<Self, DataSetError> {
        let dir = dir.as_ref();
        let plan = DataSetPlan::read(dir)?;
        let paths: Vec<_> = (0..plan.shards()).map(|k| DataSetPlan::shard_path(dir, k)).collect();
        let missing = paths.iter().filter(|p| !p.is_file()).count();
        if missing > 0 {
            return Err(DataSetError::Incomplete { path: dir.into(), missing, shards: paths.len() });
        }
        let shards = (0..plan.shards()).map(|k| open_shard(dir, &plan, k)).collect::<Result<_, _>>()?;
        Ok(Self { dir: dir.into(), plan, shards })
    }

    /// The folder of the data set.
    pub fn dir(&self) -> &Path {
        &self.dir
    }

    /// Contents and settings.
    pub fn plan(&self) -> &DataSetPlan {
        &self.plan
    }

    /// Number of pairs, at least one.
    #[allow(clippy::len_without_is_empty)] // an empty data set cannot be opened
    pub fn len(&self) -> usize {
        self.plan.count
    }

    /// Pair `i`: the object, [R, C], maximum 1, and its expected frame, electrons, [rows, cols], without noise.
    ///
    /// # Errors
    /// There is no such pair, or its shard has been damaged since the data set was opened.
    pub fn pair(&self, i: usize) -> Result<(Array2<f32>, Array2<f32>), DataSetError> {
        if i >= self.plan.count {
            return Err(DataSetError::NoPair { index: i, count: self.plan.count });
        }
        let k = i / self.plan.shard_pairs;
        let at = i % self.plan.shard_pairs;
        let entry = |name| -> Result<Array2<f32>, DataSetError> {
            let values: ArrayD<f32> = self.shards[k].read_entry(name, at)?;
            let path = DataSetPlan::shard_path(&self.dir, k);
            values.into_dimensionality::<Ix2>().map_err(|_| DataSetError::Foreign { path })
        };
        Ok((entry("objects")?, entry("frames_e")?))
    }
}

/// Opens shard `k` and checks that it belongs to the plan.
pub(super) fn open_shard(dir: &Path, plan: &DataSetPlan, k: usize) -> Result<Index<ShardBody>, DataSetError> {
    let path = DataSetPlan::shard_path(dir, k);
    let index: Index<ShardBody> = Index::open(&path, SHARD_KIND, VERSION)?;
    let n = plan.pairs_of(k).len();
    let damaged = |e: serde_json::Error| DataSetError::Plan { path: dir.into(), detail: e.to_string() };
    let hashes = [plan.hash().map_err(damaged)?, plan.hash_with_count().map_err(damaged)?];
    let ShardBody { shard, plan: stored } = &index.header().body;
    let belongs = *shard == k
        && hashes.contains(stored)
        && index.shape("objects")? == [n, plan.object[0], plan.object[1]]
        && index.shape("frames_e")? == [n, plan.frame[0], plan.frame[1]];
    if belongs { Ok(index) } else { Err(DataSetError::Foreign { path }) }
}
