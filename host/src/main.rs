//! The `spherecal` program: see [`spherecal::cli`].

use std::process::ExitCode;

fn main() -> ExitCode {
    spherecal::cli::main()
}
