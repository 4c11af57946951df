//! A virtual session whose frames are computed when they are read, for sessions too large for a disk.

use super::instrument::{Draw, VirtualInstrument};
use super::stacks::CALIBRATION_ROLES;
use crate::session::{ComputedFrames, ComputedStack, FrameInfo, Role, Session, SessionError};
use ndarray::Array2;
use rayon::prelude::*;
use std::path::Path;
use std::sync::Arc;

/// A stack of darks, flats or beads.
#[derive(Debug)]
struct LiveStack {
    instrument: Arc<VirtualInstrument>,
    role: Role,
    seed: u64,
    infos: Vec<FrameInfo>,
}

impl ComputedFrames for LiveStack {
    fn shape(&self) -> [usize; 3] {
        let sensor = &self.instrument.config.sensor;
        [self.infos.len(), sensor.rows, sensor.cols]
    }

    fn frames_from(&self, i: usize) -> Result<Vec<Array2<f32>>, SessionError> {
        // One frame for each thread.
        let last = (i + rayon::current_num_threads()).min(self.infos.len());
        Ok(self.infos[i..last].par_iter().map(|info| self.frame(info)).collect())
    }
}

impl LiveStack {
    fn frame(&self, info: &FrameInfo) -> Array2<f32> {
        let lit = self.instrument.lit(self.role, &self.infos, info);
        self.instrument.read_out(&lit, Draw { role: self.role, seed: self.seed }, info)
    }
}

impl VirtualInstrument {
    /// The darks, flats and bead scan that [`VirtualInstrument::measure`] would write under `seed`, with the same bits,
    /// but computed when they are read. `name` stands for the session's folder in error messages.
    pub fn live(self: &Arc<Self>, name: &Path, seed: u64) -> Session {
        let stack = |role| {
            let info = self.infos(role);
            let live = LiveStack { instrument: Arc::clone(self), role, seed, infos: info.clone() };
            ComputedStack { entry: self.entry(role), info, frames: Arc::new(live) }
        };
        let stacks = CALIBRATION_ROLES.into_iter().map(stack).filter(|s| !s.info.is_empty());
        Session::computed(name, self.config.manifest(), stacks.collect())
    }
}
