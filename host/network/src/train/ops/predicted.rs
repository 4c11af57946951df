//! The filter bank on frames that a linear operator predicts, with gradients for the objects and for the filters.

use super::fourier::{Fourier, FourierSizes, Spectrum};
use super::portable::Terms;
use super::{Primitive, is_cpu, plain, portable, primitive, register, tracked, values};
use burn_dispatch::backends::autodiff::checkpoint::base::Checkpointer;
use burn_dispatch::backends::autodiff::checkpoint::strategy::NoCheckpointing;
use burn_dispatch::backends::autodiff::grads::Gradients;
use burn_dispatch::backends::autodiff::ops::{Backward, Ops, OpsKind};
use burn_dispatch::backends::{Autodiff, Flex};
use burn_tensor::Tensor;
use std::sync::Arc;

/// A linear operator from objects, [object rows * object cols], to frames, [frame rows * frame cols], both in C order.
pub trait Linear: std::fmt::Debug + Send + Sync {
    /// The frame of an object.
    fn apply(&self, object: &[f32]) -> Vec<f32>;

    /// The exact transpose: from a frame to the object grid.
    fn adjoint(&self, frame: &[f32]) -> Vec<f32>;

    /// The terms that make up the operator, for devices other than the CPU.
    fn terms(&self) -> &Terms;
}

/// The filters `re`, `im` [channels * T * (T/2+1)] on the frames of objects `x` [batch, 1, object rows, object cols]:
/// [batch, channels, object rows, object cols].
pub fn filter_predicted(
    plan: &Arc<Fourier>,
    predict: &Arc<dyn Linear>,
    x: Tensor<4>,
    [re, im]: [Tensor<1>; 2],
) -> Tensor<4> {
    if !is_cpu(&x) {
        return portable::filter_predicted(plan, predict.terms(), x, [re, im]);
    }
    let FourierSizes { frame, object: [rows, cols], channels, .. } = plan.sizes();
    let run = |x: &Primitive, re: &Primitive, im: &Primitive| {
        let x = values(x);
        let spectrum = |x: &[f32]| plan.rfft2(&predict.apply(x), frame);
        let spectra: Vec<Spectrum> = x.chunks_exact(rows * cols).map(spectrum).collect();
        let filters = plan.filters(&values(re), &values(im));
        let y = primitive(plan.forward(&spectra, &filters), &[spectra.len(), channels, rows, cols]);
        (y, State { spectra, filters })
    };
    if !re.is_autodiff() {
        return Tensor::from_primitive::<Flex>(run(&plain(x), &plain(re), &plain(im)).0);
    }
    let (x, re, im) = (tracked(x), tracked(re), tracked(im));
    let ((x, n0), (re, n1), (im, n2)) = (x.into_parts(), re.into_parts(), im.into_parts());
    let (y, state) = run(&x, &re, &im);
    let operator = PredictedBank { plan: Arc::clone(plan), predict: Arc::clone(predict) };
    let y = match operator.prepare::<NoCheckpointing>([n0, n1, n2]).compute_bound().stateful() {
        OpsKind::Tracked(prep) => prep.finish(state, y),
        OpsKind::UnTracked(prep) => prep.finish(y),
    };
    Tensor::from_primitive::<Autodiff<Flex>>(y)
}

#[derive(Debug)]
struct PredictedBank {
    plan: Arc<Fourier>,
    predict: Arc<dyn Linear>,
}

/// What the gradients need: spectra of the predicted frames, and of the filters.
#[derive(Clone, Debug)]
struct State {
    spectra: Vec<Spectrum>,
    filters: Vec<Spectrum>,
}

impl Backward<Flex, 3> for PredictedBank {
    type State = State;

    fn backward(self, ops: Ops<Self::State, 3>, grads: &mut Gradients, _: &mut Checkpointer) {
        let g = grads.consume::<Flex>(&ops.node);
        let g = values(&g);
        let State { spectra, filters } = &ops.state;
        let (re, im) = self.plan.backward(spectra, &g);
        let FourierSizes { object: [rows, cols], channels, .. } = self.plan.sizes();
        let to_object = |g: &[f32]| self.predict.adjoint(&self.plan.backward_to_frame(filters, g));
        let x: Vec<f32> = g.chunks_exact(channels * rows * cols).flat_map(to_object).collect();
        let (n, [px, pre, pim]) = (re.len(), ops.parents.map(|p| p.map(|n| n.id)));
        register(grads, px, x, &[spectra.len(), 1, rows, cols]);
        register(grads, pre, re, &[n]);
        register(grads, pim, im, &[n]);
    }
}
