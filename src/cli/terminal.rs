//! Words to the terminal that never stop the work: a reader that went away (`pitchd … | head`) is no failure.

use std::fmt::Arguments;
use std::io::{ErrorKind, Write};

/// Writes to standard output. Nobody reading is fine: the files are still written. A full disk behind it is not:
/// the program ends with 1.
pub fn say(text: Arguments<'_>) {
    match std::io::stdout().write_fmt(text) {
        Err(error) if error.kind() != ErrorKind::BrokenPipe => {
            tell(format_args!("pitchd: error: standard output: {error}\n"));
            std::process::exit(1);
        }
        _ => {}
    }
}

/// Writes to standard error; where that cannot be written there is nowhere to say so.
pub fn tell(text: Arguments<'_>) {
    let _ = std::io::stderr().write_fmt(text);
}

/// `print!` through [`say`].
macro_rules! say {
    ($($text:tt)*) => { $crate::cli::terminal::say(format_args!($($text)*)) };
}

/// `println!` through [`say`].
macro_rules! say_line {
    () => { $crate::cli::terminal::say(format_args!("\n")) };
    ($($text:tt)*) => { $crate::cli::terminal::say(format_args!("{}\n", format_args!($($text)*))) };
}

/// `eprintln!` through [`tell`].
macro_rules! tell_line {
    ($($text:tt)*) => { $crate::cli::terminal::tell(format_args!("{}\n", format_args!($($text)*))) };
}
