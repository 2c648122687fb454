//! What happens to a path at each event: work items and pure stage functions, the CPU twins of `kernels/transport`.

pub mod estimators;
pub mod guide;
pub mod items;
pub mod light;
pub mod light_tree;
pub mod path;
pub mod roulette;
pub mod split;
pub mod step;
