//! qtracer: a wavefront path tracer on any vendor's GPU that learns where light comes from.
//!
//! ```
//! use qtracer::{RenderOptions, Renderer, Scene, scene::Material};
//!
//! let scene = Scene::builder("a ball under the sky")
//!     .camera([0.0, 1.0, 4.0], [0.0, 0.0, 0.0], 45.0)
//!     .size(32, 24)
//!     .environment([0.6, 0.8, 1.0])
//!     .material("clay", Material::diffuse([0.7, 0.4, 0.3]))
//!     .sphere([0.0, 0.0, 0.0], 1.0, "clay")
//!     .build()?;
//! let mut renderer = Renderer::new(&scene, RenderOptions::cpu())?;
//! while renderer.samples() < 16 {
//!     renderer.step(16 - renderer.samples())?;
//! }
//! assert_eq!(renderer.image().rgb.len(), 32 * 24);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! Floors, each of which uses only lower ones (docs/ARCHITECTURE.md): the command line over [`engine`] and [`gpu`], over
//! [`transport`], over [`scene`], [`bsdf`], [`film`], over the mathematics. The kernels under `kernels/` are the GPU's
//! twins of [`transport`] and what lies below it.

pub mod accel;
pub mod bsdf;
pub mod engine;
pub mod film;
pub mod gpu;
pub mod guiding;
pub mod layout;
pub mod math;
pub mod random;
pub mod sampling;
pub mod scene;
pub mod stats;
pub mod transport;
pub mod untrusted;

pub use engine::{
    Budget, CancelToken, EngineChoice, EngineKind, RenderError, RenderOptions, RenderStats, Renderer,
};
pub use film::{Film, Image};
pub use random::Sampler;
pub use scene::Scene;
