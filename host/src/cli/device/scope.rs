//! Which region of the object is reconstructed, and whether exactly.

use crate::device::Scope;
use ommatidia_shared::blob::Header;
use ommatidia_shared::image::Region;

/// Options that name a region.
#[derive(Debug, clap::Args)]
pub(super) struct Args {
    /// Reconstruct this region of the object only, pixels: the same bits as cut out of the whole, unless --hold says otherwise
    #[arg(long, value_name = "ROW,COL,ROWS,COLS", value_parser = region)]
    roi: Option<Region>,
    /// Approximate, and faster: N frames one after the other take what depends on the whole field (brightness, channel attention) from an exact
    /// frame before them, and only the region and what it needs round it is computed. Without N: 9, so that every tenth frame is exact
    #[arg(long, value_name = "N", requires = "roi", num_args = 0..=1, default_missing_value = "9", value_parser = clap::value_parser!(u16).range(1..))]
    hold: Option<u16>,
}

impl Args {
    pub(super) fn scope(&self) -> Scope {
        Scope { region: self.roi, hold: self.hold.unwrap_or(0) }
    }

    /// The region, or all of the object.
    pub(super) fn region(&self, header: &Header) -> Region {
        self.roi.unwrap_or(Region::whole(header.object.rows, header.object.cols))
    }
}

/// How many of the frames are exact, in words.
pub(super) fn told(held: usize, frames: usize) -> String {
    match held {
        0 => "measured in every frame: exact".into(),
        _ => format!("measured in {} of {frames} frames, held in the others, which are approximate", frames - held),
    }
}

/// A region as it is written on the command line.
fn region(text: &str) -> Result<Region, String> {
    let numbers: Vec<u16> = text.split(',').map_while(|number| number.trim().parse().ok()).collect();
    match (numbers.as_slice(), text.split(',').count()) {
        (&[row, col, rows, cols], 4) => Ok(Region { row, col, rows, cols }),
        _ => Err("expected four numbers of pixels, `ROW,COL,ROWS,COLS`: the first row and column, and how many".into()),
    }
}
