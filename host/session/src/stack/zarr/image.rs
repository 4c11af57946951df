//! What OME-Zarr says of an image: the array of its finest resolution, its axes, and their scales.

use super::json::{ATTRIBUTES_2, METADATA, read, text};
use crate::stack::codec::damaged;
use crate::stack::layout::StackScale;
use serde_json::Value;
use std::io::Result;
use std::path::{Component, Path};

/// The finest resolution of an image.
#[derive(Debug)]
pub(super) struct Image {
    /// Folder of the array below that of the image.
    pub path: String,
    /// Names of the axes, in their order.
    pub axes: Vec<String>,
    pub scale: StackScale,
}

impl Image {
    /// The image in a folder; `None` if its metadata state none.
    pub fn open(folder: &Path) -> Result<Option<Self>> {
        let attributes = match read(&folder.join(METADATA))? {
            Some(mut metadata) => metadata.get_mut("attributes").map(Value::take).unwrap_or_default(),
            None => read(&folder.join(ATTRIBUTES_2))?.unwrap_or_default(),
        };
        let all = attributes.get("ome").unwrap_or(&attributes).get("multiscales");
        let Some(image) = all.and_then(|all| all.get(0)) else { return Ok(None) };
        let finest = image.get("datasets").and_then(|all| all.get(0));
        let finest = finest.ok_or_else(|| damaged("its metadata list no datasets"))?;
        let path = text(finest, "path").to_string();
        if path.is_empty() || !Path::new(&path).components().all(|part| matches!(part, Component::Normal(_))) {
            return Err(damaged(format!("a dataset at `{path}`")));
        }
        // Until version 0.3 an axis was only a name.
        let axes: Vec<&Value> = image.get("axes").and_then(Value::as_array).into_iter().flatten().collect();
        let name = |axis: &Value| axis.as_str().unwrap_or(text(axis, "name")).to_string();
        let scales = [scale_of(finest, axes.len()), scale_of(image, axes.len())];
        let stated = |name: &str, units: &[(&str, f64)]| {
            let at = axes.iter().position(|axis| text(axis, "name") == name)?;
            let unit = units.iter().find(|(unit, _)| *unit == text(axes[at], "unit"))?.1;
            let size = scales.iter().flatten().map(|scale| scale[at]).product::<f64>() * unit;
            (scales.iter().any(Option::is_some) && size.is_finite() && size > 0.0).then_some(size)
        };
        let lengths = [("micrometer", 1.0), ("nanometer", 1e-3), ("millimeter", 1e3), ("meter", 1e6)];
        let times = [("second", 1.0), ("millisecond", 1e-3), ("microsecond", 1e-6), ("minute", 60.0)];
        let pixel_um = stated("y", &lengths).zip(stated("x", &lengths)).map(|(y, x)| [y, x]);
        let scale = StackScale { pixel_um, interval_s: stated("t", &times) };
        Ok(Some(Self { path, axes: axes.into_iter().map(name).collect(), scale }))
    }
}

/// The scale of each axis that an image or a dataset states.
fn scale_of(value: &Value, axes: usize) -> Option<Vec<f64>> {
    let all = value.get("coordinateTransformations")?.as_array()?;
    let scale = all.iter().find(|transformation| text(transformation, "type") == "scale")?;
    let scale: Option<Vec<f64>> = scale.get("scale")?.as_array()?.iter().map(Value::as_f64).collect();
    scale.filter(|scale| scale.len() == axes)
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;

    #[test]
    fn metadata_that_are_no_object_state_no_image() {
        let folder = tempfile::tempdir().unwrap();
        for text in ["5", "[]", "null", "\"attributes\"", "{}", "{\"attributes\": 5}"] {
            std::fs::write(folder.path().join(METADATA), text).unwrap();
            assert!(Image::open(folder.path()).unwrap().is_none(), "{text}");
        }
    }
}
