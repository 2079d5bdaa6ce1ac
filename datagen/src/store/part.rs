//! A part of the shards of a dataset, so that several machines can share the work.

use std::fmt;
use std::str::FromStr;

/// Part `number` of `of`: every `of`-th shard, starting at shard `number`.
///
/// Parts with different `of` can be mixed. Together they give the same dataset if they cover all shards.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Part {
    number: u64,
    of: u64,
}

impl Part {
    /// All shards.
    pub const WHOLE: Self = Self { number: 1, of: 1 };

    /// Returns part `number` of `of`, counted from 1, or `None` if there is no such part.
    pub fn new(number: u64, of: u64) -> Option<Self> {
        (1..=of).contains(&number).then_some(Self { number, of })
    }

    /// Returns whether shard `i` of a dataset, counted from 0, is in the part.
    pub fn contains(self, i: u64) -> bool {
        i % self.of == self.number - 1
    }
}

impl fmt::Display for Part {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(formatter, "{}/{}", self.number, self.of)
    }
}

/// The error for text that names no part.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{0}: expected I/N, part I of N with I from 1 to N, for example 2/4")]
pub struct InvalidPart(String);

impl FromStr for Part {
    type Err = InvalidPart;

    fn from_str(text: &str) -> Result<Self, InvalidPart> {
        let numbers =
            text.split_once('/').and_then(|(number, of)| Some((number.parse().ok()?, of.parse().ok()?)));
        numbers.and_then(|(number, of)| Self::new(number, of)).ok_or_else(|| InvalidPart(text.to_owned()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_parts_of_a_number_cover_each_shard_once() {
        for of in 1..=5 {
            for i in 0..12 {
                let parts = (1..=of).filter(|&number| Part::new(number, of).unwrap().contains(i));
                assert_eq!(parts.collect::<Vec<_>>(), [i % of + 1]);
            }
        }
        assert!((0..9).all(|i| Part::WHOLE.contains(i)));
    }

    #[test]
    fn a_part_is_parsed_as_it_is_displayed() {
        assert_eq!("2/4".parse::<Part>().unwrap().to_string(), "2/4");
        for text in ["", "2", "0/4", "5/4", "1/0", "-1/4", "a/b", "1/2/3"] {
            let error = text.parse::<Part>().unwrap_err().to_string();
            assert!(error.contains("expected I/N"), "{error}");
        }
    }
}
