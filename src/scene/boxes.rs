//! A box is not a shape of its own: it becomes six quads.

use glam::DVec3;

use super::Geometry;

/// The six sides, outward, of the box `size` about `center`, turned about the y axis (counter-clockwise from above).
/// Sides of size 0 give degenerate quads: check the size first.
pub(super) fn box_quads(center: DVec3, size: DVec3, rotate_y_deg: f64) -> [Geometry; 6] {
    let (sin, cos) = sin_cos_deg(rotate_y_deg);
    let x = DVec3::new(cos, 0.0, -sin) * size.x;
    let y = DVec3::Y * size.y;
    let z = DVec3::new(sin, 0.0, cos) * size.z;
    let low = center - 0.5 * (x + y + z);
    let quad = |corner, e1, e2| Geometry::Quad { corner, e1, e2 };
    [
        quad(low, z, y),     // -x
        quad(low + x, y, z), // +x
        quad(low, x, z),     // -y
        quad(low + y, z, x), // +y
        quad(low, y, x),     // -z
        quad(low + z, x, y), // +z
    ]
}

/// Sine and cosine, exact at multiples of 90°.
pub(super) fn sin_cos_deg(degrees: f64) -> (f64, f64) {
    match degrees.rem_euclid(360.0) {
        0.0 => (0.0, 1.0),
        90.0 => (1.0, 0.0),
        180.0 => (0.0, -1.0),
        270.0 => (-1.0, 0.0),
        other => other.to_radians().sin_cos(),
    }
}
