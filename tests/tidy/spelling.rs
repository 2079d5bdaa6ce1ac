//! American spelling in code and prose.

use super::{collect, none};
use crate::support::repository;

/// The paper's title keeps its spelling.
const TITLE: &str =
    "visual servoing in virtualised environments based on optical flow learning and constrained optimisation";

/// British words, with their American spelling.
const WORDS: &[(&str, &str)] = &[
    ("analyse", "analyze"),
    ("artefact", "artifact"),
    ("behaviour", "behavior"),
    ("cancelled", "canceled"),
    ("cancelling", "canceling"),
    ("catalogue", "catalog"),
    ("centimetre", "centimeter"),
    ("centre", "center"),
    ("centred", "centered"),
    ("colour", "color"),
    ("coloured", "colored"),
    ("defence", "defense"),
    ("favour", "favor"),
    ("favourite", "favorite"),
    ("fibre", "fiber"),
    ("flavour", "flavor"),
    ("grey", "gray"),
    ("honour", "honor"),
    ("judgement", "judgment"),
    ("kilometre", "kilometer"),
    ("labelled", "labeled"),
    ("labelling", "labeling"),
    ("licence", "license"),
    ("metre", "meter"),
    ("micrometre", "micrometer"),
    ("millimetre", "millimeter"),
    ("modelled", "modeled"),
    ("modelling", "modeling"),
    ("neighbour", "neighbor"),
    ("neighbouring", "neighboring"),
    ("neighbourhood", "neighborhood"),
    ("programme", "program"),
    ("sceptical", "skeptical"),
    ("signalled", "signaled"),
    ("travelled", "traveled"),
    ("travelling", "traveling"),
    ("whilst", "while"),
];

/// Verbs that end in -ize, without their ending.
const VERBS: &[&str] = &[
    "author",
    "capital",
    "categor",
    "character",
    "discret",
    "equal",
    "final",
    "general",
    "initial",
    "linear",
    "maxim",
    "minim",
    "normal",
    "optim",
    "organ",
    "parallel",
    "parametr",
    "penal",
    "polar",
    "quant",
    "random",
    "raster",
    "real",
    "recogn",
    "regular",
    "serial",
    "special",
    "stabil",
    "standard",
    "summar",
    "symbol",
    "synchron",
    "token",
    "util",
    "virtual",
    "visual",
];

/// The American spelling of a British word in lower case.
fn american(word: &str) -> Option<String> {
    let singular = word.strip_suffix('s').unwrap_or(word);
    if let Some((_, american)) = WORDS.iter().find(|(british, _)| *british == word || *british == singular) {
        return Some((*american).to_owned());
    }
    let ending = ["ise", "ised", "ises", "iser", "isers", "ising", "isation", "isations", "isable"]
        .into_iter()
        .find(|ending| word.strip_suffix(ending).is_some_and(is_verb))?;
    let stem = word.strip_suffix(ending)?;
    Some(format!("{stem}{}", ending.replacen("is", "iz", 1)))
}

fn is_verb(stem: &str) -> bool {
    let bare = ["de", "re", "un"].iter().find_map(|prefix| stem.strip_prefix(prefix)).unwrap_or(stem);
    VERBS.contains(&stem) || VERBS.contains(&bare)
}

/// Words in lower case with their line numbers. Names in code are split at underscores and capital letters.
fn words(text: &str) -> Vec<(usize, String)> {
    let mut found: Vec<(usize, String)> = Vec::new();
    for (number, line) in text.lines().enumerate() {
        let mut before = ' ';
        for c in line.chars() {
            if c.is_ascii_alphabetic() {
                let begins = !before.is_ascii_alphabetic() || (before.is_lowercase() && c.is_uppercase());
                if begins {
                    found.push((number + 1, String::new()));
                }
                found.last_mut().unwrap().1.push(c.to_ascii_lowercase());
            }
            before = c;
        }
    }
    found
}

/// British words of a text, with their lines.
fn british(text: &str) -> Vec<(usize, String, String)> {
    let title: Vec<_> = TITLE.split(' ').collect();
    let words = words(text);
    let mut found = Vec::new();
    let mut i = 0;
    while i < words.len() {
        if words[i..].len() >= title.len()
            && words[i..].iter().zip(&title).all(|((_, word), part)| word == part)
        {
            i += title.len();
            continue;
        }
        let (line, word) = &words[i];
        found.extend(american(word).map(|american| (*line, word.clone(), american)));
        i += 1;
    }
    found
}

#[test]
fn prose_and_names_are_american() {
    let mut files = Vec::new();
    let folders = [
        "configs", "datagen", "docs", "eval", "fuzz", "python", "registry", "report", "src", "tests",
        "train", "world",
    ];
    for folder in folders {
        collect(&repository().join(folder), &["rs", "md", "toml", "sh", "py", "txt"], &mut files);
    }
    for file in ["build.rs", "Cargo.toml", "clippy.toml", ".ci/run"] {
        files.push(super::Source::read(&repository().join(file)));
    }
    for file in ["README", "ARCHITECTURE", "CONTRIBUTING", "CHANGELOG"] {
        files.push(super::Source::read(&repository().join(file).with_extension("md")));
    }
    // This file has the list.
    files.retain(|file| file.name != "tests/tidy/spelling.rs");
    let report = |file: &super::Source| {
        let say =
            |(line, word, american)| format!("{}:{line}: {word}, in American English {american}", file.name);
        british(&file.text).into_iter().map(say).collect::<Vec<_>>()
    };
    none("British spelling", &files.iter().flat_map(report).collect::<Vec<_>>());
}

#[test]
fn british_words_are_found() {
    let text = "//! `normaliseColours` in metres\n/// an optimised centre, but not an optimistic surprise.";
    let found: Vec<_> = british(text).into_iter().map(|(line, word, _)| (line, word)).collect();
    let expected = [(1, "normalise"), (1, "colours"), (1, "metres"), (2, "optimised"), (2, "centre")];
    assert_eq!(found, expected.map(|(line, word)| (line, word.to_owned())));
    let title = "*Visual servoing in virtualised environments based on optical flow learning\n//! and constrained optimisation*";
    assert_eq!(british(title), []);
    assert_eq!(american("unnormalised").as_deref(), Some("unnormalized"));
}
