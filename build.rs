//! Notes the revision of the code, which published models carry in their lineage.

#![allow(clippy::print_stdout)] // This is how a build script speaks.

use std::process::Command;

fn main() {
    // Where there is no checkout, as in a source archive, the revision is unknown, and the lineage says nothing of it.
    let output = Command::new("git").args(["rev-parse", "HEAD"]).output();
    if let Some(output) = output.ok().filter(|output| output.status.success()) {
        let revision = String::from_utf8_lossy(&output.stdout);
        println!("cargo::rustc-env=FLOWSERVO_REVISION={}", revision.trim());
    }
    println!("cargo::rerun-if-changed=build.rs");
    if std::path::Path::new(".git/logs/HEAD").exists() {
        println!("cargo::rerun-if-changed=.git/logs/HEAD");
    }
}
