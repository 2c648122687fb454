//! The command line program: arguments in, images and reports out. Everything it can do is in the library, `qtracer`.

mod cli;

use std::process::ExitCode;

fn main() -> ExitCode {
    // Without a desktop session Mesa's device-select layer prints errors about it; there it has nothing to select.
    if std::env::var_os("XDG_RUNTIME_DIR").is_none() {
        // SAFETY: no other thread runs yet.
        unsafe { std::env::set_var("NODEVICE_SELECT", "1") };
    }
    cli::main()
}
