//! Which examples a step takes: new ones each time, or some of them again.

use crate::train::NetworkConfig;
use std::ops::Range;

/// Examples in a group whose members are used again, and how often each is used. An estimate costs some ten times as
/// much as a step.
const GROUP: u64 = 16;
const TIMES: u64 = 4;

/// Examples are drawn in groups. All of a group are used one after the other, and that several times, before the next
/// group. The examples of a step depend on its number alone, so that a run that is resumed takes the same ones.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Reuse {
    group: u64,
    /// How often each example is used.
    pub times: u64,
}

impl Reuse {
    /// That of a network: examples with estimates are used again, others are not.
    pub fn of(network: &NetworkConfig) -> Self {
        match network.iterations() {
            0 => Self { group: 1, times: 1 },
            _ => Self { group: GROUP, times: TIMES },
        }
    }

    /// The draw whose examples step `step` takes.
    pub fn draw(self, step: u64) -> u64 {
        let block = self.group * self.times;
        step / block * self.group + step % block % self.group
    }

    /// The draw of the next group that is simulated during `step`, if one is: they are spread evenly over the steps.
    pub fn ahead(self, step: u64) -> Option<u64> {
        let block = self.group * self.times;
        let at = step % block;
        (at % self.times == self.times - 1).then_some((step / block + 1) * self.group + at / self.times)
    }

    /// Whether a later step takes the examples of step `step` again.
    pub fn again(self, step: u64) -> bool {
        step % (self.group * self.times) < self.group * (self.times - 1)
    }

    /// Draws that are of use at `step` or later: those of its group and of the next one.
    pub fn kept(self, step: u64) -> Range<u64> {
        let first = step / (self.group * self.times) * self.group;
        first..first + 2 * self.group
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn without_reuse_each_step_has_a_draw_of_its_own() {
        let reuse = Reuse { group: 1, times: 1 };
        for step in 0..5 {
            assert_eq!((reuse.draw(step), reuse.ahead(step), reuse.again(step)), (step, Some(step + 1), false));
        }
    }

    #[test]
    fn each_draw_is_used_the_same_number_of_times_and_is_ready_when_it_is_needed() {
        let reuse = Reuse { group: 4, times: 3 };
        let used: Vec<u64> = (0..24).map(|step| reuse.draw(step)).collect();
        assert_eq!(used[..12], [0, 1, 2, 3, 0, 1, 2, 3, 0, 1, 2, 3]);
        assert!((0..8).all(|draw| used.iter().filter(|used| **used == draw).count() == 3));
        assert!((0..24).all(|step| reuse.again(step) == used[step as usize + 1..].contains(&used[step as usize])));
        let ahead: Vec<u64> = (0..12).filter_map(|step| reuse.ahead(step)).collect();
        assert_eq!(ahead, [4, 5, 6, 7]);
        assert!((0..24).all(|step| reuse.kept(step).contains(&reuse.draw(step))));
        assert!((0..24).filter_map(|step| Some((step, reuse.ahead(step)?))).all(|(s, d)| reuse.kept(s).contains(&d)));
    }
}
