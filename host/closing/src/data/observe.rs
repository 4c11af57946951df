//! The frames of a session that the loop uses, and the hold-outs, which are fixed before anything is fitted.

use super::blocks::Blocks;
use super::recording::{Chooser, Kept, content};
use super::registration::{Registration, of_stack};
use ndarray::Array2;
use ommatidia_session::{Cut, FrameInfo, Role, Session, SessionError, Stack};
use serde::{Deserialize, Serialize};

/// How much of a session is used.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Budget {
    /// Maximum number of scenes. Of a longer recording of unknown specimens half as many parts give a frame each, the
    /// one that shows most, and the frame before it.
    pub scenes: usize,
    /// Maximum number of flats.
    pub flats: usize,
    /// Maximum number of darks.
    pub darks: usize,
    /// Maximum number of bead frames. They are used if no scene has a known object.
    pub beads: usize,
    /// Maximum number of pixels of a frame. Of a larger frame an even sample is used.
    pub pixels: usize,
    /// Spatial blocks along each side of the frame.
    pub blocks: usize,
}

/// Maximum number of scenes whose truths are placed one by one: each adds four free values.
const PLACED_ONE_BY_ONE: usize = 16;

impl Default for Budget {
    fn default() -> Self {
        Self { scenes: 48, flats: 20, darks: 12, beads: 96, pixels: 270_000, blocks: 6 }
    }
}

/// What a frame shows.
#[derive(Clone, Debug, PartialEq)]
pub enum Shown {
    /// A known object: index into [`Observations::truths`].
    Object(usize),
    /// A bead: object pixel (row, col), fractional.
    Bead([f64; 2]),
    /// Even light.
    Even,
    /// No light.
    Dark,
    /// An unknown specimen, which is estimated from the frame: effects are tested beside every change that a specimen
    /// could make.
    Estimated,
    /// An unknown specimen that is not estimated: only detail that is sharper than its smooth part can be compared with
    /// a model.
    Unknown,
}

/// One frame.
#[derive(Clone, Debug)]
pub struct Frame {
    /// Index of the stack in the session.
    pub stack: usize,
    /// Role of the stack.
    pub role: Role,
    /// Its record in the session.
    pub info: FrameInfo,
    /// As measured, DN, [sensor rows, sensor cols].
    pub measured: Array2<f32>,
    /// The part of the frame that was measured; None: all of it.
    pub cut: Option<Cut>,
    /// What it shows.
    pub shown: Shown,
    /// Whether it is kept out of every fit.
    pub held_out: bool,
    /// Index of the preceding frame of the same stack, if that is among the frames that are used.
    pub previous: Option<usize>,
}

/// The frames, with the objects of the scenes.
#[derive(Clone, Debug)]
pub struct Observations {
    /// Frames, stack by stack, in order.
    pub frames: Vec<Frame>,
    /// Known objects, [object rows, object cols], as the session records them.
    pub truths: Vec<Array2<f32>>,
    /// Registrations of the truths.
    pub registrations: Vec<Registration>,
    /// Pixels that are used: flat indices into a frame, block by block.
    pub pixels: Vec<u32>,
    /// Range of `pixels` of each spatial block; blocks are in row order.
    pub blocks: Vec<std::ops::Range<usize>>,
    /// Whether a block is kept out of every fit.
    pub held_out_blocks: Vec<bool>,
    /// Rows and columns of the sensor.
    pub sensor: [usize; 2],
    /// Frames of unknown specimens in the session; `frames` may hold some of them only.
    pub recorded: usize,
    /// Why the specimens of such frames were not estimated, if they could not be.
    pub not_estimated: Option<String>,
}

impl Observations {
    /// Whether a block of frame `k` is kept out of every fit. Flats are kept out as whole frames: the shape of their
    /// lamp is fitted, and a half of the sensor does not show the other half of it. Where too few are there for that,
    /// their blocks are kept out only if nothing else is judged.
    pub fn is_held_out(&self, k: usize, block: usize) -> bool {
        let f = &self.frames[k];
        let others = || self.frames.iter().any(|o| o.held_out || !matches!(o.shown, Shown::Even | Shown::Dark));
        f.held_out || self.held_out_blocks[block] && !(f.shown == Shown::Even && others())
    }

    /// Reads the frames.
    ///
    /// The hold-outs are fixed here, before any fit, by rule and not by chance: every fourth scene, every fourth pair
    /// of flats, darks and unknown scenes, every second bead and every eighth spatial block; with fewer than four
    /// scenes or beads, every second block, like the fields of one colour of a chessboard: each lens has both. A scene
    /// whose truth has a registration of its own is not held out: nothing but the frame itself shows where its truth
    /// lies. The spatial blocks judge there.
    ///
    /// Frames whose table says that their data are damaged are left out.
    ///
    /// Stacks of unknown specimens are read once, from the first frame to the last, and only frames that are used stay
    /// in memory.
    ///
    /// # Errors
    /// A frame or an object cannot be read.
    pub fn read(session: &Session, budget: &Budget) -> Result<Self, SessionError> {
        let sensor = [session.manifest().sensor.rows, session.manifest().sensor.cols];
        let (mut frames, mut truths, mut registrations) = (Vec::new(), Vec::new(), Vec::new());
        let known = session.stacks_of(Role::Scene).any(|s| s.entry().truth.is_some());
        let recorded: usize =
            session.stacks_of(Role::Scene).filter(|s| s.entry().truth.is_none()).map(Stack::len).sum();
        for (s, stack) in session.stacks().iter().enumerate() {
            let most = match stack.role() {
                Role::Scene if stack.entry().truth.is_none() && recorded > budget.scenes && !known => {
                    let parts = (budget.scenes / 2 * stack.len() / recorded).max(1);
                    read_recording(session, stack, (s, parts), &mut frames)?;
                    continue;
                }
                Role::Scene if stack.entry().truth_registration_per_frame => budget.scenes.min(PLACED_ONE_BY_ONE),
                Role::Scene => budget.scenes,
                Role::Flat => budget.flats,
                Role::Dark => budget.darks,
                Role::Bead if known => 0,
                Role::Bead => budget.beads,
            };
            let whole: Vec<usize> = stack.whole().map(|info| info.frame).collect();
            let chosen: Vec<usize> = in_pairs(whole.len(), most).into_iter().map(|k| whole[k]).collect();
            registrations.extend(of_stack(stack, s, &chosen));
            read_stack(session, stack, (s, &chosen), &mut frames, &mut truths)?;
        }
        let mut it = Self {
            frames,
            truths,
            registrations,
            pixels: Vec::new(),
            blocks: Vec::new(),
            held_out_blocks: Vec::new(),
            sensor,
            recorded,
            not_estimated: None,
        };
        it.set(Blocks::even(sensor, budget.pixels, budget.blocks, it.is_single()));
        Ok(it)
    }

    /// Uses those pixels of the sensor that `taken` names by row and column, in blocks of `side` along each side of the
    /// sensor. Blocks without a pixel are left out.
    pub(crate) fn use_pixels(&mut self, taken: impl Fn(usize, usize) -> bool, side: usize) {
        self.set(Blocks::of(self.sensor, taken, side, self.is_single()));
    }

    /// Uses the pixels of blocks.
    pub(crate) fn set(&mut self, blocks: Blocks) {
        (self.pixels, self.blocks, self.held_out_blocks) = (blocks.pixels, blocks.ranges, blocks.held_out);
    }

    /// Whether there are so few scenes or beads that every second block is held out.
    pub(crate) fn is_single(&self) -> bool {
        self.of(Role::Scene).chain(self.of(Role::Bead)).count() < 4
    }

    /// 1 at pixels that are used, else 0, [sensor rows, sensor cols].
    pub(crate) fn used(&self) -> Array2<f32> {
        let mut used = Array2::zeros((self.sensor[0], self.sensor[1]));
        self.pixels.iter().for_each(|p| used[[*p as usize / self.sensor[1], *p as usize % self.sensor[1]]] = 1.0);
        used
    }

    /// Whether some pixels of the sensor are not used.
    pub(crate) fn is_part(&self) -> bool {
        self.pixels.len() < self.sensor[0] * self.sensor[1]
    }

    /// Index of the registration of frame `k`'s truth; None: it has no truth.
    pub fn registration_of(&self, k: usize) -> Option<usize> {
        let f = &self.frames[k];
        self.registrations.iter().position(|r| r.holds(f.stack, f.info.frame))
    }

    /// Leaves the truths out: the specimens are unknown, and nothing but blocks of their frames is held out.
    pub(crate) fn forget_truths(&mut self) {
        self.truths.clear();
        self.registrations.clear();
        for f in self.frames.iter_mut().filter(|f| matches!(f.shown, Shown::Object(_))) {
            (f.shown, f.held_out) = (Shown::Unknown, false);
            self.recorded += 1;
        }
    }

    /// Leaves frames out.
    pub(crate) fn leave_out(&mut self, which: impl Fn(&Frame) -> bool) {
        let mut next = 0;
        // Where each frame goes; None: it is left out.
        let places: Vec<Option<usize>> = self
            .frames
            .iter()
            .map(|f| {
                let place = (!which(f)).then_some(next);
                next += usize::from(place.is_some());
                place
            })
            .collect();
        let mut place = places.iter();
        self.frames.retain(|_| place.next().is_some_and(Option::is_some));
        for f in &mut self.frames {
            f.previous = f.previous.and_then(|p| places[p]);
        }
    }

    /// Indices of the frames with a role.
    pub fn of(&self, role: Role) -> impl Iterator<Item = usize> + '_ {
        (0..self.frames.len()).filter(move |k| self.frames[*k].role == role)
    }
}

fn read_stack(
    session: &Session,
    stack: &Stack,
    (s, chosen): (usize, &[usize]),
    frames: &mut Vec<Frame>,
    truths: &mut Vec<Array2<f32>>,
) -> Result<(), SessionError> {
    if chosen.is_empty() {
        return Ok(());
    }
    let (mut reader, mut truth) = (stack.frames()?, stack.truth()?);
    let first = frames.len();
    let everything = chosen.len() == stack.len();
    for (n, i) in chosen.iter().enumerate() {
        let info = stack.info()[*i].clone();
        let shown = match (stack.role(), &mut truth) {
            (Role::Scene, Some(truth)) => {
                truths.push(truth.read(*i)?);
                Shown::Object(truths.len() - 1)
            }
            (Role::Scene, None) => Shown::Unknown,
            (Role::Bead, _) => Shown::Bead(session.manifest().object.pixel_of_um(info.y_um, info.x_um)),
            (Role::Flat, _) => Shown::Even,
            (Role::Dark, _) => Shown::Dark,
        };
        let previous = (n > 0 && chosen[n - 1] + 1 == *i).then(|| first + n - 1);
        // Every second bead, else every fourth frame.
        let held_out = match stack.role() {
            Role::Bead => bead_is_held_out(*i),
            // Repeats stay together, and so do frames of an unknown specimen, which may be repeats.
            Role::Dark | Role::Flat => n / 2 % 4 == 3,
            Role::Scene if stack.entry().truth_registration_per_frame => false,
            Role::Scene if everything && truth.is_some() => i % 4 == 3,
            Role::Scene => n / 2 % 4 == 3,
        };
        let measured = reader.read(*i)?;
        frames.push(Frame {
            stack: s,
            role: stack.role(),
            cut: if stack.role() == Role::Bead { Cut::of(&measured) } else { None },
            measured,
            info,
            shown,
            held_out,
            previous,
        });
    }
    Ok(())
}

/// Reads a stack of unknown specimens once and keeps the frames that show most: of each of some parts of it one, with
/// the frame before that. Frames at another depth than the first do not count, since specimens are estimated at one.
fn read_recording(
    session: &Session,
    stack: &Stack,
    (s, parts): (usize, usize),
    frames: &mut Vec<Frame>,
) -> Result<(), SessionError> {
    let (mut reader, info) = (stack.frames()?, stack.info());
    let full_dn = session.manifest().sensor.saturation_dn();
    let mut chooser = Chooser::new(stack.len(), parts);
    for of in stack.whole() {
        let index = of.frame;
        let frame = reader.read(index)?;
        let content = if of.z_um == info[0].z_um { content(&frame, full_dn) } else { 0.0 };
        chooser.push(Kept { index, frame, content });
    }
    let first = frames.len();
    for (n, Kept { index, frame, .. }) in chooser.finish().into_iter().enumerate() {
        let before = frames.last().filter(|f| f.stack == s && f.info.frame + 1 == info[index].frame);
        let previous = before.map(|_| first + n - 1);
        frames.push(Frame {
            stack: s,
            role: stack.role(),
            info: info[index].clone(),
            measured: frame,
            cut: None,
            shown: Shown::Unknown,
            held_out: n / 2 % 4 == 3,
            previous,
        });
    }
    Ok(())
}

/// Whether frame `i` of a bead stack is kept out of every fit. In a raster scan with an odd number of columns the
/// held-out beads form one colour of a checkerboard.
pub(crate) fn bead_is_held_out(i: usize) -> bool {
    i % 2 == 1
}

/// At most `most` of `n` frames, evenly spread, in pairs of neighbours: repeats need pairs, and effects of the
/// preceding frame too.
fn in_pairs(n: usize, most: usize) -> Vec<usize> {
    if n <= most {
        return (0..n).collect();
    }
    let pairs = most / 2;
    let mut out: Vec<usize> = (0..pairs)
        .flat_map(|p| {
            let start = if pairs < 2 { 0 } else { p * (n - 2) / (pairs - 1) };
            [start, start + 1]
        })
        .collect();
    out.dedup();
    out
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;

    #[test]
    fn chosen_frames_come_in_pairs_and_reach_both_ends() {
        assert_eq!(in_pairs(5, 8), [0, 1, 2, 3, 4]);
        assert_eq!(in_pairs(40, 6), [0, 1, 19, 20, 38, 39]);
        assert!(in_pairs(9, 0).is_empty());
    }

    #[test]
    fn a_long_recording_is_read_once_and_its_best_frames_stay() {
        let folder = tempfile::tempdir().unwrap();
        let dir = folder.path();
        let manifest = "format = 1\nname = \"film\"\n[sensor]\nrows = 20\ncols = 24\npixel_pitch_um = 2.0\n\
                        bit_depth = 12\n[array]\nrows = 1\ncols = 1\npitch_px = 20.0\n[optics]\n\
                        magnification = 0.66\npsf_window_px = 9\n[object]\nrows = 8\ncols = 8\npixel_um = 3.0\n\
                        [[stack]]\nrole = \"scene\"\nfile = \"scene.npy\"\nexposure_ms = 10.0\n";
        std::fs::write(dir.join("session.toml"), manifest).unwrap();
        // A few frames of light among dim ones.
        let bright = [3, 200, 201, 450];
        let stack = ndarray::Array3::from_shape_fn((500, 20, 24), |(f, r, c)| {
            let light = if bright.contains(&f) { 500.0 } else { 20.0 };
            100.0 + if (r / 3 + c / 3) % 2 == 0 { light } else { 0.0 } + (f % 7) as f32
        });
        ommatidia_session::stack::write(&dir.join("scene.npy"), stack.view()).unwrap();
        let session = Session::open(dir).unwrap();
        let seen = Observations::read(&session, &Budget::default()).unwrap();
        assert!(seen.recorded == 500 && (24..=48).contains(&seen.frames.len()), "{}", seen.frames.len());
        let numbers: Vec<usize> = seen.frames.iter().map(|f| f.info.frame).collect();
        assert!(numbers.windows(2).all(|w| w[0] < w[1]), "{numbers:?}");
        assert!([3, 200, 450].iter().all(|b| numbers.contains(b)), "{numbers:?}");
        for f in &seen.frames {
            assert_eq!(f.measured, stack.slice(ndarray::s![f.info.frame, .., ..]));
            assert!(f.previous.is_none_or(|p| seen.frames[p].info.frame + 1 == f.info.frame));
        }
        assert!(seen.frames.iter().filter(|f| f.previous.is_some()).count() >= 20);
        // Damaged frames are left out, however bright they are; so are they of a stack that is used as a whole.
        let table = |frames: usize, damaged: &[usize]| {
            let data = |f: usize| if damaged.contains(&f) { "damaged" } else { "whole" };
            let rows: String = (0..frames).map(|f| format!("{f},{}\n", data(f))).collect();
            std::fs::write(dir.join("scene.csv"), format!("frame,data\n{rows}")).unwrap();
            std::fs::write(dir.join("session.toml"), format!("{manifest}table = \"scene.csv\"\n")).unwrap();
            let seen = Observations::read(&Session::open(dir).unwrap(), &Budget::default()).unwrap();
            seen.frames.iter().map(|f| f.info.frame).collect::<Vec<usize>>()
        };
        let numbers = table(500, &[200, 449]);
        assert!(numbers.contains(&201) && numbers.contains(&450), "{numbers:?}");
        assert!(!numbers.contains(&200) && !numbers.contains(&449), "{numbers:?}");
        ommatidia_session::stack::write(&dir.join("scene.npy"), stack.slice(ndarray::s![..6, .., ..])).unwrap();
        assert_eq!(table(6, &[2]), [0, 1, 3, 4, 5]);
    }
}
