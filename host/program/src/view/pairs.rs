//! The pairs of a data set.

use super::source::{Description, Group, Pane, Picture, Plane, Source};
use ommatidia_model::dataset::DataSet;
use ommatidia_report::{Look, Pixels, number};
use ommatidia_session::{ObjectGrid, SensorSpec};
use std::path::Path;

/// An open data set.
pub struct PairSource {
    data: DataSet,
    description: Description,
}

impl PairSource {
    /// Opens a data set. Its plan does not state the size of pixels: that of the instrument or session among `grids`
    /// with objects and frames of this size is taken.
    ///
    /// # Errors
    /// The plan or a shard is missing or damaged.
    pub fn open(path: &Path, grids: &[(SensorSpec, ObjectGrid)]) -> anyhow::Result<Self> {
        let data = DataSet::open(path)?;
        let plan = data.plan();
        let um = |size: [usize; 2]| match Pixels::of(size[0], size[1], grids) {
            Pixels::Sensor(um) | Pixels::Object(um) => Some([um; 2]),
            Pixels::Unknown => None,
        };
        let object = Pane { pixel_um: um(plan.object), ..Pane::object("object", plan.object, None, "of its maximum") };
        let frame = Pane {
            name: "expected frame".into(),
            unit: "e-".into(),
            size: plan.frame,
            pixel_um: um(plan.frame),
            plane: Plane::Sensor,
            look: Look::Raw,
            ..object.clone()
        };
        let name = String::from("pairs");
        let groups =
            vec![Group { name, frames: plan.count, z_um: Vec::new(), panes: vec![object, frame], swipe: None }];
        let [low, high] = plan.peak_e;
        let facts = vec![
            ["pairs".into(), plan.count.to_string()],
            ["brightest pixel".into(), format!("{} to {} e-", number(low), number(high))],
        ];
        let notes = vec!["frames are free of noise: training draws it anew each time".into()];
        Ok(Self { data, description: Description { facts, notes, groups } })
    }
}

impl Source for PairSource {
    fn description(&self) -> &Description {
        &self.description
    }

    fn read(&mut self, _group: usize, pane: usize, frame: usize) -> anyhow::Result<Picture> {
        let (object, light_e) = self.data.pair(frame)?;
        Ok(Picture { values: if pane == 0 { object } else { light_e }, label: String::new() })
    }
}
