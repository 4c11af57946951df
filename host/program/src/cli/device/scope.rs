//! Options for the region of the object, and whether it is reconstructed exactly.

use crate::device::Scope;
use ommatidia_shared::blob::Header;
use ommatidia_shared::image::Region;

/// Options that name a region.
#[derive(Debug, clap::Args)]
pub(super) struct ScopeArgs {
    /// Reconstruct only this region of the object, pixels (default: the whole object). Without --hold its bits equal
    /// those of the whole reconstruction
    #[arg(long, value_name = "ROW,COL,ROWS,COLS", value_parser = region)]
    roi: Option<Region>,
    /// Approximate and faster: N consecutive frames take what depends on the whole field (brightness, channel
    /// attention) from an exact frame before them, and only the region and its surroundings are computed. Without N: 9,
    /// so that every tenth frame is exact (default: every frame is exact)
    #[arg(long, value_name = "N", requires = "roi", num_args = 0..=1, default_missing_value = "9", value_parser =
        clap::value_parser!(u16).range(1..))]
    hold: Option<u16>,
}

impl ScopeArgs {
    pub(super) fn scope(&self) -> Scope {
        Scope { region: self.roi, hold: self.hold.unwrap_or(0) }
    }

    /// The region, or all of the object.
    pub(super) fn region(&self, header: &Header) -> Region {
        self.roi.unwrap_or(Region::whole(header.object.rows, header.object.cols))
    }
}

/// How many of the frames are exact, for people.
pub(super) fn exactness(held: usize, frames: usize) -> String {
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
        _ => Err("expected `ROW,COL,ROWS,COLS`, pixels: first row, first column, number of rows, number of \
            columns"
            .into()),
    }
}
