//! Where a mesh stands: scaled about its own origin, turned, then moved.

use glam::{DAffine3, DMat3, DVec3};

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

impl Placement {
    /// The same as a matrix.
    pub(in crate::scene) fn transform(&self) -> DAffine3 {
        let (sin, cos) = sin_cos_deg(self.rotate_y_deg);
        let turn = DMat3::from_cols(DVec3::new(cos, 0.0, -sin), DVec3::Y, DVec3::new(sin, 0.0, cos));
        DAffine3 { matrix3: turn * self.scale, translation: self.translate }
    }
}

impl MeshData {
    /// The mesh under any affine map. One that mirrors turns triangles around, so that their outer sides stay outside; normals
    /// stay at right angles to surfaces (they go by the cofactors) and outside too.
    #[must_use]
    pub(in crate::scene) fn transformed(&self, map: &DAffine3) -> MeshData {
        if *map == DAffine3::IDENTITY {
            return self.clone();
        }
        let [x, y, z] = [map.matrix3.x_axis, map.matrix3.y_axis, map.matrix3.z_axis];
        let mirrors = x.cross(y).dot(z) < 0.0;
        let side = if mirrors { -1.0 } else { 1.0 };
        let cofactors = DMat3::from_cols(y.cross(z), z.cross(x), x.cross(y)) * side;
        let turned = |&[a, b, c]: &[u32; 3]| if mirrors { [a, c, b] } else { [a, b, c] };
        MeshData {
            positions: self.positions.iter().map(|&p| map.transform_point3(p)).collect(),
            normals: self.normals.iter().map(|&n| cofactors * n).collect(),
            uvs: self.uvs.clone(),
            triangles: self.triangles.iter().map(turned).collect(),
        }
    }

    /// The mesh, placed so.
    #[must_use]
    pub fn placed(self, placement: &Placement) -> MeshData {
        match *placement == Placement::default() {
            true => self,
            false => self.transformed(&placement.transform()),
        }
    }
}
