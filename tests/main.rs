//! Integration tests. They share one binary, because each additional one would link Burn again.

#![forbid(unsafe_code)]
#![allow(clippy::unwrap_used)]

/// Runs the program in a temporary folder.
mod support;

/// House rules that a machine can check.
mod tidy;

/// Equations (1) to (8) and the ranges of Section 6.2, each against an independent oracle.
mod paper;

/// Dataset commands.
mod datasets;

/// Bad input: clear errors and exit codes.
mod bad_input;

/// Ctrl-C, kills and full disks: finished work is kept, and the same command resumes.
#[cfg(unix)]
mod interrupted;

/// The whole pipeline, from datasets to Table 1 and the report.
mod pipeline;

/// Training from a published model.
mod warm_start;

/// Registry commands.
mod models;

/// The registry under concurrent publishers, readers and SIGKILL.
#[cfg(unix)]
mod registry;

/// `wgpu` on a software Vulkan driver.
#[cfg(feature = "wgpu-software")]
mod devices;
