//! A part of a dataset's files, so that several machines make one dataset.

use crate::error::Error;
use std::fmt;
use std::str::FromStr;

/// Every so-manieth file of a dataset. Parts of any mix that cover all files give the same dataset.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Part {
    number: u64,
    of: u64,
}

impl Part {
    /// All files.
    pub const WHOLE: Self = Self { number: 1, of: 1 };

    /// Part `number` of `of`, from 1; `None` if there is no such part.
    pub fn new(number: u64, of: u64) -> Option<Self> {
        (1..=of).contains(&number).then_some(Self { number, of })
    }

    /// Does file `i` of a dataset, from 0, belong to it?
    pub fn has(self, i: u64) -> bool {
        i % self.of == self.number - 1
    }
}

impl fmt::Display for Part {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(formatter, "{}/{}", self.number, self.of)
    }
}

impl FromStr for Part {
    type Err = Error;

    fn from_str(text: &str) -> Result<Self, Error> {
        let numbers =
            text.split_once('/').and_then(|(number, of)| Some((number.parse().ok()?, of.parse().ok()?)));
        numbers
            .and_then(|(number, of)| Self::new(number, of))
            .ok_or_else(|| Error::Part { text: text.to_owned() })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_parts_of_a_number_share_out_all_files() {
        for of in 1..=5 {
            for i in 0..12 {
                let having = (1..=of).filter(|&number| Part::new(number, of).unwrap().has(i));
                assert_eq!(having.collect::<Vec<_>>(), [i % of + 1]);
            }
        }
        assert!((0..9).all(|i| Part::WHOLE.has(i)));
    }

    #[test]
    fn a_part_is_read_as_it_is_shown() {
        assert_eq!("2/4".parse::<Part>().unwrap().to_string(), "2/4");
        for text in ["", "2", "0/4", "5/4", "1/0", "-1/4", "a/b", "1/2/3"] {
            let error = text.parse::<Part>().unwrap_err().to_string();
            assert!(error.contains("expected I/N"), "{error}");
        }
    }
}
