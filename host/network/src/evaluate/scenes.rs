//! The scenes of a session whose objects are known, numbered over all of its stacks and read frame by frame.

use anyhow::Context;
use ommatidia_model::forward::Forward;
use ommatidia_model::metrics::{Case, FrameComparison};
use ommatidia_physics::effects::FrameContext;
use ommatidia_session::{FrameInfo, FrameReader, Role, Session, TruthReader};

/// A scene stack with known objects.
struct Known {
    frames: FrameReader,
    truth: TruthReader,
    expected: Option<FrameReader>,
    info: Vec<FrameInfo>,
}

/// The scenes of a session that have a truth.
pub struct Scenes {
    stacks: Vec<Known>,
    /// Stack and frame of each scene.
    index: Vec<(usize, usize)>,
}

impl Scenes {
    /// The scene stacks of `session` that have a truth, limited to the first `most` scenes. Frames that are marked as
    /// damaged are left out.
    ///
    /// # Errors
    /// There are no such scenes, or a file was removed since the session was opened.
    pub fn of(session: &Session, most: Option<usize>) -> anyhow::Result<Self> {
        let mut stacks = Vec::new();
        for stack in session.stacks_of(Role::Scene) {
            if let Some(truth) = stack.truth()? {
                let (frames, expected) = (stack.frames()?, stack.expected()?);
                stacks.push(Known { frames, truth, expected, info: stack.info().to_vec() });
            }
        }
        let whole = |k: &Known| -> Vec<usize> {
            (0..k.frames.len()).filter(|i| k.info.get(*i).is_none_or(|info| !info.is_damaged())).collect()
        };
        let all = stacks.iter().enumerate().flat_map(|(s, k)| whole(k).into_iter().map(move |i| (s, i)));
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

    /// The place of each scene among all scene frames with a truth, those that are left out counted: reconstructions of
    /// all frames have one at each place.
    pub fn places(&self) -> Vec<usize> {
        let before = |s: usize| self.stacks[..s].iter().map(|k| k.frames.len()).sum::<usize>();
        self.index.iter().map(|(s, frame)| before(*s) + frame).collect()
    }

    /// Depth of the object in scene `i`, um.
    pub fn z_um(&self, i: usize) -> f64 {
        let (s, frame) = self.index[i];
        self.stacks[s].info.get(frame).map_or(0.0, |info| info.z_um)
    }

    /// Frame and known object of scene `i`.
    ///
    /// # Errors
    /// A file cannot be read or holds values that are not allowed.
    pub fn case(&mut self, i: usize) -> anyhow::Result<Case> {
        let (s, frame) = self.index[i];
        let stack = &mut self.stacks[s];
        Ok(Case { frame_dn: stack.frames.read(frame)?, truth: stack.truth.read(frame)? })
    }

    /// The frame of scene `i` as measured, as expected (where that is known), and as the model predicts it for `light`
    /// times the truth.
    ///
    /// # Errors
    /// A file cannot be read, or the model does not fit the session.
    pub fn comparison(&mut self, i: usize, forward: &Forward, light: f64) -> anyhow::Result<FrameComparison> {
        let Case { frame_dn: measured, truth } = self.case(i)?;
        let (s, frame) = self.index[i];
        let stack = &mut self.stacks[s];
        let mut cx = context(forward, &stack.info[frame]);
        cx.illumination *= light;
        let predicted = forward.expected_dn(truth.view(), &cx).with_context(|| format!("scene frame {i}"))?;
        let expected = stack.expected.as_mut().map(|e| e.read(frame)).transpose()?;
        Ok(FrameComparison { predicted, expected, measured })
    }
}

/// Time, exposure and illumination of a frame, from the session's table.
fn context<'a>(forward: &'a Forward, info: &FrameInfo) -> FrameContext<'a> {
    FrameContext {
        frame: info.frame,
        time_s: info.time_s,
        exposure_ms: info.exposure_ms,
        illumination: info.illumination,
        ..forward.context()
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;
    use ommatidia_model::testing::Testbed;

    #[test]
    fn scenes_that_are_marked_as_damaged_are_left_out() {
        let bed = Testbed { scan: 3, ..Testbed::new() };
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("session");
        bed.write(&path);
        let session = || Session::open(&path).unwrap();
        let mut all = Scenes::of(&session(), None).unwrap();
        assert_eq!(all.count(), bed.scenes);
        std::fs::write(path.join("scene.csv"), "exposure_ms,data\n10,whole\n10, Damaged\n10,whole\n").unwrap();
        let manifest = std::fs::read_to_string(path.join("session.toml")).unwrap();
        let named = manifest.replace("file = \"scene.npy\"", "file = \"scene.npy\"\ntable = \"scene.csv\"");
        std::fs::write(path.join("session.toml"), named).unwrap();
        let mut whole = Scenes::of(&session(), None).unwrap();
        assert_eq!((whole.count(), whole.places(), all.places()), (2, vec![0, 2], vec![0, 1, 2]));
        assert_eq!(whole.case(1).unwrap().frame_dn, all.case(2).unwrap().frame_dn);
        assert_eq!(Scenes::of(&session(), Some(1)).unwrap().count(), 1);
    }
}
