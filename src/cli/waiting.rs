//! What takes long before the first sample, such as reading and ordering millions of triangles: said on stderr while it lasts,
//! where that is a terminal.

use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use std::io::IsTerminal;
use std::sync::mpsc::{RecvTimeoutError, channel};
use std::thread;
use std::time::Duration;

/// What is done sooner is not worth a word.
const SOON: Duration = Duration::from_millis(500);

/// Does `work`, and says `what` it is where that takes long.
pub fn during<T>(what: &str, quiet: bool, work: impl FnOnce() -> T) -> T {
    match quiet || !std::io::stderr().is_terminal() {
        true => work(),
        false => said_after(SOON, what, ProgressDrawTarget::stderr(), work).0,
    }
}

/// The result, and whether it was worth a word.
fn said_after<T>(
    soon: Duration,
    what: &str,
    target: ProgressDrawTarget,
    work: impl FnOnce() -> T,
) -> (T, bool) {
    let (working, done) = channel::<()>();
    thread::scope(|scope| {
        let watcher = scope.spawn(move || {
            let long = done.recv_timeout(soon) == Err(RecvTimeoutError::Timeout);
            if long {
                let bar = ProgressBar::with_draw_target(None, target);
                if let Ok(style) = ProgressStyle::with_template("{spinner} {msg}, {elapsed}") {
                    bar.set_style(style);
                }
                bar.set_message(what.to_owned());
                bar.enable_steady_tick(Duration::from_millis(100));
                // Ends when the other side is dropped, be it by a panic.
                let _ = done.recv();
                bar.finish_and_clear();
            }
            long
        });
        let result = work();
        drop(working);
        (result, watcher.join().unwrap_or_default())
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_what_takes_long_is_said() {
        let hidden = ProgressDrawTarget::hidden;
        assert_eq!(said_after(Duration::from_secs(60), "thinking", hidden(), || 6 * 7), (42, false));
        let slow = || thread::sleep(Duration::from_millis(50));
        assert_eq!(said_after(Duration::from_millis(1), "sleeping", hidden(), slow), ((), true));
    }
}
