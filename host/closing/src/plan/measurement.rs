//! The catalogue of measurements, and what the model expects of each.

use super::information::Information;
use super::{Found, columns};
use crate::data::{Blocks, Budget, Frame, Observations, Registration, Shown};
use crate::fit::{Design, Fitted, Misfit, Model, Scope, State, Term, replicas};
use ndarray::Array2;
use ommatidia_model::forward::ForwardError;
use ommatidia_session::{FrameInfo, Role};

/// A measurement that may be advised.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Measurement {
    Darks,
    FlatLevels,
    FlatExposures,
    MoreScenes,
    ScenesOtherExposures,
    ScenesMoved,
    Beads,
    BeadsInDepth,
}

/// Time from frame to frame, s.
const INTERVAL_S: f64 = 0.02;
/// Maximum number of objects of the session that are used.
const OBJECTS: usize = 8;
/// Positions along each side of a bead scan.
const SIDE: usize = 5;
/// Distance that specimens are moved by on the stage, object pixels.
const MOVED_PX: usize = 8;
/// Brightest pixel of beads, and of objects that the session does not know, relative to full scale.
const PEAK: f64 = 0.5;

impl Measurement {
    pub(crate) const ALL: [Self; 8] = [
        Self::Darks,
        Self::FlatLevels,
        Self::FlatExposures,
        Self::MoreScenes,
        Self::ScenesOtherExposures,
        Self::ScenesMoved,
        Self::Beads,
        Self::BeadsInDepth,
    ];

    pub(crate) fn id(self) -> &'static str {
        match self {
            Self::Darks => "darks",
            Self::FlatLevels => "flat_levels",
            Self::FlatExposures => "flat_exposures",
            Self::MoreScenes => "more_scenes",
            Self::ScenesOtherExposures => "scene_exposures",
            Self::ScenesMoved => "scenes_moved",
            Self::Beads => "beads",
            Self::BeadsInDepth => "beads_in_depth",
        }
    }

    pub(crate) fn words(self) -> &'static str {
        match self {
            Self::Darks => "darks at 1, 4 and 16 times the exposure, four of each",
            Self::FlatLevels => "flats at 15, 35 and 60 % of full scale, six of each",
            Self::FlatExposures => "flats of the same brightness at 1/4, 1 and 4 times the exposure, six of each",
            Self::MoreScenes => "three times as many scenes of known objects",
            Self::ScenesOtherExposures => "the scenes of known objects again at 1/4 and 1/2 of the exposure",
            Self::ScenesMoved => "the same specimens moved by 8 object pixels on the stage",
            Self::Beads => "a bead scan of 5 x 5 positions, in a session of its own",
            Self::BeadsInDepth => "a bead scan of 5 x 5 positions at two depths, in a session of its own",
        }
    }

    /// Effort, relative to a stack of darks.
    pub(crate) fn cost(self) -> f64 {
        match self {
            Self::Darks | Self::FlatLevels => 1.0,
            Self::FlatExposures | Self::MoreScenes | Self::ScenesOtherExposures => 2.0,
            Self::ScenesMoved => 3.0,
            Self::Beads => 5.0,
            Self::BeadsInDepth => 8.0,
        }
    }

    /// The information that the model expects of it. None: this instrument or session cannot do it.
    ///
    /// # Errors
    /// An object holds negative or non-finite light.
    pub(crate) fn information(
        self,
        model: &Model<'_>,
        found: &Found<'_>,
        trials: &[Term],
    ) -> Result<Option<Information>, ForwardError> {
        let Some(plan) = self.frames(model, found) else { return Ok(None) };
        let simulated = Model::new(found.instrument, &plan.seen)?;
        let stacks = plan.seen.frames.iter().map(|f| f.stack + 1).max().unwrap_or(0);
        let mut state = State {
            scale: vec![1.0; stacks],
            background_e: vec![[0.0; 3]; stacks],
            registration: vec![[0.0; 4]; plan.seen.registrations.len()],
            specimens: None,
            ..found.now.state.clone()
        };
        let scenes = simulated.scenes(&state)?;
        state.scale[stacks - 1] = match plan.light {
            Light::Scale(scale) => scale,
            Light::Peak(share) => {
                let first = simulated.predict(&state, &scenes);
                let peak = first.iter().flat_map(|p| p.sum_e.iter().copied()).fold(1e-6f32, f32::max);
                share * simulated.forward.noise().full_scale_e() / f64::from(peak)
            }
        };
        let predicted = simulated.predict(&state, &scenes);
        let none = Misfit::default();
        let gauges = Vec::new();
        let fitted = Fitted {
            state,
            predicted,
            scenes,
            training: none,
            held_out: none,
            known_held_out: none,
            even_held_out: none,
            gauges,
            given_up: false,
        };
        let errors = replicas(&simulated, found.instrument, &fitted.state)?.of(&simulated, &fitted)?;
        let columns = columns(&simulated, &fitted, trials);
        let design = Design::compute(&simulated, fitted.expansion(trials), columns, &errors, Scope::Training)?;
        let times = if self == Self::MoreScenes { 3.0 } else { 1.0 };
        let mut information = Information::of(&design, times);
        information.alone = plan.alone;
        Ok(Some(information))
    }

    fn frames(self, model: &Model<'_>, found: &Found<'_>) -> Option<Planned> {
        let seen = model.seen;
        let stack = seen.frames.iter().map(|f| f.stack + 1).max().unwrap_or(0);
        let exposure = model.exposure_ms;
        let mut make = Make { seen, stack, frames: Vec::new() };
        let known = seen.frames.iter().position(|f| matches!(f.shown, Shown::Object(_)));
        let (mut truths, mut light, mut alone) = (Vec::new(), Light::Scale(1.0), false);
        match self {
            Self::Darks => [1.0, 4.0, 16.0].into_iter().for_each(|factor| {
                make.repeats(Role::Dark, 4, &FrameInfo::plain(0, factor * exposure));
            }),
            Self::FlatLevels => {
                light = Light::Peak(0.6);
                [0.25, 0.6, 1.0].into_iter().for_each(|illumination| {
                    make.repeats(Role::Flat, 6, &FrameInfo { illumination, ..FrameInfo::plain(0, exposure) });
                });
            }
            Self::FlatExposures => {
                light = Light::Peak(0.35);
                [0.25, 1.0, 4.0].into_iter().for_each(|factor| {
                    let info = FrameInfo { illumination: 1.0 / factor, ..FrameInfo::plain(0, factor * exposure) };
                    make.repeats(Role::Flat, 6, &info);
                });
            }
            Self::MoreScenes | Self::ScenesOtherExposures | Self::ScenesMoved => {
                truths = objects(seen, model.forward.operator().object_shape());
                // As bright as the session's own.
                light = known.map_or(Light::Peak(PEAK), |k| Light::Scale(found.now.state.scale[seen.frames[k].stack]));
                let factors: &[f64] = if self == Self::ScenesOtherExposures { &[0.25, 0.5] } else { &[1.0] };
                let own = known.map_or(exposure, |k| seen.frames[k].info.exposure_ms);
                if self == Self::ScenesMoved {
                    truths.iter_mut().for_each(|t| *t = rolled(t));
                }
                for factor in factors {
                    for truth in 0..truths.len() {
                        make.push(Role::Scene, Shown::Object(truth), FrameInfo::plain(0, factor * own));
                    }
                }
            }
            Self::Beads | Self::BeadsInDepth => {
                let depths = &found.instrument.psf.node_depths_um;
                let used = match (self, depths.as_slice()) {
                    (Self::Beads, _) => vec![model.forward.depth_um()],
                    (_, [first, .., last]) => vec![*first, *last],
                    _ => return None,
                };
                // A session with known scenes is judged by them alone, so that its beads would not be read.
                (light, alone) = (Light::Peak(PEAK), known.is_some());
                let [rows, cols] = model.forward.operator().object_shape();
                let place = |i: usize, n: usize| ((i as f64 + 0.5) / SIDE as f64 * n as f64 - 0.5).round();
                for z_um in used {
                    for i in 0..SIDE * SIDE {
                        let at = [place(i / SIDE, rows), place(i % SIDE, cols)];
                        make.push(Role::Bead, Shown::Bead(at), FrameInfo { z_um, ..FrameInfo::plain(0, exposure) });
                    }
                }
            }
        }
        let frames = make.frames;
        // Registrations of the session are not those of the new stack.
        let mut registrations: Vec<Registration> =
            seen.registrations.iter().map(|r| Registration { sigma_px: 0.0, ..*r }).collect();
        if let Some(own) = seen.registrations.first().filter(|_| !truths.is_empty()) {
            registrations.push(Registration { stack, frame: None, ..*own });
        }
        let seen = Observations { frames, truths, registrations, ..empty(seen) };
        Some(Planned { seen, light, alone })
    }
}

/// Frames that are planned.
struct Planned {
    seen: Observations,
    light: Light,
    alone: bool,
}

/// How bright a planned stack is.
#[derive(Clone, Copy)]
enum Light {
    /// Light of the stack, as in a state.
    Scale(f64),
    /// The brightest pixel reaches this share of full scale.
    Peak(f64),
}

/// Frames of one stack in the making.
struct Make<'a> {
    seen: &'a Observations,
    stack: usize,
    frames: Vec<Frame>,
}

impl Make<'_> {
    fn repeats(&mut self, role: Role, count: usize, info: &FrameInfo) {
        let shown = if role == Role::Dark { Shown::Dark } else { Shown::Even };
        (0..count).for_each(|_| self.push(role, shown.clone(), info.clone()));
    }

    fn push(&mut self, role: Role, shown: Shown, info: FrameInfo) {
        let n = self.frames.len();
        // The rules of `Observations::read`.
        let held_out = match role {
            Role::Bead => n % 2 == 1,
            Role::Scene => n % 4 == 3,
            Role::Dark | Role::Flat => n / 2 % 4 == 3,
        };
        self.frames.push(Frame {
            stack: self.stack,
            role,
            info: FrameInfo { frame: n, time_s: INTERVAL_S * n as f64, ..info },
            measured: Array2::zeros((self.seen.sensor[0], self.seen.sensor[1])),
            cut: None,
            shown,
            held_out,
            previous: n.checked_sub(1),
        });
    }
}

/// The pixels and blocks of a session, without its frames. Measurements to come show known light, so that a region on
/// which specimens were estimated is none of theirs.
fn empty(seen: &Observations) -> Observations {
    let mut it = Observations {
        frames: Vec::new(),
        truths: Vec::new(),
        registrations: Vec::new(),
        pixels: seen.pixels.clone(),
        blocks: seen.blocks.clone(),
        held_out_blocks: seen.held_out_blocks.clone(),
        sensor: seen.sensor,
        recorded: 0,
        not_estimated: None,
    };
    if seen.is_part() {
        let budget = Budget::default();
        it.set(Blocks::even(seen.sensor, budget.pixels, budget.blocks, seen.is_single()));
    }
    it
}

/// Objects of the session, or, where it knows none, points spread over the field.
fn objects(seen: &Observations, [rows, cols]: [usize; 2]) -> Vec<Array2<f32>> {
    if !seen.truths.is_empty() {
        return seen.truths.iter().take(OBJECTS).cloned().collect();
    }
    let point =
        |k: usize| move |(r, c): (usize, usize)| if (r * 31 + c * 17 + k * 53).is_multiple_of(97) { 1.0 } else { 0.0 };
    (0..OBJECTS).map(|k| Array2::from_shape_fn((rows, cols), point(k))).collect()
}

/// The object moved along its columns; what leaves it comes back on the other side.
fn rolled(object: &Array2<f32>) -> Array2<f32> {
    let cols = object.ncols();
    Array2::from_shape_fn(object.dim(), |(r, c)| object[[r, (c + MOVED_PX) % cols]])
}
