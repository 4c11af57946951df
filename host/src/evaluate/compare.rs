//! One method, judged on scenes of known truth.

use super::{Measured, MethodFigures, Rings, Spectra, measured};
use crate::methods::Reconstruct;
use crate::metrics::{Case, Figures, compare, scaled};
use crate::session::ObjectGrid;
use anyhow::Context;
use ndarray::{Array3, Axis};

/// Number of rings between the centre of the field and its corner.
const RINGS: usize = 6;

/// Source of reconstructions.
pub enum Source<'a> {
    /// A method, which is run and timed.
    Method(&'a dyn Reconstruct),
    /// Finished reconstructions, [frames, object rows, object cols].
    Stack(&'a Array3<f32>),
}

/// Judges one source on `count` cases, which `case` returns one by one. Also returns the reconstructions with the
/// indices `pictured`, each scaled to its truth: [pictured, object rows, object cols].
///
/// `done` is called after each frame.
///
/// # Errors
/// A case cannot be loaded, the method refuses a frame, or a figure cannot be computed; the error names the frame.
pub fn judge(
    source: &Source<'_>,
    grid: &ObjectGrid,
    count: usize,
    pictured: &[usize],
    mut case: impl FnMut(usize) -> anyhow::Result<Case>,
    mut done: impl FnMut(),
) -> anyhow::Result<(MethodFigures, Array3<f32>)> {
    let (mut rings, mut spectra) = (Rings::new(grid, RINGS), Spectra::new(grid));
    let mut pictures = Array3::zeros((pictured.len(), grid.rows, grid.cols));
    let mut result = MethodFigures::default();
    let (mut seconds, mut peak) = (0.0, None);
    for i in 0..count {
        let case = case(i)?;
        let named = || format!("scene frame {i}");
        let object = match source {
            Source::Stack(stack) => stack.index_axis(Axis(0), i).to_owned(),
            Source::Method(method) => {
                if i == 0 {
                    // The first run plans, allocates and fills caches, and is not timed.
                    method.reconstruct(case.frame_dn.view()).with_context(named)?;
                }
                let run = measured(|| method.reconstruct(case.frame_dn.view()));
                let Measured { result: object, seconds: s, peak_bytes } = run;
                (seconds, peak) = (seconds + s, peak.max(peak_bytes));
                object.with_context(named)?
            }
        };
        let figures = compare(object.view(), case.truth.view()).with_context(named)?;
        rings.add(object.view(), case.truth.view(), figures.scale);
        spectra.add(object.view(), case.truth.view(), figures.scale);
        if let Some(p) = pictured.iter().position(|&p| p == i) {
            pictures.index_axis_mut(Axis(0), p).assign(&scaled(&object, figures.scale));
        }
        result.frames.push(figures);
        done();
    }
    summarise(&mut result);
    (result.field, result.spectra) = (rings.figures(), spectra.figures());
    if matches!(source, Source::Method(_)) && count > 0 {
        result.seconds_per_frame = Some(seconds / count as f64);
        result.peak_bytes = peak;
    }
    Ok((result, pictures))
}

/// Means over the frames, and the standard deviation of the PSNR.
fn summarise(result: &mut MethodFigures) {
    let n = result.frames.len().max(1) as f64;
    let mean = |f: fn(&Figures) -> f64| result.frames.iter().map(f).sum::<f64>() / n;
    let (psnr_db, ssim, nrmse, pcc) = (mean(|f| f.psnr_db), mean(|f| f.ssim), mean(|f| f.nrmse), mean(|f| f.pcc));
    let variance = result.frames.iter().map(|f| (f.psnr_db - psnr_db).powi(2)).sum::<f64>() / (n - 1.0).max(1.0);
    result.psnr_db_std = variance.sqrt();
    (result.psnr_db, result.ssim, result.nrmse, result.pcc) = (psnr_db, ssim, nrmse, pcc);
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use ndarray::{Array2, ArrayView2};

    /// Returns the frame as the object, at half the light.
    struct Half;

    impl Reconstruct for Half {
        fn name(&self) -> &str {
            "half"
        }

        fn reconstruct(&self, frame_dn: ArrayView2<'_, f32>) -> anyhow::Result<Array2<f32>> {
            anyhow::ensure!(frame_dn[[0, 0]] < 1000.0, "too bright");
            Ok(frame_dn.mapv(|v| 0.5 * v))
        }
    }

    fn grid() -> ObjectGrid {
        ObjectGrid { rows: 16, cols: 16, pixel_um: 2.0 }
    }

    fn truth(i: usize) -> Array2<f32> {
        Array2::from_shape_fn((16, 16), |(r, c)| 1.0 + ((r * 3 + c * 5 + i) % 7) as f32)
    }

    fn case(i: usize) -> anyhow::Result<Case> {
        let mut frame_dn = truth(i);
        frame_dn[[4, 5]] += i as f32;
        Ok(Case { frame_dn, truth: truth(i) })
    }

    #[test]
    fn means_pictures_and_timing() {
        let mut steps = 0;
        let method = Source::Method(&Half);
        let (figures, pictures) = judge(&method, &grid(), 3, &[0, 2], case, || steps += 1).unwrap();
        assert!(steps == 3 && figures.frames.len() == 3 && figures.seconds_per_frame.is_some());
        assert!(figures.frames[0].psnr_db == 200.0 && figures.frames[2].psnr_db < figures.frames[1].psnr_db);
        let mean = figures.frames.iter().map(|f| f.psnr_db).sum::<f64>() / 3.0;
        assert!((figures.psnr_db - mean).abs() < 1e-9 && figures.psnr_db_std > 0.0);
        let difference = &pictures.index_axis(Axis(0), 0) - &truth(0);
        assert!(difference.iter().all(|v| v.abs() < 1e-5), "pictures are in the truth's unit");
    }

    #[test]
    fn a_stack_gives_the_same_figures_without_time() {
        let stack = Array3::from_shape_fn((3, 16, 16), |(i, r, c)| case(i).unwrap().frame_dn[[r, c]] * 7.0);
        let (a, _) = judge(&Source::Stack(&stack), &grid(), 3, &[], case, || ()).unwrap();
        let (b, _) = judge(&Source::Method(&Half), &grid(), 3, &[], case, || ()).unwrap();
        assert!((a.psnr_db - b.psnr_db).abs() < 1e-3 && a.seconds_per_frame.is_none() && a.peak_bytes.is_none());
    }

    #[test]
    fn a_refused_frame_is_named() {
        let bright = |i| Ok(Case { frame_dn: truth(i) + 1000.0 * i as f32, truth: truth(i) });
        let error = judge(&Source::Method(&Half), &grid(), 3, &[], bright, || ()).unwrap_err();
        assert_eq!(format!("{error:#}"), "scene frame 1: too bright");
    }
}
