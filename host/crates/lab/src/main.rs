//! The `spherecal-lab` program: see [`spherecal_lab::cli`].

use std::process::ExitCode;

fn main() -> ExitCode {
    spherecal_lab::cli::main()
}
