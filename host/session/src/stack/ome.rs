//! The description of the first page of a TIFF stack: OME-XML, so that microscopy programs know axes, pixel size and
//! frame interval; and what such descriptions, or those of ImageJ, say of a stack that is read.

use super::layout::{SampleType, StackScale, StackSpec};

/// OME-XML, schema 2016-06: one image with one channel and `frames` frames along the axis T, `interval_s` apart. Pixel
/// size and interval stand in the attributes of `Pixels` and nowhere else.
pub(super) fn description(spec: &StackSpec, interval_s: Option<f64>, frames: &str) -> String {
    let kind = match spec.samples {
        SampleType::U8 => "uint8",
        SampleType::U16 => "uint16",
        SampleType::F32 => "float",
    };
    // `&#181;` is the sign for micro: a TIFF description is ASCII.
    let mut pixel = match spec.pixel_um {
        Some(um) => format!(
            concat!(
                r#" PhysicalSizeX="{um}" PhysicalSizeXUnit="&#181;m""#,
                r#" PhysicalSizeY="{um}" PhysicalSizeYUnit="&#181;m""#
            ),
            um = um
        ),
        None => String::new(),
    };
    if let Some(s) = interval_s {
        pixel += &format!(r#" TimeIncrement="{s}" TimeIncrementUnit="s""#);
    }
    let big_endian = cfg!(target_endian = "big");
    format!(
        concat!(
            r#"<?xml version="1.0" encoding="UTF-8"?>"#,
            r#"<OME xmlns="http://www.openmicroscopy.org/Schemas/OME/2016-06""#,
            r#" xmlns:xsi="http://www.w3.org/2001/XMLSchema-instance""#,
            r#" xsi:schemaLocation="http://www.openmicroscopy.org/Schemas/OME/2016-06"#,
            r#" http://www.openmicroscopy.org/Schemas/OME/2016-06/ome.xsd" Creator="ommatidia {version}">"#,
            r#"<Image ID="Image:0"><Pixels ID="Pixels:0" DimensionOrder="XYZCT" Type="{kind}" BigEndian="{big}""#,
            r#" SizeX="{cols}" SizeY="{rows}" SizeZ="1" SizeC="1" SizeT="{frames}"{pixel}>"#,
            r#"<Channel ID="Channel:0:0" SamplesPerPixel="1"/><TiffData IFD="0" PlaneCount="{frames}"/>"#,
            r#"</Pixels></Image></OME>"#
        ),
        version = env!("CARGO_PKG_VERSION"),
        kind = kind,
        big = big_endian,
        cols = spec.cols,
        rows = spec.rows,
        frames = frames,
        pixel = pixel,
    )
}

/// What a description says of pixel size and frame interval. `resolution` holds pixels per unit, [row, col], from the
/// tags of the page, which ImageJ refers to. Sizes that are not positive, and units that are none of length or time,
/// count as not given.
pub(super) fn scale(text: &str, resolution: [Option<f64>; 2]) -> StackScale {
    let positive = |v: &f64| v.is_finite() && *v > 0.0;
    if let Some(pixels) = element(text, "Pixels") {
        let size = |axis: &str| {
            let number: f64 = attribute(pixels, &format!("PhysicalSize{axis}"))?.parse().ok()?;
            let unit = attribute(pixels, &format!("PhysicalSize{axis}Unit")).unwrap_or_else(|| "um".into());
            Some(number * um(&unit)?).filter(positive)
        };
        let interval = || {
            let number: f64 = attribute(pixels, "TimeIncrement")?.parse().ok()?;
            let unit = attribute(pixels, "TimeIncrementUnit").unwrap_or_else(|| "s".into());
            Some(number * seconds(&unit)?).filter(positive)
        };
        return StackScale { pixel_um: size("Y").zip(size("X")).map(|(y, x)| [y, x]), interval_s: interval() };
    }
    if !text.starts_with("ImageJ=") {
        return StackScale::default();
    }
    let line = |name: &str| text.lines().find_map(|l| l.strip_prefix(name)?.strip_prefix('=')).map(str::trim);
    let size = |per_unit: Option<f64>| Some(um(line("unit")?)? / per_unit?).filter(positive);
    let interval = || {
        let number: f64 = line("finterval")?.parse().ok()?;
        Some(number * seconds(line("tunit").unwrap_or("s"))?).filter(positive)
    };
    StackScale { pixel_um: size(resolution[0]).zip(size(resolution[1])).map(|(y, x)| [y, x]), interval_s: interval() }
}

/// The start tag of the first element of this name.
fn element<'a>(text: &'a str, name: &'a str) -> Option<&'a str> {
    elements(text, name).next().map(|(_, tag)| tag)
}

/// Where each element of this name begins, and its start tag.
pub(super) fn elements<'a>(text: &'a str, name: &'a str) -> impl Iterator<Item = (usize, &'a str)> {
    let starts = move |at: &usize| {
        // The name may have a prefix: `<ome:Pixels`. `</Pixels` is an end.
        let prefix = text[..*at].rfind('<').map(|open| &text[open + 1..*at]);
        let is_word = |p: &str| p[..p.len() - 1].chars().all(|c| c.is_alphanumeric() || "_-.".contains(c));
        let before = prefix.is_some_and(|p| p.is_empty() || (p.ends_with(':') && is_word(p)));
        before && text[at + name.len()..].starts_with([' ', '\n', '\r', '\t', '>', '/'])
    };
    text.match_indices(name).map(|(at, _)| at).filter(starts).map(move |at| {
        let rest = &text[at..];
        (at, &rest[..rest.find('>').unwrap_or(rest.len())])
    })
}

/// The value of an attribute in a start tag.
pub(super) fn attribute(tag: &str, name: &str) -> Option<String> {
    let whole = |at: &usize| tag[..*at].ends_with([' ', '\n', '\r', '\t']);
    tag.match_indices(name).map(|(at, _)| at).filter(whole).find_map(|at| {
        let value = tag[at + name.len()..].trim_start().strip_prefix('=')?.trim_start();
        let quote = value.chars().next().filter(|c| ['"', '\''].contains(c))?;
        let value = &value[1..];
        Some(value[..value.find(quote)?].replace("&#181;", "µ").replace("&#xB5;", "µ").replace("&#956;", "µ"))
    })
}

/// Micrometres in a unit of length.
fn um(unit: &str) -> Option<f64> {
    Some(match unit.replace("\\u00B5", "µ").replace('μ', "µ").as_str() {
        "µm" | "um" | "micron" | "microns" | "micrometer" | "micrometre" => 1.0,
        "pm" => 1e-6,
        "nm" => 1e-3,
        "mm" => 1e3,
        "cm" => 1e4,
        "m" => 1e6,
        "inch" | "in" => 25_400.0,
        _ => return None,
    })
}

/// Seconds in a unit of time.
fn seconds(unit: &str) -> Option<f64> {
    Some(match unit.replace('μ', "µ").as_str() {
        "s" | "sec" | "seconds" => 1.0,
        "ms" | "msec" => 1e-3,
        "µs" | "us" => 1e-6,
        "min" => 60.0,
        "h" => 3600.0,
        _ => return None,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn of(text: &str) -> StackScale {
        scale(text, [Some(2.0), Some(4.0)])
    }

    #[test]
    fn sizes_and_intervals_are_read_in_any_unit() {
        let ome =
            |attributes: &str| of(&format!(r#"<OME><Image ID="a"><Pixels {attributes}><Channel/></Pixels></OME>"#));
        let both = |y, x, s| StackScale { pixel_um: Some([y, x]), interval_s: Some(s) };
        // Without units: um and s, by the schema.
        assert_eq!(ome(r#"PhysicalSizeX="0.5" PhysicalSizeY="0.25" TimeIncrement="0.02""#), both(0.25, 0.5, 0.02));
        let units = r#"PhysicalSizeXUnit="nm" PhysicalSizeX="500.0" PhysicalSizeY="2.5e-4" PhysicalSizeYUnit="mm"
            TimeIncrementUnit='ms' TimeIncrement='20'"#;
        assert_eq!(ome(units), both(0.25, 0.5, 0.02));
        for micro in ["µm", "μm", "&#181;m", "um"] {
            let text = format!(
                r#"PhysicalSizeX="3" PhysicalSizeXUnit="{micro}" PhysicalSizeY="3" PhysicalSizeYUnit="{micro}""#
            );
            assert_eq!(ome(&text), StackScale { pixel_um: Some([3.0; 2]), interval_s: None }, "{micro}");
        }
        let prefixed = r#"<ome:OME><ome:Pixels PhysicalSizeX="1" PhysicalSizeY="1"/></ome:OME>"#;
        assert_eq!(of(prefixed).pixel_um, Some([1.0; 2]));
    }

    #[test]
    fn what_is_no_size_is_none() {
        for attributes in [
            "",
            r#"PhysicalSizeX="1""#,
            r#"PhysicalSizeX="0" PhysicalSizeY="0" TimeIncrement="0""#,
            r#"PhysicalSizeX="1" PhysicalSizeXUnit="pixel" PhysicalSizeY="1" PhysicalSizeYUnit="pixel""#,
            r#"PhysicalSizeX="big" PhysicalSizeY="NaN" TimeIncrement="-1""#,
            r#"PhysicalSizeX="1" PhysicalSizeY="#,
        ] {
            assert_eq!(of(&format!("<OME><Pixels {attributes}/></OME>")), StackScale::default(), "{attributes}");
        }
        assert_eq!(of("made by hand"), StackScale::default());
        assert_eq!(of(""), StackScale::default());
    }

    #[test]
    fn imagej_counts_pixels_per_unit() {
        let text = "ImageJ=1.53t\nimages=6\nslices=6\nunit=micron\nfinterval=0.05\n";
        assert_eq!(of(text), StackScale { pixel_um: Some([0.5, 0.25]), interval_s: Some(0.05) });
        let text = "ImageJ=1.53t\nunit=\\u00B5m\n";
        assert_eq!(of(text), StackScale { pixel_um: Some([0.5, 0.25]), interval_s: None });
        assert_eq!(scale(text, [None; 2]), StackScale::default());
        assert_eq!(of("ImageJ=1.53t\nunit=pixel\n"), StackScale::default());
    }
}
