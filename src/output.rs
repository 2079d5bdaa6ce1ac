//! Standard output and standard error, written so that a closed pipe is no crash: the macros `out!` and `note!` stand in the
//! place of `println!` and `eprintln!`, which panic there.

use std::fmt::Arguments;
use std::io::{ErrorKind, Write};

/// What a shell sees of a program whose reader went away (128 + SIGPIPE), as after `head`.
const CLOSED_PIPE: i32 = 141;

/// Prints a line of the result. Without a reader there is nothing left to do, so the program ends.
macro_rules! out {
    ($($argument:tt)*) => { $crate::output::line(format_args!($($argument)*)) };
}
pub(crate) use out;

/// Prints a line about how it goes. Without a reader the work goes on.
macro_rules! note {
    ($($argument:tt)*) => { $crate::output::remark(format_args!($($argument)*)) };
}
pub(crate) use note;

/// What `out!` does.
pub(crate) fn line(text: Arguments<'_>) {
    let mut stdout = std::io::stdout().lock();
    // Flushed here, where an error is noticed: at the program's end it would not be.
    if let Err(error) = writeln!(stdout, "{text}").and_then(|()| stdout.flush()) {
        if error.kind() == ErrorKind::BrokenPipe {
            std::process::exit(CLOSED_PIPE);
        }
        remark(format_args!("error: standard output: {error}"));
        std::process::exit(1);
    }
}

/// What `note!` does.
pub(crate) fn remark(text: Arguments<'_>) {
    // No one is left to tell of an error.
    let _ = writeln!(std::io::stderr().lock(), "{text}");
}
