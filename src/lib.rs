//! qtracer: a wavefront path tracer that learns where light comes from.

pub mod film;
pub mod scene;
pub mod stats;
