//! Where a mesh stands: scaled about its own origin, turned, then moved.

use glam::DVec3;

use super::MeshData;
use crate::scene::boxes::sin_cos_deg;

/// How a mesh is brought into the scene, in this order.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Placement {
    /// Size in the scene of a length of 1 in the mesh; above 0.
    pub scale: f64,
    /// Turn about the y axis, counterclockwise from above, as for a box.
    pub rotate_y_deg: f64,
    /// Where its origin goes.
    pub translate: DVec3,
}

impl Default for Placement {
    /// Where and as it is.
    fn default() -> Self {
        Self { scale: 1.0, rotate_y_deg: 0.0, translate: DVec3::ZERO }
    }
}

impl MeshData {
    /// The mesh, placed so.
    #[must_use]
    pub fn placed(mut self, placement: &Placement) -> MeshData {
        let (sin, cos) = sin_cos_deg(placement.rotate_y_deg);
        let turned = |v: DVec3| DVec3::new(cos * v.x + sin * v.z, v.y, cos * v.z - sin * v.x);
        if *placement != Placement::default() {
            self.positions.iter_mut().for_each(|p| *p = turned(*p * placement.scale) + placement.translate);
            self.normals.iter_mut().for_each(|n| *n = turned(*n));
        }
        self
    }
}
