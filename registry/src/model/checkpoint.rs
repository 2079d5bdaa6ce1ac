//! Checkpoints on disk: folders of regular files whose names mean the same on every system.

use std::collections::BTreeSet;
use std::fs::{self, File};
use std::path::{Path, PathBuf};

use crate::digest::Fingerprint;
use crate::error::{Error, Result};

/// Longest part of a path. Common file systems take 255 bytes, and the store appends a few.
const PART_LIMIT: usize = 128;

/// Lists the files in folder `root`: path in the checkpoint and path on disk, sorted. The files and folders directly in `root`
/// that are named in `ignored` are left out.
///
/// Refuses links, special files, empty folders, and names that some system would not accept: what is published must be
/// delivered unchanged.
pub(crate) fn list(root: &Path, ignored: &[&str]) -> Result<Vec<(String, PathBuf)>> {
    let mut found = Vec::new();
    walk(root, "", ignored, &mut found)?;
    found.sort();
    let paths = found.iter().map(|(path, _)| path.as_str());
    check_paths(paths).map_err(|reason| Error::file(root, reason))?;
    Ok(found)
}

/// Computes the fingerprint of the file `source`.
pub(crate) fn fingerprint(source: &Path) -> Result<Fingerprint> {
    File::open(source).and_then(Fingerprint::of).map_err(Error::io("read", source))
}

fn walk(folder: &Path, prefix: &str, ignored: &[&str], found: &mut Vec<(String, PathBuf)>) -> Result<()> {
    let before = found.len();
    for entry in fs::read_dir(folder).map_err(Error::io("read the folder", folder))? {
        let entry = entry.map_err(Error::io("read the folder", folder))?;
        let source = entry.path();
        let refuse = |reason: &str| Error::file(&source, reason);
        let name =
            entry.file_name().into_string().map_err(|_| refuse("the name is not Unicode; rename it"))?;
        if ignored.contains(&name.as_str()) {
            continue;
        }
        let path = format!("{prefix}{name}");
        let kind = entry.file_type().map_err(Error::io("read", &source))?;
        if kind.is_dir() {
            walk(&source, &format!("{path}/"), &[], found)?;
        } else if kind.is_file() {
            found.push((path, source));
        } else {
            return Err(refuse(
                "a checkpoint may hold only regular files and folders, no links; put a copy here",
            ));
        }
    }
    if found.len() == before {
        return Err(Error::file(folder, "the folder is empty; each folder of a checkpoint needs a file"));
    }
    Ok(())
}

/// Checks that the paths stay inside the checkpoint, and name different files on every file system.
pub(crate) fn check_paths<'a>(paths: impl Iterator<Item = &'a str>) -> std::result::Result<(), String> {
    let mut seen = BTreeSet::new();
    for path in paths {
        if !path.split('/').all(is_safe_part) {
            return Err(format!(
                "`{path}` cannot be a file of a checkpoint: use 1 to {PART_LIMIT} letters, digits, `.`, `-` and `_` for \
                 each part, with no `.` at its start or end"
            ));
        }
        if let Some(part) = path.split('/').find(|part| is_device(part)) {
            return Err(format!(
                "`{path}` cannot be a file on Windows, where `{part}` is a device; rename it"
            ));
        }
        if !seen.insert(path.to_ascii_lowercase()) {
            return Err(format!("`{path}` occurs twice, or in upper and lower case; rename one"));
        }
    }
    let above = |path: &String| {
        path.match_indices('/').find(|(end, _)| seen.contains(&path[..*end])).map(|(end, _)| end)
    };
    match seen.iter().find_map(|path| Some((path, above(path)?))) {
        Some((path, end)) => {
            Err(format!("`{}` is both a file and the folder of `{path}`; rename one", &path[..end]))
        }
        None => Ok(()),
    }
}

/// Returns whether `part` names a device on Windows, whatever its extension.
fn is_device(part: &str) -> bool {
    let stem = part.split('.').next().unwrap_or(part).to_ascii_lowercase();
    let port = stem.strip_prefix("com").or_else(|| stem.strip_prefix("lpt"));
    matches!(stem.as_str(), "con" | "prn" | "aux" | "nul")
        || port.is_some_and(|number| number.len() == 1 && number.bytes().all(|c| c.is_ascii_digit()))
}

fn is_safe_part(part: &str) -> bool {
    (1..=PART_LIMIT).contains(&part.len())
        && part.bytes().all(|c| c.is_ascii_alphanumeric() || matches!(c, b'.' | b'-' | b'_'))
        && !part.starts_with('.')
        && !part.ends_with('.')
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn files_are_sorted() {
        let folder = tempfile::tempdir().unwrap();
        fs::create_dir(folder.path().join("state")).unwrap();
        fs::write(folder.path().join("weights.bin"), b"abc").unwrap();
        fs::write(folder.path().join("state/step.json"), b"7").unwrap();
        let files = list(folder.path(), &[]).unwrap();
        let paths: Vec<_> = files.iter().map(|(path, _)| path.as_str()).collect();
        assert_eq!(paths, ["state/step.json", "weights.bin"]);
        assert_eq!(fs::read(&files[1].1).unwrap(), b"abc");
    }

    #[test]
    fn what_cannot_be_delivered_is_refused() {
        type Spoil = fn(&Path);
        let cases: [(&str, Spoil); 5] = [
            ("empty", |_| {}),
            ("empty", |root| fs::create_dir(root.join("empty")).unwrap()),
            ("cannot be a file", |root| fs::write(root.join(".hidden"), b"").unwrap()),
            ("cannot be a file", |root| fs::write(root.join("a b"), b"").unwrap()),
            ("in upper and lower case", |root| {
                fs::write(root.join("a"), b"").unwrap();
                fs::write(root.join("A"), b"").unwrap();
            }),
        ];
        for (expected, spoil) in cases {
            let folder = tempfile::tempdir().unwrap();
            spoil(folder.path());
            let message = list(folder.path(), &[]).unwrap_err().to_string();
            assert!(message.contains(expected), "{message}");
        }
        let missing = list(Path::new("no/such/checkpoint"), &[]).unwrap_err().to_string();
        assert!(missing.contains("no/such/checkpoint"), "{missing}");
    }

    #[cfg(unix)]
    #[test]
    fn links_and_pipes_are_refused() {
        let folder = tempfile::tempdir().unwrap();
        let pipe = folder.path().join("pipe");
        assert!(std::process::Command::new("mkfifo").arg(&pipe).status().unwrap().success());
        let message = list(folder.path(), &[]).unwrap_err().to_string();
        assert!(message.contains("pipe") && message.contains("only regular files and folders"), "{message}");
        fs::remove_file(pipe).unwrap();
        std::os::unix::fs::symlink("/etc/hostname", folder.path().join("config.json")).unwrap();
        let message = list(folder.path(), &[]).unwrap_err().to_string();
        assert!(message.contains("config.json") && message.contains("no links"), "{message}");
    }

    #[test]
    fn paths_cannot_leave_the_checkpoint() {
        for bad in ["../x", "/x", "a//b", "a/../b", "a/.", "", "a\\b", "c:x", "a.", "a/", "a\0", "é", "a\n"]
        {
            assert!(check_paths([bad].into_iter()).unwrap_err().contains("cannot be a file"), "{bad:?}");
        }
        for device in ["con", "state/NUL", "aux.json", "Com1", "lpt9.tar.gz"] {
            assert!(check_paths([device].into_iter()).unwrap_err().contains("on Windows"), "{device}");
        }
        check_paths(["config", "com", "com12", "console", "nul1", "lpt.a/b"].into_iter()).unwrap();
    }

    #[test]
    fn paths_name_different_files() {
        for (bad, expected) in [
            (["a", "a"], "`a` occurs twice"),
            (["a/b", "A/B"], "`A/B`"),
            (["a", "a/b"], "`a` is both a file and the folder of `a/b`"),
            (["A/b/c", "a/B"], "`a/b` is both a file and the folder of `a/b/c`"),
        ] {
            let refusal = check_paths(bad.into_iter()).unwrap_err();
            assert!(refusal.contains(expected), "{refusal}");
        }
        check_paths(["a/b", "a/c", "ab", "a-b/c", "b"].into_iter()).unwrap();
    }
}
