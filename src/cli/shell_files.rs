//! `pitchd completions` and `pitchd man`: made from the same definitions as `--help`.

use std::io::Write;
use std::path::PathBuf;

use anyhow::Context;
use clap::{Args, CommandFactory};
use clap_complete::Shell;

use super::Cli;

/// Arguments of `pitchd completions`.
#[derive(Debug, Args)]
#[command(after_help = "Example:\n  pitchd completions bash > /etc/bash_completion.d/pitchd")]
pub struct CompletionsArgs {
    /// The shell.
    pub shell: Shell,
}

/// Prints the shell's completion script.
///
/// # Errors
/// Standard output that cannot be written; a reader that has gone is none.
pub fn completions(args: &CompletionsArgs) -> anyhow::Result<()> {
    let mut script = Vec::new();
    clap_complete::generate(args.shell, &mut Cli::command(), "pitchd", &mut script);
    match std::io::stdout().write_all(&script) {
        Err(e) if e.kind() != std::io::ErrorKind::BrokenPipe => Err(e).context("cannot write the script"),
        _ => Ok(()),
    }
}

/// Arguments of `pitchd man`.
#[derive(Debug, Args)]
#[command(after_help = "Example:\n  pitchd man --out /usr/share/man/man1")]
pub struct ManArgs {
    /// Folder for pitchd.1 and a page per subcommand.
    #[arg(long, value_name = "DIR")]
    pub out: PathBuf,
}

/// Writes the manual pages.
///
/// # Errors
/// A folder that cannot be written.
pub fn man(args: &ManArgs) -> anyhow::Result<()> {
    std::fs::create_dir_all(&args.out).with_context(|| format!("cannot make {}", args.out.display()))?;
    clap_mangen::generate_to(Cli::command(), &args.out)
        .with_context(|| format!("cannot write manual pages to {}", args.out.display()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_subcommand_has_a_page_and_is_completed() {
        let folder = tempfile::tempdir().unwrap();
        let out = folder.path().to_owned();
        man(&ManArgs { out: out.clone() }).unwrap();
        let mut script = Vec::new();
        clap_complete::generate(Shell::Bash, &mut Cli::command(), "pitchd", &mut script);
        let script = String::from_utf8(script).unwrap();
        for command in Cli::command().get_subcommands() {
            let name = command.get_name();
            let page = std::fs::read_to_string(out.join(format!("pitchd-{name}.1"))).unwrap();
            assert!(page.contains("SYNOPSIS"), "{name}");
            assert!(script.contains(&format!("pitchd,{name})")), "{name}");
        }
    }
}
