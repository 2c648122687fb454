//! Files are data from anywhere: what is decoded by other people's code may be damaged, truncated or lying, and must neither
//! end the program nor take memory out of proportion to its own size.

use std::panic::{AssertUnwindSafe, catch_unwind};

/// Memory per byte of file that no compression of real images exceeds (deflate reaches 1032).
const MOST_EXPANSION: u64 = 1 << 12;
/// Memory always allowed.
const FREE_BYTES: u64 = 1 << 24;

/// Bytes that decoding a file of so many may take.
pub fn memory_for(file_bytes: usize) -> u64 {
    (file_bytes as u64).saturating_mul(MOST_EXPANSION).saturating_add(FREE_BYTES)
}

/// Decoders of others may panic on what their authors have not thought of: that is the error `damaged` then.
pub fn unless_it_panics<T, E>(damaged: E, decode: impl FnOnce() -> Result<T, E>) -> Result<T, E> {
    catch_unwind(AssertUnwindSafe(decode)).unwrap_or(Err(damaged))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn decoders_that_panic_are_errors() {
        let panics = || -> Result<(), &str> { panic!("what the decoder's authors have not thought of") };
        assert_eq!(unless_it_panics("damaged", panics), Err("damaged"));
        assert_eq!(unless_it_panics("damaged", || Ok(7)), Ok(7));
        assert_eq!(unless_it_panics("damaged", || Err::<(), _>("of another kind")), Err("of another kind"));
    }
}
