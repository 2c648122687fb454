//! What a render built and spent.

use crate::guiding::Learner;
use crate::scene::bvh::NODE_ROWS;
use crate::scene::compiled::CompiledScene;
use std::collections::BTreeMap;

/// Figures for `--stats` and for tests.
#[derive(Clone, Debug, Default, PartialEq, serde::Serialize)]
pub struct RenderStats {
    pub engine: String,
    pub device: String,
    /// What the kernels were specialised to; empty on the CPU.
    pub kernel_key: String,
    /// Kernels linked.
    pub kernels: Vec<String>,
    /// Bytes of each GPU buffer.
    pub buffers: BTreeMap<String, u64>,
    /// Paths traced.
    pub paths: u64,
    /// Rays traced, shadow rays not included.
    pub rays: u64,
    /// Samples whose radiance was infinite, no number or beyond 2⁶⁰: they count as black. 0 unless something is wrong.
    pub lost_samples: u64,
    /// Seconds that the GPU worked, by its own clock; 0 where it has none.
    pub gpu_seconds: f64,
    /// Seconds within the engine, waiting included.
    pub seconds: f64,
    /// The hierarchy over the shapes; absent where rays ask all of them.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub hierarchy: Option<HierarchyStats>,
    /// Submissions to the GPU.
    pub submissions: u64,
    /// Levels recorded by the wavefront engine.
    pub iterations: u64,
    /// What was learnt; absent where nothing is.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub guide: Option<GuideStats>,
}

/// Figures about the hierarchy over the shapes.
#[derive(Clone, Debug, Default, PartialEq, serde::Serialize)]
pub struct HierarchyStats {
    /// Shapes in it.
    pub shapes: usize,
    /// Of these, triangles of meshes.
    pub triangles: usize,
    /// Nodes, of two boxes each.
    pub nodes: usize,
    /// Bytes of the nodes.
    pub bytes: usize,
    /// Nodes from the top to the deepest leaf.
    pub depth: u32,
    /// Seconds that it took to build.
    pub build_seconds: f64,
}

impl HierarchyStats {
    pub(super) fn new(scene: &CompiledScene) -> Option<HierarchyStats> {
        scene.bvh.as_ref().map(|bvh| HierarchyStats {
            shapes: scene.shape_count(),
            triangles: scene.triangles.len(),
            nodes: bvh.rows.len() / NODE_ROWS,
            bytes: size_of_val(&bvh.rows[..]),
            depth: bvh.depth,
            build_seconds: bvh.seconds,
        })
    }
}

/// Figures about what was learnt.
#[derive(Clone, Debug, Default, PartialEq, serde::Serialize)]
pub struct GuideStats {
    /// Kind of table.
    pub mode: String,
    /// Edge of a base cell.
    pub cell_size: f32,
    /// Cells that exist.
    pub cells: usize,
    /// Quadtree nodes that exist.
    pub nodes: usize,
    /// Bytes of the table, but for the estimates of the pixels.
    pub table_bytes: u64,
    /// Bytes of the sums of a pass.
    pub sums_bytes: u64,
    /// Lessons taken in, those of a loaded table included.
    pub passes: u32,
    /// Samples per pixel that taught, likewise.
    pub learning_samples: u64,
}

impl GuideStats {
    pub(super) fn new(learner: &Learner) -> GuideStats {
        GuideStats {
            mode: learner.mode().to_string(),
            cell_size: learner.cell_size(),
            cells: learner.cells(),
            nodes: learner.nodes(),
            table_bytes: learner.table_bytes(),
            sums_bytes: learner.sums_bytes(),
            passes: learner.passes(),
            learning_samples: learner.samples(),
        }
    }
}
