//! The number of frames that the description of a TIFF announces: OME-XML, that of ImageJ, or that of tifffile.
//!
//! Some programs describe all frames and list the first page only, with the others behind it. And pages of several
//! channels or images would be taken for frames.

use super::ome::{attribute, elements};
use crate::error::SessionError;
use serde_json::Value;
use std::collections::BTreeSet;
use std::path::Path;

const REMEDY: &str = "save one channel in one focal plane as a stack of its own";

/// The number of frames that a description announces for a file of pages of [rows, cols]; `None` where it says nothing.
///
/// # Errors
/// It announces several channels, focal planes or images.
pub(super) fn frames(path: &Path, text: &str, page: [usize; 2]) -> Result<Option<usize>, SessionError> {
    if elements(text, "Pixels").next().is_some() {
        return of_ome(path, text);
    }
    if text.starts_with("ImageJ=") {
        return of_imagej(path, text);
    }
    match serde_json::from_str::<Value>(text) {
        Ok(Value::Object(entries)) => of_tifffile(path, &entries, page),
        _ => Ok(None),
    }
}

/// Refuses more than one of what is not an axis of time.
fn one(path: &Path, what: &str, found: Option<usize>) -> Result<(), SessionError> {
    match found.filter(|n| *n > 1) {
        Some(n) => Err(SessionError::value(path, what, "1", n, REMEDY)),
        None => Ok(()),
    }
}

fn of_ome(path: &Path, text: &str) -> Result<Option<usize>, SessionError> {
    // A data set of several files has the same description in each: the images of this one are those that name it.
    let starts: Vec<usize> = elements(text, "Image").map(|(at, _)| at).collect();
    let ends = starts.iter().skip(1).copied().chain([text.len()]);
    let images: Vec<&str> = starts.iter().zip(ends).map(|(start, end)| &text[*start..end]).collect();
    let files = |text: &str| -> BTreeSet<String> {
        elements(text, "UUID").filter_map(|(_, tag)| attribute(tag, "FileName")).collect()
    };
    let name = path.file_name().unwrap_or_default().to_string_lossy();
    let named: Vec<&str> = images.iter().copied().filter(|image| files(image).contains(name.as_ref())).collect();
    let ours = if named.is_empty() { images } else { named };
    one(path, "images", Some(ours.len()))?;
    let Some((_, pixels)) = elements(ours.first().unwrap_or(&text), "Pixels").next() else { return Ok(None) };
    let size = |axis: &str| attribute(pixels, axis).and_then(|n| n.trim().parse::<usize>().ok());
    one(path, "channels", size("SizeC"))?;
    one(path, "focal planes", size("SizeZ"))?;
    Ok(if files(text).len() > 1 { None } else { size("SizeT") })
}

fn of_imagej(path: &Path, text: &str) -> Result<Option<usize>, SessionError> {
    let number = |name: &str| {
        let line = text.lines().find_map(|line| line.strip_prefix(name)?.strip_prefix('='));
        line.and_then(|n| n.trim().parse::<usize>().ok())
    };
    one(path, "channels", number("channels"))?;
    // ImageJ calls a plain stack of frames slices.
    if number("frames").is_some() || number("channels").is_some() {
        one(path, "focal planes", number("slices"))?;
    }
    Ok(number("images").or_else(|| number("frames")))
}

/// tifffile states the size of the array, and its axes where they were given to it: `{"shape": [6, 32, 40]}`.
fn of_tifffile(
    path: &Path,
    entries: &serde_json::Map<String, Value>,
    [rows, cols]: [usize; 2],
) -> Result<Option<usize>, SessionError> {
    let Some(list) = entries.get("shape").and_then(Value::as_array) else { return Ok(None) };
    let sizes: Option<Vec<usize>> = list.iter().map(|n| usize::try_from(n.as_u64()?).ok()).collect();
    let Some(sizes) = sizes else { return Ok(None) };
    // The last axes are those of a page.
    let product = |sizes: &[usize]| sizes.iter().try_fold(1usize, |n, size| n.checked_mul(*size));
    let mut ends = (0..sizes.len().saturating_sub(1)).rev();
    let page = ends.find(|at| product(&sizes[*at..]) == rows.checked_mul(cols));
    let Some(page) = page else { return Ok(None) };
    let axes: Vec<char> = entries.get("axes").and_then(Value::as_str).unwrap_or("").chars().collect();
    let of = |letter: char| axes.iter().zip(&sizes[..page]).find_map(|(axis, n)| (*axis == letter).then_some(*n));
    one(path, "channels", of('C'))?;
    one(path, "focal planes", of('Z'))?;
    if sizes[..page].iter().filter(|n| **n > 1).count() > 1 {
        let found = format!("an array of {sizes:?}");
        return Err(SessionError::value(path, "axes", "one axis of frames, then rows and columns", found, REMEDY));
    }
    Ok(product(&sizes[..page]))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn of(text: &str) -> Result<Option<usize>, String> {
        frames("b.tif".as_ref(), text, [32, 40]).map_err(|e| e.to_string())
    }

    #[test]
    fn each_kind_of_description_announces_its_frames() {
        for (text, expected) in [
            ("made by hand", None),
            ("", None),
            ("[1, 2]", None),
            ("ImageJ=1.53t\nimages=6\nslices=6\n", Some(6)),
            ("ImageJ=1.53t\nunit=um\n", None),
            (r#"{"shape": [6, 32, 40], "truncated": true}"#, Some(6)),
            (r#"{"shape": [6, 1, 32, 40], "axes": "TCYX"}"#, Some(6)),
            (r#"{"shape": [6, 32, 40, 1]}"#, Some(6)),
            (r#"{"shape": [32, 40]}"#, Some(1)),
            (r#"{"shape": [6, 7]}"#, None),
            ("<OME><Image ID='a'><Pixels SizeC='1' SizeZ='1' SizeT='500'/></Image></OME>", Some(500)),
            (r#"<ome:OME><ome:Image><ome:Pixels SizeT = "0000000012"/></ome:Image></ome:OME>"#, Some(12)),
        ] {
            assert_eq!(of(text), Ok(expected), "{text}");
        }
        // More frames than any file holds are several axes like others.
        assert!(of(r#"{"shape": [18446744073709551615, 4, 32, 40]}"#).is_err());
    }

    #[test]
    fn channels_planes_and_images_are_refused_however_they_are_written() {
        let image = "<Image ID='a'><Pixels SizeC='1' SizeZ='1' SizeT='6'/></Image>";
        for (text, what) in [
            ("<OME><Image><Pixels SizeX='4' SizeC='2' SizeT='6'/></Image></OME>".to_string(), "channels"),
            ("<OME><Image><Pixels SizeC=\n  \"1\" SizeZ=\"3\"/></Image></OME>".into(), "focal planes"),
            (format!("<OME>{image}{image}</OME>"), "images"),
            (r#"{"shape": [6, 2, 32, 40], "axes": "TCYX"}"#.into(), "channels"),
            (r#"{"shape": [6, 2, 32, 40]}"#.into(), "axes"),
        ] {
            let error = of(&text).unwrap_err();
            assert!(error.contains(&format!("b.tif: {what}: expected")) && error.contains("of its own"), "{error}");
        }
    }

    #[test]
    fn a_data_set_of_several_files_is_not_counted() {
        let image = |file: &str| {
            format!("<Image><Pixels SizeT='6'><TiffData><UUID FileName='{file}'>u</UUID></TiffData></Pixels></Image>")
        };
        assert_eq!(of(&format!("<OME>{}{}</OME>", image("a.tif"), image("b.tif"))), Ok(None));
        assert!(of(&format!("<OME>{}{}</OME>", image("b.tif"), image("b.tif"))).is_err());
        assert_eq!(of(&format!("<OME>{}</OME>", image("b.tif"))), Ok(Some(6)));
    }
}
