//! The scenes of a session whose objects are known, numbered over all of its stacks, read frame by frame.

use super::{Case, Triple};
use crate::effects::FrameContext;
use crate::forward::Forward;
use crate::session::{FrameInfo, FrameReader, Role, Session, TruthReader};
use anyhow::Context;

struct Known {
    frames: FrameReader,
    truth: TruthReader,
    expected: Option<FrameReader>,
    info: Vec<FrameInfo>,
}

/// The scenes with truth.
pub struct Scenes {
    stacks: Vec<Known>,
    /// Stack and frame of each scene.
    index: Vec<(usize, usize)>,
}

impl Scenes {
    /// Finds the scene stacks that have a truth; keeps `most` scenes at most.
    ///
    /// # Errors
    /// There is none, or a file was taken away since the session was opened.
    pub fn of(session: &Session, most: Option<usize>) -> anyhow::Result<Self> {
        let mut stacks = Vec::new();
        for stack in session.stacks_of(Role::Scene) {
            if let Some(truth) = stack.truth()? {
                let (frames, expected) = (stack.frames()?, stack.expected()?);
                stacks.push(Known { frames, truth, expected, info: stack.info().to_vec() });
            }
        }
        let all = stacks.iter().enumerate().flat_map(|(s, k)| (0..k.frames.len()).map(move |i| (s, i)));
        let index: Vec<_> = all.take(most.unwrap_or(usize::MAX)).collect();
        anyhow::ensure!(
            !index.is_empty(),
            "{}: expected a scene stack with `truth`, found none; methods are judged against known objects",
            session.manifest_path().display()
        );
        Ok(Self { stacks, index })
    }

    /// Number of scenes.
    pub fn count(&self) -> usize {
        self.index.len()
    }

    /// Depth of the object of scene `i`, um.
    pub fn z_um(&self, i: usize) -> f64 {
        let (s, frame) = self.index[i];
        self.stacks[s].info.get(frame).map_or(0.0, |info| info.z_um)
    }

    /// Frame and known object of scene `i`.
    ///
    /// # Errors
    /// A file cannot be read or holds what it should not.
    pub fn case(&mut self, i: usize) -> anyhow::Result<Case> {
        let (s, frame) = self.index[i];
        let stack = &mut self.stacks[s];
        Ok(Case { frame_dn: stack.frames.read(frame)?, truth: stack.truth.read(frame)? })
    }

    /// Scene `i` as it was measured, as it is expected where that is known, and as a model predicts it from the truth.
    ///
    /// # Errors
    /// A file cannot be read, or the model does not fit the session.
    pub fn triple(&mut self, i: usize, forward: &Forward) -> anyhow::Result<Triple> {
        let Case { frame_dn: measured, truth } = self.case(i)?;
        let (s, frame) = self.index[i];
        let stack = &mut self.stacks[s];
        let cx = context(forward, &stack.info[frame]);
        let predicted = forward.expected_dn(truth.view(), &cx).with_context(|| format!("scene frame {i}"))?;
        let expected = stack.expected.as_mut().map(|e| e.read(frame)).transpose()?;
        Ok(Triple { predicted, expected, measured })
    }
}

/// What the session's table says of a frame.
fn context<'a>(forward: &'a Forward, info: &FrameInfo) -> FrameContext<'a> {
    FrameContext {
        frame: info.frame,
        time_s: info.time_s,
        exposure_ms: info.exposure_ms,
        illumination: info.illumination,
        ..forward.context()
    }
}
