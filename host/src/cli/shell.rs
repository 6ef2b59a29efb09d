//! `spherecal completions` and `spherecal man`: shell completions and manual pages, generated from
//! the description of the command line.

use std::io::Write as _;
use std::path::PathBuf;

use clap::builder::PossibleValuesParser;
use clap::{Args, Command};
use clap_complete::Shell;

use super::exit::{CliError, Exit, unwritten};
use super::out::outln;
use spherecal_identify::{Method, Model};
use spherecal_shared::robot::BUILT_IN;
use spherecal_sim::inject::PRESETS;
use spherecal_sim::plant;

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

/// What an option may be, by its name, as far as names and kinds go; files may stand there too where the flag says so.
fn values(option: &str) -> Option<(Vec<&'static str>, bool)> {
    Some(match option {
        "robot" => (BUILT_IN.to_vec(), true),
        "preset" => (plant::PRESETS.to_vec(), false),
        "method" => (Method::ALL.map(Method::name).to_vec(), false),
        "model" => (Model::ALL.map(Model::name).to_vec(), false),
        "inject" => (PRESETS.iter().map(|preset| preset.name).collect(), true),
        "instrument" => (vec!["none", "tracker", "points"], false),
        "link" => (
            vec![
                "sim",
                "qemu",
                "serial:",
                "tcp:",
                "franka:",
                "fri:",
                "ur:",
                "controller:",
                "grpc:",
                "grpcs:",
            ],
            false,
        ),
        _ => return None,
    })
}

/// The command line with the values of its options, for shells alone: the program itself takes files in the same places.
fn with_values(command: Command) -> Command {
    let of_robot = command.get_name() == "robot";
    command
        .mut_args(|arg| {
            let known =
                values(arg.get_id().as_str()).filter(|_| arg.get_long().is_some() && arg.get_action().takes_values());
            match known {
                Some((names, _)) => arg.value_parser(PossibleValuesParser::new(names)),
                None => arg,
            }
        })
        .mut_subcommands(move |sub| {
            // `robot show NAME` and `robot convert NAME`.
            let sub = if of_robot {
                sub.mut_args(|arg| match arg.get_id().as_str() {
                    "robot" | "from" => arg.value_parser(PossibleValuesParser::new(BUILT_IN.iter().copied())),
                    _ => arg,
                })
            } else {
                sub
            };
            with_values(sub)
        })
}

/// Lets shells complete files beside the names: those of fish and zsh leave them out where names are known.
fn files_too(shell: Shell, script: String) -> String {
    let lists: Vec<String> = ["robot", "inject"]
        .into_iter()
        .filter_map(|option| Some(values(option)?.0.join(" ")))
        .collect();
    match shell {
        Shell::Zsh => lists.iter().fold(script, |script, names| {
            let both = format!(": _alternative \"names\\:name\\:({names})\" \"files\\:file\\:_files\"");
            script.replace(&format!(":({names})"), &both)
        }),
        Shell::Fish => script
            .lines()
            .map(|line| {
                let wanted = [" -l robot ", " -l inject "].iter().any(|option| line.contains(option));
                let line = if wanted {
                    line.replacen(" -r -f -a ", " -r -F -a ", 1)
                } else {
                    line.to_owned()
                };
                line + "\n"
            })
            .collect(),
        _ => script,
    }
}

pub(super) fn completions(args: &CompletionsArgs, command: Command) -> Result<Exit, CliError> {
    let mut script = Vec::new();
    clap_complete::generate(args.shell, &mut with_values(command), "spherecal", &mut script);
    print_bytes(files_too(args.shell, String::from_utf8_lossy(&script).into_owned()).as_bytes())
}

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
    std::fs::create_dir_all(folder).map_err(unwritten(folder))?;
    clap_mangen::generate_to(command, folder).map_err(unwritten(folder))?;
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
