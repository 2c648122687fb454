//! Directions and frames; a checksum. GPU twin of all but that: kernels/base/vector.wesl

use glam::Vec3;
use std::f32::consts::PI;

/// Two tangents that complete `normal` to a right-handed orthonormal basis (Duff et al. 2017).
#[inline(always)]
pub fn frame_around(normal: Vec3) -> (Vec3, Vec3) {
    let s = if normal.z >= 0.0 { 1.0 } else { -1.0 };
    let a = -1.0 / (s + normal.z);
    let b = normal.x * normal.y * a;
    (
        Vec3::new(1.0 + s * normal.x * normal.x * a, s * b, -s * normal.x),
        Vec3::new(b, s + normal.y * normal.y * a, -normal.y),
    )
}

/// `local`, given in the frame whose third axis is `normal`, in world coordinates.
#[inline(always)]
pub fn to_world(local: Vec3, normal: Vec3) -> Vec3 {
    let (tangent, bitangent) = frame_around(normal);
    tangent * local.x + bitangent * local.y + normal * local.z
}

/// `world`, a direction in world coordinates, in the frame whose third axis is `normal`.
#[inline(always)]
pub fn to_local(world: Vec3, normal: Vec3) -> Vec3 {
    let (tangent, bitangent) = frame_around(normal);
    Vec3::new(world.dot(tangent), world.dot(bitangent), world.dot(normal))
}

/// Mirror image of the direction `d` in the plane with unit normal `n`.
#[inline]
pub fn mirrored(d: Vec3, n: Vec3) -> Vec3 {
    d - n * (2.0 * d.dot(n))
}

/// 1 − cos of the angle between unit vectors, without the cancellation: half the square of their distance.
#[inline]
pub fn one_minus_cos(a: Vec3, b: Vec3) -> f32 {
    let d = a - b;
    0.5 * d.dot(d)
}

/// Luminance of linear sRGB (Rec. 709 primaries).
#[inline]
pub fn luminance(rgb: Vec3) -> f32 {
    rgb.dot(Vec3::new(0.2126, 0.7152, 0.0722))
}

/// The arc whose tangent is `across` / `along`, neither of them negative, to within 3e-7: a polynomial (Abramowitz and Stegun
/// 4.4.49), since WGSL lets drivers be wrong by 4096 roundings. 0 where both are 0.
#[inline(always)]
pub fn acute_angle(across: f32, along: f32) -> f32 {
    let t = across.min(along) / across.max(along).max(1e-30);
    let s = t * t;
    let tail = -0.075_289_64 + s * (0.042_909_614 + s * (-0.016_165_737 + s * 0.002_866_225_7));
    let share =
        1.0 + s * (-0.333_331_45 + s * (0.199_935_51 + s * (-0.142_089 + s * (0.106_562_64 + s * tail))));
    if across > along { 0.5 * PI - t * share } else { t * share }
}

/// The angle of (x, y), −π to π, to within 3e-7.
#[inline(always)]
pub fn angle_of(y: f32, x: f32) -> f32 {
    let acute = acute_angle(y.abs(), x.abs());
    let angle = if x < 0.0 { PI - acute } else { acute };
    if y < 0.0 { -angle } else { angle }
}

/// Weight of the strategy with density `pdf` against one with density `other` (power heuristic, Veach 1997).
/// As a ratio, so that neither square can overflow. `pdf` must be positive.
#[inline]
pub fn mis_weight(pdf: f32, other: f32) -> f32 {
    let ratio = other / pdf;
    1.0 / (1.0 + ratio * ratio)
}

/// FNV-1a over all parts as if they were one: a checksum against damage, not against forgers.
pub fn fnv1a<'a>(parts: impl IntoIterator<Item = &'a [u8]>) -> u64 {
    let bytes = parts.into_iter().flatten();
    bytes.fold(0xcbf2_9ce4_8422_2325, |hash, &byte| (hash ^ u64::from(byte)).wrapping_mul(0x0100_0000_01b3))
}
