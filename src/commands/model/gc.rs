//! `flowservo model gc`: lists unused files, and deletes them on request.

use crate::cli::Gc;
use crate::clock;
use crate::output::{out, print_json};
use anyhow::Result;
use registry::{Garbage, Registry};
use serde::Serialize;

/// Result of a garbage collection.
#[derive(Serialize)]
struct Collected {
    found: Vec<Garbage>,
    found_bytes: u64,
    deleted: Vec<Garbage>,
    deleted_bytes: u64,
}

/// Runs the command.
pub(crate) fn run(arguments: &Gc, json: bool) -> Result<()> {
    let registry = Registry::open(&arguments.registry.registry)?;
    let (now, grace) = (clock::now(), arguments.older_than);
    let found = registry.garbage(now, grace)?;
    for garbage in &found {
        out!("{}  {} bytes, {}", garbage.key, garbage.size, age(garbage.age_s));
    }
    let found_bytes = bytes(&found);
    out!("{} unused objects, {found_bytes} bytes", found.len());
    let mut deleted = Vec::new();
    if arguments.delete {
        deleted = registry.delete_garbage(found.clone(), now, grace)?;
        out!("deleted {} of them, {} bytes", deleted.len(), bytes(&deleted));
    } else if !found.is_empty() {
        out!("nothing was deleted; add --delete to delete them");
    }
    let deleted_bytes = bytes(&deleted);
    print_json(json, &Collected { found, found_bytes, deleted, deleted_bytes })
}

fn bytes(garbage: &[Garbage]) -> u64 {
    garbage.iter().map(|garbage| garbage.size).sum()
}

fn age(seconds: u64) -> String {
    match seconds {
        0..3600 => format!("{} minutes old", seconds / 60),
        3600..172_800 => format!("{} hours old", seconds / 3600),
        _ => format!("{} days old", seconds / 86400),
    }
}
