//! Samplers against their densities: χ² of what is drawn, densities that integrate to one, weights that are f·cosθ/pdf; and
//! the numbers that they draw with. Both twins of each function answer the same questions.
//!
//! Each χ² test has α = 1e-4: a right sampler fails it once in 10,000 seeds. Its negative control, a density 3 % askew or
//! some other wrong one, must have a chance below 1e-9. `cargo test … -- --nocapture` shows the worst errors measured.

mod camera;
mod cells;
mod directions;
mod frames;
mod fresnel;
mod independence;
mod light_choice;
mod light_directions;
mod light_tree;
mod lights;
mod materials;
mod microfacet_albedos;
mod microfacets;
mod random;
pub mod twins;
mod weights;

pub use cells::{ALPHA, Cells, WRONG};

use qtracer::Sampler;
use qtracer::random::{SampleKey, sample4};

/// The numbers that path `i` draws: the program's own, so that they are tested too. [`DRAW`] is the kernels'.
pub fn draw(i: u32) -> glam::Vec4 {
    sample4(Sampler::Independent, SampleKey { pixel: 3, sample: i, seed: 41 }, 7)
}

/// [`draw`] of the question's last word, as `u`.
pub const DRAW: &str = "let u = sample4(SampleKey(3u, a.w, 41u), 7u);\n";
pub const DRAW_IMPORTS: &str = "import package::base::random::{SampleKey, sample4};\n";
