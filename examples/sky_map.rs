//! Makes the skies of scenes/maps: `cargo run --release --example sky_map -- scenes/maps/afternoon.hdr 256`, and coarse.hdr
//! with 64.
//!
//! A made-up clear sky, for a map whose origin is known: blue that pales towards the horizon, haze and a glow about the sun,
//! ground of albedo 0.2 below. The sun is spread over a few texels, and brings five times what the rest of the sky brings
//! to the ground, as on a clear afternoon. The number is that of columns, twice that of rows. Radiance format.

use glam::{DVec3, dvec3};
use image::codecs::hdr::HdrEncoder;
use image::{ExtendedColorType, ImageEncoder};
use std::error::Error;
use std::f64::consts::PI;
use std::fs::File;
use std::io::BufWriter;

/// Where the sun is: 35° high, in the direction of +x.
const SUN_HEIGHT: f64 = 35.0;
/// Its standard deviation, in texels.
const SUN_WIDTH: f64 = 0.8;

/// The direction of a texel's centre, as src/scene/environment says: the middle of the picture is +z.
fn direction(column: usize, row: usize, width: usize) -> DVec3 {
    let longitude = 2.0 * PI * (column as f64 + 0.5) / width as f64;
    let colatitude = 2.0 * PI * (row as f64 + 0.5) / width as f64;
    let sine = colatitude.sin();
    dvec3(sine * longitude.sin(), colatitude.cos(), -sine * longitude.cos())
}

/// The sky without its sun.
fn sky(d: DVec3, sun: DVec3) -> DVec3 {
    if d.y < 0.0 {
        return dvec3(0.26, 0.24, 0.2);
    }
    // How much air lies in that direction, in zenith heights.
    let air = 1.0 / (d.y + 0.08);
    let haze = 1.0 - (-0.12 * air).exp();
    let blue = dvec3(0.16, 0.34, 0.82).lerp(dvec3(0.85, 0.95, 1.05), haze);
    let near = d.dot(sun).clamp(-1.0, 1.0).acos();
    let glow = 1.6 * (-near / 0.18).exp() + 0.35 * (-near / 0.7).exp();
    blue + dvec3(1.0, 0.86, 0.65) * glow
}

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [path, width] = arguments.as_slice() else {
        return Err("usage: sky_map OUTPUT.hdr COLUMNS".into());
    };
    let width: usize = width.parse()?;
    let texel = 2.0 * PI / width as f64;
    let (sin, cos) = SUN_HEIGHT.to_radians().sin_cos();
    let sun = dvec3(cos, sin, 0.0);
    let bump = |d: DVec3| (-(d - sun).length_squared() / (2.0 * (SUN_WIDTH * texel).powi(2))).exp();
    let directions =
        || (0..width / 2).flat_map(|row| (0..width).map(move |column| direction(column, row, width)));
    // What reaches level ground, of the sky and of a sun of radiance 1.
    let irradiance = |radiance: &dyn Fn(DVec3) -> f64| -> f64 {
        directions().map(|d| radiance(d) * d.y.max(0.0) * texel * texel * (1.0 - d.y * d.y).sqrt()).sum()
    };
    let brightness = 5.0 * irradiance(&|d| sky(d, sun).y) / irradiance(&bump);
    let radiance =
        |d: DVec3| (sky(d, sun) + dvec3(1.0, 0.9, 0.75) * brightness * bump(d)).as_vec3().to_array();
    let bytes: Vec<u8> = directions().flat_map(radiance).flat_map(f32::to_ne_bytes).collect();
    let out = BufWriter::new(File::create(path)?);
    HdrEncoder::new(out).write_image(&bytes, width as u32, width as u32 / 2, ExtendedColorType::Rgb32F)?;
    println!("{path}: a sun of radiance {brightness:.0}");
    Ok(())
}
