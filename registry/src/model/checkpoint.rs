//! Checkpoints on disk: folders of regular files whose names mean the same on every system.

use std::collections::BTreeSet;
use std::path::Path;

use crate::error::{Error, Result};
use crate::store::Store;

/// Longest part of a path. Common file systems take 255 bytes, and the store appends a few.
const PART_LIMIT: usize = 128;

/// Opens the folder `root` and lists its files, sorted. The files and folders directly in `root` that are named in `ignored` are
/// left out.
///
/// Refuses links, special files, empty folders, and names that some system would not accept: what is published must be
/// delivered unchanged.
pub(crate) fn open(root: &Path, ignored: &[&str]) -> Result<(Store, Vec<String>)> {
    let store = Store::open(&root.into())?;
    let found = store.walk("")?;
    let is_part = |key: &str| !ignored.contains(&key.split('/').next().unwrap_or(key));
    if let Some(special) = found.problems.iter().find(|problem| is_part(&problem.object)) {
        let reason = "a checkpoint may hold only regular files and folders, no links; put a copy here";
        return Err(Error::refused(&root.join(&special.object).display(), reason));
    }
    let mut paths: Vec<_> =
        found.objects.into_iter().map(|object| object.key).filter(|key| is_part(key)).collect();
    let is_empty = |folder: &&str| !paths.iter().any(|path| path.starts_with(&format!("{folder}/")));
    let mut folders = found.folders.iter().map(String::as_str).filter(|folder| is_part(folder));
    if let Some(empty) = folders.find(is_empty).or(paths.is_empty().then_some("")) {
        let reason = "the folder is empty; each folder of a checkpoint needs a file";
        return Err(Error::refused(&root.join(empty).display(), reason));
    }
    paths.sort();
    check_paths(paths.iter().map(String::as_str))
        .map_err(|reason| Error::refused(&root.display(), reason))?;
    Ok((store, paths))
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
    for path in &seen {
        let mut folders = path.match_indices('/').map(|(end, _)| &path[..end]);
        if let Some(folder) = folders.find(|&folder| seen.contains(folder)) {
            return Err(format!("`{folder}` is both a file and the folder of `{path}`; rename one"));
        }
    }
    Ok(())
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
    use std::fs;

    use super::*;

    #[test]
    fn files_are_sorted() {
        let folder = tempfile::tempdir().unwrap();
        fs::create_dir(folder.path().join("state")).unwrap();
        fs::write(folder.path().join("weights.bin"), b"abc").unwrap();
        fs::write(folder.path().join("state/step.json"), b"7").unwrap();
        let (store, paths) = open(folder.path(), &[]).unwrap();
        assert_eq!(paths, ["state/step.json", "weights.bin"]);
        assert_eq!(store.read(&paths[1]).unwrap().unwrap(), b"abc");
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
            let message = open(folder.path(), &[]).unwrap_err().to_string();
            assert!(message.contains(expected), "{message}");
        }
        let missing = open(Path::new("no/such/checkpoint"), &[]).unwrap_err().to_string();
        assert!(missing.contains("no/such/checkpoint"), "{missing}");
    }

    #[cfg(unix)]
    #[test]
    fn links_and_pipes_are_refused() {
        let folder = tempfile::tempdir().unwrap();
        let pipe = folder.path().join("pipe");
        assert!(std::process::Command::new("mkfifo").arg(&pipe).status().unwrap().success());
        let message = open(folder.path(), &[]).unwrap_err().to_string();
        assert!(message.contains("pipe") && message.contains("only regular files and folders"), "{message}");
        fs::remove_file(pipe).unwrap();
        std::os::unix::fs::symlink("/etc/hostname", folder.path().join("config.json")).unwrap();
        let message = open(folder.path(), &[]).unwrap_err().to_string();
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
