//! The passes after the first one, as a device computes them: the model that predicts frames in half precision, with
//! coefficient maps that are linear between evenly spaced nodes.

use super::QuantizeError;
use super::pack::{halves, narrow, rcan};
use crate::train::weights::{BASIS, COEFFICIENTS, NODES, name};
use crate::train::{Checkpoint, Feedback, NetworkConfig};
use ommatidia_model::psf::nodes::Taps;
use ommatidia_session::artifact::Tensors;
use ommatidia_shared::blob::{Corner, MAX_LENSES, Passes, Size};
use ommatidia_shared::num::f16;

/// Largest error of maps that are linear between nodes, relative to their root mean square. The error of the model of
/// few terms is some ten times as large.
const MOST_ERROR: f64 = 0.005;
/// Largest number of pixels from node to node that is tried.
const MOST_STEP: u16 = 64;

/// The passes after the first one.
pub struct PlannedPasses {
    /// Their shape, as the header stores it.
    pub passes: Passes,
    /// Coefficient maps and basis PSFs in the order of the file.
    pub model: Vec<f16>,
    /// Weights of their enhancement networks, one pass after the other.
    pub rcan: Vec<f16>,
}

impl PlannedPasses {
    /// The later passes of a checkpoint; None: it has one pass.
    ///
    /// # Errors
    /// There are more lenses than devices have room for, no transform holds the image of a lens, or a number is too
    /// large.
    pub fn of(checkpoint: &Checkpoint) -> Result<Option<Self>, QuantizeError> {
        let network = &checkpoint.body.network;
        let Some(feedback) = &network.feedback else { return Ok(None) };
        let object = Size { rows: narrow("object", network.object[0])?, cols: narrow("object", network.object[1])? };
        let model = Model::of(feedback, network.object, &checkpoint.weights)?;
        let mut passes = Passes {
            later: narrow("passes", feedback.passes)?,
            terms: narrow("terms", feedback.terms)?,
            window: narrow("window", feedback.window)?,
            node_step: 1,
            corners: Default::default(),
        };
        for corner in &feedback.corners {
            let [row, col] = corner.map(|v| v.clamp(i16::MIN.into(), i16::MAX.into()) as i16);
            let found = feedback.corners.len();
            let expected = || format!("at most {MAX_LENSES}");
            passes.corners.push(Corner { row, col }).map_err(|_| QuantizeError::Size {
                field: "lenses",
                expected: expected(),
                found,
            })?;
        }
        let Some(tile) = passes.tile(object) else {
            let expected = "at most 1024 for the side of the object and of a basis PSF together".into();
            let found = network.object[0].max(network.object[1]) + feedback.window - 1;
            return Err(QuantizeError::Size { field: "passes", expected, found });
        };
        let coarser = (0..).map(|log2| MOST_STEP >> log2).take_while(|step| *step > 1);
        passes.node_step = coarser.into_iter().find(|step| model.error(*step) <= MOST_ERROR).unwrap_or(1);
        let of_pass = |pass| rcan_of_pass(network, &checkpoint.weights, pass);
        let rcan = (1..network.passes()).map(of_pass).collect::<Result<Vec<_>, _>>()?.concat();
        let model = model.halves(&passes, object, f32::from(tile))?;
        Ok(Some(Self { passes, model, rcan }))
    }
}

/// The weights of the enhancement network of a pass, in the order of the file.
fn rcan_of_pass(network: &NetworkConfig, weights: &Tensors, pass: usize) -> Result<Vec<f16>, QuantizeError> {
    let prefix = name::of_pass(pass);
    let own = weights.iter().filter_map(|(name, tensor)| Some((name.strip_prefix(&prefix)?.into(), tensor.clone())));
    let network = NetworkConfig { channels: network.inputs(pass), feedback: None, ..network.clone() };
    rcan(&network, &own.collect()).map_err(|error| match error {
        QuantizeError::Range { name, index, found } => {
            QuantizeError::Range { name: format!("{prefix}{name}"), index, found }
        }
        other => other,
    })
}

/// The model of a checkpoint: one map and one basis PSF for each term of each lens.
struct Model {
    /// Maps at all pixels of the object, row by row.
    maps: Vec<Vec<f32>>,
    /// Maps at their own nodes.
    coefficients: Vec<Vec<f32>>,
    /// Basis PSFs.
    basis: Vec<Vec<f32>>,
    /// Positions of the nodes, pixels.
    nodes: [Vec<f64>; 2],
    object: [usize; 2],
    terms: usize,
}

impl Model {
    fn of(feedback: &Feedback, object: [usize; 2], weights: &Tensors) -> Result<Self, QuantizeError> {
        let count = feedback.corners.len() * feedback.terms;
        let values = |name: &'static str, expected: usize| -> Result<Vec<f32>, QuantizeError> {
            let values: Vec<f32> = weights.get(name).map_or_else(Vec::new, |t| t.iter().copied().collect());
            match values.len() {
                found if found == expected => Ok(values),
                found => Err(QuantizeError::Size { field: name, expected: expected.to_string(), found }),
            }
        };
        let [rows, cols] = feedback.nodes;
        let parts = |values: Vec<f32>, len: usize| values.chunks_exact(len.max(1)).map(<[f32]>::to_vec).collect();
        let nodes = |axis: usize| -> Result<Vec<f64>, QuantizeError> {
            Ok(values(NODES[axis], feedback.nodes[axis])?.into_iter().map(f64::from).collect())
        };
        let mut model = Self {
            maps: Vec::new(),
            coefficients: parts(values(COEFFICIENTS, count * rows * cols)?, rows * cols),
            basis: parts(values(BASIS, count * feedback.window.pow(2))?, feedback.window.pow(2)),
            nodes: [nodes(0)?, nodes(1)?],
            object,
            terms: feedback.terms,
        };
        model.maps = model.sampled(object, 1);
        Ok(model)
    }

    /// All maps at every `step`-th pixel, so many rows and columns.
    fn sampled(&self, [rows, cols]: [usize; 2], step: usize) -> Vec<Vec<f32>> {
        let taps = |axis: usize, n: usize| -> Vec<Taps> {
            (0..n).map(|i| Taps::at(&self.nodes[axis], (i * step) as f64)).collect()
        };
        let (down, across) = (taps(0, rows), taps(1, cols));
        let map = |coefficients: &Vec<f32>| {
            let along: Vec<Vec<f32>> = across
                .iter()
                .map(|tap| coefficients.chunks_exact(self.nodes[1].len()).map(|row| tap.apply(row)).collect())
                .collect();
            down.iter().flat_map(|tap| along.iter().map(move |column| tap.apply(column))).collect()
        };
        self.coefficients.iter().map(map).collect()
    }

    /// Error of maps that are linear between nodes `step` pixels apart, relative to the root mean square of all maps.
    fn error(&self, step: u16) -> f64 {
        let shape = Passes { later: 1, terms: 1, window: 1, node_step: step, corners: Default::default() };
        let [rows, cols] = self.object;
        let nodes = shape.nodes(Size { rows: rows as u16, cols: cols as u16 });
        let step = usize::from(step);
        let (mut error, mut all) = (0.0, 0.0);
        for (map, at_nodes) in self.maps.iter().zip(self.sampled(nodes, step)) {
            let at = |r: usize, c: usize| at_nodes[r.min(nodes[0] - 1) * nodes[1] + c.min(nodes[1] - 1)];
            for (p, value) in map.iter().enumerate() {
                let ([r, c], [f, g]) =
                    ([p / cols / step, p % cols / step], [p / cols, p % cols].map(|i| (i % step) as f32 / step as f32));
                let [above, below] = [r, r + 1].map(|r| at(r, c) + (at(r, c + 1) - at(r, c)) * g);
                error += f64::from(above + (below - above) * f - value).powi(2);
                all += f64::from(*value).powi(2);
            }
        }
        if all > 0.0 { (error / all).sqrt() } else { 0.0 }
    }

    /// Maps and basis PSFs as the file stores them: each map with a largest magnitude of 1, and the basis PSFs of all
    /// lenses times a common factor, a power of two, with which the lags of the brightest lens sum to half of `tile` or
    /// more, and to `tile` at most.
    fn halves(&self, passes: &Passes, object: Size, tile: f32) -> Result<Vec<f16>, QuantizeError> {
        let mut maps = self.sampled(passes.nodes(object), passes.node_step.into());
        let mut basis = self.basis.clone();
        for (map, basis) in maps.iter_mut().zip(&mut basis) {
            let most = map.iter().fold(0.0f32, |most, v| most.max(v.abs()));
            map.iter_mut().for_each(|v| *v = if most > 0.0 { (*v / most).clamp(-1.0, 1.0) } else { 0.0 });
            basis.iter_mut().for_each(|v| *v *= most);
        }
        let light = |factor: f32| {
            let sum = |lens: &[Vec<f32>]| lens.iter().flatten().map(|v| f16::from_f32(v * factor).to_f32().abs()).sum();
            basis.chunks(self.terms.max(1)).map(sum).fold(0.0f32, f32::max)
        };
        let most = basis.chunks(self.terms.max(1)).map(|lens| lens.iter().flatten().map(|v| v.abs()).sum::<f32>());
        let most = most.fold(0.0f32, f32::max);
        let mut factor = if most > 0.0 { (tile / most).log2().floor().exp2() } else { 1.0 };
        // Rounded lags may sum to a little more.
        while light(factor) > 0.999 * tile {
            factor /= 2.0;
        }
        let mut section = Vec::new();
        for (map, basis) in maps.into_iter().zip(&basis) {
            section.extend(halves(COEFFICIENTS, map.into_iter())?);
            section.extend(halves(BASIS, basis.iter().map(|v| v * factor))?);
        }
        Ok(section)
    }
}
