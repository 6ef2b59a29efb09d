//! `spherecal completions` and `spherecal man`: shell completions and manual pages, generated from
//! the description of the command line.

use std::io::Write as _;
use std::path::{Path, PathBuf};

use clap::{Args, Command};
use clap_complete::Shell;

use super::exit::{CliError, Exit};
use super::out::outln;
use spherecal_job::JobError;

/// Arguments of `completions`.
#[derive(Args, Clone, Debug)]
pub struct CompletionsArgs {
    /// The shell.
    #[arg(value_name = "SHELL")]
    pub shell: Shell,
}

/// Arguments of `man`.
#[derive(Args, Clone, Debug)]
pub struct ManArgs {
    /// Write one page for each command into this folder, instead of the main page to stdout.
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
}

/// `spherecal completions`
pub(super) fn completions(args: &CompletionsArgs, mut command: Command) -> Result<Exit, CliError> {
    let mut script = Vec::new();
    clap_complete::generate(args.shell, &mut command, "spherecal", &mut script);
    print_bytes(&script)
}

/// `spherecal man`
pub(super) fn man(args: &ManArgs, command: Command) -> Result<Exit, CliError> {
    let Some(folder) = &args.out else {
        let mut page = Vec::new();
        let mut command = command.disable_help_subcommand(true);
        command.build();
        clap_mangen::Man::new(command)
            .render(&mut page)
            .map_err(CliError::job)?;
        return print_bytes(&page);
    };
    std::fs::create_dir_all(folder).map_err(|source| unwritten(folder, source))?;
    clap_mangen::generate_to(command, folder).map_err(|source| unwritten(folder, source))?;
    outln!("{}", folder.join("spherecal.1").display());
    Ok(Exit::Done)
}

/// A reader that closed the pipe (`| head`) is not an error.
fn print_bytes(bytes: &[u8]) -> Result<Exit, CliError> {
    match std::io::stdout().lock().write_all(bytes) {
        Err(error) if error.kind() != std::io::ErrorKind::BrokenPipe => Err(CliError::job(error)),
        _ => Ok(Exit::Done),
    }
}

fn unwritten(folder: &Path, source: std::io::Error) -> JobError {
    JobError::Write {
        path: folder.display().to_string(),
        source,
    }
}
