//! What can be wrong with the question, as opposed to the answer.

/// Why two images, or a histogram and its expectation, can't be compared.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum StatsError {
    #[error("cannot compare a {0}x{1} image with a {2}x{3} one; render both at one size")]
    SizeMismatch(usize, usize, usize, usize),
    #[error("the {what} image has {got} {item} for {expected} pixels; it was put together wrongly")]
    WrongLength { what: &'static str, item: &'static str, got: usize, expected: usize },
    #[error(
        "neither image says its standard errors; render at least one with 2 samples per pixel or more and keep it as .exr"
    )]
    NoStandardErrors,
    #[error(
        "the {what} image's standard error is {value} at pixel ({x}, {y}); \
         a z-test needs finite ones, so render it with at least 2 samples per pixel"
    )]
    BadStandardError { what: &'static str, x: usize, y: usize, value: f32 },
    #[error("alpha {0} is not between 0 and 1; the usual choice is 0.01")]
    BadAlpha(f64),
    #[error("blocks of 0 pixels hold nothing; the usual choice is 8")]
    EmptyBlock,
    #[error("{0} pixels per degree is not a display; the usual choice is 67, between 1 and 1000")]
    BadPixelsPerDegree(f64),
    #[error("an image without pixels can't be compared")]
    EmptyImage,
    #[error("{observed} cells were observed and {expected} expected; count both over the same cells")]
    CellMismatch { observed: usize, expected: usize },
    #[error("cell {cell} expects {value}, which is no count; expectations are finite and not negative")]
    BadExpectation { cell: usize, value: f64 },
}
