//! The checks of a header before anything is computed.

use super::error::{PipelineError, check};
use super::later::Later;
use crate::blob::{Header, has_black_level};
use crate::filter::FilterBank;
use crate::nn::rcan::Rcan;

/// Largest side of a frame or an object, pixels. Products of shapes are checked where the operators are planned.
const MAX_SIDE: u32 = 4096;

/// The planned operators.
pub(super) struct Shapes<'a> {
    pub filter: FilterBank<'a>,
    pub rcan: Rcan,
    pub later: Option<Later<'a>>,
}

/// Checks the shapes of a header and plans the operators.
pub(super) fn shapes(header: &Header) -> Result<Shapes<'_>, PipelineError> {
    for (field, side) in [("frame.rows", header.frame.rows), ("frame.cols", header.frame.cols)] {
        check(field, "1 to 4096 pixels", u32::from(side), |side| (1..=MAX_SIDE).contains(&side))?;
    }
    for (field, side) in [("object.rows", header.object.rows), ("object.cols", header.object.cols)] {
        let even = |side| (2..=MAX_SIDE).contains(&side) && side % 2 == 0;
        check(field, "an even number of 2 to 4096 pixels", u32::from(side), even)?;
    }
    let network = header.rcan;
    check("rcan.width", "1 to 63 channels", network.width.into(), |width| (1..64).contains(&width))?;
    let divides = |reduction| reduction > 0 && u32::from(network.width) % reduction == 0;
    check("rcan.reduction", "a divisor of the width", network.reduction.into(), divides)?;
    check("bank.channels", "1 to 63 channels", header.bank.channels.into(), |channels| (1..64).contains(&channels))?;
    if !has_black_level(header.sensor.black_level_dn) {
        return Err(PipelineError::BlackLevel { found: header.sensor.black_level_dn });
    }
    let filter = FilterBank::new(&header.bank, header.frame, header.object)?;
    let rcan = Rcan::new(network, header.integers, header.bank.channels, header.object)?;
    let later = match &header.passes {
        Some(passes) => Some(Later::new(header, passes)?),
        None => None,
    };
    Ok(Shapes { filter, rcan, later })
}
