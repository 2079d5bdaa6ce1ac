//! Integration tests: one binary, because every further one would link Burn again.

#![forbid(unsafe_code)]
#![allow(clippy::unwrap_used)]

/// Drives the program in a folder of its own.
mod support;

/// The house rules that a machine can check.
mod tidy;

/// Equations (1) to (8) and the ranges of Section 6.2, each against an oracle of its own.
mod paper;

/// Datasets through the command line.
mod datasets;

/// Bad input: each case gets a clear error and the right exit code.
mod bad_input;

/// Ctrl-C and a full disk: what is finished stays, and the same command goes on.
#[cfg(unix)]
mod interrupted;

/// From datasets to Table 1 and the report, through the command line.
mod pipeline;

/// Training from a published model.
mod warm_start;

/// The registry through the command line.
mod models;

/// The registry under attack: publishers at once, readers in between, SIGKILL.
#[cfg(unix)]
mod registry;

/// The wgpu path on a software Vulkan driver.
#[cfg(feature = "wgpu-software")]
mod devices;
