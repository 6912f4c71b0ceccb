//! Arguments in, exit code out.

use std::io::IsTerminal;
use std::process::ExitCode;

use clap::Parser;
use pitchd::cli::Cli;
use pitchd::cli::log_queue::LogQueue;
use tracing_subscriber::EnvFilter;

fn main() -> ExitCode {
    let cli = Cli::parse();
    let level = match cli.verbose {
        0 => "warn",
        1 => "info",
        _ => "debug",
    };
    let filter = EnvFilter::try_from_env("PITCHD_LOG").unwrap_or_else(|_| EnvFilter::new(level));
    let log = match LogQueue::start(std::io::stderr()) {
        Ok(log) => log,
        Err(error) => {
            pitchd::cli::terminal::tell(format_args!("pitchd: error: no thread for the log: {error}\n"));
            return ExitCode::FAILURE;
        }
    };
    tracing_subscriber::fmt()
        .with_env_filter(filter)
        .with_writer(log.clone())
        .with_ansi(std::io::stderr().is_terminal())
        .with_target(false)
        .without_time()
        .init();
    let done = cli.run();
    log.finish();
    match done {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            pitchd::cli::terminal::tell(format_args!("pitchd: error: {}\n", one_line(&error)));
            ExitCode::FAILURE
        }
    }
}

/// The chain of causes on one line, outermost first; a cause that the error before it already told is left out.
fn one_line(error: &anyhow::Error) -> String {
    let mut line = String::new();
    for cause in error.chain().map(ToString::to_string) {
        if line.is_empty() {
            line = cause;
        } else if !line.ends_with(&cause) {
            line = format!("{line}: {cause}");
        }
    }
    line.replace('\n', " ")
}
