//! Stage positions in the names of files.

use super::LengthUnit;
use crate::error::SessionError;
use std::path::Path;

/// Positions of files by their names.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct InNames {
    /// Position x, y, z of each file, um; x and y in object pixels where `in_pixels` says so.
    pub at: Vec<[f64; 3]>,
    /// Whether x and y are in object pixels.
    pub in_pixels: bool,
}

/// Positions x, y, z of each file; `None` where the names hold none.
///
/// A position is a letter x, y or z at the start of a word, a number, and its unit: `x-120um_y40um.tif`,
/// `bead_X=0.12mm_Y=0_003.tif`. `unit` is that of numbers without one.
///
/// # Errors
/// Some names hold positions and others do not, a number has no unit and `unit` is not given, a unit is not known, or
/// pixels and lengths are mixed.
pub(super) fn in_names(paths: &[&Path], unit: Option<LengthUnit>) -> Result<Option<InNames>, SessionError> {
    let mut found = InNames { at: Vec::new(), in_pixels: false };
    for path in paths {
        let stem = path.file_stem().unwrap_or_default().to_string_lossy().to_lowercase();
        let axis = |letter: char| of_axis(&stem, letter);
        let (x, y, z) = (axis('x'), axis('y'), axis('z'));
        let (Some(x), Some(y)) = (x, y) else {
            if found.at.is_empty() {
                return Ok(None);
            }
            let remedy = "name all files alike, or give the positions in a table (--positions)";
            let expected = "positions x and y, as in the files before";
            return Err(SessionError::value(path, "name", expected, stem, remedy));
        };
        let wrong = |what: String, remedy| {
            Err(SessionError::value(path, "unit of the positions in the name", "um, mm or px", what, remedy))
        };
        let units = [&x, &y].into_iter().chain(&z).map(|(_, unit)| unit);
        if let Some(word) = units.clone().find_map(|u| if let Stated::Unknown(word) = u { Some(word) } else { None }) {
            let remedy = "rename the files, or give the positions in a table (--positions); or, if the frames show no \
                          beads, write scene= in front of the recording";
            return wrong(format!("`{word}`"), remedy);
        }
        let stated = |of: &Stated| if let Stated::Unit(unit) = of { Some(*unit) } else { None };
        let usual = unit.map(|unit| match unit {
            LengthUnit::Um => Unit::Um(1.0),
            LengthUnit::Mm => Unit::Um(1e3),
            LengthUnit::Px => Unit::Px,
        });
        let Some(of_file) = units.clone().find_map(stated).or(usual) else {
            return wrong("none".into(), "state it: --unit um, --unit mm or --unit px");
        };
        let value = |(v, u): &(f64, Stated)| match stated(u).unwrap_or(of_file) {
            Unit::Um(um) => (um * v, false),
            Unit::Px => (*v, true),
        };
        let ((x, x_px), (y, y_px), (z, z_px)) = (value(&x), value(&y), z.as_ref().map_or((0.0, false), value));
        if x_px != y_px || z_px || (!found.at.is_empty() && found.in_pixels != x_px) {
            let remedy = "give x and y of all files in the same unit, and z in um or mm";
            return wrong("pixels for some and lengths for others".into(), remedy);
        }
        found.in_pixels = x_px;
        found.at.push([x, y, z]);
    }
    Ok(Some(found).filter(|f| !f.at.is_empty()))
}

/// A unit of positions: a length, um, or an object pixel.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Unit {
    Um(f64),
    Px,
}

/// What follows a number in a name.
#[derive(Clone, Debug, PartialEq)]
enum Stated {
    Unit(Unit),
    Unknown(String),
    Nothing,
}

/// The number behind a letter at the start of a word.
fn of_axis(name: &str, letter: char) -> Option<(f64, Stated)> {
    for (at, _) in name.match_indices(letter) {
        if name[..at].ends_with(|c: char| c.is_alphabetic()) {
            continue;
        }
        let rest = name[at + 1..].trim_start_matches(['=', '_', ' ']).replace('\u{2212}', "-");
        let end = number_end(&rest);
        let text = rest[..end].replace([',', 'p'], ".");
        let Ok(value) = text.parse::<f64>() else { continue };
        return Some((value, unit_of(&rest[end..])));
    }
    None
}

/// The unit behind a number. A word right behind it must be one, unless it is the next axis; one behind an underscore
/// or a blank may be.
fn unit_of(rest: &str) -> Stated {
    let word = |text: &str| text.replace(['µ', 'μ'], "u").chars().take_while(|c| c.is_alphabetic()).collect::<String>();
    let (close, apart) = (word(rest), word(rest.trim_start_matches(['_', ' '])));
    let unit = match apart.as_str() {
        "nm" => Unit::Um(1e-3),
        "um" | "micron" | "microns" => Unit::Um(1.0),
        "mm" => Unit::Um(1e3),
        "px" | "pix" | "pixel" | "pixels" => Unit::Px,
        _ if close.is_empty() || ["x", "y", "z"].contains(&close.as_str()) => return Stated::Nothing,
        _ => return Stated::Unknown(close),
    };
    Stated::Unit(unit)
}

/// Where a number with sign and decimal point (`.`, `,`, or `p` between digits) ends.
fn number_end(text: &str) -> usize {
    let bytes = text.as_bytes();
    let digit = |i: usize| bytes.get(i).is_some_and(u8::is_ascii_digit);
    let mut end = usize::from(matches!(bytes.first(), Some(b'+' | b'-')));
    let mut point = false;
    loop {
        let here = bytes.get(end).copied().unwrap_or(b' ');
        if digit(end) {
            end += 1;
        } else if !point && b".,p".contains(&here) && digit(end + 1) {
            point = true;
            end += 1;
        } else {
            return end;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn of(name: &str, unit: Option<LengthUnit>) -> Option<([f64; 3], bool)> {
        in_names(&[name.as_ref()], unit).ok().flatten().map(|found| (found.at[0], found.in_pixels))
    }

    #[test]
    fn positions_of_usual_names_are_read() {
        use LengthUnit::{Mm, Um};
        for (name, unit, expected) in [
            ("x-120um_y40um.tif", None, Some(([-120.0, 40.0, 0.0], false))),
            ("bead_X=0.12mm_Y=0_003.tif", None, Some(([120.0, 0.0, 0.0], false))),
            ("x_10_y_-20_z_5.tif", Some(Um), Some(([10.0, -20.0, 5.0], false))),
            ("x1p5_y2,5.tif", Some(Mm), Some(([1500.0, 2500.0, 0.0], false))),
            ("X12px_Y13px.tif", None, Some(([12.0, 13.0, 0.0], true))),
            ("x-10000nm_y10um.tif", None, Some(([-10.0, 10.0, 0.0], false))),
            ("x 3 microns, y \u{2212}4 microns.tif", None, Some(([3.0, -4.0, 0.0], false))),
            ("x10y20_scan.tif", Some(Um), Some(([10.0, 20.0, 0.0], false))),
            ("x10_y20.tif", None, None),
            ("matrix10_day20.tif", Some(Um), None),
            ("0001.tif", Some(Um), None),
        ] {
            assert_eq!(of(name, unit), expected, "{name}");
        }
    }

    #[test]
    fn a_missing_unit_and_a_name_without_position_are_errors() {
        let error = |names: &[&str]| {
            let paths: Vec<&Path> = names.iter().map(Path::new).collect();
            in_names(&paths, None).unwrap_err().to_string()
        };
        assert!(error(&["x1_y2.tif"]).contains("--unit"));
        assert!(error(&["x1um_y2um.tif", "dark.tif"]).contains("dark.tif"));
        assert!(error(&["x1inch_y2inch.tif"]).contains("`inch`"));
        for mixed in [&["x-10px_y10um.tif"][..], &["x1px_y2px_z3px.tif"], &["x1px_y2px.tif", "x1um_y2um.tif"]] {
            assert!(error(mixed).contains("same unit"), "{mixed:?}");
        }
    }
}
