//! A session with some of its frames only.

use ndarray::Array2;
use ommatidia_session::{
    ComputedFrames, ComputedStack, FrameInfo, FrameReader, Manifest, Session, SessionError, Stack, StackEntry,
};
use std::sync::{Arc, Mutex, PoisonError};

/// The session with those frames for which `keep` (index of the stack, stack, index of the frame) is true, and without
/// truths. Stacks of which nothing is kept are absent. Frames are read from the files of the session when they are
/// needed.
///
/// # Errors
/// A stack cannot be opened.
pub(crate) fn part_of(session: &Session, keep: impl Fn(usize, &Stack, usize) -> bool) -> Result<Session, SessionError> {
    let mut stacks = Vec::new();
    for (s, stack) in session.stacks().iter().enumerate() {
        let indices: Vec<usize> = (0..stack.len()).filter(|i| keep(s, stack, *i)).collect();
        if indices.is_empty() {
            continue;
        }
        let info =
            indices.iter().enumerate().map(|(n, i)| FrameInfo { frame: n, ..stack.info()[*i].clone() }).collect();
        let entry = StackEntry { truth: None, expected: None, ..stack.entry().clone() };
        let frames: Arc<dyn ComputedFrames> = Arc::new(Selected::of(stack, indices)?);
        stacks.push(ComputedStack { entry, info, frames });
    }
    let entries = stacks.iter().map(|stack| stack.entry.clone()).collect();
    let manifest = Manifest { stacks: entries, ..session.manifest().clone() };
    Ok(Session::computed(session.dir(), manifest, stacks))
}

/// Some frames of a stack.
#[derive(Debug)]
struct Selected {
    reader: Mutex<FrameReader>,
    /// Rows and columns of a frame.
    size: [usize; 2],
    /// Their indices in the stack.
    indices: Vec<usize>,
}

impl Selected {
    fn of(stack: &Stack, indices: Vec<usize>) -> Result<Self, SessionError> {
        let reader = stack.frames()?;
        Ok(Self { size: [reader.rows(), reader.cols()], reader: Mutex::new(reader), indices })
    }
}

impl ComputedFrames for Selected {
    fn shape(&self) -> [usize; 3] {
        [self.indices.len(), self.size[0], self.size[1]]
    }

    fn frames_from(&self, i: usize) -> Result<Vec<Array2<f32>>, SessionError> {
        let mut reader = self.reader.lock().unwrap_or_else(PoisonError::into_inner);
        Ok(vec![reader.read(self.indices[i])?])
    }
}
