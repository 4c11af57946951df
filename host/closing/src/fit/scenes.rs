//! The light of the frames' objects behind the optics, which states share that emit the same.

use super::in_use::InUse;
use super::projection::Specimens;
use super::state::{State, Term};
use ommatidia_model::forward::SceneLight;
use ommatidia_physics::effects::Stage;
use std::sync::{Arc, Weak};

/// The light of each frame's object behind the optics ([`super::Model::scenes`]). Few effects change it.
pub type Scenes = Arc<[Option<SceneLight>]>;

/// What the light behind the optics depends on.
struct Emission {
    /// Effects on the emission.
    effects: Vec<Term>,
    /// The estimated specimens. A weak reference keeps their address from being used again.
    specimens: Option<Weak<Specimens>>,
}

impl Emission {
    fn of(state: &State) -> Self {
        let effects = state.terms.iter().filter(|t| t.effect.descriptor().stage == Stage::Object);
        Self { effects: effects.cloned().collect(), specimens: state.specimens.as_ref().map(Arc::downgrade) }
    }

    fn is(&self, other: &Self) -> bool {
        let same = match (&self.specimens, &other.specimens) {
            (Some(own), Some(other)) => Weak::ptr_eq(own, other),
            (own, other) => own.is_none() && other.is_none(),
        };
        let alike = |(a, b): (&Term, &Term)| a.id() == b.id() && a.params == b.params && a.table == b.table;
        same && self.effects.len() == other.effects.len() && self.effects.iter().zip(&other.effects).all(alike)
    }
}

/// The light behind the optics that states of a model are using.
#[derive(Default)]
pub(super) struct ScenesInUse(InUse<Emission, [Option<SceneLight>]>);

impl ScenesInUse {
    /// That of a state: one that is in use, or a new one.
    pub(super) fn of<E>(&self, state: &State, compute: impl FnOnce() -> Result<Scenes, E>) -> Result<Scenes, E> {
        let emission = Emission::of(state);
        if let Some(same) = self.0.find(|other, _| other.is(&emission)) {
            return Ok(same);
        }
        let new = compute()?;
        self.0.add(emission, &new);
        Ok(new)
    }
}
