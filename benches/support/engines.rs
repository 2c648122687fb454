//! The engines and their schedules, by one word each.

use qtracer::gpu::stage::Schedule;
use qtracer::{EngineChoice, RenderOptions};

/// An engine, and for the wavefront how it runs a level.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Way {
    /// What rows and legends call it.
    pub name: &'static str,
    pub engine: EngineChoice,
    pub schedule: Option<Schedule>,
}

/// All ways to run the transport. `wavefront` is its default schedule.
pub const WAYS: [Way; 8] = [
    Way { name: "cpu", engine: EngineChoice::Cpu, schedule: None },
    Way { name: "mega", engine: EngineChoice::Megakernel, schedule: None },
    Way { name: "fused", engine: EngineChoice::Wavefront, schedule: Some(Schedule::Fused) },
    Way { name: "sorted", engine: EngineChoice::Wavefront, schedule: Some(Schedule::Sorted) },
    Way { name: "streamed", engine: EngineChoice::Wavefront, schedule: Some(Schedule::Streamed) },
    Way { name: "compacted", engine: EngineChoice::Wavefront, schedule: Some(Schedule::Compacted) },
    Way { name: "wavefront", engine: EngineChoice::Wavefront, schedule: None },
    Way { name: "auto", engine: EngineChoice::Auto, schedule: None },
];

impl Way {
    /// The way of this name.
    pub fn named(name: &str) -> Result<Way, String> {
        let names: Vec<&str> = WAYS.iter().map(|way| way.name).collect();
        let found = WAYS.iter().find(|way| way.name == name || (name == "megakernel" && way.name == "mega"));
        found
            .copied()
            .ok_or_else(|| format!("no engine is called \"{name}\"; there are {}", names.join(", ")))
    }

    /// Asks `options` for this way.
    pub fn apply(&self, options: &mut RenderOptions) {
        options.engine = self.engine;
        options.schedule = self.schedule;
    }
}
