//! What the program's functions are held against, in f64 and by other formulas than theirs.

pub mod bsdf;
pub mod geometry;
pub mod ggx;
pub mod sampling;
