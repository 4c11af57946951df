//! The artifact of an evaluation: figures and pictures of a comparison of methods, for reports.

use super::{Ring, RingSpectrum};
use ndarray::{Array3, Axis, Ix3};
use ommatidia_model::metrics::{Figures, PredictionFigures};
use ommatidia_session::artifact::{self, ArtifactError, Header, Provenance, Tensors};
use ommatidia_session::{ObjectGrid, SensorSpec};
use serde::{Deserialize, Serialize};
use std::path::Path;

/// Kind of the artifact.
pub const KIND: &str = "evaluation";
/// Version of its layout.
pub const VERSION: u32 = 1;

/// Figures of one method.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct MethodFigures {
    /// Name of the method, unique in the evaluation.
    pub name: String,
    /// File that the method was made from, or that its reconstructions were read from.
    pub source: String,
    /// Mean peak signal-to-noise ratio over the frames, dB.
    pub psnr_db: f64,
    /// Standard deviation of the peak signal-to-noise ratio from frame to frame, dB.
    pub psnr_db_std: f64,
    /// Mean structural similarity.
    pub ssim: f64,
    /// Mean normalised root mean squared error.
    pub nrmse: f64,
    /// Mean Pearson correlation coefficient.
    pub pcc: f64,
    /// Mean wall time of one frame, s, without the first; None for reconstructions that were read from a file.
    pub seconds_per_frame: Option<f64>,
    /// Peak resident memory of the process during reconstruction, bytes; None where it is unknown.
    pub peak_bytes: Option<u64>,
    /// Figures of each frame.
    pub frames: Vec<Figures>,
    /// Figures by field radius.
    pub field: Vec<Ring>,
    /// Power spectra by field radius.
    #[serde(default)]
    pub spectra: Vec<RingSpectrum>,
}

/// The header of the artifact: everything but the pictures.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Summary {
    /// Name of the session.
    pub session: String,
    /// Sensor of the session.
    pub sensor: SensorSpec,
    /// Object grid of the session.
    pub object: ObjectGrid,
    /// Number of frames compared.
    pub frames: usize,
    /// Indices of the frames whose pictures are kept.
    pub pictured: Vec<usize>,
    /// Figures of the methods, highest PSNR first.
    pub methods: Vec<MethodFigures>,
    /// Figures of the instrument's prediction of the frames; None where no instrument was given.
    pub prediction: Option<PredictionFigures>,
}

/// An evaluation with its pictures.
#[derive(Clone, Debug)]
pub struct Evaluation {
    /// The figures.
    pub summary: Summary,
    /// Raw frames, DN, [pictured, sensor rows, sensor cols].
    pub raw_dn: Array3<f32>,
    /// Predictions of the same frames from their truths; None where no instrument was given.
    pub predicted: Option<Predicted>,
    /// Truths, [pictured, object rows, object cols].
    pub truths: Array3<f32>,
    /// Reconstructions of each method in the unit of the truth, each [pictured, object rows, object cols].
    pub reconstructions: Vec<Array3<f32>>,
}

/// Predictions of the pictured frames, each [pictured, sensor rows, sensor cols].
#[derive(Clone, Debug)]
pub struct Predicted {
    /// Predicted frames, DN.
    pub frames_dn: Array3<f32>,
    /// (measured - predicted) in standard deviations of the noise model.
    pub residual_sigma: Array3<f32>,
}

impl Evaluation {
    /// Writes the artifact: whole, or not at all.
    ///
    /// # Errors
    /// See [`artifact::write`].
    pub fn write(&self, path: &Path, provenance: Provenance) -> Result<(), ArtifactError> {
        let mut tensors = Tensors::new();
        tensors.insert("raw_dn".into(), self.raw_dn.clone().into_dyn());
        tensors.insert("truths".into(), self.truths.clone().into_dyn());
        if let Some(predicted) = &self.predicted {
            tensors.insert("predicted_dn".into(), predicted.frames_dn.clone().into_dyn());
            tensors.insert("residual_sigma".into(), predicted.residual_sigma.clone().into_dyn());
        }
        for (method, pictures) in self.summary.methods.iter().zip(&self.reconstructions) {
            tensors.insert(tensor_name(&method.name), pictures.clone().into_dyn());
        }
        let header = Header { kind: KIND.into(), version: VERSION, provenance, body: &self.summary };
        artifact::write(path, &header, &tensors)
    }

    /// Reads the artifact.
    ///
    /// # Errors
    /// The file is missing or not an evaluation, or a picture is missing or has the wrong shape.
    pub fn read(path: &Path) -> Result<(Self, Provenance), ArtifactError> {
        let (header, mut tensors) = artifact::read::<Summary>(path, KIND, VERSION)?;
        let summary = header.body;
        let pictures = Some(summary.pictured.len());
        let sensor = [pictures, Some(summary.sensor.rows), Some(summary.sensor.cols)];
        let object = [pictures, Some(summary.object.rows), Some(summary.object.cols)];
        let has_prediction = tensors.contains_key("predicted_dn");
        let mut take = |name: &str, shape: &[Option<usize>; 3]| -> Result<Array3<f32>, ArtifactError> {
            let tensor = artifact::take(path, &mut tensors, name, shape)?;
            let format = |e: ndarray::ShapeError| ArtifactError::Format { path: path.into(), detail: e.to_string() };
            tensor.into_dimensionality::<Ix3>().map_err(format)
        };
        let (raw_dn, truths) = (take("raw_dn", &sensor)?, take("truths", &object)?);
        let predicted = match has_prediction {
            true => Some(Predicted {
                frames_dn: take("predicted_dn", &sensor)?,
                residual_sigma: take("residual_sigma", &sensor)?,
            }),
            false => None,
        };
        let reconstructions =
            summary.methods.iter().map(|m| take(&tensor_name(&m.name), &object)).collect::<Result<_, _>>()?;
        Ok((Self { summary, raw_dn, predicted, truths, reconstructions }, header.provenance))
    }

    /// Sorts the methods, highest PSNR first.
    pub fn sort(&mut self) {
        let mut order: Vec<usize> = (0..self.summary.methods.len()).collect();
        order.sort_by(|&a, &b| self.summary.methods[b].psnr_db.total_cmp(&self.summary.methods[a].psnr_db));
        self.reconstructions = order.iter().map(|&i| self.reconstructions[i].clone()).collect();
        self.summary.methods = order.iter().map(|&i| self.summary.methods[i].clone()).collect();
    }

    /// Number of pictured frames.
    pub fn pictures(&self) -> usize {
        self.truths.len_of(Axis(0))
    }
}

fn tensor_name(method: &str) -> String {
    format!("reconstructions/{method}")
}

#[cfg(test)]
pub(crate) mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    /// Two methods over two small pictures.
    pub(crate) fn evaluation() -> Evaluation {
        let method = |name: &str, psnr_db| MethodFigures { name: name.into(), psnr_db, ..MethodFigures::default() };
        Evaluation {
            summary: Summary {
                session: "by hand".into(),
                sensor: SensorSpec { rows: 5, cols: 6, pixel_pitch_um: 2.0, bit_depth: 12 },
                object: ObjectGrid { rows: 3, cols: 4, pixel_um: 4.0 },
                frames: 7,
                pictured: vec![0, 4],
                methods: vec![method("wiener", 20.0), method("svfouriernet", 25.0)],
                prediction: None,
            },
            raw_dn: Array3::from_elem((2, 5, 6), 70.0),
            predicted: Some(Predicted {
                frames_dn: Array3::from_elem((2, 5, 6), 69.0),
                residual_sigma: Array3::from_elem((2, 5, 6), 0.5),
            }),
            truths: Array3::from_elem((2, 3, 4), 1.0),
            reconstructions: vec![Array3::from_elem((2, 3, 4), 0.5), Array3::from_elem((2, 3, 4), 0.9)],
        }
    }

    #[test]
    fn what_was_written_is_read() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("evaluation.safetensors");
        let mut written = evaluation();
        written.sort();
        written.write(&path, Provenance::new("evaluate", 3, &())).unwrap();
        let (read, provenance) = Evaluation::read(&path).unwrap();
        assert!(read.summary == written.summary && provenance.seed == 3);
        assert_eq!(read.summary.methods[0].name, "svfouriernet");
        assert_eq!(read.reconstructions, written.reconstructions);
        assert!(read.reconstructions[0].iter().all(|&v| v == 0.9));
    }

    #[test]
    fn a_missing_picture_is_named() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("evaluation.safetensors");
        let mut written = evaluation();
        written.reconstructions.pop();
        written.write(&path, Provenance::new("evaluate", 3, &())).unwrap();
        let error = Evaluation::read(&path).unwrap_err().to_string();
        assert!(error.contains("reconstructions/svfouriernet") && error.contains("no tensor of this name"), "{error}");
    }
}
