//! What is allowed but probably not meant.

use std::fmt;

use super::error::quoted;
use super::{Material, Scene};

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
        }
    }
}

impl Scene {
    /// What is odd about this scene; empty for most.
    pub fn warnings(&self) -> Vec<SceneWarning> {
        let mut warnings = Vec::new();
        if !self.has_light() {
            warnings.push(SceneWarning::NoLight);
        }
        warnings.extend(self.materials.iter().filter_map(albedo_warning));
        warnings
    }

    fn has_light(&self) -> bool {
        let emits = |index: usize| self.materials.get(index).is_some_and(Material::is_emissive);
        self.environment.max_element() > 0.0 || self.shapes.iter().any(|shape| emits(shape.material))
    }
}

fn albedo_warning(material: &Material) -> Option<SceneWarning> {
    let largest = material.kind.color().max_element();
    (largest > 1.0).then(|| SceneWarning::AlbedoAboveOne { material: material.name.clone(), largest })
}
