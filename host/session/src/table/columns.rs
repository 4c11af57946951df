//! What the columns of a table mean, by their names.

/// Meaning of a column.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(crate) enum Meaning {
    Frame,
    X,
    Y,
    Z,
    Exposure,
    Illumination,
    Time,
    Temperature,
}

/// Unit that the name of a column states.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Unit {
    /// As the session format has it, times this factor.
    Times(f64),
    /// Object pixels.
    ObjectPixel,
    /// The name states no unit.
    Unstated,
}

/// The name that the session format gives a column.
pub(crate) fn format_name(meaning: Meaning) -> &'static str {
    match meaning {
        Meaning::Frame => "frame",
        Meaning::X => "x_um",
        Meaning::Y => "y_um",
        Meaning::Z => "z_um",
        Meaning::Exposure => "exposure_ms",
        Meaning::Illumination => "illumination",
        Meaning::Time => "time_s",
        Meaning::Temperature => "temperature_c",
    }
}

/// The columns with a meaning: the place of each, what it means, and its unit. A column with the name of the session
/// format comes before others that could mean the same; those, and all with unknown names, are not listed.
pub(crate) fn meanings(names: &[String]) -> Vec<(usize, Meaning, Unit)> {
    let exact = |name: &str| ALL.into_iter().find(|m| format_name(*m) == name);
    let mut found: Vec<(usize, Meaning, Unit)> = Vec::new();
    for (i, name) in names.iter().enumerate() {
        let meaning = exact(name).filter(|m| found.iter().all(|(_, other, _)| other != m));
        found.extend(meaning.map(|m| (i, m, Unit::Times(1.0))));
    }
    for (i, name) in names.iter().enumerate() {
        if found.iter().any(|(at, ..)| *at == i) {
            continue;
        }
        let alike = usual(name).filter(|(m, _)| found.iter().all(|(_, other, _)| other != m));
        found.extend(alike.map(|(m, unit)| (i, m, unit)));
    }
    found.sort_by_key(|(i, ..)| *i);
    found
}

/// Whether columns x and y are among the names.
pub(crate) fn has_positions(names: &[String]) -> bool {
    let found = meanings(names);
    [Meaning::X, Meaning::Y].iter().all(|wanted| found.iter().any(|(_, meaning, _)| meaning == wanted))
}

/// The column of times, and its unit, s; `None` for a unit that is not stated.
pub(crate) fn time_column(names: &[String]) -> Option<(usize, Option<f64>)> {
    let (at, _, unit) = meanings(names).into_iter().find(|(_, meaning, _)| *meaning == Meaning::Time)?;
    Some((at, if let Unit::Times(s) = unit { Some(s) } else { None }))
}

const ALL: [Meaning; 8] = [
    Meaning::Frame,
    Meaning::X,
    Meaning::Y,
    Meaning::Z,
    Meaning::Exposure,
    Meaning::Illumination,
    Meaning::Time,
    Meaning::Temperature,
];

/// What a usual name means: words in any case and order, then a unit behind an underscore, a blank or in brackets.
fn usual(name: &str) -> Option<(Meaning, Unit)> {
    let name = name.to_lowercase().replace(['µ', 'μ', '\u{fffd}'], "u");
    let words: Vec<&str> = name.split(|c: char| !c.is_alphanumeric()).filter(|w| !w.is_empty()).collect();
    let unit = words.last().and_then(|w| unit(w)).filter(|_| words.len() > 1);
    let words = if unit.is_some() { &words[..words.len() - 1] } else { &words[..] };
    let filler = ["pos", "position", "stage", "bead", "no", "nr", "number", "index", "stamp", "relative", "level"];
    let mut kept: Vec<&str> = words.iter().copied().filter(|w| !filler.contains(w)).collect();
    if kept.is_empty() {
        kept = words.to_vec();
    }
    let [word] = kept[..] else { return None };
    let meaning = match word {
        "frame" | "frames" | "index" => Meaning::Frame,
        "x" | "xpos" | "posx" => Meaning::X,
        "y" | "ypos" | "posy" => Meaning::Y,
        "z" | "zpos" | "posz" | "depth" => Meaning::Z,
        "exposure" => Meaning::Exposure,
        "illumination" => Meaning::Illumination,
        "time" | "times" | "t" | "timestamp" | "timestamps" => Meaning::Time,
        "temperature" | "temp" => Meaning::Temperature,
        _ => return None,
    };
    let length = matches!(meaning, Meaning::X | Meaning::Y | Meaning::Z);
    let found = match (meaning, unit) {
        (Meaning::X | Meaning::Y, Some("px")) => Unit::ObjectPixel,
        (_, Some(unit)) if length => Unit::Times(um(unit)?),
        (Meaning::Time, Some(unit)) => Unit::Times(seconds(unit)?),
        (Meaning::Exposure, Some(unit)) => Unit::Times(1e3 * seconds(unit)?),
        (Meaning::Temperature, Some("c")) | (Meaning::Frame | Meaning::Illumination, None) => Unit::Times(1.0),
        (_, Some(_)) => return None,
        (_, None) => Unit::Unstated,
    };
    Some((meaning, found))
}

/// The short name of a unit.
fn unit(word: &str) -> Option<&'static str> {
    Some(match word {
        "nm" => "nm",
        "um" | "micron" | "microns" | "micrometer" | "micrometers" | "micrometre" | "micrometres" => "um",
        "mm" | "millimeter" | "millimeters" | "millimetre" | "millimetres" => "mm",
        "px" | "pixel" | "pixels" | "pix" => "px",
        "us" => "us",
        "ms" | "msec" | "milliseconds" => "ms",
        "s" | "sec" | "seconds" => "s",
        "c" | "celsius" | "degc" => "c",
        _ => return None,
    })
}

/// Micrometres in a unit of length.
fn um(unit: &str) -> Option<f64> {
    Some(match unit {
        "nm" => 1e-3,
        "um" => 1.0,
        "mm" => 1e3,
        _ => return None,
    })
}

fn seconds(unit: &str) -> Option<f64> {
    Some(match unit {
        "us" => 1e-6,
        "ms" => 1e-3,
        "s" => 1.0,
        _ => return None,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn usual_names_are_understood() {
        for (name, expected) in [
            ("X (mm)", (Meaning::X, Unit::Times(1e3))),
            ("stage_y [µm]", (Meaning::Y, Unit::Times(1.0))),
            ("Pos_X_px", (Meaning::X, Unit::ObjectPixel)),
            ("Frame Number", (Meaning::Frame, Unit::Times(1.0))),
            ("Time Stamp (ms)", (Meaning::Time, Unit::Times(1e-3))),
            ("Exposure_s", (Meaning::Exposure, Unit::Times(1e3))),
            ("depth nm", (Meaning::Z, Unit::Times(1e-3))),
            ("Y", (Meaning::Y, Unit::Unstated)),
            ("time_ms", (Meaning::Time, Unit::Times(1e-3))),
            ("TIMESTAMP [s]", (Meaning::Time, Unit::Times(1.0))),
            ("Timestamp", (Meaning::Time, Unit::Unstated)),
        ] {
            assert_eq!(usual(name), Some(expected), "{name}");
        }
        for name in ["Buffer Index", "comment", "x_kg", "x y", "max", "", "°"] {
            assert!(usual(name).is_none_or(|(m, _)| m == Meaning::Frame && name == "Buffer Index"), "{name}");
        }
    }

    #[test]
    fn the_name_of_the_format_comes_first() {
        let names = ["x (mm)", "x_um", "y_um"].map(String::from);
        assert_eq!(meanings(&names), [(1, Meaning::X, Unit::Times(1.0)), (2, Meaning::Y, Unit::Times(1.0))]);
    }
}
