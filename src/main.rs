//! The command line program: arguments in, images and reports out. Everything it can do is in the library, `qtracer`.

mod cli;

use std::process::ExitCode;

fn main() -> ExitCode {
    cli::main()
}
