//! Intervals beside the reconstructions: two further stacks, and warnings.

use super::Output;
use crate::cli::common::in_json;
use ndarray::{Array2, ArrayView2};
use ommatidia_model::instrument::Instrument;
use ommatidia_network::uncertainty::{Ready, Suspicion, Widths};
use std::path::{Path, PathBuf};

/// Stacks of lower and upper limits.
pub(super) struct Limits<'a> {
    ready: Ready,
    lower: Output<'a>,
    upper: Output<'a>,
    seen: Vec<Suspicion>,
}

/// Path of the lower and the upper limits beside an output: `objects.lower.tif` and `objects.upper.tif`.
pub(super) fn beside(output: &Path) -> [PathBuf; 2] {
    ["lower", "upper"].map(|which| {
        let suffix = output.extension().map_or(String::new(), |e| format!(".{}", e.to_string_lossy()));
        output.with_extension(format!("{which}{suffix}"))
    })
}

impl<'a> Limits<'a> {
    /// Widths read from `path` and checked against method and instrument; `outputs` are those of the limits.
    ///
    /// # Errors
    /// A file cannot be read, or the widths belong to another method or instrument.
    pub(super) fn open(
        path: &Path,
        method: &str,
        with: &Path,
        instrument: &Path,
        outputs: [Output<'a>; 2],
    ) -> anyhow::Result<Self> {
        let widths = Widths::read(path)?;
        widths.check(path, method, with, instrument)?;
        let [lower, upper] = outputs;
        Ok(Self { ready: widths.on(&Instrument::read(instrument)?)?, lower, upper, seen: Vec::new() })
    }

    /// Adds the limits of one reconstruction.
    pub(super) fn push(&mut self, frame: ArrayView2<'_, f32>, object: &Array2<f32>) -> anyhow::Result<()> {
        let intervals = self.ready.intervals(frame, object)?;
        self.lower.push(&intervals.lower)?;
        self.upper.push(&intervals.upper)?;
        self.seen.push(intervals.suspicion);
        Ok(())
    }

    /// Completes the stacks; gives the warnings about `frames`, and the figures for the JSON.
    pub(super) fn finish(self, frames: &Path) -> anyhow::Result<(Vec<String>, serde_json::Value)> {
        let paths = [self.lower.path, self.upper.path].map(in_json);
        self.lower.finish()?;
        self.upper.finish()?;
        let listed = |is: &dyn Fn(&Suspicion) -> bool| -> Option<(usize, usize, Suspicion)> {
            let all: Vec<_> = self.seen.iter().enumerate().filter(|(_, s)| is(s)).collect();
            all.first().map(|(i, s)| (*i, all.len(), **s))
        };
        let of = |n: usize| if n > 1 { format!(" ({} more of {})", n - 1, self.seen.len()) } else { String::new() };
        let inconsistent = listed(&|s| s.inconsistent).map(|(i, n, s)| {
            format!(
                "{}: frame {i}{}: the frame that its reconstruction predicts is off by {:.1} times as much as usual, \
                 and the intervals are wider by that much: the instrument may have changed (`ommatidia close`), or the \
                 specimen is of a kind that the method does not reconstruct",
                frames.display(),
                of(n),
                s.misfit
            )
        });
        let unlike = listed(&|s| s.unlike).map(|(i, n, _)| {
            format!(
                "{}: frame {i}{}: no scene of the calibration looks like this one, so its intervals may not hold; make \
                 widths for such specimens and light (`ommatidia uncertainty --specimen --peak-e`)",
                frames.display(),
                of(n)
            )
        });
        let json = serde_json::json!({ "lower": paths[0], "upper": paths[1], "frames": self.seen });
        Ok((inconsistent.into_iter().chain(unlike).collect(), json))
    }
}
