//! Differentiable operators on the CPU where burn's are too slow or missing.
//!
//! Each has an implementation on slices ([`conv`], [`fourier`]), tested on its own, and a thin wrapper here that
//! registers it in burn's graph. Weights are flat tensors whose shapes the operators know. Tensors on other devices use
//! burn's own operators ([`portable`]).

pub mod conv;
pub mod fourier;
pub mod patch;
pub mod portable;
pub mod predicted;
pub mod stream;
pub mod winograd;

use burn_backend::tensor::FloatTensor;
use burn_dispatch::backends::autodiff::NodeId;
use burn_dispatch::backends::autodiff::checkpoint::base::Checkpointer;
use burn_dispatch::backends::autodiff::checkpoint::strategy::NoCheckpointing;
use burn_dispatch::backends::autodiff::grads::Gradients;
use burn_dispatch::backends::autodiff::ops::{Backward, Ops, OpsKind};
use burn_dispatch::backends::{Autodiff, Flex};
use burn_tensor::{Device, Tensor, TensorData};
use conv::Conv3x3;
use fourier::{Fourier, Spectrum};
use std::sync::Arc;

type Primitive = FloatTensor<Flex>;

/// 3x3 convolution with zero padding: `x` (batch, inputs, rows, cols), `weight` (outputs * inputs * 9), `bias`
/// (outputs) -> [batch, outputs, rows, cols].
pub fn conv3x3(x: Tensor<4>, weight: Tensor<1>, bias: Tensor<1>) -> Tensor<4> {
    if !is_cpu(&x) {
        return portable::conv3x3(x, weight, bias);
    }
    let [batch, inputs, rows, cols] = x.dims();
    let sizes = Conv3x3 { batch, inputs, outputs: bias.dims()[0], rows, cols };
    if !weight.is_autodiff() {
        let [x, weight, bias] = [plain(x), plain(weight), plain(bias)];
        return Tensor::from_primitive::<Flex>(forward(sizes, &x, &weight, &bias));
    }
    let [x, weight, bias] = [tracked(x), tracked(weight), tracked(bias)];
    let ((x, n0), (weight, n1), (bias, n2)) = (x.into_parts(), weight.into_parts(), bias.into_parts());
    let y = forward(sizes, &x, &weight, &bias);
    let y = match (Conv { sizes }).prepare::<NoCheckpointing>([n0, n1, n2]).compute_bound().stateful() {
        OpsKind::Tracked(prep) => prep.finish((x, weight), y),
        OpsKind::UnTracked(prep) => prep.finish(y),
    };
    Tensor::from_primitive::<Autodiff<Flex>>(y)
}

/// The Fourier filter bank on frames with given spectra: `re`, `im` [channels * T * (T/2+1)] -> [batch, channels,
/// object rows, object cols].
///
/// Frames are data, so no gradient is computed for them.
pub fn filter_bank(plan: &Arc<Fourier>, spectra: Arc<Vec<Spectrum>>, re: Tensor<1>, im: Tensor<1>) -> Tensor<4> {
    if !is_cpu(&re) {
        return portable::filter_bank(plan, &spectra, re, im);
    }
    let run = |re: &Primitive, im: &Primitive| {
        let [rows, cols] = plan.sizes().object;
        let y = plan.forward(&spectra, &plan.filters(&values(re), &values(im)));
        primitive(y, &[spectra.len(), plan.sizes().channels, rows, cols])
    };
    if !re.is_autodiff() {
        return Tensor::from_primitive::<Flex>(run(&plain(re), &plain(im)));
    }
    let ((re, n0), (im, n1)) = (tracked(re).into_parts(), tracked(im).into_parts());
    let y = run(&re, &im);
    let operator = Bank { plan: Arc::clone(plan) };
    let y = match operator.prepare::<NoCheckpointing>([n0, n1]).compute_bound().stateful() {
        OpsKind::Tracked(prep) => prep.finish(spectra, y),
        OpsKind::UnTracked(prep) => prep.finish(y),
    };
    Tensor::from_primitive::<Autodiff<Flex>>(y)
}

/// Spectra of kernels `h` [channels * T * T]: real parts, then imaginary parts, each [channels * T * (T/2+1)].
pub fn kernel_spectra(plan: &Arc<Fourier>, h: Tensor<1>) -> [Tensor<1>; 2] {
    if !is_cpu(&h) {
        return portable::kernel_spectra(plan, h);
    }
    let run = |h: &Primitive| {
        let (mut re, im) = plan.kernel_parts(&values(h));
        re.extend(im);
        let n = re.len();
        primitive(re, &[n])
    };
    let parts = if h.is_autodiff() {
        let (h, n0) = tracked(h).into_parts();
        let y = run(&h);
        let operator = Spectra { plan: Arc::clone(plan) };
        let y = match operator.prepare::<NoCheckpointing>([n0]).compute_bound().stateful() {
            OpsKind::Tracked(prep) => prep.finish((), y),
            OpsKind::UnTracked(prep) => prep.finish(y),
        };
        Tensor::<1>::from_primitive::<Autodiff<Flex>>(y)
    } else {
        Tensor::<1>::from_primitive::<Flex>(run(&plain(h)))
    };
    let n = parts.dims()[0] / 2;
    [parts.clone().narrow(0, 0, n), parts.narrow(0, n, n)]
}

/// Whether a tensor is on the CPU, where our operators run.
fn is_cpu<const D: usize>(tensor: &Tensor<D>) -> bool {
    tensor.device().inner() == Device::flex()
}

#[derive(Debug)]
struct Spectra {
    plan: Arc<Fourier>,
}

impl Backward<Flex, 1> for Spectra {
    type State = ();

    fn backward(self, ops: Ops<Self::State, 1>, grads: &mut Gradients, _: &mut Checkpointer) {
        let g = grads.consume::<Flex>(&ops.node);
        let g = values(&g);
        let (re, im) = g.split_at(g.len() / 2);
        let h = self.plan.kernel_gradient(re, im);
        let (n, [parent]) = (h.len(), ops.parents.map(|p| p.map(|n| n.id)));
        register(grads, parent, h, &[n]);
    }
}

#[derive(Debug)]
struct Conv {
    sizes: Conv3x3,
}

impl Backward<Flex, 3> for Conv {
    type State = (Primitive, Primitive);

    fn backward(self, ops: Ops<Self::State, 3>, grads: &mut Gradients, _: &mut Checkpointer) {
        let g = grads.consume::<Flex>(&ops.node);
        let (x, weight) = ops.state;
        let Conv3x3 { batch, inputs, outputs, rows, cols } = self.sizes;
        let found = self.sizes.backward(&values(&x), &values(&weight), &values(&g));
        let [px, pw, pb] = ops.parents.map(|p| p.map(|n| n.id));
        register(grads, px, found.input, &[batch, inputs, rows, cols]);
        register(grads, pw, found.weight, &[outputs * inputs * 9]);
        register(grads, pb, found.bias, &[outputs]);
    }
}

#[derive(Debug)]
struct Bank {
    plan: Arc<Fourier>,
}

impl Backward<Flex, 2> for Bank {
    type State = Arc<Vec<Spectrum>>;

    fn backward(self, ops: Ops<Self::State, 2>, grads: &mut Gradients, _: &mut Checkpointer) {
        let g = grads.consume::<Flex>(&ops.node);
        let (re, im) = self.plan.backward(&ops.state, &values(&g));
        let (n, [pre, pim]) = (re.len(), ops.parents.map(|p| p.map(|n| n.id)));
        register(grads, pre, re, &[n]);
        register(grads, pim, im, &[n]);
    }
}

fn forward(sizes: Conv3x3, x: &Primitive, weight: &Primitive, bias: &Primitive) -> Primitive {
    let y = sizes.forward(&values(x), &values(weight), &values(bias));
    primitive(y, &[sizes.batch, sizes.outputs, sizes.rows, sizes.cols])
}

fn register(grads: &mut Gradients, parent: Option<NodeId>, values: Vec<f32>, shape: &[usize]) {
    if let Some(parent) = parent {
        grads.register::<Flex>(parent, primitive(values, shape));
    }
}

fn primitive(values: Vec<f32>, shape: &[usize]) -> Primitive {
    Primitive::from_data(TensorData::new(values, shape.to_vec()))
}

/// The values in C order; copied only if the tensor is not contiguous.
fn values(tensor: &Primitive) -> std::borrow::Cow<'_, [f32]> {
    match tensor.as_slice::<f32>() {
        Some(values) => values.into(),
        None => tensor.to_contiguous().storage::<f32>().to_vec().into(),
    }
}

fn plain<const D: usize>(tensor: Tensor<D>) -> Primitive {
    match tensor.try_into_primitive::<Flex>() {
        Ok(tensor) => tensor,
        Err(error) => unreachable!("`is_cpu` checked that the tensor is on the Flex device: {error:?}"),
    }
}

fn tracked<const D: usize>(tensor: Tensor<D>) -> FloatTensor<Autodiff<Flex>> {
    match tensor.try_into_primitive::<Autodiff<Flex>>() {
        Ok(tensor) => tensor,
        Err(error) => unreachable!("`is_cpu` checked that the tensor is on the Flex device with autodiff: {error:?}"),
    }
}
