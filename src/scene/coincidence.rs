//! Whether two shapes share a piece of surface, as far as f32 can tell.

use super::Geometry;
use glam::DVec3;

/// Distances below this share of the shapes' coordinates count as none: a few units in the last place of an f32.
const SAME: f64 = 1e-6;

/// Equal spheres, or parallelograms of one plane that overlap by more than an edge.
pub(super) fn coincident(a: &Geometry, b: &Geometry) -> bool {
    match (a, b) {
        (
            Geometry::Sphere { center, radius, .. },
            Geometry::Sphere { center: other, radius: other_radius, .. },
        ) => {
            let size = center.abs().max_element().max(*radius);
            (center - other).length() <= SAME * size && (radius - other_radius).abs() <= SAME * size
        }
        (Geometry::Quad { corner, e1, e2 }, Geometry::Quad { corner: c, e1: f1, e2: f2 }) => {
            quads_overlap(&corners(*corner, *e1, *e2), &corners(*c, *f1, *f2), [*e1, *e2, *f1, *f2])
        }
        _ => false,
    }
}

fn corners(corner: DVec3, e1: DVec3, e2: DVec3) -> [DVec3; 4] {
    [corner, corner + e1, corner + e2, corner + e1 + e2]
}

/// Separating axes: the first's normal must not separate them, and no normal of an edge within the plane may.
fn quads_overlap(a: &[DVec3; 4], b: &[DVec3; 4], edges: [DVec3; 4]) -> bool {
    let size = a.iter().chain(b).fold(0.0f64, |m, v| m.max(v.abs().max_element()));
    let normal = edges[0].cross(edges[1]).normalize_or_zero();
    if b.iter().any(|v| (v - a[0]).dot(normal).abs() > SAME * size) {
        return false;
    }
    edges.iter().all(|edge| {
        let axis = edge.cross(normal).normalize_or_zero();
        let range = |quad: &[DVec3; 4]| {
            quad.iter()
                .map(|v| v.dot(axis))
                .fold((f64::MAX, f64::MIN), |(low, high), x| (low.min(x), high.max(x)))
        };
        let ((a_low, a_high), (b_low, b_high)) = (range(a), range(b));
        a_high.min(b_high) - a_low.max(b_low) > SAME * size
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn quad(corner: [f64; 3], e1: [f64; 3], e2: [f64; 3]) -> Geometry {
        Geometry::Quad { corner: corner.into(), e1: e1.into(), e2: e2.into() }
    }

    #[test]
    fn quads_coincide_if_they_overlap_in_one_plane() {
        let ceiling = quad([0.0, 5.0, 0.0], [5.0, 0.0, 0.0], [0.0, 0.0, 5.0]);
        let flush = quad([2.0, 5.0, 2.0], [1.0, 0.0, 1.0], [-1.0, 0.0, 1.0]);
        let below = quad([2.0, 4.99, 2.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]);
        let beside = quad([5.0, 5.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]);
        let upright = quad([2.0, 5.0, 2.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]);
        assert!(coincident(&ceiling, &flush) && coincident(&flush, &ceiling));
        for apart in [below, beside, upright] {
            assert!(!coincident(&ceiling, &apart) && !coincident(&apart, &ceiling), "{apart:?}");
        }
    }

    #[test]
    fn spheres_coincide_if_they_are_the_same() {
        let sphere =
            |x: f64, radius| Geometry::Sphere { center: DVec3::new(x, 0.0, 0.0), radius, inward: false };
        assert!(coincident(&sphere(1.0, 2.0), &sphere(1.0, 2.0)));
        assert!(!coincident(&sphere(1.0, 2.0), &sphere(1.0, 2.1)));
        assert!(!coincident(&sphere(1.0, 2.0), &sphere(1.1, 2.0)));
    }
}
