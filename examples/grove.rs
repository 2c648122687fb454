//! A grove of so many trees of about so many triangles each, as large as you like: one mesh and a scene that places it many
//! times. The same numbers give the same bytes on every machine: all is made of whole numbers and of sums, products, quotients
//! and roots, which round alike everywhere. A thousand trees of 100,000 triangles are a file of 4 MB, and 11 MiB on a GPU.
//!
//! `cargo run --release --example grove -- 100000 1000 target/grove`
//! `cargo run --release -- render target/grove/grove.toml`

use std::fmt::Write as _;
use std::io::{BufWriter, Write};
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::{env, error, fs};

/// Corners around the trunk, and pieces of it from the ground up.
const SIDES: u32 = 6;
const PIECES: u32 = 8;
/// Triangles of the trunk.
const TRUNK: u32 = 2 * SIDES * PIECES;
/// Middle and half the size of the crown.
const CROWN: [[f32; 3]; 2] = [[0.0, 2.6, 0.0], [1.0, 1.3, 1.0]];
/// Distance between trees.
const SPACING: f32 = 2.4;

/// A number in 0..1 that belongs to a thing and to one of its properties (by the finaliser of MurmurHash3).
fn number(thing: u32, property: u32) -> f32 {
    let mut h = thing.wrapping_mul(0x9e37_79b1) ^ property.wrapping_mul(0x85eb_ca77);
    h = (h ^ h >> 16).wrapping_mul(0x85eb_ca6b);
    h = (h ^ h >> 13).wrapping_mul(0xc2b2_ae35);
    ((h ^ h >> 16) >> 8) as f32 / (1 << 24) as f32
}

/// A point of the unit ball: the first that lies within of those that belong to the thing.
fn in_ball(thing: u32, property: u32) -> [f32; 3] {
    let point = |attempt: u32| [0, 1, 2].map(|axis| 2.0 * number(thing, property + 3 * attempt + axis) - 1.0);
    (0..100).map(point).find(|[x, y, z]| x * x + y * y + z * z <= 1.0).unwrap_or([0.0; 3])
}

fn scaled(v: [f32; 3], length: f32) -> [f32; 3] {
    let [x, y, z] = v;
    let own = (x * x + y * y + z * z).sqrt().max(1e-3);
    v.map(|x| x / own * length)
}

/// Corners and triangles.
#[derive(Default)]
struct Mesh {
    positions: Vec<[f32; 3]>,
    triangles: Vec<[u32; 3]>,
}

/// A trunk, six-sided and crooked, and as many leaves of two triangles as it takes.
fn tree(triangles: u32) -> Mesh {
    let mut mesh = Mesh::default();
    // Half the height of a triangle of equal sides.
    let half = 0.866_025_4;
    let around = [[1.0, 0.0], [0.5, half], [-0.5, half], [-1.0, 0.0], [-0.5, -half], [0.5, -half]];
    for piece in 0..=PIECES {
        let up = piece as f32 / PIECES as f32;
        let (radius, bend) = (0.12 * (1.0 - 0.8 * up), 0.2 * (number(piece, 7) - 0.5) * up);
        mesh.positions.extend(around.map(|[x, z]| [x * radius + bend, 3.2 * up, z * radius]));
    }
    for piece in 0..PIECES {
        for side in 0..SIDES {
            let [a, b] = [side, (side + 1) % SIDES].map(|side| piece * SIDES + side);
            mesh.triangles.extend([[a, a + SIDES, b], [b, a + SIDES, b + SIDES]]);
        }
    }
    let leaves = triangles.saturating_sub(TRUNK).div_ceil(2);
    // Together they cover the crown some times over, however many they are.
    let size = 3.0 / (leaves as f32).sqrt();
    for leaf in 0..leaves {
        let [middle, half] = CROWN;
        let place = in_ball(leaf, 1000);
        let place = [0, 1, 2].map(|axis| middle[axis] + half[axis] * place[axis]);
        let (along, across) = (scaled(in_ball(leaf, 2000), size), scaled(in_ball(leaf, 3000), 0.5 * size));
        let at = |s: f32, t: f32| [0, 1, 2].map(|axis| place[axis] + s * along[axis] + t * across[axis]);
        let first = mesh.positions.len() as u32;
        mesh.positions.extend([at(0.0, 0.0), at(0.5, 0.5), at(0.5, -0.5), at(1.0, 0.0)]);
        mesh.triangles.extend([[first, first + 1, first + 2], [first + 1, first + 3, first + 2]]);
    }
    mesh
}

/// As a binary PLY file.
fn write_mesh(path: &Path, mesh: &Mesh) -> std::io::Result<()> {
    let mut out = BufWriter::new(fs::File::create(path)?);
    write!(
        out,
        "ply\nformat binary_little_endian 1.0\ncomment made by examples/grove.rs\n\
        element vertex {}\nproperty float x\nproperty float y\nproperty float z\n\
        element face {}\nproperty list uchar int vertex_indices\nend_header\n",
        mesh.positions.len(),
        mesh.triangles.len()
    )?;
    for coordinate in mesh.positions.iter().flatten() {
        out.write_all(&coordinate.to_le_bytes())?;
    }
    for triangle in &mesh.triangles {
        out.write_all(&[3])?;
        for corner in triangle {
            out.write_all(&corner.to_le_bytes())?;
        }
    }
    out.flush()
}

/// The trees stand in rows, each a little beside its place, turned and scaled.
fn scene(triangles: usize, trees: u32) -> String {
    let row = f64::from(trees).sqrt().ceil() as u32;
    let half = SPACING * row as f32 / 2.0;
    let mut text = format!(
        r#"# {trees} trees of {triangles} triangles each under a low sun and a blue sky, made by examples/grove.rs.
# A right render shows trees of three colours, all alike but turned and scaled, with their shadows on the ground.
name = "grove"
description = "{trees} instances of a tree of {triangles} triangles, a distant lamp for a sun, a uniform sky"

[environment]
radiance = [0.25, 0.4, 0.7]

[camera]
origin = [0, {}, {}]
target = [0, 0, 0]
fov_y_deg = 42
width = 640
height = 480

[materials.ground]
type = "diffuse"
color = [0.4, 0.34, 0.24]

[materials.spring]
type = "diffuse"
color = [0.3, 0.5, 0.12]

[materials.summer]
type = "diffuse"
color = [0.14, 0.34, 0.1]

[materials.autumn]
type = "diffuse"
color = [0.6, 0.3, 0.08]

[materials.sun]
type = "diffuse"
color = [0, 0, 0]
emission = [560, 490, 390]

[[shapes]]
type = "quad"
corner = [{}, 0, {}]
e1 = [0, 0, {}]
e2 = [{}, 0, 0]
material = "ground"

[[shapes]]
type = "sphere"
center = [{}, {}, {half}]
radius = {}
material = "sun"
"#,
        0.6 * half + 4.0,
        1.2 * half + 6.0,
        -2.0 * half,
        -2.0 * half,
        4.0 * half,
        4.0 * half,
        -6.0 * half,
        4.0 * half,
        0.4 * half,
    );
    for tree in 0..trees {
        let [x, z] = [(tree % row, 11), (tree / row, 12)]
            .map(|(place, property)| (place as f32 + 0.2 + 0.6 * number(tree, property)) * SPACING - half);
        let material = ["spring", "summer", "autumn"][(3.0 * number(tree, 13)) as usize];
        let (scale, turn) = (0.7 + 0.6 * number(tree, 14), 360.0 * number(tree, 15));
        let _ = write!(
            text,
            "\n[[shapes]]\ntype = \"mesh\"\nfile = \"tree.ply\"\nmaterial = \"{material}\"\nscale = {scale}\n\
             rotate_y_deg = {turn}\ntranslate = [{x}, 0, {z}]\n"
        );
    }
    text
}

fn write(folder: &Path, triangles: u32, trees: u32) -> Result<(PathBuf, usize), Box<dyn error::Error>> {
    fs::create_dir_all(folder)?;
    let mesh = tree(triangles);
    write_mesh(&folder.join("tree.ply"), &mesh)?;
    let path = folder.join("grove.toml");
    fs::write(&path, scene(mesh.triangles.len(), trees))?;
    Ok((path, mesh.triangles.len()))
}

/// Makes what the arguments say; what it made, or what is wrong and the remedy.
fn make(mut arguments: impl Iterator<Item = String>) -> Result<String, String> {
    let mut count = |name: &str, range: std::ops::RangeInclusive<u32>| {
        let given = arguments.next().unwrap_or_default();
        given.parse().ok().filter(|count| range.contains(count)).ok_or_else(|| {
            let (least, most) = range.into_inner();
            format!(
                "{name} is \"{given}\"; give a number from {least} to {most}: grove TRIANGLES TREES [FOLDER]"
            )
        })
    };
    let (triangles, trees) = (count("TRIANGLES", TRUNK + 2..=100_000_000)?, count("TREES", 1..=250_000)?);
    let folder = arguments.next().map_or_else(|| PathBuf::from("target/grove"), PathBuf::from);
    let (path, each) = write(&folder, triangles, trees)
        .map_err(|e| format!("cannot write into \"{}\": {e}; choose another folder", folder.display()))?;
    Ok(format!("{}: {trees} trees of {each} triangles, {}", path.display(), u64::from(trees) * each as u64))
}

fn main() -> ExitCode {
    match make(env::args().skip(1)) {
        Ok(made) => {
            println!("{made}");
            ExitCode::SUCCESS
        }
        Err(problem) => {
            eprintln!("error: {problem}");
            ExitCode::from(2)
        }
    }
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
        let (path, each) = write(folder.path(), 1000, 40).unwrap();
        let scene = Scene::load(&path).unwrap();
        let shared = scene.shapes.iter().filter(|shape| matches!(shape.geometry, Geometry::Instance(_)));
        assert_eq!((shared.count(), each, scene.triangle_count()), (40, 1000, 40_000));
        assert!(scene.warnings().is_empty(), "{:?}", scene.warnings());
        let [mesh, text] =
            ["tree.ply", "grove.toml"].map(|name| fingerprint(&fs::read(folder.path().join(name)).unwrap()));
        assert_eq!(
            [mesh, text],
            [0x36f8_2b82_afb0_c240, 0xdac7_3aee_b7e3_4d40],
            "other bytes than elsewhere: {mesh:#x} {text:#x}"
        );
    }
}
