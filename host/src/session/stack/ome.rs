//! OME-XML for the first page of a TIFF stack, so that microscopy programs know its axes and pixel size.

use super::layout::{SampleType, StackSpec};

/// OME-XML, schema 2016-06: one image with one channel and `frames` frames along the axis T.
pub(super) fn description(spec: &StackSpec, frames: &str) -> String {
    let kind = match spec.samples {
        SampleType::U8 => "uint8",
        SampleType::U16 => "uint16",
        SampleType::F32 => "float",
    };
    // The default unit of PhysicalSize is um.
    let pixel = match spec.pixel_um {
        Some(um) => format!(r#" PhysicalSizeX="{um}" PhysicalSizeY="{um}""#),
        None => String::new(),
    };
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
