//! What is allowed but probably not meant.

use std::collections::HashSet;
use std::fmt;
use std::sync::Arc;

use super::coincidence::coincident;
use super::compiled::LEAST_ALPHA;
use super::error::{counted, quoted};
use super::resolution::Resolution;
use super::validate::shape_label;
use super::{Material, Repairs, Scene, Shape};

/// Pairs of shapes that are compared for a warning: a second at most.
const MOST_PAIRS: usize = 1 << 25;

/// Something odd about a valid scene.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub enum SceneWarning {
    /// Neither the environment nor any shape emits: the image will be black.
    NoLight,
    /// A colour above 1 reflects more than it receives: closed scenes may never converge.
    AlbedoAboveOne {
        /// Its name.
        material: String,
        /// The largest channel.
        largest: f64,
    },
    /// A roughness that is taken for a greater one, since the highlights are narrower than f32 directions can tell.
    Smoothed {
        /// The material's name.
        material: String,
        /// As given.
        roughness: f64,
        /// What it is taken for.
        least: f64,
    },
    /// A lamp coincides with another shape: rounding decides which of the two a ray meets.
    FlushLamp {
        /// The lamp, as errors call it.
        lamp: String,
        /// The shape in whose surface it lies.
        other: String,
    },
    /// The environment map had negative radiance, which was taken for black.
    NegativeRadiance {
        /// How many.
        texels: usize,
    },
    /// Triangles that were left out of meshes, and normals and texture coordinates that were replaced.
    MeshRepaired {
        /// The first such mesh, as errors call it.
        mesh: String,
        /// How many of which kind, in all meshes.
        repairs: Repairs,
        /// How many other meshes there are.
        others: usize,
    },
    /// Something in a file of a model that was repaired, left out or chosen.
    InFile {
        /// Its name; empty where it is itself the scene.
        file: String,
        /// Where in it, what was done, and the remedy.
        problem: String,
    },
    /// Shapes are so small, so far from the origin, that rays leave them at a distance that matters.
    BelowResolution {
        /// The worst of them, as errors call it.
        shape: String,
        /// Its radius, or the lesser height of a parallelogram.
        size: f64,
        /// How far beside it rays start.
        offset: f64,
        /// How many others there are.
        others: usize,
    },
}

impl fmt::Display for SceneWarning {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::NoLight => write!(
                f,
                "nothing emits light, so the image will be black; give a material an emission and a shape that uses it, \
                 or the environment a radiance"
            ),
            Self::AlbedoAboveOne { material, largest } => write!(
                f,
                "material {}: a color of {largest} is above 1, so each bounce adds energy; lower it to 1 or less",
                quoted(material)
            ),
            Self::Smoothed { material, roughness, least } => write!(
                f,
                "material {}: a roughness of {roughness} is taken for {least:.3}, below which highlights are too narrow for \
                 32 bits; for perfect smoothness use a mirror or a dielectric",
                quoted(material)
            ),
            Self::FlushLamp { lamp, other } => write!(
                f,
                "{lamp} lies in the surface of {other}, so rounding decides which of the two a ray meets; move the lamp \
                 off it a little, to the side that it lights"
            ),
            Self::MeshRepaired { mesh, repairs, others } => {
                let more = if *others > 0 { format!(" (and {others} more)") } else { String::new() };
                write!(f, "{mesh}{more}: {}; clean the mesh to be rid of this", repairs_made(repairs))
            }
            Self::InFile { file, problem } if file.is_empty() => f.write_str(problem),
            Self::InFile { file, problem } => write!(f, "{file}: {problem}"),
            Self::NegativeRadiance { texels } => write!(
                f,
                "environment: {texels} texels of the map are negative somewhere, which counts as 0; write it without to be \
                 rid of this"
            ),
            Self::BelowResolution { shape, size, offset, others } => {
                let more = if *others > 0 { format!(" (and {others} more)") } else { String::new() };
                write!(
                    f,
                    "{shape}{more} measures only {size:.1e} where rays start {offset:.1e} beside surfaces, so light on \
                     and near it is wrong; move the scene towards the origin"
                )
            }
        }
    }
}

impl Scene {
    /// What is odd about this scene; empty for most.
    pub fn warnings(&self) -> Vec<SceneWarning> {
        let mut warnings = self.file_warnings.clone();
        if !self.has_light() {
            warnings.push(SceneWarning::NoLight);
        }
        let negative = self.environment_map.iter().map(|map| map.negative()).filter(|&texels| texels > 0);
        warnings.extend(negative.map(|texels| SceneWarning::NegativeRadiance { texels }));
        warnings.extend(self.materials.iter().filter_map(albedo_warning));
        warnings.extend(self.materials.iter().filter_map(roughness_warning));
        warnings.extend(self.flush_lamps());
        warnings.extend(self.repaired_meshes());
        warnings.extend(self.below_resolution());
        warnings
    }

    /// One warning for all meshes that have lost triangles.
    fn repaired_meshes(&self) -> Option<SceneWarning> {
        let mut told = HashSet::new();
        let repaired = self.shapes.iter().enumerate().filter_map(|(index, shape)| {
            let mesh = shape.geometry.mesh()?;
            // A mesh that stands in many places is repaired once.
            let new = told.insert(Arc::as_ptr(mesh));
            (new && mesh.repairs() != Repairs::default()).then(|| (index, mesh.repairs()))
        });
        let repaired: Vec<(usize, Repairs)> = repaired.collect();
        let &(first, _) = repaired.first()?;
        let sum = |of: fn(&Repairs) -> usize| repaired.iter().map(|(_, repairs)| of(repairs)).sum();
        let repairs = Repairs {
            degenerate: sum(|repairs| repairs.degenerate),
            duplicate: sum(|repairs| repairs.duplicate),
            normals: sum(|repairs| repairs.normals),
            turned: repaired.iter().any(|(_, repairs)| repairs.turned),
            uvs: sum(|repairs| repairs.uvs),
        };
        let mesh = shape_label(first, self.shapes[first].name.as_deref());
        Some(SceneWarning::MeshRepaired { mesh, repairs, others: repaired.len() - 1 })
    }

    /// One warning for all shapes that are too small where they are.
    fn below_resolution(&self) -> Option<SceneWarning> {
        let resolutions = self.shapes.iter().map(|shape| Resolution::of(&shape.geometry)).enumerate();
        let poor: Vec<_> = resolutions.filter(|(_, resolution)| resolution.is_poor()).collect();
        let ratio = |&(_, Resolution { size, offset }): &(usize, Resolution)| size / offset;
        let worst = poor.iter().min_by(|a, b| ratio(a).total_cmp(&ratio(b)))?;
        let &(index, Resolution { size, offset }) = worst;
        let shape = shape_label(index, self.shapes[index].name.as_deref());
        Some(SceneWarning::BelowResolution { shape, size, offset, others: poor.len() - 1 })
    }

    /// One warning for each lamp that coincides with another shape. Meshes are not looked at, and of very many lamps only the
    /// first: nobody waits for a warning.
    fn flush_lamps(&self) -> Vec<SceneWarning> {
        let emits = |shape: &Shape| self.materials.get(shape.material).is_some_and(Material::is_emissive);
        let label = |index: usize| shape_label(index, self.shapes[index].name.as_deref());
        let is_mesh = |shape: &Shape| shape.geometry.mesh().is_some();
        let plain: Vec<usize> = (0..self.shapes.len()).filter(|&i| !is_mesh(&self.shapes[i])).collect();
        let lamps = plain.iter().copied().filter(|&i| emits(&self.shapes[i]));
        let other = |lamp: usize| {
            let coincides =
                |i: &usize| *i != lamp && coincident(&self.shapes[lamp].geometry, &self.shapes[*i].geometry);
            plain.iter().copied().find(coincides)
        };
        lamps
            .take(MOST_PAIRS / plain.len().max(1))
            .filter_map(|lamp| {
                Some(SceneWarning::FlushLamp { lamp: label(lamp), other: label(other(lamp)?) })
            })
            .collect()
    }

    fn has_light(&self) -> bool {
        let emits = |index: usize| self.materials.get(index).is_some_and(Material::is_emissive);
        let sky = self.environment_map.as_ref().is_none_or(|map| map.brightest() > 0.0);
        sky && self.environment.max_element() > 0.0 || self.shapes.iter().any(|shape| emits(shape.material))
    }
}

fn albedo_warning(material: &Material) -> Option<SceneWarning> {
    let largest = material.kind.color().max_element();
    (largest > 1.0).then(|| SceneWarning::AlbedoAboveOne { material: material.name.clone(), largest })
}

fn roughness_warning(material: &Material) -> Option<SceneWarning> {
    let (roughness, least) = (material.kind.roughness()?, f64::from(LEAST_ALPHA).sqrt());
    let name = || material.name.clone();
    (roughness < least).then(|| SceneWarning::Smoothed { material: name(), roughness, least })
}

/// What was done to a mesh, in words.
fn repairs_made(repairs: &Repairs) -> String {
    let Repairs { degenerate, duplicate, normals, turned, uvs } = *repairs;
    let mut made = Vec::new();
    if degenerate + duplicate > 0 {
        let repeat = if duplicate == 1 { "repeats" } else { "repeat" };
        made.push(format!(
            "left out {} without area and {duplicate} that {repeat} another",
            counted(degenerate, "triangle")
        ));
    }
    if turned {
        made.push("turned all normals around, since most point inwards".to_owned());
    }
    if normals > 0 {
        made.push(format!(
            "took the triangle's own normal at {}, whose normals are zero, no numbers or point inwards",
            counted(normals, "corner")
        ));
    }
    if uvs > 0 {
        made.push(format!("took 0 for {}: no numbers, or beyond 1e6", counted(uvs, "texture coordinate")));
    }
    made.join("; ")
}
