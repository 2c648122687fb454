//! How a command fails: with which messages, and with which exit code.

use super::console;
use qtracer::RenderError;
use qtracer::gpu::error::GpuError;
use std::fmt::Display;
use std::process::ExitCode;

#[derive(Debug)]
pub struct Failure {
    exit_code: u8,
    messages: Vec<String>,
}

impl Failure {
    /// What was asked can't be done: arguments, scenes, images that can't be read, places that can't be written.
    pub fn bad_input(message: impl Display) -> Self {
        Failure { exit_code: 2, messages: vec![message.to_string()] }
    }

    /// It could be asked, and failed; or images differ.
    pub fn failed(message: impl Display) -> Self {
        Self::failed_all(vec![message.to_string()])
    }

    /// Several things failed.
    pub fn failed_all(messages: Vec<String>) -> Self {
        Failure { exit_code: 1, messages }
    }

    /// A renderer that could not start: whether the options or the machine are to blame decides the exit code.
    pub fn of_start(error: &RenderError) -> Self {
        match error {
            RenderError::Option { .. }
            | RenderError::Guide(_)
            | RenderError::TooManySamples { .. }
            | RenderError::Gpu(GpuError::NoAdapter { wanted: Some(_), .. }) => Self::bad_input(error),
            _ => Self::failed(error),
        }
    }

    pub fn into_messages(self) -> Vec<String> {
        self.messages
    }

    /// Prints the messages and gives the exit code.
    pub fn report(&self) -> ExitCode {
        for message in &self.messages {
            console::error(message);
        }
        ExitCode::from(self.exit_code)
    }
}
