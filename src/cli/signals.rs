//! Ctrl-C, SIGTERM and SIGHUP: the first asks the renderer to stop, the second ends the program at once.

use super::console;
use qtracer::CancelToken;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, OnceLock};

/// Where to put the renderer's token as soon as there is one.
pub type CancelSlot = Arc<OnceLock<CancelToken>>;

/// From here on an interrupt goes to the renderer. While there is none, nothing can be lost: it ends the program.
pub fn watch() -> CancelSlot {
    let slot = CancelSlot::default();
    let (cancel, interrupted) = (slot.clone(), AtomicBool::new(false));
    let handler = move || match cancel.get() {
        Some(cancel) if !interrupted.swap(true, Ordering::SeqCst) => {
            console::note("interrupted: writing what there is; interrupt again to stop at once");
            cancel.cancel();
        }
        Some(_) => std::process::exit(1),
        None => {
            console::error("interrupted before rendering began: nothing was written");
            std::process::exit(1);
        }
    };
    if let Err(error) = ctrlc::set_handler(handler) {
        console::warning(format!("an interrupt will lose the image: {error}"));
    }
    slot
}
