//! The pictures inside artifacts: evaluations, residuals and accounts of `close`, sensor maps of instruments.

use super::facts;
use super::source::{Description, Group, Pane, Picture, Source};
use anyhow::Context;
use ndarray::{Array2, Ix2};
use ommatidia_closing::{Closing, account};
use ommatidia_model::instrument::{INSTRUMENT_KIND, INSTRUMENT_VERSION};
use ommatidia_network::evaluate::{self, Summary};
use ommatidia_network::methods::title;
use ommatidia_report::{Look, smoothed};
use ommatidia_session::artifact::Index;
use ommatidia_session::{Manifest, ObjectGrid, SensorSpec};
use serde_json::Value;
use std::path::Path;

/// An open artifact.
pub struct TensorSource {
    index: Index<Value>,
    description: Description,
    /// The tensor of each pane of each group, and how it is shown.
    tensors: Vec<Vec<(String, Shown)>>,
    /// What is known of each frame of each group.
    labels: Vec<Vec<String>>,
}

/// How a tensor is shown.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Shown {
    /// One entry of its first axis for each frame.
    Entry,
    /// The same; a 0 is no value.
    Residual,
    /// The same, as means of 5 × 5 pixels, which show what is weaker than the noise of one.
    Means,
    /// All of it.
    Whole,
}

impl TensorSource {
    /// An evaluation: frames, truths, and the reconstructions of all methods.
    ///
    /// # Errors
    /// It cannot be read.
    pub fn evaluation(path: &Path) -> anyhow::Result<Self> {
        let index: Index<Value> = Index::open(path, evaluate::KIND, evaluate::VERSION)?;
        let s: Summary = serde_json::from_value(index.header().body.clone()).context("the evaluation is damaged")?;
        let (sensor, object) = ([s.sensor.rows, s.sensor.cols], [s.object.rows, s.object.cols]);
        let light = |name: &str| Pane::object(name, object, Some(s.object.pixel_um), "unit of the truth");
        let pitch_um = s.sensor.pixel_pitch_um;
        let mut panes = vec![
            (Pane::raw("frame", sensor, pitch_um), "raw_dn".to_string(), Shown::Entry),
            (light("truth"), "truths".into(), Shown::Entry),
        ];
        for method in &s.methods {
            panes.push((light(&title(&method.name)), format!("reconstructions/{}", method.name), Shown::Entry));
        }
        if index.shape("predicted_dn").is_ok() {
            panes.push((Pane::raw("predicted frame", sensor, pitch_um), "predicted_dn".into(), Shown::Entry));
            panes.push((Pane::residual("residual", sensor, pitch_um), "residual_sigma".into(), Shown::Entry));
        }
        let labels = s.pictured.iter().map(|n| format!("scene {n}")).collect();
        let mut this = Self::new(index, facts::of_evaluation(&s));
        this.add("scenes", labels, panes, None)?;
        Ok(this)
    }

    /// A residual, or the account of a closed loop: residuals before and after.
    ///
    /// # Errors
    /// It cannot be read.
    pub fn account(path: &Path, grids: &[(SensorSpec, ObjectGrid)]) -> anyhow::Result<Self> {
        let index: Index<Value> = Index::open(path, account::KIND, account::VERSION)?;
        let body = &index.header().body;
        let closing: Closing = serde_json::from_value(body["closing"].clone()).context("the account is damaged")?;
        let numbers = |name: &str| -> Vec<u64> {
            body[name].as_array().into_iter().flatten().filter_map(Value::as_u64).collect()
        };
        let held_out = |n: &u64| closing.held_out_frames.iter().any(|held| *held as u64 == *n);
        let label = |n: &u64| format!("frame {n}{}", if held_out(n) { ", held out of every fit" } else { "" });
        let labels: Vec<String> = numbers("frames").iter().map(label).collect();
        let specimens: Vec<String> = numbers("specimens").iter().map(|n| format!("frame {n}")).collect();
        let asked = index.header().provenance.verb != "residual";
        let sensor = size_of(&index, "measured_dn")?;
        let um = |size: [usize; 2]| match ommatidia_report::Pixels::of(size[0], size[1], grids) {
            ommatidia_report::Pixels::Sensor(um) | ommatidia_report::Pixels::Object(um) => Some([um; 2]),
            ommatidia_report::Pixels::Unknown => None,
        };
        let pixel_um = um(sensor);
        let residual = |name: &str| Pane { pixel_um, ..Pane::residual(name, sensor, 1.0) };
        let mut panes =
            vec![(Pane { pixel_um, ..Pane::raw("measured", sensor, 1.0) }, "measured_dn".to_string(), Shown::Entry)];
        let of: &[(&str, &str)] =
            if asked { &[("before", "before"), ("after", "after")] } else { &[("residual", "before")] };
        for (shown, words) in [(Shown::Means, ", mean of 5 × 5"), (Shown::Residual, "")] {
            for (name, tensor) in of {
                panes.push((residual(&format!("{name}{words}")), (*tensor).into(), shown));
            }
        }
        let mut this = Self::new(index, facts::of_closing(&closing));
        this.description.notes = closing.notes.clone();
        this.add("residual, measured minus predicted", labels, panes, asked.then_some([1, 2]))?;
        if !specimens.is_empty() {
            let size = size_of(&this.index, "specimen_before")?;
            let pane = |name: &str| Pane { pixel_um: um(size), ..Pane::object(name, size, None, "unit of light") };
            let panes = vec![
                (pane("estimated before"), "specimen_before".to_string(), Shown::Entry),
                (pane("estimated after"), "specimen_after".into(), Shown::Entry),
            ];
            this.add("unknown specimens", specimens, panes, Some([0, 1]))?;
        }
        Ok(this)
    }

    /// The sensor maps of an instrument.
    ///
    /// # Errors
    /// It cannot be read.
    pub fn instrument(path: &Path) -> anyhow::Result<Self> {
        let index: Index<Value> = Index::open(path, INSTRUMENT_KIND, INSTRUMENT_VERSION)?;
        let body = &index.header().body;
        let manifest: Manifest =
            serde_json::from_value(body["manifest"].clone()).context("the instrument is damaged")?;
        let facts = facts::of_instrument(&manifest, body);
        let size = [manifest.sensor.rows, manifest.sensor.cols];
        let map = |name: &str, unit: &str| Pane {
            unit: unit.into(),
            look: Look::Map,
            ..Pane::raw(name, size, manifest.sensor.pixel_pitch_um)
        };
        let all = [
            ("offset_dn", map("offset from the black level", "DN"), "darks"),
            ("response", map("response relative to the mean", ""), "flats"),
            ("reading_dn2", map("variance of the reading", "DN^2"), "darks that show a difference between pixels"),
        ];
        let mut this = Self::new(index, facts);
        let mut panes = Vec::new();
        for (tensor, pane, need) in all {
            match this.index.shape(tensor) {
                Ok(_) => panes.push((pane, tensor.to_string(), Shown::Whole)),
                Err(_) => this.description.notes.push(format!("no map of {}: it takes {need}", pane.name)),
            }
        }
        if !panes.is_empty() {
            this.add("sensor maps", vec![String::new()], panes, None)?;
        }
        Ok(this)
    }

    fn new(index: Index<Value>, facts: Vec<[String; 2]>) -> Self {
        let description = Description { facts, ..Description::default() };
        Self { index, description, tensors: Vec::new(), labels: Vec::new() }
    }

    /// Adds a group; `labels` has an entry for each frame. Checks the shapes of the tensors.
    fn add(
        &mut self,
        name: &str,
        labels: Vec<String>,
        panes: Vec<(Pane, String, Shown)>,
        swipe: Option<[usize; 2]>,
    ) -> anyhow::Result<()> {
        let frames = labels.len();
        for (pane, tensor, shown) in &panes {
            let found = self.index.shape(tensor)?;
            let [rows, cols] = pane.size;
            let whole = [frames, rows, cols];
            let expected = if *shown == Shown::Whole { &whole[1..] } else { &whole[..] };
            anyhow::ensure!(found == expected, "tensor `{tensor}`: expected shape {expected:?}, found {found:?}");
        }
        let (panes, tensors): (Vec<Pane>, Vec<_>) = panes.into_iter().map(|(p, t, s)| (p, (t, s))).unzip();
        self.description.groups.push(Group { name: name.into(), frames, z_um: Vec::new(), panes, swipe });
        self.tensors.push(tensors);
        self.labels.push(labels);
        Ok(())
    }
}

/// Rows and columns of a stack in an artifact.
fn size_of(index: &Index<Value>, tensor: &str) -> anyhow::Result<[usize; 2]> {
    match index.shape(tensor)? {
        [_, rows, cols] => Ok([*rows, *cols]),
        found => anyhow::bail!("tensor `{tensor}`: expected three axes, found shape {found:?}"),
    }
}

impl Source for TensorSource {
    fn description(&self) -> &Description {
        &self.description
    }

    fn read(&mut self, group: usize, pane: usize, frame: usize) -> anyhow::Result<Picture> {
        let (tensor, shown) = self.tensors.get(group).and_then(|panes| panes.get(pane)).context("no such picture")?;
        let values = match shown {
            Shown::Whole => self.index.read(tensor)?,
            _ => self.index.read_entry(tensor, frame)?,
        };
        let values: Array2<f32> = values.into_dimensionality::<Ix2>()?;
        let values = match shown {
            Shown::Entry | Shown::Whole => values,
            Shown::Residual => values.mapv(|v| if v == 0.0 { f32::NAN } else { v }),
            Shown::Means => smoothed(values.view()),
        };
        let label = self.labels.get(group).and_then(|labels| labels.get(frame)).cloned().unwrap_or_default();
        Ok(Picture { values, label })
    }
}
