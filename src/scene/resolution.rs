//! Which shapes are too small, where they are, for rays to start beside them.

use super::Geometry;
use super::shapes::RELATIVE_OFFSET;

/// Below this many spawn offsets a shape is hardly one: its surface is rounded to steps, and what lies on it is jumped over.
const LEAST_OFFSETS: f64 = 10.0;

/// How large a shape is across, and the distance beside it at which rays start.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Resolution {
    pub size: f64,
    pub offset: f64,
}

impl Resolution {
    /// The radius of a sphere, the lesser height of a parallelogram, the longest side of the box around a mesh.
    pub fn of(geometry: &Geometry) -> Resolution {
        let offset = |largest: f64| f64::from(RELATIVE_OFFSET) * largest;
        match *geometry {
            Geometry::Sphere { center, radius, .. } => {
                Resolution { size: radius, offset: offset(center.abs().max_element().max(radius)) }
            }
            Geometry::Quad { corner, e1, e2 } => {
                let corners = [corner, corner + e1, corner + e2, corner + e1 + e2];
                let largest = corners.iter().fold(0.0f64, |most, v| most.max(v.abs().max_element()));
                let height = e1.cross(e2).length() / e1.length().max(e2.length());
                Resolution { size: height, offset: offset(largest) }
            }
            Geometry::Mesh(_) | Geometry::Instance(_) => {
                let [low, high] = geometry.mesh_bounds().unwrap_or_default().map(|corner| corner.as_dvec3());
                let largest = low.abs().max(high.abs()).max_element();
                Resolution { size: (high - low).max_element(), offset: offset(largest) }
            }
        }
    }

    pub fn is_poor(&self) -> bool {
        self.size < LEAST_OFFSETS * self.offset
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DVec3;

    #[test]
    fn shapes_are_too_small_below_ten_offsets() {
        let sphere = |x: f64, radius: f64| {
            Resolution::of(&Geometry::Sphere { center: DVec3::X * x, radius, inward: false }).is_poor()
        };
        // Ten offsets at 1e4 are 0.0954.
        assert!(sphere(1e4, 0.095) && !sphere(1e4, 0.096) && sphere(-1e4, 0.095));
        assert!(!sphere(0.0, 1e-9) && !sphere(0.0, 1e7), "alone at the origin anything is large");
        let quad = |x: f64, e1: DVec3, e2: DVec3| {
            Resolution::of(&Geometry::Quad { corner: DVec3::X * x, e1, e2 }).is_poor()
        };
        assert!(quad(1e4, DVec3::Y, DVec3::Z * 0.095) && !quad(1e4, DVec3::Y, DVec3::Z * 0.096));
        assert!(quad(1e4, DVec3::Y, DVec3::Y + DVec3::Z * 0.095), "a slender one is small across");
    }
}
