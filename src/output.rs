//! Standard output and standard error. The macros `out!` and `note!` replace `println!` and `eprintln!`, which panic on a closed
//! pipe.

use anyhow::Result;
use serde::Serialize;
use std::fmt::Arguments;
use std::io::{ErrorKind, Write};

/// Exit code of a program whose reader has closed the pipe (128 + SIGPIPE), as after `head`.
const CLOSED_PIPE: i32 = 141;

/// Prints a line of the result to standard output. Exits the program if nobody reads it.
macro_rules! out {
    ($($argument:tt)*) => { $crate::output::line(format_args!($($argument)*)) };
}
pub(crate) use out;

/// Prints a message to standard error. The work continues if nobody reads it.
macro_rules! note {
    ($($argument:tt)*) => { $crate::output::remark(format_args!($($argument)*)) };
}
pub(crate) use note;

/// Implements `out!`.
pub(crate) fn line(text: Arguments<'_>) {
    let mut stdout = std::io::stdout().lock();
    // Flushes here, because an error at the end of the program would go unnoticed.
    if let Err(error) = writeln!(stdout, "{text}").and_then(|()| stdout.flush()) {
        if error.kind() == ErrorKind::BrokenPipe {
            std::process::exit(CLOSED_PIPE);
        }
        remark(format_args!("error: standard output: {error}"));
        std::process::exit(1);
    }
}

/// Implements `note!`.
pub(crate) fn remark(text: Arguments<'_>) {
    // There is nowhere left to report an error.
    let _ = writeln!(std::io::stderr().lock(), "{text}");
}

/// Prints a result as one line of JSON if `--json` is given.
pub(crate) fn print_json(requested: bool, result: &impl Serialize) -> Result<()> {
    if requested {
        out!("{}", serde_json::to_string(result)?);
    }
    Ok(())
}
