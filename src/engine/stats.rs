//! What a render built and spent.

use crate::guiding::Learner;
use crate::scene::bvh::NODE_ROWS;
use crate::scene::compiled::CompiledScene;
use crate::scene::sharing::shared_bytes;
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
    /// Meshes that are stored once for many instances; absent where none is.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub instances: Option<InstanceStats>,
    /// Normals, texture coordinates and textures; absent where nothing has any.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub surfaces: Option<SurfaceStats>,
    /// The environment map; absent without one, or if it is black.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub environment_map: Option<EnvironmentStats>,
    /// The tree that chooses among lights; absent where they are few, and chosen by power.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub light_tree: Option<LightTreeStats>,
    /// Submissions to the GPU.
    pub submissions: u64,
    /// Levels recorded by the wavefront engine.
    pub iterations: u64,
    /// What was learnt; absent where nothing is.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub guide: Option<GuideStats>,
}

/// Figures about the environment map.
#[derive(Clone, Debug, Default, PartialEq, serde::Serialize)]
pub struct EnvironmentStats {
    pub width: u32,
    pub height: u32,
    /// Bytes of its texels and of the tables that choose among them; part of the scene's rows on a GPU.
    pub bytes: usize,
    /// Chance that direct light asks it and not a lamp: by power, 0.25 to 0.75, 1 without lamps.
    pub share: f32,
}

impl EnvironmentStats {
    pub(super) fn new(scene: &CompiledScene) -> Option<EnvironmentStats> {
        scene.sky.as_ref().map(|sky| EnvironmentStats {
            width: sky.width,
            height: sky.height,
            bytes: sky.bytes(),
            share: sky.share,
        })
    }
}

/// Figures about the hierarchy over the shapes.
#[derive(Clone, Debug, Default, PartialEq, serde::Serialize)]
pub struct HierarchyStats {
    /// Shapes in it.
    pub shapes: usize,
    /// Of these, triangles of meshes, those of each instance counted.
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
            triangles: scene.triangle_count(),
            nodes: bvh.rows.len() / NODE_ROWS,
            bytes: size_of_val(&bvh.rows[..]),
            depth: bvh.depth,
            build_seconds: bvh.seconds,
        })
    }
}

/// Figures about meshes that are stored once for many instances.
#[derive(Clone, Debug, Default, PartialEq, serde::Serialize)]
pub struct InstanceStats {
    /// Instances, and the meshes that they share.
    pub instances: usize,
    pub meshes: usize,
    /// Triangles of these meshes,
    pub stored_triangles: usize,
    /// … and of the instances, each counted.
    pub seen_triangles: usize,
    /// Bytes of instances and meshes, with nodes, normals and texture coordinates,
    pub bytes: u64,
    /// … and what they would take if each instance had triangles of its own.
    pub laid_out_bytes: u64,
}

impl InstanceStats {
    pub fn new(scene: &CompiledScene) -> Option<InstanceStats> {
        let shared = &scene.shared;
        let [bytes, laid_out_bytes] = shared_bytes(scene);
        (!shared.instances.is_empty()).then_some(InstanceStats {
            instances: shared.instances.len(),
            meshes: shared.meshes,
            stored_triangles: shared.triangles.len(),
            seen_triangles: shared.seen,
            bytes,
            laid_out_bytes,
        })
    }
}

/// Figures about what surfaces have besides where they are.
#[derive(Clone, Debug, Default, PartialEq, serde::Serialize)]
pub struct SurfaceStats {
    /// Bytes of the normals at the corners of triangles.
    pub normal_bytes: usize,
    /// … and of the texture coordinates.
    pub uv_bytes: usize,
    /// Textures in use, and bytes of their texels.
    pub textures: usize,
    pub texture_bytes: usize,
}

impl SurfaceStats {
    pub fn new(scene: &CompiledScene) -> Option<SurfaceStats> {
        let surfaces = &scene.surfaces;
        surfaces.changes_triangles().then(|| SurfaceStats {
            normal_bytes: size_of_val(&surfaces.normals[..]),
            uv_bytes: size_of_val(&surfaces.uvs[..]),
            textures: surfaces.taken_images,
            texture_bytes: size_of_val(&surfaces.texels[..]),
        })
    }
}

/// Figures about the tree over the lights.
#[derive(Clone, Debug, Default, PartialEq, serde::Serialize)]
pub struct LightTreeStats {
    /// Lights in it.
    pub lights: usize,
    /// Lights and nodes over them.
    pub clusters: usize,
    /// Bytes of all clusters.
    pub bytes: usize,
    /// Seconds that it took to build.
    pub build_seconds: f64,
}

impl LightTreeStats {
    pub(super) fn new(scene: &CompiledScene) -> Option<LightTreeStats> {
        scene.light_tree.as_ref().map(|tree| LightTreeStats {
            lights: scene.lights.len(),
            clusters: tree.clusters.len(),
            bytes: size_of_val(&tree.clusters[..]),
            build_seconds: tree.seconds,
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
