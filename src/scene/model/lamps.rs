//! Lights without a surface, as KHR_lights_punctual has them, become small shapes: a renderer that follows paths meets nothing
//! else. Each shines as strongly as the light does, seen from farther away than its own size.

use std::f64::consts::PI;

use glam::DVec3;

use super::{Lamp, LampKind};
use crate::scene::{Geometry, Material};

/// Radius of lamps, as a share of the diagonal of the box around the model.
pub(super) const RADIUS: f64 = 1.0 / 512.0;
/// Distance of suns, in diagonals: their direction differs by half a thousandth from one end of the model to the other.
pub(super) const DISTANCE: f64 = 1000.0;
/// Half the angle at which the sun is seen from the Earth, 0.2666°.
pub(super) const SUN_HALF_ANGLE: f64 = 0.2666 / 180.0 * PI;
/// Beyond it squares would overflow an f32.
const FARTHEST: f64 = 4e8;

impl Lamp {
    /// The shape and its black, shining material, for a model within a box of that middle and diagonal.
    ///
    /// A sphere of radius r and radiance L has intensity L·π·r² in every direction; a square of area A has L·A straight ahead,
    /// less beside (by the cosine) and nothing behind; a disc of half-angle a lights what faces it with L·π·sin²a.
    pub fn shape(&self, middle: DVec3, diagonal: f64) -> (Geometry, Material) {
        let radius = RADIUS * diagonal;
        let area = PI * radius * radius;
        let (geometry, radiance) = match self.kind {
            LampKind::Point => (sphere(self.position, radius), self.strength / area),
            LampKind::Spot => (self.square(area.sqrt()), self.strength / area),
            LampKind::Sun => {
                let distance = (DISTANCE * diagonal).min(FARTHEST);
                let sine = SUN_HALF_ANGLE.sin();
                let center = middle - self.direction * distance;
                (sphere(center, distance * sine), self.strength / (PI * sine * sine))
            }
        };
        (geometry, Material { name: self.name.clone(), ..Material::diffuse([0.0; 3]).emitting(radiance) })
    }

    /// About the lamp's place, its outer side where it shines.
    fn square(&self, side: f64) -> Geometry {
        let e1 = self.direction.any_orthonormal_vector() * side;
        let e2 = self.direction.cross(e1);
        Geometry::Quad { corner: self.position - 0.5 * (e1 + e2), e1, e2 }
    }
}

fn sphere(center: DVec3, radius: f64) -> Geometry {
    Geometry::Sphere { center, radius, inward: false }
}
