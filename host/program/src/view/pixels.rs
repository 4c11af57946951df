//! Pictures as bytes, for a page that draws them itself.

use super::source::colours;
use crate::http::Answer;
use ndarray::Array2;
use ommatidia_report::{Look, Scale};
use ommatidia_session::SampleType;
use serde_json::json;

/// The header that describes the bytes, JSON.
const HEADER: &str = "Picture";

/// A picture: its samples row by row, least significant byte first; the header gives rows, columns, the type of the
/// samples, the range of the colours, and the label of the frame.
pub fn picture(values: &Array2<f32>, samples: SampleType, look: Look, label: &str) -> Answer {
    pictures(&[values], samples, look, label)
}

/// Several pictures of one size, one after another; the range is that of the first.
pub fn pictures(all: &[&Array2<f32>], samples: SampleType, look: Look, label: &str) -> Answer {
    let [rows, cols] = all.first().map_or([0, 0], |first| [first.nrows(), first.ncols()]);
    let scale = all.first().map(|first| look.scale(first.view()));
    let Scale { low, high, .. } = scale.unwrap_or(Scale::linear(0.0, 1.0, ommatidia_report::ColourMap::Grey));
    let values = all.iter().flat_map(|image| image.iter().copied());
    let mut bytes = Vec::with_capacity(all.len() * rows * cols * samples.bytes());
    match samples {
        SampleType::U8 => bytes.extend(values.map(|v| v as u8)),
        SampleType::U16 => bytes.extend(values.flat_map(|v| (v as u16).to_le_bytes())),
        SampleType::F32 => bytes.extend(values.flat_map(f32::to_le_bytes)),
    }
    let header = json!({
        "rows": rows, "cols": cols, "samples": samples.name(), "low": low, "high": high, "label": label,
        "layers": all.len(), "look": colours(look),
    });
    Answer::new("application/octet-stream", bytes).note(HEADER, header)
}

#[cfg(test)]
mod tests {
    use super::*;
    use ndarray::array;

    #[test]
    fn samples_are_sent_as_they_are() {
        let image = array![[0.0f32, 255.0], [258.0, 65535.0]];
        let sixteen = picture(&image, SampleType::U16, Look::Raw, "z 5 um");
        assert_eq!(sixteen.body(), [0, 0, 255, 0, 2, 1, 255, 255]);
        let float = picture(&array![[1.5f32, f32::NAN]], SampleType::F32, Look::Residual, "");
        assert_eq!(float.body()[..4], 1.5f32.to_le_bytes());
        assert!(f32::from_le_bytes([4, 5, 6, 7].map(|i| float.body()[i])).is_nan());
        let empty = picture(&Array2::zeros((0, 0)), SampleType::F32, Look::Light, "");
        assert!(empty.body().is_empty());
    }
}
