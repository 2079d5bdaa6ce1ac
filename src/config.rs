//! Reads a configuration: a TOML file, the files that its tables extend, and the changes by `--set`.
//!
//! There are two rules. A table with a key `extends = "path"` is the table in that file (with the path relative to the extending
//! file), overlaid by the other keys; subtables are merged key by key. Then each `--set a.b.0.c=value` sets one key, where a
//! number is an index into an array. The resolved configuration is complete and is written next to the results.

use crate::error::bad_input;
use anyhow::{Context, Result, anyhow, bail};
use serde::de::DeserializeOwned;
use std::path::{Path, PathBuf};
use toml::{Table, Value};

/// A resolved configuration, not yet parsed into its type.
#[derive(Debug, Clone)]
pub(crate) struct Config {
    path: PathBuf,
    table: Table,
}

impl Config {
    /// Reads a file, resolves `extends` and applies the arguments of `--set`.
    pub(crate) fn load(path: &Path, overrides: &[String]) -> Result<Self> {
        let resolve = || -> Result<Table> {
            let mut table = read(path, &mut Vec::new())?;
            for assignment in overrides {
                set(&mut table, assignment).with_context(|| format!("--set {assignment}"))?;
            }
            Ok(table)
        };
        Ok(Self { path: path.to_owned(), table: resolve().map_err(bad_input)? })
    }

    /// Parses the configuration. Unknown and missing keys are errors.
    pub(crate) fn parse<T: DeserializeOwned>(&self) -> Result<T> {
        let parsed: Result<T, toml::de::Error> = T::deserialize(self.table.clone());
        parsed
            .map_err(|error| bad_input(anyhow!("{}: {}", self.path.display(), error.to_string().trim_end())))
    }

    /// Adds the file name to an error about a value.
    pub(crate) fn check<T, E: std::error::Error + Send + Sync + 'static>(
        &self,
        result: Result<T, E>,
    ) -> Result<T> {
        result.map_err(|error| bad_input(anyhow!(error).context(self.path.display().to_string())))
    }
}

/// Reads a file and resolves `extends`. `opened` holds the files that are being resolved.
fn read(path: &Path, opened: &mut Vec<PathBuf>) -> Result<Table> {
    let here = path.canonicalize().with_context(|| format!("{}: cannot be opened", path.display()))?;
    if opened.contains(&here) {
        bail!("{}: extends itself", path.display());
    }
    let text =
        std::fs::read_to_string(path).with_context(|| format!("{}: cannot be read", path.display()))?;
    let table: Table = text.parse().map_err(|error| anyhow!("{}: {error}", path.display()))?;
    opened.push(here);
    let resolved = extend(table, path, opened);
    opened.pop();
    resolved
}

/// Resolves `extends` in a table and in all of its subtables.
fn extend(mut table: Table, file: &Path, opened: &mut Vec<PathBuf>) -> Result<Table> {
    let base = match table.remove("extends") {
        None => Table::new(),
        Some(Value::String(name)) => {
            let folder = file.parent().unwrap_or(Path::new(""));
            read(&folder.join(&name), opened).with_context(|| format!("{}: extends", file.display()))?
        }
        Some(other) => bail!("{}: extends = {other}: expected a path in quotes", file.display()),
    };
    let mut overlay = Table::new();
    for (key, value) in table {
        overlay.insert(key, extend_value(value, file, opened)?);
    }
    Ok(overlaid(base, overlay))
}

fn extend_value(value: Value, file: &Path, opened: &mut Vec<PathBuf>) -> Result<Value> {
    Ok(match value {
        Value::Table(inner) => Value::Table(extend(inner, file, opened)?),
        Value::Array(items) => {
            let items: Result<_> = items.into_iter().map(|item| extend_value(item, file, opened)).collect();
            Value::Array(items?)
        }
        plain => plain,
    })
}

/// Merges two tables; the keys of `overlay` take precedence.
fn overlaid(mut base: Table, overlay: Table) -> Table {
    for (key, value) in overlay {
        let merged = match (base.remove(&key), value) {
            (Some(Value::Table(below)), Value::Table(above)) => Value::Table(overlaid(below, above)),
            (_, above) => above,
        };
        base.insert(key, merged);
    }
    base
}

/// Applies an assignment `key=value`. A value that is not valid TOML is taken as a string.
fn set(table: &mut Table, assignment: &str) -> Result<()> {
    let (path, text) = assignment.split_once('=').context("expected key=value")?;
    let value = format!("value = {text}").parse::<Table>().ok().and_then(|mut parsed| parsed.remove("value"));
    let value = value.unwrap_or_else(|| Value::String(text.to_owned()));
    let mut keys: Vec<&str> = path.trim().split('.').collect();
    let last = keys.pop().unwrap_or_default();
    let mut place = table;
    let mut seen = String::new();
    let mut keys = keys.into_iter().peekable();
    while let Some(key) = keys.next() {
        seen = if seen.is_empty() { key.to_owned() } else { format!("{seen}.{key}") };
        let below = place.get_mut(key).with_context(|| format!("unknown key {seen}"))?;
        place = match (below, keys.peek().and_then(|next| next.parse::<usize>().ok())) {
            (Value::Table(inner), _) => inner,
            (Value::Array(items), Some(index)) => {
                keys.next();
                let count = items.len();
                let item = items.get_mut(index).with_context(|| format!("{seen} has {count} entries"))?;
                item.as_table_mut().with_context(|| format!("{seen}.{index} is not a table"))?
            }
            (other, _) => bail!("{seen} is a {}, not a table", other.type_str()),
        };
    }
    if !place.contains_key(last) {
        let known: Vec<&str> = place.keys().map(String::as_str).collect();
        bail!("unknown key {path}; known keys: {}", known.join(", "));
    }
    place.insert(last.to_owned(), value);
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::fs;

    fn folder(files: &[(&str, &str)]) -> tempfile::TempDir {
        let folder = tempfile::tempdir().unwrap();
        for (name, text) in files {
            let path = folder.path().join(name);
            fs::create_dir_all(path.parent().unwrap()).unwrap();
            fs::write(path, text).unwrap();
        }
        folder
    }

    fn resolved(files: &[(&str, &str)], overrides: &[&str]) -> Result<Table> {
        let folder = folder(files);
        let overrides: Vec<String> = overrides.iter().map(ToString::to_string).collect();
        Config::load(&folder.path().join("main.toml"), &overrides).map(|config| config.table)
    }

    const BASE: (&str, &str) = ("worlds/base.toml", "[camera]\nwidth = 640\nheight = 480\n");

    #[test]
    fn a_table_overlays_the_file_that_it_extends() {
        let main = ("main.toml", "seed = 7\n[world]\nextends = 'worlds/base.toml'\ncamera.width = 96\n");
        let table = resolved(&[BASE, main], &[]).unwrap();
        assert_eq!(table, "seed = 7\nworld.camera = { width = 96, height = 480 }".parse().unwrap());
    }

    #[test]
    fn set_changes_one_key_even_in_an_array() {
        let main =
            ("main.toml", "count = 1\nname = 'x'\n[[motions]]\nshare = 0.5\n[[motions]]\nshare = 0.5\n");
        let table = resolved(&[main], &["count=4000", "motions.1.share=0.25", "name=y-z"]).unwrap();
        let expected = "count = 4000\nname = 'y-z'\nmotions = [{ share = 0.5 }, { share = 0.25 }]";
        assert_eq!(table, expected.parse().unwrap());
    }

    #[test]
    fn errors_name_the_place() {
        let cycle = resolved(&[("main.toml", "extends = 'main.toml'")], &[]).unwrap_err();
        assert!(cycle.to_string().contains("main.toml: extends itself"), "{cycle}");
        let unknown = resolved(&[("main.toml", "count = 1")], &["cuont=2"]).unwrap_err();
        assert!(unknown.to_string().contains("unknown key cuont; known keys: count"), "{unknown}");
        let missing = resolved(&[("main.toml", "extends = 'nowhere.toml'")], &[]).unwrap_err();
        assert!(missing.to_string().contains("nowhere.toml: cannot be opened"), "{missing}");
        let index = resolved(&[("main.toml", "m = [{ a = 1 }]")], &["m.3.a=2"]).unwrap_err();
        assert!(index.to_string().contains("m has 1 entries"), "{index}");
    }
}
