//! Shading normals: those given at the corners of a triangle, blended; bent by normal maps; and how a viewer gets to see
//! them. The normal of the shape decides what is outside, where rays start and what they may reach. GPU twin:
//! kernels/scene/shading.wesl

use super::compiled::{CompiledScene, KIND_DIFFUSE, NONE};
use super::shapes::Surface;
use super::surfaces::{MaterialMaps, TriangleNormals, TriangleUvs};
use super::texels::texture_bytes;
use super::triangle::SMALLEST_SQUARE;
use crate::math::mirrored;
use glam::{Vec2, Vec3};

/// Largest of the 16-bit numbers of a packed normal.
pub const PACKED_ONE: f32 = 32767.0;
/// Cosine that a shading normal has with that of the shape at least, and a mirror direction too, but half the viewer's where
/// that is less.
pub const LEAST_COSINE: f32 = 0.01;

/// A unit vector on the octahedron unfolded to a square (Meyer et al. 2010), two 16-bit numbers: within 4e-5 of it.
pub fn packed_normal(normal: Vec3) -> u32 {
    let [x, y, z] = (normal / normal.abs().element_sum()).to_array();
    let [x, y] = if z >= 0.0 { [x, y] } else { [(1.0 - y.abs()).copysign(x), (1.0 - x.abs()).copysign(y)] };
    let word = |v: f32| u32::from((v * PACKED_ONE).round() as i16 as u16);
    word(x) | word(y) << 16
}

#[inline]
pub fn unpacked_normal(word: u32) -> Vec3 {
    let [x, y] = [word as i16, (word >> 16) as i16].map(|v| f32::from(v) / PACKED_ONE);
    let z = 1.0 - x.abs() - y.abs();
    let fold = (-z).max(0.0);
    let folded = |v: f32| if v >= 0.0 { v - fold } else { v + fold };
    Vec3::new(folded(x), folded(y), z).normalize()
}

/// Where a point of the triangle lies: the shares of b and c; that of a is the rest.
#[inline]
pub fn triangle_shares(p: Vec3, a: Vec3, b: Vec3, c: Vec3) -> Vec2 {
    let (from_a, e1, e2) = (p - a, b - a, c - a);
    let n = e1.cross(e2);
    let square = n.dot(n).max(SMALLEST_SQUARE);
    let s = (from_a.cross(e2).dot(n) / square).clamp(0.0, 1.0);
    let t = (e1.cross(from_a).dot(n) / square).clamp(0.0, 1.0 - s);
    Vec2::new(s, t)
}

/// The normal between those of the corners, `flat` where the triangle has none.
#[inline]
pub fn smooth_normal(normals: &TriangleNormals, shares: Vec2, flat: Vec3) -> Vec3 {
    if normals.given == 0 {
        return flat;
    }
    let [a, b, c] = [normals.a, normals.b, normals.c].map(unpacked_normal);
    let blended = a * (1.0 - shares.x - shares.y) + b * shares.x + c * shares.y;
    blended / blended.dot(blended).max(SMALLEST_SQUARE).sqrt()
}

#[inline]
pub fn triangle_uv(uvs: &TriangleUvs, shares: Vec2) -> Vec2 {
    let [a, b, c] = [Vec2::new(uvs.u_a, uvs.v_a), Vec2::new(uvs.u_b, uvs.v_b), Vec2::new(uvs.u_c, uvs.v_c)];
    a * (1.0 - shares.x - shares.y) + b * shares.x + c * shares.y
}

/// Which way u grows on the surface and which way v falls, which is up the image: the same all over a triangle. Of any
/// length; zero where the coordinates are those of a line or a point.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Tangents {
    pub u: Vec3,
    pub up: Vec3,
}

#[inline]
pub fn triangle_tangents(uvs: &TriangleUvs, a: Vec3, b: Vec3, c: Vec3) -> Tangents {
    let (e1, e2) = (b - a, c - a);
    let d1 = Vec2::new(uvs.u_b - uvs.u_a, uvs.v_b - uvs.v_a);
    let d2 = Vec2::new(uvs.u_c - uvs.u_a, uvs.v_c - uvs.v_a);
    let turn = d1.x * d2.y - d1.y * d2.x;
    let side = if turn > 0.0 {
        1.0
    } else if turn < 0.0 {
        -1.0
    } else {
        0.0
    };
    Tangents { u: (e1 * d2.y - e2 * d1.y) * side, up: (e1 * d2.x - e2 * d1.x) * side }
}

/// The normal that a normal map puts in place of the surface's shading normal.
#[inline]
pub fn mapped_normal(scene: &CompiledScene, surface: &Surface, maps: &MaterialMaps) -> Vec3 {
    let normal = surface.shading_normal;
    if maps.normal == NONE {
        return normal;
    }
    // 128 is none at all, so that a map which is flat bends nothing.
    let told = (texture_bytes(scene, maps.normal, surface.uv) - 128.0) / 127.0;
    let Tangents { u, up } = surface.tangents;
    let along = u - normal * normal.dot(u);
    let square = along.dot(along);
    if square <= SMALLEST_SQUARE {
        return normal;
    }
    let tangent = along / square.sqrt();
    let across = normal.cross(tangent);
    let upwards = if across.dot(up) >= 0.0 { across } else { -across };
    let bent = (tangent * told.x + upwards * told.y) * maps.normal_scale + normal * told.z;
    let square = bent.dot(bent);
    if square > SMALLEST_SQUARE { bent / square.sqrt() } else { normal }
}

/// Moved towards the shape's normal as far as it takes to be on its side.
#[inline]
fn raised(normal: Vec3, facing: Vec3) -> Vec3 {
    let height = normal.dot(facing);
    if height >= LEAST_COSINE {
        return normal;
    }
    (normal + facing * (LEAST_COSINE - height)).normalize()
}

/// Moved towards the shape's normal as far as it takes for the mirror direction of the viewer to be on its side (Keller et
/// al. 2017, appendix A.3): where the viewer sees the normal from behind, that is the normal of the mirror that shows the
/// horizon. What changes goes to nothing where nothing need be changed.
#[inline]
fn bent_for(normal: Vec3, facing: Vec3, wo: Vec3) -> Vec3 {
    let reflected = mirrored(-wo, normal);
    let height = reflected.dot(facing);
    let least = LEAST_COSINE.min(0.5 * wo.dot(facing));
    if height >= least {
        return normal;
    }
    let lifted = reflected + facing * (least - height);
    let half = wo + lifted / lifted.dot(lifted).max(SMALLEST_SQUARE).sqrt();
    let square = half.dot(half);
    if square > SMALLEST_SQUARE { half / square.sqrt() } else { facing }
}

/// The shading normal for a viewer towards `wo` on the side of `facing`, the shape's normal turned to the viewer. A Lambertian
/// surface does not ask where its viewer is, so its normal is not bent.
#[inline]
pub fn viewed_normal(surface: &Surface, facing: Vec3, outside: bool, wo: Vec3, kind: u32) -> Vec3 {
    let normal = if outside { surface.shading_normal } else { -surface.shading_normal };
    let normal = raised(normal, facing);
    if kind == KIND_DIFFUSE { normal } else { bent_for(normal, facing, wo) }
}

/// Whether a direction is on the same side of the shading normal and of the shape's. Others bring nothing: what the shading
/// normal takes for reflection would go through the surface, and light would leak.
#[inline]
pub fn keeps_side(normal: Vec3, facing: Vec3, wi: Vec3) -> bool {
    (wi.dot(normal) > 0.0) == (wi.dot(facing) > 0.0)
}
