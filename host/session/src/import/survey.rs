//! Reads every frame once: finds repeated frames and the largest value, and copies on the way.

use crate::error::SessionError;
use crate::stack::{FrameReader, FrameWriter, StackSpec};
use crate::write::SessionWriter;
use ndarray::Array2;

/// What all frames together show.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct Survey {
    /// Frames that equal the frame before in every pixel.
    pub repeated: Vec<usize>,
    /// Largest value.
    pub max_dn: f64,
}

/// A copy of the frames in the session.
pub(super) struct Copy(FrameWriter);

impl Copy {
    pub fn start(writer: &SessionWriter, name: &str, frames: &FrameReader) -> Result<Self, SessionError> {
        let (rows, cols, samples) = (frames.rows(), frames.cols(), frames.samples());
        writer.frames(name, StackSpec { frames: frames.len(), rows, cols, samples, pixel_um: None }).map(Self)
    }
}

impl Survey {
    pub fn of(
        frames: &mut FrameReader,
        mut copy: Option<Copy>,
        progress: &mut impl FnMut(),
    ) -> Result<Self, SessionError> {
        let mut survey = Self::default();
        let mut before: Option<Array2<f32>> = None;
        for i in 0..frames.len() {
            let frame = frames.read(i)?;
            if before.as_ref() == Some(&frame) {
                survey.repeated.push(i);
            }
            survey.max_dn = frame.iter().fold(survey.max_dn, |most, v| most.max(f64::from(*v)));
            if let Some(Copy(writer)) = &mut copy {
                writer.push(frame.view())?;
            }
            before = Some(frame);
            progress();
        }
        if let Some(Copy(writer)) = copy {
            writer.finish()?;
        }
        Ok(survey)
    }
}
