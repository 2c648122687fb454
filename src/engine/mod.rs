//! Engines: three ways to run the same transport, behind one trait, and the renderer that chooses among them.

mod auto;
mod batch;
mod cpu;
mod cpu_levels;
mod error;
mod features;
mod gpu_film;
mod gpu_guide;
mod guided;
mod megakernel;
mod options;
mod pacing;
mod pilot;
mod renderer;
mod show;
mod stats;
mod strategy;
mod submissions;
mod tracer;
mod wavefront;
mod workload;

pub use crate::transport::estimators::Estimators;
pub use auto::{preferred_engine, preferred_schedule};
pub use batch::Batch;
pub use error::RenderError;
pub use options::{Budget, EngineChoice, EngineKind, RenderOptions};
pub use renderer::Renderer;
pub use show::GuideView;
pub use stats::{
    EnvironmentStats, GuideStats, HierarchyStats, InstanceStats, LightTreeStats, RenderStats, SurfaceStats,
};
pub use strategy::{Pass, Strategy};
#[doc(hidden)]
pub use wavefront::recorded::{RecordedLevel, RecordedStage};

use crate::film::Film;
use crate::guiding::{Committed, GuideUpdate};
use std::ops::Range;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

/// A flag that another thread may set to end a render early; what was finished is kept.
#[derive(Clone, Debug, Default)]
pub struct CancelToken(Arc<AtomicBool>);

impl CancelToken {
    pub fn cancel(&self) {
        self.0.store(true, Ordering::Relaxed);
    }
    pub fn is_cancelled(&self) -> bool {
        self.0.load(Ordering::Relaxed)
    }
}

/// One way to run the transport. All engines trace the same paths from the same seed.
pub trait Engine: Send {
    fn kind(&self) -> EngineKind;

    /// What it runs on, for people.
    fn device(&self) -> String;

    /// Adds the samples `range` of every pixel to the film. On cancellation or failure, what was added before stays, and
    /// the film's counts say how much that is.
    fn render(&mut self, range: Range<u32>, film: &mut Film, cancel: &CancelToken)
    -> Result<(), RenderError>;

    /// Traces paths as this pass asks from now on.
    fn set_pass(&mut self, pass: &Pass) -> Result<(), RenderError>;

    /// Bytes that a guide may take, whatever is allowed.
    fn largest_guide(&self) -> u64 {
        u64::MAX
    }

    /// Puts a table in place: from now on it guides paths, and what they teach is added up from zero.
    fn set_guide(&mut self, update: GuideUpdate) -> Result<(), RenderError>;

    /// Begins [`Engine::commit`] where that can go on while the caller does other things.
    fn begin_commit(&mut self) {}

    /// Commits what paths taught since the table was put in place: what is known now, which the engine keeps, too.
    fn commit(&mut self) -> Result<Committed, RenderError>;

    /// Samples per pixel to ask for at once, so that a step is neither long nor wasteful.
    fn step_samples(&self) -> u32;

    /// What was built and spent so far.
    fn stats(&self) -> RenderStats;
}
