//! The stages of the pipeline as data: which kernel source each is linked from, with which flags, and the constants
//! (counters, queues, argument slots) that host and kernels share. docs/KERNELS.md tells the stages' contracts.

use super::key::{KIND_NAMES, KernelKey, SmallScene};
use crate::layout::GpuStruct;
use crate::scene::bvh::NODE_ROWS;
use crate::scene::compiled::{KINDS, Light, Material, Quad, Sphere, Triangle};
use crate::scene::instance::Instance;
use crate::scene::light_tree::LightCluster;
use crate::scene::rows::{ALIGNED_ROWS, MATERIAL_HOT_ROWS, QUAD_HOT_ROWS, SPHERE_HOT_ROWS};
use crate::scene::surfaces::{MaterialMaps, TextureImage, TriangleNormals, TriangleUvs};
use std::fmt::Write;

/// How the wavefront engine schedules a level of all paths in flight. All give the same image.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Schedule {
    /// A kernel per material; survivors stay in their slots and a compaction kernel gathers them.
    Compacted,
    /// A kernel per material; survivors are pushed straight into the next dense queue.
    Streamed,
    /// One kernel for whole levels (intersection, shading and shadow test fused), some in a row; survivors streamed.
    Fused,
    /// A list of hits per material, whose paths are followed while they meet that material; then they change lists.
    /// Paths cannot split here.
    Sorted,
}

/// Invocations per workgroup of every kernel but those below and the one-invocation ones. 256 is what every browser grants.
pub const WORKGROUP: u32 = 256;
/// … of the megakernel, where a workgroup occupies its part of the GPU until its longest path ends: smaller parts wait less.
pub const MEGAKERNEL_WORKGROUP: u32 = 128;
/// Most items of a list of the sorted schedule for each invocation of a workgroup.
pub const ITEMS: u32 = 4;
/// Invocations per workgroup of the commit kernel: cells are few, and each has much to do.
pub const CELLS_AT_ONCE: u32 = 32;
/// Workgroups in a row of the two-dimensional grid (`GRID_WIDTH` in kernels/stages/queues.wesl).
pub const GRID_WIDTH: u32 = 32768;
/// Samples of a pixel that the GPU sums in f32 before the host adds them up in f64.
pub const BLOCK: u32 = 32;

/// Words of the counter buffer. Hit queues' lengths follow after the last.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Counter {
    /// A bit per queue that ran over.
    Overflow,
    /// Rays pushed for the next level.
    Survivors,
    /// Rays of this level.
    Live,
    /// Slot of the first fresh ray of this level.
    FreshBegin,
    /// First path of the batch not yet started.
    NextPath,
    /// Shadow rays pushed.
    Shadows,
    /// Shadow rays being traced.
    ShadowsLive,
    /// Transitions pushed.
    Transitions,
    /// Transitions being learnt.
    TransitionsLive,
    /// Rays traced by this batch, shadow rays not counted.
    Rays,
    /// Places for radiance that the paths of rays pushed for the next level own; where paths split.
    Places,
    /// Levels of this batch in which there was anything to do.
    Levels,
    /// Levels of a path that a visit of this level may have.
    Visit,
    FirstHit,
}

const COUNTER_NAMES: [&str; 14] = [
    "COUNTER_OVERFLOW",
    "COUNTER_SURVIVORS",
    "COUNTER_LIVE",
    "COUNTER_FRESH_BEGIN",
    "COUNTER_NEXT_PATH",
    "COUNTER_SHADOWS",
    "COUNTER_SHADOWS_LIVE",
    "COUNTER_TRANSITIONS",
    "COUNTER_TRANSITIONS_LIVE",
    "COUNTER_RAYS",
    "COUNTER_PLACES",
    "COUNTER_LEVELS",
    "COUNTER_VISIT",
    "FIRST_HIT_COUNTER",
];

/// Slots of the indirect arguments. Hit queues' slots follow after the last.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Argument {
    Generate,
    Intersect,
    Shadow,
    Learn,
    FirstHit,
}

/// What each word of the counter buffer counts, for people: an overflow bit is named by its number.
pub fn queue_names(key: &KernelKey) -> Vec<String> {
    let mut names: Vec<String> = COUNTER_NAMES[..Counter::FirstHit as usize]
        .iter()
        .map(|name| name.trim_start_matches("COUNTER_").to_lowercase().replace('_', " "))
        .collect();
    names.extend((0..KINDS).filter(|&k| key.kinds[k]).map(|k| format!("{} hits", KIND_NAMES[k])));
    names.push("environment".to_string());
    names
}

/// How many words the counter buffer has.
pub fn counter_words(key: &KernelKey) -> u32 {
    Counter::FirstHit as u32 + key.hit_queues()
}

/// How many rows of four words the buffer of lengths has: a word for each counter.
pub fn length_rows(key: &KernelKey) -> u32 {
    counter_words(key).div_ceil(4)
}

/// How many words the argument buffer has.
pub fn argument_words(key: &KernelKey) -> u32 {
    3 * (Argument::FirstHit as u32 + key.hit_queues())
}

/// A kernel of one of the engines.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Stage {
    PrepareRays,
    Generate,
    Intersect,
    PrepareShade,
    Environment,
    /// Shading of one material kind.
    Shade(u32),
    Compact,
    Shadow,
    Learn,
    Step,
    /// Paths at surfaces of one material kind.
    Follow(u32),
    /// Paths at surfaces of all kinds that have no [`Stage::Follow`] of their own, and fresh ones.
    FollowOthers,
    Megakernel,
    Resolve,
    /// At a pass's end, and where a table is put in place.
    Commit,
}

impl Stage {
    /// Stages that the wavefront engine runs for this scene, in order of a level, then those that run behind a batch or a pass;
    /// no others are linked.
    pub fn wavefront(key: &KernelKey, schedule: Schedule) -> Vec<Stage> {
        if schedule == Schedule::Fused {
            let own = [Stage::PrepareRays, Stage::Step];
            return own.into_iter().chain(Stage::behind_levels(key)).collect();
        }
        if schedule == Schedule::Sorted {
            let own = key.own_kernel().map(Stage::Follow);
            let level = [Stage::PrepareRays].into_iter().chain(own).chain([Stage::FollowOthers]);
            return level.chain(Stage::behind_levels(key)).collect();
        }
        let mut stages = vec![Stage::PrepareRays, Stage::Generate];
        if key.direct_light {
            stages.push(Stage::Shadow);
        }
        if key.teaches {
            stages.push(Stage::Learn);
        }
        stages.extend([Stage::Intersect, Stage::PrepareShade]);
        if key.environment {
            stages.push(Stage::Environment);
        }
        stages.extend((0..KINDS as u32).filter(|&kind| key.kinds[kind as usize]).map(Stage::Shade));
        if schedule == Schedule::Compacted {
            stages.push(Stage::Compact);
        }
        stages.extend(Stage::behind_levels(key));
        stages
    }

    /// Stages of the megakernel engine.
    pub fn megakernel(key: &KernelKey) -> Vec<Stage> {
        [Stage::Megakernel].into_iter().chain(Stage::behind_levels(key)).collect()
    }

    /// Stages of every engine: behind a batch, and where paths teach behind a pass.
    fn behind_levels(key: &KernelKey) -> impl Iterator<Item = Stage> {
        [Stage::Resolve].into_iter().chain(key.teaches.then_some(Stage::Commit))
    }

    /// Whether it is part of a level of all paths in flight.
    pub fn is_in_level(self) -> bool {
        !matches!(self, Stage::Resolve | Stage::Commit)
    }

    pub fn name(self) -> String {
        match self {
            Stage::Shade(kind) => format!("shade_{}", KIND_NAMES[kind as usize]),
            Stage::Follow(kind) => format!("follow_{}", KIND_NAMES[kind as usize]),
            Stage::FollowOthers => "follow_others".to_string(),
            stage => stage.module().to_string(),
        }
    }

    /// Source module under kernels/stages.
    pub fn module(self) -> &'static str {
        match self {
            Stage::PrepareRays => "prepare_rays",
            Stage::Generate => "generate",
            Stage::Intersect => "intersect",
            Stage::PrepareShade => "prepare_shade",
            Stage::Environment => "environment",
            Stage::Shade(_) => "shade",
            Stage::Compact => "compact",
            Stage::Shadow => "shadow",
            Stage::Learn => "learn",
            Stage::Step => "step",
            Stage::Follow(_) | Stage::FollowOthers => "follow",
            Stage::Megakernel => "megakernel",
            Stage::Resolve => "resolve",
            Stage::Commit => "commit",
        }
    }

    /// The key that this stage is linked with: a kernel of one material knows no other.
    pub fn key(self, scene: KernelKey) -> KernelKey {
        match self {
            Stage::Shade(kind) | Stage::Follow(kind) => scene.only_kind(kind),
            Stage::FollowOthers => scene.without_kind(scene.own_kernel()),
            _ => scene,
        }
    }

    /// Where this stage's indirect arguments lie, None if it runs once.
    pub fn argument(self, key: &KernelKey) -> Option<u32> {
        let first_hit = Argument::FirstHit as u32;
        match self {
            Stage::Generate => Some(Argument::Generate as u32),
            Stage::Intersect | Stage::Compact | Stage::Step | Stage::FollowOthers => {
                Some(Argument::Intersect as u32)
            }
            Stage::Shadow => Some(Argument::Shadow as u32),
            Stage::Learn => Some(Argument::Learn as u32),
            Stage::Environment => Some(first_hit + key.hit_queues() - 1),
            Stage::Shade(kind) | Stage::Follow(kind) => Some(first_hit + key.hit_queue(kind)),
            _ => None,
        }
    }

    /// Feature flags of this stage beyond those of the scene.
    pub fn flags(self, scene: &KernelKey, schedule: Schedule) -> Vec<(&'static str, bool)> {
        let whole_levels = matches!(schedule, Schedule::Fused | Schedule::Sorted);
        vec![
            ("commits", self == Stage::Commit),
            ("sorted", schedule == Schedule::Sorted),
            ("others", self == Stage::FollowOthers),
            ("stands", self.key(*scene).kinds.contains(&true)),
            ("in_place", schedule == Schedule::Compacted),
            ("prepares", matches!(self, Stage::PrepareRays | Stage::PrepareShade)),
            ("pushes_hits", self == Stage::Intersect),
            ("pushes_shadows", matches!(self, Stage::Shade(_))),
            ("pushes_transitions", scene.teaches && matches!(self, Stage::Shade(_))),
            ("transition_queue", scene.teaches && !whole_levels),
            ("shadow_queue", scene.direct_light && !whole_levels),
        ]
    }

    /// The module `package::key`: numbers that host and kernels agree on.
    pub fn constants(self, scene: &KernelKey) -> String {
        let mut text = String::new();
        let mut define = |name: &str, value: u32| {
            let _ = writeln!(text, "const {name}: u32 = {value}u;");
        };
        let workgroup = if self == Stage::Megakernel { MEGAKERNEL_WORKGROUP } else { WORKGROUP };
        define("WORKGROUP", workgroup);
        define("CELLS_AT_ONCE", CELLS_AT_ONCE);
        define("BLOCK", BLOCK);
        define("ITEMS", if self == Stage::FollowOthers { 1 } else { ITEMS });
        define("SPLIT", scene.places);
        define("COUNTERS", counter_words(scene));
        define("LENGTH_ROWS", length_rows(scene));
        for (i, name) in COUNTER_NAMES.iter().enumerate() {
            define(name, i as u32);
        }
        define("ARGUMENT_GENERATE", Argument::Generate as u32);
        define("ARGUMENT_INTERSECT", Argument::Intersect as u32);
        define("ARGUMENT_SHADOW", Argument::Shadow as u32);
        define("ARGUMENT_LEARN", Argument::Learn as u32);
        define("FIRST_HIT_ARGUMENT", Argument::FirstHit as u32);
        if let Some(SmallScene { spheres, quads, aligned }) = scene.small_scene {
            define("SPHERES", spheres);
            define("QUADS", quads);
            for (name, count) in ["ALIGNED_X", "ALIGNED_Y", "ALIGNED_Z"].into_iter().zip(aligned) {
                define(name, count);
            }
            let aligned: u32 = aligned.iter().sum();
            let first_other = spheres * SPHERE_HOT_ROWS as u32 + aligned * ALIGNED_ROWS as u32;
            define("FIRST_OTHER_QUAD_ROW", first_other);
            // No array is empty.
            define("HOT_ROWS", (first_other + (quads - aligned) * QUAD_HOT_ROWS as u32).max(1));
        }
        if let Some(depth) = scene.bvh {
            define("BVH_DEPTH", depth);
        }
        if let Some(instances) = scene.instances {
            define("INSTANCES", instances);
        }
        for (name, rows) in [
            ("NODE_ROWS", NODE_ROWS),
            ("ALIGNED_ROWS", ALIGNED_ROWS),
            ("SPHERE_HOT_ROWS", SPHERE_HOT_ROWS),
            ("SPHERE_REST_ROWS", Sphere::ROWS - SPHERE_HOT_ROWS),
            ("QUAD_HOT_ROWS", QUAD_HOT_ROWS),
            ("QUAD_REST_ROWS", Quad::ROWS - QUAD_HOT_ROWS),
            ("TRIANGLE_ROWS", Triangle::ROWS),
            ("INSTANCE_ROWS", Instance::ROWS),
            ("MATERIAL_HOT_ROWS", MATERIAL_HOT_ROWS),
            ("MATERIAL_REST_ROWS", Material::ROWS - MATERIAL_HOT_ROWS),
            ("LIGHT_ROWS", Light::ROWS),
            ("TRIANGLE_NORMALS_ROWS", TriangleNormals::ROWS),
            ("TRIANGLE_UVS_ROWS", TriangleUvs::ROWS),
            ("MATERIAL_MAPS_ROWS", MaterialMaps::ROWS),
            ("TEXTURE_IMAGE_ROWS", TextureImage::ROWS),
            ("CLUSTER_ROWS", LightCluster::ROWS),
        ] {
            define(name, rows as u32);
        }
        define("HIT_QUEUES", scene.hit_queues());
        define("MATERIAL_QUEUES", scene.material_queues());
        define("OWN_KERNELS", u32::from(scene.own_kernel().is_some()));
        const { assert!(KINDS <= 8, "four bits a kind, in a word") };
        debug_assert!(scene.own_kernel().is_none_or(|kind| scene.hit_queue(kind) == 0), "the first list");
        let kinds = 0..KINDS as u32;
        define("KIND_QUEUES", kinds.map(|kind| scene.hit_queue(kind) << (4 * kind)).sum());
        for (kind, name) in KIND_NAMES.iter().enumerate() {
            define(&format!("QUEUE_{}", name.to_uppercase()), scene.hit_queue(kind as u32));
        }
        define("QUEUE_ENVIRONMENT", scene.hit_queues().saturating_sub(1));
        if let Stage::Shade(kind) | Stage::Follow(kind) = self {
            define("HIT_QUEUE", scene.hit_queue(kind));
        }
        text
    }
}
