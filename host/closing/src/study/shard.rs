//! One share of a study, so that several computers divide it.

use std::str::FromStr;

/// The instruments whose number is `index` modulo `count`, with all their cases. All instruments by default.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Shard {
    /// Number of this share, counted from 0.
    pub index: usize,
    /// Number of shares.
    pub count: usize,
}

impl Default for Shard {
    fn default() -> Self {
        Self { index: 0, count: 1 }
    }
}

impl Shard {
    /// Whether instrument number `instrument` belongs to this share.
    pub fn has(self, instrument: usize) -> bool {
        instrument % self.count.max(1) == self.index
    }
}

impl FromStr for Shard {
    type Err = String;

    /// Parses `I/N`.
    fn from_str(text: &str) -> Result<Self, String> {
        let parts =
            text.split_once('/').and_then(|(i, n)| Some(Self { index: i.parse().ok()?, count: n.parse().ok()? }));
        parts.filter(|s| s.index < s.count).ok_or_else(|| "expected I/N with I below N, e.g. 0/2".into())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_shard_is_one_of_some() {
        assert_eq!("1/4".parse(), Ok(Shard { index: 1, count: 4 }));
        assert!(["4/4", "1", "a/b"].iter().all(|text| text.parse::<Shard>().is_err()));
        assert!(Shard { index: 1, count: 4 }.has(5) && !Shard { index: 1, count: 4 }.has(4) && Shard::default().has(7));
    }
}
