//! A virtual session whose frames are made as they are asked for: what would fill a disk never touches one.

use super::measure::{CALIBRATION_ROLES, VirtualInstrument};
use crate::session::{FrameInfo, FrameSource, Role, Session, SessionError};
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

impl FrameSource for LiveStack {
    fn shape(&self) -> [usize; 3] {
        let sensor = &self.instrument.config.sensor;
        [self.infos.len(), sensor.rows, sensor.cols]
    }

    fn frames_from(&self, i: usize) -> Result<Vec<Array2<f32>>, SessionError> {
        // As many at a time as there are threads for.
        let last = (i + rayon::current_num_threads()).min(self.infos.len());
        Ok(self.infos[i..last].par_iter().map(|info| self.frame(info)).collect())
    }
}

impl LiveStack {
    fn frame(&self, info: &FrameInfo) -> Array2<f32> {
        let lit = self.instrument.lit(self.role, &self.infos, info);
        self.instrument.read_out(&lit, (self.role, self.seed), info)
    }
}

impl VirtualInstrument {
    /// Darks, flats and bead scan of the session that [`VirtualInstrument::measure`] would write under `seed`, bit for bit, without
    /// writing them; a frame is made each time that it is read. `name` stands for the folder in messages.
    pub fn live(self: &Arc<Self>, name: &Path, seed: u64) -> Session {
        let stack = |role| {
            let infos = self.infos(role);
            let live = LiveStack { instrument: Arc::clone(self), role, seed, infos: infos.clone() };
            let maker: Arc<dyn FrameSource> = Arc::new(live);
            (self.entry(role), infos, maker)
        };
        let stacks = CALIBRATION_ROLES.into_iter().map(stack).filter(|(_, infos, _)| !infos.is_empty());
        Session::made(name, self.config.manifest(), stacks.collect())
    }
}
