//! Ctrl-C, SIGTERM and SIGHUP: the first asks the renderer to stop, the second ends the program at once.

use super::console;
use qtracer::CancelToken;
use std::sync::atomic::{AtomicBool, Ordering};

pub fn cancel_on_interrupt(cancel: CancelToken) {
    let interrupted = AtomicBool::new(false);
    let handler = move || {
        if interrupted.swap(true, Ordering::SeqCst) {
            std::process::exit(1);
        }
        console::note("interrupted: writing what there is; interrupt again to stop at once");
        cancel.cancel();
    };
    if let Err(error) = ctrlc::set_handler(handler) {
        console::warning(format!("an interrupt will lose the image: {error}"));
    }
}
