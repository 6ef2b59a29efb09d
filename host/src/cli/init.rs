//! `spherecal init`: a first cell, from questions or options.

use std::fs::File;
use std::io::{ErrorKind, IsTerminal as _, Write as _};
use std::path::{Path, PathBuf};

use super::exit::{CliError, Exit, unwritten};
use super::init_given::{Given, InitArgs, refused};
use super::init_questions::Questions;
use super::out::outln;
use super::run::shell_word;
use spherecal_job::new_cell::{Instrument, NewCell, NewCellFiles};

/// Names of the files, and what they are for.
const CELL: &str = "cell.toml";
const PLATE: &str = "plate.toml";
const POSES: &str = "poses.csv";

pub(super) fn run(args: &InitArgs) -> Result<Exit, CliError> {
    let there: Vec<String> = [CELL, PLATE, POSES]
        .into_iter()
        .map(|name| args.out.join(name))
        .filter(|path| path.symlink_metadata().is_ok())
        .map(|path| path.display().to_string())
        .collect();
    if !there.is_empty() {
        return Err(already(&there.join(", ")));
    }
    let mut given = Given::of(args)?;
    let asks = !args.yes && std::io::stdin().is_terminal() && std::io::stderr().is_terminal();
    let missing = given.missing();
    if asks {
        let stdin = std::io::stdin().lock();
        Questions::new(stdin, std::io::stderr().lock()).ask(&mut given)?;
    } else if !missing.is_empty() {
        let why = if args.yes {
            "--yes asks nothing"
        } else {
            "there is no terminal to ask at"
        };
        return Err(CliError::input(format!(
            "{why}, and these options are missing:\n  {}",
            missing.join("\n  ")
        )));
    }
    let cell = given.cell(args)?;
    let files = cell.files().map_err(refused)?;
    if asks && !missing.is_empty() {
        let stdin = std::io::stdin().lock();
        let mut questions = Questions::new(stdin, std::io::stderr().lock());
        if !questions.confirm(&files.assumed, &args.out)? {
            return Err(CliError::input("nothing is written"));
        }
    }
    write(&args.out, &files)?;
    say(args, &cell, &files);
    Ok(Exit::Done)
}

fn already(files: &str) -> CliError {
    CliError::input(format!(
        "{files}: there already, and nothing is overwritten: give another --out, or move the old files away"
    ))
}

/// Writes the files, all or none. A file that is there is never replaced.
fn write(folder: &Path, files: &NewCellFiles) -> Result<(), CliError> {
    std::fs::create_dir_all(folder).map_err(unwritten(folder))?;
    let mut made: Vec<PathBuf> = Vec::new();
    for (name, text) in [
        (CELL, &files.cell_toml),
        (PLATE, &files.plate_toml),
        (POSES, &files.poses_csv),
    ] {
        let path = folder.join(name);
        let written = File::create_new(&path).and_then(|mut file| {
            made.push(path.clone());
            file.write_all(text.as_bytes())?;
            file.sync_all()
        });
        if let Err(error) = written {
            for path in &made {
                // What is left of a full disk is named by the error.
                let _ = std::fs::remove_file(path);
            }
            return Err(match error.kind() {
                ErrorKind::AlreadyExists => already(&path.display().to_string()),
                _ => unwritten(&path)(error).into(),
            });
        }
    }
    Ok(())
}

/// Says what was written, what was assumed, and what to type next.
fn say(args: &InitArgs, cell: &NewCell, files: &NewCellFiles) {
    let here = args.out == Path::new(".");
    let path = |name: &str| {
        let path = if here { PathBuf::from(name) } else { args.out.join(name) };
        shell_word(&path.display().to_string())
    };
    outln!("Files:\n  {}\n  {}\n  {}", path(CELL), path(PLATE), path(POSES));
    if !files.assumed.is_empty() {
        outln!("\nAssumed:");
        for words in &files.assumed {
            outln!("  {words}");
        }
    }
    let plate = match cell.instrument {
        Instrument::None => format!(" --plate {}", path(PLATE)),
        Instrument::Tracker | Instrument::Points => String::new(),
    };
    let identify = format!(
        "spherecal identify --robot {} --data {}{plate} {} --certificate {} --out {}",
        shell_word(&cell.robot),
        path(POSES),
        files.identify_options,
        path(CELL),
        path("identified")
    );
    let out = if here {
        String::new()
    } else {
        format!(" --out {}", shell_word(&args.out.display().to_string()))
    };
    let run = format!("spherecal run --config {}{out}", path(CELL));
    match cell.instrument {
        Instrument::None => outln!(
            "\nFrom poses of your own, once {POSES} has rows:\n  {identify}\n\nThe whole job on a simulated arm in this cell, \
             and with --link on the robot.\nNext: {run}"
        ),
        Instrument::Tracker | Instrument::Points => outln!(
            "\nThe whole job on a simulated arm in this cell, and with --link on the robot:\n  {run}\n\nWrite one row per \
             measured pose into {POSES}.\nNext: {identify}"
        ),
    }
}
