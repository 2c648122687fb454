//! What finds the nearest shape on the CPU faster than asking one after the other.

mod lanes;
mod search;
mod vector;

pub use lanes::{RayLanes, ShadowEnds, ShapeLanes};
pub use search::Search;
