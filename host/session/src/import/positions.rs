//! Stage positions in the names of files.

use super::LengthUnit;
use crate::error::SessionError;
use std::path::Path;

/// A position x, y, z and its unit, um or object pixels.
pub(super) type Position = ([f64; 3], LengthUnit);

/// Positions x, y, z of each file, um or object pixels; `None` where the names hold none.
///
/// A position is a letter x, y or z at the start of a word, a number, and its unit: `x-120um_y40um.tif`,
/// `bead_X=0.12mm_Y=0_003.tif`. `unit` is that of numbers without one.
///
/// # Errors
/// Some names hold positions and others do not, or a number has no unit and `unit` is not given.
pub(super) fn in_names(paths: &[&Path], unit: Option<LengthUnit>) -> Result<Option<Vec<Position>>, SessionError> {
    let mut found = Vec::new();
    for path in paths {
        let stem = path.file_stem().unwrap_or_default().to_string_lossy().to_lowercase();
        let axis = |letter: char| of_axis(&stem, letter);
        let (x, y, z) = (axis('x'), axis('y'), axis('z'));
        let (Some(x), Some(y)) = (x, y) else {
            if found.is_empty() {
                return Ok(None);
            }
            let remedy = "name all files alike, or give the positions in a table (--positions)";
            let expected = "positions x and y, as in the files before";
            return Err(SessionError::value(path, "name", expected, stem, remedy));
        };
        let stated = [x, y].iter().chain(&z).find_map(|(_, u)| *u).or(unit);
        let Some(of_file) = stated else {
            let remedy = "state it: --unit um, --unit mm or --unit px";
            return Err(SessionError::value(path, "unit of the positions in the name", "um, mm or px", "none", remedy));
        };
        let um = |(v, u): (f64, Option<LengthUnit>)| match u.unwrap_or(of_file) {
            LengthUnit::Mm => 1e3 * v,
            _ => v,
        };
        let pixels = [x, y].iter().any(|(_, u)| u.unwrap_or(of_file) == LengthUnit::Px);
        let kind = if pixels { LengthUnit::Px } else { LengthUnit::Um };
        found.push(([um(x), um(y), z.map_or(0.0, um)], kind));
    }
    Ok(Some(found).filter(|f| !f.is_empty()))
}

/// The number behind a letter at the start of a word.
fn of_axis(name: &str, letter: char) -> Option<(f64, Option<LengthUnit>)> {
    for (at, _) in name.match_indices(letter) {
        if name[..at].ends_with(|c: char| c.is_alphabetic()) {
            continue;
        }
        let rest = name[at + 1..].trim_start_matches(['=', '_', ' ']);
        let end = number_end(rest);
        let text = rest[..end].replace([',', 'p'], ".");
        let Ok(value) = text.parse::<f64>() else { continue };
        let unit = rest[end..].trim_start_matches('_').replace(['µ', 'μ'], "u");
        let word: String = unit.chars().take_while(|c| c.is_alphabetic()).collect();
        let unit = match word.as_str() {
            "um" => Some(LengthUnit::Um),
            "mm" => Some(LengthUnit::Mm),
            "px" => Some(LengthUnit::Px),
            _ => None,
        };
        return Some((value, unit));
    }
    None
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

    fn of(name: &str, unit: Option<LengthUnit>) -> Option<([f64; 3], LengthUnit)> {
        in_names(&[name.as_ref()], unit).ok().flatten().map(|v| v[0])
    }

    #[test]
    fn positions_of_usual_names_are_read() {
        use LengthUnit::{Mm, Px, Um};
        for (name, unit, expected) in [
            ("x-120um_y40um.tif", None, Some(([-120.0, 40.0, 0.0], Um))),
            ("bead_X=0.12mm_Y=0_003.tif", None, Some(([120.0, 0.0, 0.0], Um))),
            ("x_10_y_-20_z_5.tif", Some(Um), Some(([10.0, -20.0, 5.0], Um))),
            ("x1p5_y2,5.tif", Some(Mm), Some(([1500.0, 2500.0, 0.0], Um))),
            ("X12px_Y13px.tif", None, Some(([12.0, 13.0, 0.0], Px))),
            ("x10_y20.tif", None, None),
            ("matrix10_day20.tif", Some(Um), None),
            ("0001.tif", Some(Um), None),
        ] {
            assert_eq!(of(name, unit), expected, "{name}");
        }
    }

    #[test]
    fn a_missing_unit_and_a_name_without_position_are_errors() {
        assert!(in_names(&["x1_y2.tif".as_ref()], None).unwrap_err().to_string().contains("--unit"));
        let names: [&Path; 2] = ["x1um_y2um.tif".as_ref(), "dark.tif".as_ref()];
        assert!(in_names(&names, None).unwrap_err().to_string().contains("dark.tif"));
    }
}
