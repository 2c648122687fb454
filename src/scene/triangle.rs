//! Triangles, met without gaps (Woop, Benthin, Wald 2013): the ray is turned and sheared onto an axis, and edges are tested on
//! the corners that triangles share. Beside an edge, one of its two triangles is met; on it, either. GPU twin:
//! kernels/scene/triangle.wesl

use glam::{Vec2, Vec3, Vec3Swizzles};

/// How a ray looks onto triangles: the axis that it goes along most, and what shears it onto that axis.
#[derive(Clone, Copy, Debug)]
pub struct RayShear {
    axis: u32,
    shear: Vec3,
}

/// The components in the order around, with that of `axis` last.
#[inline(always)]
fn turned(v: Vec3, axis: u32) -> Vec3 {
    match axis {
        0 => v.yzx(),
        1 => v.zxy(),
        _ => v,
    }
}

#[inline(always)]
pub fn ray_shear(direction: Vec3) -> RayShear {
    let size = direction.abs();
    let axis = if size.x >= size.y.max(size.z) { 0 } else { 2 - u32::from(size.y >= size.z) };
    let d = turned(direction, axis);
    RayShear { axis, shear: (d.xy() / d.z).extend(1.0 / d.z) }
}

/// A corner as the ray sees it: where beside the ray, and how far along.
#[inline(always)]
fn sheared(corner: Vec3, view: &RayShear) -> Vec3 {
    let v = turned(corner, view.axis);
    (v.xy() - view.shear.xy() * v.z).extend(view.shear.z * v.z)
}

/// On which side of the edge from p to q the ray passes. Products round monotonously, so the sign is right or 0.
#[inline(always)]
fn edge(p: Vec3, q: Vec3) -> f32 {
    p.x * q.y - p.y * q.x
}

/// Distance along the ray to the triangle with corners a, b, c; not above 0 if it is not met.
#[inline(always)]
pub fn intersect_triangle(origin: Vec3, view: &RayShear, a: Vec3, b: Vec3, c: Vec3) -> f32 {
    let [from_a, from_b, from_c] = [a, b, c].map(|corner| sheared(corner - origin, view));
    let (u, v, w) = (edge(from_c, from_b), edge(from_a, from_c), edge(from_b, from_a));
    let inside = u.min(v.min(w)) >= 0.0 || u.max(v.max(w)) <= 0.0;
    let sum = u + v + w;
    if !inside || sum == 0.0 {
        return 0.0;
    }
    let t = (u * from_a.z + v * from_b.z + w * from_c.z) / sum;
    let reach = from_a.abs().max(from_b.abs().max(from_c.abs()));
    if t > distance_error(reach, sum) { t } else { 0.0 }
}

/// What rounding makes of a distance: little, but for slivers, which a ray that starts on them must not meet. `reach` bounds
/// the sheared corners.
#[inline(always)]
fn distance_error(reach: Vec3, sum: f32) -> f32 {
    let beside = reach.x.max(reach.y);
    ROUNDING * reach.z * beside * (beside + reach.z) / sum.abs()
}

/// Half the distance of 1 from the next number.
const ROUNDING: f32 = f32::EPSILON / 2.0;

/// Normal times twice the area, on the side from which a, b, c go counterclockwise.
#[inline(always)]
pub fn double_area(a: Vec3, b: Vec3, c: Vec3) -> Vec3 {
    (b - a).cross(c - a)
}

/// Squares of areas that stand for zero: no division by it overflows.
pub const SMALLEST_SQUARE: f32 = 1e-37;

/// The point of the triangle next to `p`, which lies about in its plane and within: between the corners whatever is rounded.
#[inline(always)]
pub fn onto_triangle(p: Vec3, a: Vec3, b: Vec3, c: Vec3) -> Vec3 {
    let (from_a, e1, e2) = (p - a, b - a, c - a);
    let n = e1.cross(e2);
    let square = n.dot(n).max(SMALLEST_SQUARE);
    let s = (from_a.cross(e2).dot(n) / square).clamp(0.0, 1.0);
    let t = (e1.cross(from_a).dot(n) / square).clamp(0.0, 1.0 - s);
    a + e1 * s + e2 * t
}

/// A point of the triangle, uniform over its area, that goes from corner to corner with `u` (Heitz 2019).
#[inline(always)]
pub fn sample_triangle(u: Vec2, a: Vec3, b: Vec3, c: Vec3) -> Vec3 {
    let half = u * 0.5;
    let (s, t) = if u.y > u.x { (half.x, u.y - half.x) } else { (u.x - half.y, half.y) };
    a + (b - a) * s + (c - a) * t
}
