//! Both output streams. A reader that has gone away (`qtracer … | head -1`) is never a panic.

use super::failure::Failure;
use std::fmt::Display;
use std::io::{self, ErrorKind, Write};

/// Data, to stdout, ending in one line break. A closed pipe is the reader's choice and no failure.
pub fn data(text: impl Display) -> Result<(), Failure> {
    let text = text.to_string();
    let mut out = io::stdout().lock();
    match writeln!(out, "{}", text.trim_end_matches('\n')).and_then(|()| out.flush()) {
        Err(error) if error.kind() != ErrorKind::BrokenPipe => {
            Err(Failure::failed(format!("cannot write to stdout: {error}")))
        }
        _ => Ok(()),
    }
}

/// Data as indented JSON, to stdout.
pub fn json(value: &impl serde::Serialize) -> Result<(), Failure> {
    let text = serde_json::to_string_pretty(value)
        .map_err(|e| Failure::failed(format!("cannot write JSON: {e}")))?;
    data(text)
}

/// A line to stderr. There is nowhere to report that stderr can't be written.
pub fn line(text: impl Display) {
    let _ = writeln!(io::stderr().lock(), "{text}");
}

pub fn note(text: impl Display) {
    line(format_args!("note: {text}"));
}

pub fn warning(text: impl Display) {
    line(format_args!("warning: {text}"));
}

pub fn error(text: impl Display) {
    line(format_args!("error: {text}"));
}
