//! Records the revision of the code and the versions of the compiler and Burn, for the lineage of published models.

#![allow(clippy::print_stdout)] // Cargo reads the standard output of a build script.

use std::process::Command;

fn main() {
    // Without a checkout, as in a source archive, the revision is unknown and missing from the lineage.
    let output = Command::new("git").args(["rev-parse", "HEAD"]).output();
    if let Some(output) = output.ok().filter(|output| output.status.success()) {
        let revision = String::from_utf8_lossy(&output.stdout);
        println!("cargo::rustc-env=FLOWSERVO_REVISION={}", revision.trim());
    }
    let rustc =
        std::env::var_os("RUSTC").and_then(|rustc| Command::new(rustc).arg("--version").output().ok());
    if let Some(version) = rustc.and_then(|output| String::from_utf8(output.stdout).ok()) {
        println!("cargo::rustc-env=FLOWSERVO_RUSTC={}", version.trim().trim_start_matches("rustc "));
    }
    let lock = std::fs::read_to_string("Cargo.lock").unwrap_or_default();
    let burn = lock.split_once("name = \"burn\"\nversion = \"").and_then(|(_, rest)| rest.split_once('"'));
    if let Some((version, _)) = burn {
        println!("cargo::rustc-env=FLOWSERVO_BURN={version}");
    }
    println!("cargo::rerun-if-changed=Cargo.lock");
    println!("cargo::rerun-if-changed=build.rs");
    if std::path::Path::new(".git/logs/HEAD").exists() {
        println!("cargo::rerun-if-changed=.git/logs/HEAD");
    }
}
