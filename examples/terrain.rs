//! Mountains of about so many triangles, as large as you like: a scene with its mesh, to be rendered like any other. The same
//! number gives the same bytes on every machine: heights are made of whole numbers and of sums and products that all round
//! alike. A million triangles take 18 MB, which is why they are made and not kept.
//!
//! `cargo run --release --example terrain -- 1000000 target/terrain`
//! `cargo run --release -- render target/terrain/terrain.toml`

use std::io::{BufWriter, Write};
use std::path::{Path, PathBuf};
use std::{env, error, fs};

/// Edge of the terrain.
const SIZE: f32 = 20.0;
/// Height of the largest mountains, as a share of what noise goes through.
const HEIGHT: f32 = 2.2;
/// Waves across the terrain in the first octave; each octave after it has twice as many, half as high.
const WAVES: f32 = 3.0;
const OCTAVES: u32 = 9;

/// A number in -1..1 that belongs to a point with whole coordinates (by the finaliser of MurmurHash3).
fn at_point(x: i32, z: i32, octave: u32) -> f32 {
    let mut h = (x as u32).wrapping_mul(0x9e37_79b1) ^ (z as u32).wrapping_mul(0x85eb_ca77) ^ (octave << 27);
    h = (h ^ h >> 16).wrapping_mul(0x85eb_ca6b);
    h = (h ^ h >> 13).wrapping_mul(0xc2b2_ae35);
    ((h ^ h >> 16) >> 8) as f32 / (1 << 23) as f32 - 1.0
}

/// Smooth noise: the numbers of the points around, blended without a kink.
fn noise(x: f32, z: f32, octave: u32) -> f32 {
    let (x0, z0) = (x.floor(), z.floor());
    let blend = |t: f32| t * t * t * (t * (t * 6.0 - 15.0) + 10.0);
    let (u, v) = (blend(x - x0), blend(z - z0));
    let point = |dx, dz| at_point(x0 as i32 + dx, z0 as i32 + dz, octave);
    let near = point(0, 0) + (point(1, 0) - point(0, 0)) * u;
    let far = point(0, 1) + (point(1, 1) - point(0, 1)) * u;
    near + (far - near) * v
}

/// Height of the ground, from ridges: noise folded at zero.
fn height(x: f32, z: f32) -> f32 {
    let (mut sum, mut size, mut waves, mut above) = (0.0, 0.5, WAVES / SIZE, 1.0);
    for octave in 0..OCTAVES {
        let ridge = 1.0 - noise(x * waves, z * waves, octave).abs();
        let ridge = ridge * ridge * above;
        sum += ridge * size;
        // Valleys stay smooth: detail grows where it is high.
        above = ridge.min(1.0);
        (size, waves) = (size * 0.5, waves * 2.0);
    }
    sum * HEIGHT
}

/// A binary PLY file of a square of `side` × `side` cells, two triangles each.
fn write_mesh(path: &Path, side: u32) -> std::io::Result<()> {
    let mut out = BufWriter::new(fs::File::create(path)?);
    let points = side + 1;
    write!(
        out,
        "ply\nformat binary_little_endian 1.0\ncomment made by examples/terrain.rs\n\
        element vertex {}\nproperty float x\nproperty float y\nproperty float z\n\
        element face {}\nproperty list uchar int vertex_indices\nend_header\n",
        u64::from(points) * u64::from(points),
        2 * u64::from(side) * u64::from(side)
    )?;
    for j in 0..points {
        for i in 0..points {
            let [x, z] = [i, j].map(|k| (k as f32 / side as f32 - 0.5) * SIZE);
            for coordinate in [x, height(x, z), z] {
                out.write_all(&coordinate.to_le_bytes())?;
            }
        }
    }
    for j in 0..side {
        for i in 0..side {
            let [a, b, c, d] = [(i, j), (i, j + 1), (i + 1, j + 1), (i + 1, j)].map(|(i, j)| j * points + i);
            for corners in [[a, b, c], [a, c, d]] {
                out.write_all(&[3])?;
                for corner in corners {
                    out.write_all(&corner.to_le_bytes())?;
                }
            }
        }
    }
    out.flush()
}

fn scene(triangles: u64) -> String {
    format!(
        r#"# Mountains of {triangles} triangles under a low sun and a blue sky, made by examples/terrain.rs.
# A right render shows ridges with sharp, dark sides away from the sun, blue in their shadow, and no holes.
name = "terrain"
description = "{triangles} triangles of mountains, a distant lamp for a sun, a uniform sky"

[environment]
radiance = [0.25, 0.4, 0.7]

[camera]
origin = [0, 5.5, 10.5]
target = [0, 0.9, 0]
fov_y_deg = 42
width = 640
height = 480

[materials.rock]
type = "diffuse"
color = [0.5, 0.44, 0.38]

[materials.sun]
type = "diffuse"
color = [0, 0, 0]
emission = [560, 490, 390]

[[shapes]]
type = "mesh"
file = "terrain.ply"
material = "rock"

[[shapes]]
type = "sphere"
center = [-60, 40, 10]
radius = 4
material = "sun"
"#
    )
}

fn main() -> Result<(), Box<dyn error::Error>> {
    let usage = "usage: terrain TRIANGLES [FOLDER]; from 2 to a billion triangles";
    let mut arguments = env::args().skip(1);
    let wanted: u64 = arguments.next().and_then(|n| n.parse().ok()).ok_or(usage)?;
    if !(2..=1_000_000_000).contains(&wanted) {
        return Err(usage.into());
    }
    let folder = arguments.next().map_or_else(|| PathBuf::from("target/terrain"), PathBuf::from);
    let side = ((wanted as f64 / 2.0).sqrt().round() as u32).max(1);
    let triangles = 2 * u64::from(side) * u64::from(side);
    fs::create_dir_all(&folder)?;
    write_mesh(&folder.join("terrain.ply"), side)?;
    let path = folder.join("terrain.toml");
    fs::write(&path, scene(triangles))?;
    println!("{}: {triangles} triangles", path.display());
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use qtracer::Scene;
    use qtracer::scene::Geometry;

    /// FNV-1a.
    fn fingerprint(bytes: &[u8]) -> u64 {
        bytes
            .iter()
            .fold(0xcbf2_9ce4_8422_2325, |h, &b| (h ^ u64::from(b)).wrapping_mul(0x0000_0100_0000_01b3))
    }

    #[test]
    fn what_is_made_is_a_scene_and_the_same_everywhere() {
        let folder = tempfile::tempdir().unwrap();
        let [mesh, path] = ["terrain.ply", "terrain.toml"].map(|name| folder.path().join(name));
        write_mesh(&mesh, 10).unwrap();
        fs::write(&path, scene(200)).unwrap();
        let scene = Scene::load(&path).unwrap();
        let meshes = scene.shapes.iter().filter_map(|shape| match &shape.geometry {
            Geometry::Mesh(mesh) => Some(mesh.len()),
            _ => None,
        });
        assert_eq!(meshes.collect::<Vec<_>>(), [200]);
        assert!(scene.warnings().is_empty());
        assert_eq!(
            fingerprint(&fs::read(&mesh).unwrap()),
            0xce5f_ef2b_d94c_6e1e,
            "other bytes than elsewhere"
        );
    }
}
