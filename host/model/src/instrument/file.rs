//! The instrument on disk: an artifact of kind `instrument`.

use super::{Diagnostics, Instrument, LightUnit, Quality};
use crate::psf::pupils::{Pupils, StoredPupils};
use crate::psf::{ChiefRays, LowRankPsf};
use ndarray::{Array, ArrayD, Dimension, Ix1, Ix2, Ix4, Ix5};
use ommatidia_physics::effects::EffectSetting;
use ommatidia_physics::noise::NoiseModel;
use ommatidia_session::Manifest;
use ommatidia_session::artifact::{self, ArtifactError, Header, Provenance, Tensors};
use serde::{Deserialize, Serialize};
use std::path::Path;
use thiserror::Error;

/// Kind of the artifact.
pub const INSTRUMENT_KIND: &str = "instrument";
/// Version of the file layout.
pub const INSTRUMENT_VERSION: u32 = 1;

/// Why an instrument could not be read or written.
#[derive(Debug, Error)]
pub enum InstrumentError {
    /// The file.
    #[error(transparent)]
    Artifact(#[from] ArtifactError),
    /// A field of the header has an impossible value.
    #[error("{path}: field `{field}`: expected {expected}, found {found}; calibrate again")]
    Field {
        /// The file.
        path: std::path::PathBuf,
        /// The field.
        field: &'static str,
        /// What was expected.
        expected: String,
        /// What was found.
        found: String,
    },
}

/// The JSON header of an instrument's file.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Body {
    manifest: Manifest,
    noise: NoiseModel,
    geometry: ChiefRays,
    node_depths_um: Vec<f64>,
    node_rows_px: Vec<f64>,
    node_cols_px: Vec<f64>,
    exposure_ms: f64,
    effects: Vec<EffectSetting>,
    light_unit: LightUnit,
    quality: Quality,
    /// Fitted pupils: a fit takes seconds. Instruments of earlier versions lack them.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pupils: Option<StoredPupils>,
}

impl Instrument {
    /// Writes the instrument. The file appears whole or not at all.
    ///
    /// # Errors
    /// The folder is missing or not writable.
    pub fn write(&self, path: &Path, provenance: Provenance) -> Result<(), InstrumentError> {
        let body = Body {
            manifest: self.manifest.clone(),
            noise: self.noise,
            geometry: self.geometry.clone(),
            node_depths_um: self.psf.node_depths_um.clone(),
            node_rows_px: self.psf.node_rows_px.clone(),
            node_cols_px: self.psf.node_cols_px.clone(),
            exposure_ms: self.psf.exposure_ms,
            effects: self.effects.clone(),
            light_unit: self.light_unit,
            quality: self.quality.clone(),
            pupils: self.pupils.stored(),
        };
        let d = &self.diagnostics;
        let mut tensors = Tensors::from([
            ("psf.basis".into(), self.psf.basis.clone().into_dyn()),
            ("psf.coefficients".into(), self.psf.coefficients.clone().into_dyn()),
            ("diagnostics.positions_px".into(), d.positions_px.clone().into_dyn()),
            ("diagnostics.pcc".into(), d.pcc.clone().into_dyn()),
            ("diagnostics.bead_nrmse".into(), d.bead_nrmse.clone().into_dyn()),
            ("diagnostics.singular_values".into(), d.singular_values.clone().into_dyn()),
            ("diagnostics.error_by_rank".into(), d.error_by_rank.clone().into_dyn()),
            ("diagnostics.whole_array_error".into(), d.whole_array_error.clone().into_dyn()),
            ("diagnostics.photon_transfer".into(), d.photon_transfer.clone().into_dyn()),
            ("diagnostics.background_e".into(), d.background_e.clone().into_dyn()),
        ]);
        let maps = [("offset_dn", &self.offset_dn), ("response", &self.response), ("reading_dn2", &self.reading_dn2)];
        for (name, map) in maps {
            if let Some(map) = map {
                tensors.insert(name.into(), map.clone().into_dyn());
            }
        }
        for (j, psf) in self.replicates.iter().enumerate() {
            let [basis, coefficients] = replicate_names(j);
            tensors.insert(basis, psf.basis.clone().into_dyn());
            tensors.insert(coefficients, psf.coefficients.clone().into_dyn());
        }
        for (i, effect) in self.effects.iter().enumerate() {
            if let Some(table) = &effect.table {
                tensors.insert(table_name(i), table.clone().into_dyn());
            }
        }
        let header = Header { kind: INSTRUMENT_KIND.into(), version: INSTRUMENT_VERSION, provenance, body };
        Ok(artifact::write(path, &header, &tensors)?)
    }

    /// Reads an instrument.
    ///
    /// # Errors
    /// The file is missing, of another kind or version, cut short, or its parts disagree.
    pub fn read(path: &Path) -> Result<Self, InstrumentError> {
        let (header, mut tensors) = artifact::read::<Body>(path, INSTRUMENT_KIND, INSTRUMENT_VERSION)?;
        let body = header.body;
        check(path, &body)?;
        let (lenses, window) = (body.manifest.array.lenses(), body.manifest.optics.psf_window_px);
        let nodes = [body.node_depths_um.len(), body.node_rows_px.len(), body.node_cols_px.len()].map(Some);
        let stored = (0..).map(replicate_names).take_while(|n| n.iter().any(|n| tensors.contains_key(n)));
        let stored: Vec<[String; 2]> = stored.collect();
        // Instruments of earlier versions lack it.
        let whole_array_error = match tensors.contains_key("diagnostics.whole_array_error") {
            true => fixed::<Ix1>(artifact::take(path, &mut tensors, "diagnostics.whole_array_error", &[None])?),
            false => Array::zeros(0),
        };
        let background_e = match tensors.contains_key("diagnostics.background_e") {
            true => fixed::<Ix2>(artifact::take(path, &mut tensors, "diagnostics.background_e", &[None, None])?),
            false => Array::zeros((0, 3)),
        };
        let mut take = |name: &str, shape: &[Option<usize>]| artifact::take(path, &mut tensors, name, shape);
        let basis = take("psf.basis", &[Some(lenses), None, Some(window), Some(window)])?;
        let rank = basis.shape()[1];
        let coefficients = take("psf.coefficients", &[Some(lenses), Some(rank), nodes[0], nodes[1], nodes[2]])?;
        let psf = LowRankPsf {
            basis: fixed::<Ix4>(basis),
            coefficients: fixed::<Ix5>(coefficients),
            node_depths_um: body.node_depths_um,
            node_rows_px: body.node_rows_px,
            node_cols_px: body.node_cols_px,
            exposure_ms: body.exposure_ms,
        };
        let pupils = match body.pupils {
            None => Pupils::default(),
            Some(stored) => Pupils::restored(stored, &psf, &body.geometry, body.manifest.sensor.pixel_pitch_um)
                .ok_or_else(|| InstrumentError::Field {
                    path: path.into(),
                    field: "pupils",
                    expected: "pupils of these PSFs".into(),
                    found: "others".into(),
                })?,
        };
        let mut replicates = Vec::new();
        for [basis, coefficients] in stored {
            let basis = take(&basis, &[Some(lenses), Some(rank), Some(window), Some(window)])?;
            let coefficients = take(&coefficients, &[Some(lenses), Some(rank), nodes[0], nodes[1], nodes[2]])?;
            replicates.push(LowRankPsf {
                basis: fixed::<Ix4>(basis),
                coefficients: fixed::<Ix5>(coefficients),
                ..psf.clone()
            });
        }
        let diagnostics = Diagnostics {
            positions_px: fixed::<Ix2>(take("diagnostics.positions_px", &[None, None])?),
            pcc: fixed::<Ix1>(take("diagnostics.pcc", &[None])?),
            bead_nrmse: fixed::<Ix1>(take("diagnostics.bead_nrmse", &[None])?),
            singular_values: fixed::<Ix2>(take("diagnostics.singular_values", &[None, None])?),
            error_by_rank: fixed::<Ix2>(take("diagnostics.error_by_rank", &[None, None])?),
            whole_array_error,
            background_e,
            photon_transfer: fixed::<Ix2>(take("diagnostics.photon_transfer", &[None, None])?),
        };
        let sensor = [Some(body.manifest.sensor.rows), Some(body.manifest.sensor.cols)];
        let mut map = |name: &str, shape: &[Option<usize>]| match tensors.contains_key(name) {
            true => artifact::take(path, &mut tensors, name, shape).map(|t| Some(fixed::<Ix2>(t))),
            false => Ok(None),
        };
        let (offset_dn, response) = (map("offset_dn", &sensor)?, map("response", &sensor)?);
        let reading_dn2 = map("reading_dn2", &sensor)?;
        let mut effects = body.effects;
        for (i, effect) in effects.iter_mut().enumerate() {
            effect.table = map(&table_name(i), &[None, None])?;
        }
        Ok(Self {
            manifest: body.manifest,
            noise: body.noise,
            offset_dn,
            response,
            reading_dn2,
            geometry: body.geometry,
            psf,
            replicates,
            effects,
            light_unit: body.light_unit,
            pupils,
            quality: body.quality,
            diagnostics,
        })
    }
}

/// Name of the tensor that holds the table of effect `i`.
fn table_name(i: usize) -> String {
    format!("effects.{i}.table")
}

/// Names of the tensors of replicate `j`: basis, coefficients.
fn replicate_names(j: usize) -> [String; 2] {
    ["basis", "coefficients"].map(|part| format!("replicates.{j}.{part}"))
}

/// An array whose number of axes [`artifact::take`] has checked.
fn fixed<D: Dimension>(array: ArrayD<f32>) -> Array<f32, D> {
    array.into_dimensionality().unwrap_or_else(|_| Array::zeros(D::zeros(D::NDIM.unwrap_or(0))))
}

fn check(path: &Path, body: &Body) -> Result<(), InstrumentError> {
    let fail = |field, expected: &str, found: String| {
        Err(InstrumentError::Field { path: path.into(), field, expected: expected.into(), found })
    };
    let lenses = body.manifest.array.lenses();
    if body.geometry.anchors_px.len() != lenses || body.geometry.dead.len() != lenses {
        return fail("geometry", &format!("{lenses} lenses"), format!("{}", body.geometry.anchors_px.len()));
    }
    for (field, nodes) in [("node_rows_px", &body.node_rows_px), ("node_cols_px", &body.node_cols_px)] {
        if nodes.is_empty() || nodes.windows(2).any(|w| w[0] >= w[1]) {
            return fail(field, "ascending values", format!("{nodes:?}"));
        }
    }
    let positive = [("noise.gain_dn_per_e", body.noise.gain_dn_per_e), ("exposure_ms", body.exposure_ms)];
    for (field, value) in positive {
        if !(value.is_finite() && value > 0.0) {
            return fail(field, "a finite value above zero", value.to_string());
        }
    }
    Ok(())
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;
    use crate::testing::instrument;

    #[test]
    fn comes_back_as_it_was_written() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.instrument");
        let mut before = instrument([9, 11], [30, 33], 5, 3);
        before.light_unit = LightUnit::Truth { per_bead: 2.5 };
        let scaled = |v: f32| LowRankPsf { basis: &before.psf.basis * v, ..before.psf.clone() };
        before.replicates = vec![scaled(2.0), scaled(3.0)];
        for fitted in [false, true] {
            // Pupils are written where they were fitted, also where none explains the PSFs.
            if fitted {
                before.fit_pupils();
            }
            before.write(&path, Provenance::new("calibrate", 1, &())).unwrap();
            let after = Instrument::read(&path).unwrap();
            assert_eq!(format!("{before:?}"), format!("{after:?}"));
            assert_eq!(after.pupils.stored().is_some(), fitted);
        }
    }

    #[test]
    fn disagreeing_parts_are_refused() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.instrument");
        let refused = |change: &dyn Fn(&mut Instrument)| {
            let mut broken = instrument([9, 11], [30, 33], 5, 3);
            change(&mut broken);
            broken.write(&path, Provenance::new("calibrate", 1, &())).unwrap();
            Instrument::read(&path).unwrap_err().to_string()
        };
        assert!(refused(&|i| i.psf.node_rows_px.swap(0, 1)).contains("node_rows_px"));
        assert!(refused(&|i| i.psf.node_cols_px.truncate(2)).contains("psf.coefficients"));
        assert!(refused(&|i| i.psf.basis[[0, 0, 0, 0]] = f32::NAN).contains("NaN"));
        assert!(refused(&|i| i.noise.gain_dn_per_e = 0.0).contains("gain"));
        assert!(refused(&|i| i.geometry.dead.truncate(1)).contains("geometry"));
        let cut = |i: &mut Instrument| {
            let coefficients = i.psf.coefficients.slice(ndarray::s![.., .., .., ..2, ..]).to_owned();
            i.replicates = vec![LowRankPsf { coefficients, ..i.psf.clone() }];
        };
        assert!(refused(&cut).contains("replicates.0.coefficients"));
    }
}
