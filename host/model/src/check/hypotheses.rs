//! What people do to a table of positions, and which of it fits the frames best.
//!
//! The foci of all lenses move alike, so frames that are moved back by their positions coincide, whatever the lenses
//! look like. Each hypothesis moves them back in another way. The motion tells the eight orientations apart; it cannot
//! tell mirrored positions from mirrored frames, since an array of lenses is its own mirror image.

use super::scan::{SUSPECT, Scan, middle};
use super::{Finding, Outlier, Severity};
use ommatidia_session::{Manifest, Session};
use serde::Serialize;

/// By how much another hypothesis must fit better than the table as it is: mean correlation, as a factor and a term.
const BETTER: [f64; 2] = [1.15, 0.03];
/// Standard errors, over the frames, by which it must fit better.
const SURE: f64 = 3.0;
/// Least mean correlation of a hypothesis that can be named.
const NAMED: f64 = 0.35;
/// Mean correlation below which frames do not show what any table says.
const UNRELATED: f64 = 0.12;
/// Smallest motion of the foci by the table, as a multiple of a small pixel, from which an orientation can be tested.
const LEAST_STEPS: f64 = 4.0;

/// One of the eight ways to lay two axes over two others.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub struct Turn {
    /// Rows and columns (y and x) exchanged, before they are mirrored.
    pub exchanged: bool,
    /// Rows (y) mirrored.
    pub rows: bool,
    /// Columns (x) mirrored.
    pub cols: bool,
}

impl Turn {
    pub(super) const NONE: Self = Self { exchanged: false, rows: false, cols: false };

    /// All eight, the identity first.
    pub fn all() -> impl Iterator<Item = Self> {
        (0..8).map(|i| Self { exchanged: i & 4 != 0, rows: i & 1 != 0, cols: i & 2 != 0 })
    }

    /// A displacement [row, col], turned.
    pub fn of(self, [r, c]: [f64; 2]) -> [f64; 2] {
        let [r, c] = if self.exchanged { [c, r] } else { [r, c] };
        [if self.rows { -r } else { r }, if self.cols { -c } else { c }]
    }

    fn words(self, table: &str) -> String {
        let mirrored = match (self.rows, self.cols) {
            (false, false) => "",
            (true, false) => "y",
            (false, true) => "x",
            (true, true) => "x and y",
        };
        let frames = match (self.rows, self.cols) {
            (true, false) => "upside down",
            (false, true) => "mirrored left to right",
            _ => "rotated by 180 degrees",
        };
        match (self.exchanged, mirrored) {
            (false, "") => format!("{table} and the frames agree"),
            (false, axes @ "x and y") => format!(
                "{axes} of {table} look mirrored, or the frames look {frames} (a lens turns its image), or the rows of \
                 the table are in reverse order: change the sign of {axes} in {table}, or turn the frames, or reverse \
                 the order of the positions in {table}"
            ),
            (false, axes) => format!(
                "{axes} of {table} looks mirrored, or the frames look {frames}: change the sign of {axes} in {table}, \
                 or turn the frames"
            ),
            (true, "") => format!(
                "x and y of {table} look exchanged, or the frames look transposed: exchange the names of the \
                 columns"
            ),
            (true, axes) => format!(
                "x and y of {table} look exchanged, and {axes} then mirrored (the frames or the stage are turned by \
                 90 degrees): exchange the names of the columns and change the sign of {axes}"
            ),
        }
    }
}

/// Which position belongs to which frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Order {
    /// As the table says.
    AsIs,
    /// Frame n shows the position of row n + 1.
    Next,
    /// Frame n shows the position of row n - 1.
    Previous,
    /// The last row belongs to the first frame.
    Reversed,
    /// Every second line of the raster was scanned backwards.
    Serpentine,
}

impl Order {
    const ALL: [Self; 5] = [Self::AsIs, Self::Next, Self::Previous, Self::Reversed, Self::Serpentine];

    /// Index of the row whose position frame `n` of `count` shows; `lines` is the number of frames of a raster line.
    fn row(self, n: usize, count: usize, line: Option<usize>) -> Option<usize> {
        match self {
            Self::AsIs => Some(n),
            Self::Next => Some((n + 1) % count),
            Self::Previous => Some((n + count - 1) % count),
            Self::Reversed => Some(count - 1 - n),
            Self::Serpentine => {
                let line = line?;
                let (i, j) = (n / line, n % line);
                Some(if i % 2 == 1 { i * line + (line - 1 - j) } else { n })
            }
        }
    }

    fn words(self, table: &str) -> String {
        match self {
            Self::AsIs => String::new(),
            Self::Next => format!(
                "the positions of {table} look shifted by one frame: each frame shows the position of the next row; \
                 the first row has no frame, or a frame was lost at the start"
            ),
            Self::Previous => format!(
                "the positions of {table} look shifted by one frame: each frame shows the position of the row before; \
                 a row is missing at the start, or there is a frame too many"
            ),
            Self::Reversed => format!("the rows of {table} look reversed: the last row belongs to the first frame"),
            Self::Serpentine => format!(
                "every second line of {table} looks reversed: the stage scanned to and fro (or the table says so and \
                 it did not)"
            ),
        }
    }
}

/// What the table would have to be.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Hypothesis {
    /// Orientation.
    pub turn: Turn,
    /// Order of the rows.
    pub order: Order,
    /// Factor of the positions.
    pub scale: f64,
}

impl Hypothesis {
    /// The table as it is.
    pub const AS_IS: Self = Self { turn: Turn::NONE, order: Order::AsIs, scale: 1.0 };

    /// Displacements of the frames that were read, sensor pixels. None where the hypothesis makes no sense.
    pub fn moved(&self, scan: &Scan) -> Option<Vec<[f64; 2]>> {
        let (all, line) = (&scan.all_moved_px, line(&scan.all_moved_px));
        let one = |bead: usize| {
            let row = self.order.row(bead, all.len(), line).filter(|r| *r < all.len())?;
            Some(self.turn.of(all[row]).map(|v| v * self.scale))
        };
        scan.frames.iter().map(|f| one(f.bead)).collect()
    }
}

/// Frames of one line of a raster: positions along which only one axis changes.
fn line(moved: &[[f64; 2]]) -> Option<usize> {
    let same = |a: f64, b: f64| (a - b).abs() < 0.01;
    let axis = (0..2).find(|a| moved.len() > 2 && same(moved[0][*a], moved[1][*a]))?;
    let line = moved.iter().position(|m| !same(m[axis], moved[0][axis]))?;
    (line > 1 && moved.len().is_multiple_of(line)).then_some(line)
}

/// The hypothesis that fits best.
#[derive(Clone, Debug)]
pub struct Tried {
    /// Mean correlation of the table as it is.
    pub as_is: f64,
    /// The best hypothesis: the table as it is, unless another one is clearly better.
    pub best: Hypothesis,
    /// Its mean correlation.
    pub coincidence: f64,
    /// Its correlation of each frame.
    pub by_frame: Vec<f64>,
    /// Displacement of each frame by it, sensor pixels.
    pub moved: Vec<[f64; 2]>,
    /// Whether the scan is wide enough for a test of the table.
    pub testable: bool,
}

impl Tried {
    /// Whether the foci do not move as any hypothesis says.
    pub fn is_unrelated(&self) -> bool {
        self.best == Hypothesis::AS_IS && self.as_is < UNRELATED
    }
}

/// Factors of positions in other units than um, with their names.
fn units(m: &Manifest) -> Vec<(f64, String)> {
    let pixel = m.object.pixel_um;
    let mut all = vec![
        (1e3, "x_um and y_um look like millimetres".to_string()),
        (pixel, format!("x_um and y_um look like pixels (of {pixel} um)")),
        (1.0 / pixel, format!("x_um and y_um look as if divided by the pixel size ({pixel} um) twice")),
        (1e-3, "x_um and y_um look like nanometres".into()),
        (1e6, "x_um and y_um look like metres".into()),
        (1.0 / m.optics.magnification, "x_um and y_um look measured on the sensor, behind the magnification".into()),
    ];
    all.retain(|(f, _)| (f - 1.0).abs() > 0.2);
    all
}

/// Tries all hypotheses.
pub fn best(scan: &Scan, manifest: &Manifest) -> Tried {
    let as_is = scan.correlations(&scan.table());
    let mean = |c: &[f64]| c.iter().sum::<f64>() / c.len().max(1) as f64;
    let start = mean(&as_is);
    let mut tried = Tried {
        as_is: start,
        best: Hypothesis::AS_IS,
        coincidence: start,
        by_frame: as_is.clone(),
        moved: scan.table(),
        testable: is_testable(scan, start),
    };
    if !tried.testable {
        return tried;
    }
    let consider = |tried: &mut Tried, h: Hypothesis| {
        let Some(moved) = h.moved(scan) else { return };
        let found = scan.correlations(&moved);
        let (value, n) = (mean(&found), found.len() as f64);
        let gain: Vec<f64> = found.iter().zip(&as_is).map(|(a, b)| a - b).collect();
        let spread = gain.iter().map(|g| (g - mean(&gain)).powi(2)).sum::<f64>() / (n - 1.0).max(1.0);
        let sure = mean(&gain) > SURE * (spread / n).sqrt();
        if value > tried.coincidence && value > BETTER[0] * start + BETTER[1] && value > NAMED && sure {
            tried.by_frame = found;
            tried.moved = moved;
            (tried.coincidence, tried.best) = (value, h);
        }
    };
    // Nothing can be that much better than what agrees already.
    let open = BETTER[0] * start + BETTER[1] < 1.0;
    for order in Order::ALL.into_iter().filter(|_| open) {
        Turn::all().for_each(|turn| consider(&mut tried, Hypothesis { turn, order, scale: 1.0 }));
    }
    for (scale, _) in units(manifest).into_iter().filter(|_| open) {
        Turn::all().for_each(|turn| consider(&mut tried, Hypothesis { turn, scale, ..Hypothesis::AS_IS }));
    }
    if tried.best == Hypothesis::AS_IS {
        shifted_by_one(scan, &as_is, &mut tried);
    }
    if tried.coincidence < NAMED || tried.best.scale != 1.0 {
        // A magnification or step that is simply wrong: a quarter to four times, in steps that a focus still bridges.
        let mut other = tried.clone();
        for i in -28..=28 {
            consider(&mut other, Hypothesis { scale: 1.05_f64.powi(i), ..Hypothesis::AS_IS });
        }
        // A factor with a name is better than one that fits a little better.
        if other.coincidence > BETTER[0] * tried.coincidence {
            tried = other;
        }
    }
    tried
}

/// Tries the positions of neighbouring rows. Within a line of a raster such a table is right but for a constant, which
/// is that of the anchors: only the first or last frame of each line disagrees.
fn shifted_by_one(scan: &Scan, as_is: &[f64], tried: &mut Tried) {
    let suspects = |c: &[f64]| {
        let typical = middle(c);
        c.iter().filter(|v| **v < SUSPECT * typical).count()
    };
    let before = suspects(as_is);
    for order in [Order::Next, Order::Previous] {
        let h = Hypothesis { order, ..Hypothesis::AS_IS };
        let Some(moved) = h.moved(scan) else { continue };
        let found = scan.correlations(&moved);
        // The frame without a row of its own remains.
        if before > 2 && suspects(&found) <= 1 + before / 6 {
            let coincidence = found.iter().sum::<f64>() / found.len() as f64;
            *tried = Tried { best: h, coincidence, by_frame: found, moved, ..tried.clone() };
            return;
        }
    }
}

/// Whether positions and frames can be compared: several frames, whose foci move by the table or by themselves.
fn is_testable(scan: &Scan, as_is: f64) -> bool {
    let span = |a: usize| {
        let (low, high) =
            scan.all_moved_px.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), m| (l.min(m[a]), h.max(m[a])));
        high - low
    };
    let moves = span(0).max(span(1)) > LEAST_STEPS * scan.bin as f64;
    // Frames that do not move although the table says so, or the other way round, are for the tests as well.
    scan.frames.len() >= 4 && (moves || as_is < NAMED)
}

/// What the hypotheses mean for the user.
pub fn describe(tried: &Tried, scan: &Scan, outliers: &[Outlier], session: &Session) -> Vec<Finding> {
    let table = session
        .stacks_of(ommatidia_session::Role::Bead)
        .next()
        .and_then(|s| s.entry().table.clone())
        .unwrap_or_else(|| "the table".into());
    let shares = format!(
        "{:.0} % of the light of a bead frame then coincides with that of the others, {:.0} % as the table is",
        100.0 * tried.coincidence,
        100.0 * tried.as_is
    );
    let error = |topic, text: String| vec![Finding::new(topic, Severity::Error, text)];
    let h = &tried.best;
    if !tried.testable {
        let text = "the bead frames show too little motion for a test of the positions".to_string();
        return vec![Finding::new("positions", Severity::Ok, text)];
    }
    if h.order != Order::AsIs {
        let turned = if h.turn == Turn::NONE { String::new() } else { format!("; and {}", h.turn.words(&table)) };
        return error("order", format!("{}{turned}. {shares}", h.order.words(&table)));
    }
    if (h.scale - 1.0).abs() > 0.02 {
        let named = units(session.manifest()).into_iter().find(|(f, _)| *f == h.scale).map(|(_, name)| name);
        let turned = if h.turn == Turn::NONE { String::new() } else { format!("; and {}", h.turn.words(&table)) };
        let text = match named {
            Some(name) => format!("{table}: {name}: multiply them by {:.4}{turned}. {shares}", h.scale),
            None => format!(
                "the foci move {:.2} times as far as {table} and optics.magnification say: correct the positions, or \
                 optics.magnification with object.pixel_um{turned}. {shares}",
                h.scale
            ),
        };
        return error("units", text);
    }
    if h.turn != Turn::NONE {
        return error("orientation", format!("{}. {shares}", h.turn.words(&table)));
    }
    if tried.is_unrelated() {
        let text = format!(
            "the foci of the bead frames do not move as {table} says, nor as any exchange, mirror image, order or unit \
             of it (correlation {:.2}): check that {table} belongs to these frames, and that the bead was lit",
            tried.as_is
        );
        return error("positions", text);
    }
    let agree = scan.frames.len() - outliers.len();
    let of = if outliers.is_empty() { String::new() } else { format!(" of {}", scan.frames.len()) };
    let text = format!("x and y of {table} agree with the foci of {agree}{of} bead frames");
    vec![Finding::new("orientation", Severity::Ok, text)]
}
