//! What the benches share, a file per idea. docs: benches/README.md.

pub mod arguments;
pub mod chart;
pub mod engines;
pub mod job;
pub mod machine;
pub mod measure;
pub mod page;
pub mod rows;
pub mod summary;
pub mod truth;
pub mod variant;
