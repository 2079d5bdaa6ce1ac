//! Errors: their messages and exit codes.

use anyhow::anyhow;
use std::fmt;
use std::process::ExitCode;

/// Invalid usage or configuration: exit code 2 instead of 1.
#[derive(Debug)]
struct BadInput(String);

impl fmt::Display for BadInput {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0)
    }
}

impl std::error::Error for BadInput {}

/// Marks an error as one of usage or configuration.
pub(crate) fn bad_input(error: impl Into<anyhow::Error>) -> anyhow::Error {
    anyhow!(BadInput(message(&error.into())))
}

/// Returns the exit code: 2 for invalid usage or configuration, 1 for any other failure.
pub(crate) fn exit_code(error: &anyhow::Error) -> ExitCode {
    let usage = error.chain().any(<dyn std::error::Error>::is::<BadInput>);
    ExitCode::from(if usage { 2 } else { 1 })
}

/// Formats an error with its causes in one line. Omits a cause whose text is already part of the message, since some errors
/// include their cause.
pub(crate) fn message(error: &anyhow::Error) -> String {
    let mut message = String::new();
    for cause in error.chain().map(ToString::to_string).filter(|cause| !cause.is_empty()) {
        if message.is_empty() {
            message = cause;
        } else if !message.contains(&cause) {
            message = format!("{message}: {cause}");
        }
    }
    message
}
