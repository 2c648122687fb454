//! What is wrong with textures, coordinates and normals: said, or put right with a warning.

use super::{color_texture, image, square, unseen, white};
use glam::DVec3;
use qtracer::Scene;
use qtracer::scene::{Geometry, Material, MaterialTextures, Mesh, MeshData, Texture, TextureRef};
use std::path::Path;

const HEAD: &str = "name = 's'\n[camera]\norigin = [0, 0, 4]\ntarget = [0, 0, 0]\nfov_y_deg = 40\nwidth = 8\nheight = 8\n\
    [environment]\nradiance = [1, 1, 1]\n[materials.m]\ntype = 'diffuse'\n";
const QUAD: &str =
    "\n[[shapes]]\ntype = 'quad'\ncorner = [0, 0, 0]\ne1 = [1, 0, 0]\ne2 = [0, 1, 0]\nmaterial = 'm'\n";

fn loaded(folder: &Path, material: &str, shapes: &str) -> Result<Scene, String> {
    let path = folder.join("scene.toml");
    std::fs::write(&path, format!("{HEAD}{material}{shapes}")).unwrap();
    Scene::load(path).map_err(|error| error.to_string())
}

/// The header of a PNG file of that size, and nothing behind it.
fn png_header(width: u32, height: u32) -> Vec<u8> {
    let mut header = b"IHDR".to_vec();
    header.extend([width, height].iter().flat_map(|v| v.to_be_bytes()));
    header.extend([8, 6, 0, 0, 0]);
    // CRC-32, bit by bit.
    let mut crc = !0u32;
    for byte in &header {
        crc ^= u32::from(*byte);
        (0..8).for_each(|_| crc = crc >> 1 ^ (0xedb8_8320 & (crc & 1).wrapping_neg()));
    }
    // And an empty piece of what should be the texels.
    let data = b"\0\0\0\0IDAT\x35\xaf\x06\x1e";
    [b"\x89PNG\r\n\x1a\n".as_slice(), &13u32.to_be_bytes(), &header, &(!crc).to_be_bytes(), data].concat()
}

#[test]
fn textures_are_found_in_the_folder_of_the_scene_and_read_once() {
    let folder = tempfile::tempdir().unwrap();
    let inner = folder.path().join("inner");
    std::fs::create_dir(&inner).unwrap();
    let tiles = crate::support::root().join("scenes/textures/tiles.png");
    for path in ["outside.png", "inner/a.PNG", "inner/a.bmp"] {
        std::fs::copy(&tiles, folder.path().join(path)).unwrap();
    }
    let whole = std::fs::read(&tiles).unwrap();
    std::fs::write(inner.join("short.png"), &whole[..whole.len() / 2]).unwrap();
    std::fs::write(inner.join("text.jpg"), "no image at all").unwrap();
    for (name, width, height) in [
        ("wide.png", 16385, 1),
        ("large.png", 16384, 16384),
        ("huge.png", 1 << 30, 1 << 30),
        ("hollow.png", 8192, 8192),
    ] {
        std::fs::write(inner.join(name), png_header(width, height)).unwrap();
    }

    let found = loaded(
        &inner,
        "color_texture = 'a.PNG'\nemission_texture = 'a.PNG'\nnormal_texture = '../inner/a.PNG'\ntexture_wrap = 'mirror'",
        QUAD,
    )
    .unwrap();
    assert_eq!((found.textures.len(), found.textures[0].width, found.textures[0].height), (1, 48, 36));
    let material = &found.materials[0];
    assert_eq!(material.emission, DVec3::ONE, "a texture that shines needs no factor");
    assert_eq!(material.kind.color(), DVec3::ONE);

    for (text, words) in [
        ("color_texture = 'b.png'", "color_texture: file \"b.png\" no such file; check the path"),
        ("color_texture = '../outside.png'", "\"../outside.png\" lies outside the scene's folder"),
        ("color_texture = 'a.bmp'", "has the extension \"bmp\"; textures end in .png or .jpg"),
        ("color_texture = 'short.png'", "\"short.png\" can't be decoded"),
        ("color_texture = 'text.jpg'", "is neither PNG nor JPEG; convert it"),
        ("color_texture = 'wide.png'", "reduce"),
        ("color_texture = 'large.png'", "16384 x 16384: has more than 2^26 texels; reduce the image"),
        ("color_texture = 'huge.png'", "reduce"),
        ("color_texture = 'hollow.png'", "8192 x 8192, more than its 45 bytes can hold"),
        ("color_texture = '.'", "is not a regular file"),
        ("color_texture = 1", "color_texture must be a text in quotes"),
        ("emission_texture = 'a.PNG'", "color is missing"),
        ("color_texture = 'a.PNG'\ntexture_wrap = 'mirrored'", "did you mean \"mirror\"?"),
        ("color_texture = 'a.PNG'\ncolour = 1", "unknown key \"colour\"; did you mean \"color\"?"),
        ("color_texture = 'a.PNG'\nnormal_scale = nan", "normal_scale is not a number"),
        (
            "color_texture = 'a.PNG'\nmetallic_roughness_texture = 'a.PNG'",
            "metallic_roughness_texture is for materials",
        ),
    ] {
        let message = loaded(&inner, text, QUAD).unwrap_err();
        assert!(message.contains(words), "{message}");
        assert!(message.contains("scene.toml:") && message.contains(": material \"m\": "), "{message}");
    }
    let sphere = "\n[[shapes]]\ntype = 'sphere'\ncenter = [0, 0, 0]\nradius = 1\nmaterial = 'm'\n";
    let message = loaded(&inner, "color_texture = 'a.PNG'", sphere).unwrap_err();
    assert!(
        message.contains("shapes[0]: material \"m\" has textures, which spheres can't take; use a mesh"),
        "{message}"
    );
}

#[test]
fn textures_in_code_are_checked() {
    let quad = |texture: Texture, textures: MaterialTextures| {
        let builder = unseen().texture(texture).material("m", white().textured(textures));
        let built = builder.quad([0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], "m").build();
        built.map(|_| ()).map_err(|error| error.to_string())
    };
    assert_eq!(quad(image(1, &[[1; 3]]), color_texture(0)), Ok(()));
    for (texture, textures, words) in [
        (
            image(1, &[[1; 3]]),
            color_texture(1),
            "color_texture has index 1, out of range; there are 1 textures",
        ),
        (
            Texture::new("t", 2, 2, vec![0; 15]),
            color_texture(0),
            "textures[0] \"t\": has 15 bytes of texels; give it 16",
        ),
        (Texture::new("t", 0, 2, vec![]), color_texture(0), "has no texels"),
        (Texture::new("t", 16385, 1, vec![]), color_texture(0), "has a side above 16384"),
    ] {
        let message = quad(texture, textures).unwrap_err();
        assert!(message.contains(words), "{message}");
    }
    let bare = MeshData { uvs: Vec::new(), ..square() };
    let builder = unseen().texture(image(1, &[[1; 3]])).material("m", white().textured(color_texture(0)));
    let message = builder.mesh(bare, "m").build().unwrap_err().to_string();
    assert!(message.contains("has textures, but the mesh no texture coordinates"), "{message}");
    assert!(Texture::from_bytes("t", b"GIF89a").unwrap_err().contains("neither PNG nor JPEG"));
    assert!(Texture::from_bytes("t", &png_header(4, 4)).unwrap_err().contains("can't be decoded"));
    let maps = MaterialTextures { metallic_roughness: Some(TextureRef::new(0)), ..Default::default() };
    assert!(quad(image(1, &[[1; 3]]), maps).unwrap_err().contains("metallic-roughness"));
}

fn mesh_of(data: MeshData) -> (Scene, Vec<String>) {
    let builder = unseen().environment([1.0; 3]).material("m", Material::diffuse([0.5; 3]));
    let scene = builder.mesh(data, "m").build().unwrap();
    let warnings = scene.warnings().iter().map(|warning| warning.to_string()).collect();
    (scene, warnings)
}

fn normals(scene: &Scene) -> Vec<[DVec3; 3]> {
    let Geometry::Mesh(mesh) = &scene.shapes[0].geometry else { panic!("a mesh") };
    let mesh: &Mesh = mesh;
    mesh.normals().map(|corners| corners.map(|normal| normal.as_dvec3())).collect()
}

#[test]
fn normals_and_coordinates_of_no_use_are_replaced_with_a_warning() {
    let tilted = DVec3::new(0.6, 0.0, 0.8);
    let right = MeshData { normals: vec![tilted * 3.0; 4], ..square() };
    let (scene, warnings) = mesh_of(right.clone());
    assert!(warnings.is_empty(), "{warnings:?}");
    assert!(normals(&scene).iter().flatten().all(|normal| normal.distance(tilted) < 1e-6));

    for useless in [DVec3::ZERO, DVec3::NAN, DVec3::new(f64::INFINITY, 0.0, 0.0), -tilted] {
        let mut data = right.clone();
        data.normals[1] = useless;
        let (scene, warnings) = mesh_of(data);
        assert_eq!(warnings.len(), 1, "{useless}");
        assert!(warnings[0].contains("took the triangle's own normal at 1 corner,"), "{warnings:?}");
        assert!(
            normals(&scene)[0][1].distance(DVec3::Z) < 1e-6 && normals(&scene)[0][0].distance(tilted) < 1e-6
        );
    }

    let (scene, warnings) = mesh_of(MeshData { normals: vec![-tilted; 4], ..square() });
    assert_eq!(
        warnings,
        ["shapes[0]: turned all normals around, since most point inwards; clean the mesh to be rid of this"]
    );
    assert!(normals(&scene).iter().flatten().all(|normal| normal.distance(tilted) < 1e-6));

    let mut data = square();
    (data.uvs[0], data.uvs[1], data.uvs[2]) = ([f32::NAN, 0.0], [0.0, f32::INFINITY], [2e6, 0.0]);
    let (_, warnings) = mesh_of(data);
    assert!(warnings[0].contains("took 0 for 3 texture coordinates"), "{warnings:?}");
    let message =
        unseen().material("m", white()).mesh(MeshData { uvs: vec![[0.0; 2]; 3], ..square() }, "m").build();
    assert!(message.unwrap_err().to_string().contains("has 3 texture coordinates for 4 corners"));
}

const PLY: &str = "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\nproperty float nx\n\
    property float ny\nproperty float nz\nproperty float s\nproperty float t\nelement face 1\nproperty list uchar int vertex_indices\n\
    end_header\n0 0 0 0 0 1 0 0\n1 0 0 0.6 0 0.8 1 0.25\n0 1 0 0 0 1 0 1\n3 0 1 2\n";
/// The same, each with numbers of their own; and a triangle beside it that has neither.
const OBJ: &str = "o one\nv 0 0 0\nv 1 0 0\nv 0 1 0\nvn 0 0 1\nvn 0.6 0 0.8\nvt 0 1\nvt 0 0\nvt 1 0.25\nf 1/2/1 2/3/2 3/1/1\n\
    o two\nv 5 0 0\nv 6 0 0\nv 5 1 0\nf 4 5 6\n";

#[test]
fn files_give_normals_and_coordinates_and_may_be_flat() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("a.ply"), PLY).unwrap();
    std::fs::write(folder.path().join("a.obj"), OBJ).unwrap();
    let bare = PLY.replace("property float nx", "property float ox");
    std::fs::write(folder.path().join("bare.ply"), bare).unwrap();
    let load = |rest: &str| {
        let shape = format!("\n[[shapes]]\ntype = 'mesh'\nmaterial = 'm'\n{rest}\n");
        loaded(folder.path(), "color = [1, 1, 1]", &shape)
    };
    for file in ["a.ply", "a.obj"] {
        let scene = load(&format!("file = '{file}'\nrotate_y_deg = 90")).unwrap();
        let Geometry::Mesh(mesh) = &scene.shapes[0].geometry else { panic!("a mesh") };
        // A quarter turn counterclockwise from above takes z to x and x to −z.
        let expected = [DVec3::X, DVec3::new(0.8, 0.0, -0.6), DVec3::X];
        let found = normals(&scene)[0];
        assert!(found.iter().zip(expected).all(|(a, b)| a.distance(b) < 1e-6), "{file}: {found:?}");
        // Upwards in the file, downwards here.
        assert_eq!(mesh.uvs().next(), Some([[0.0, 1.0], [1.0, 0.75], [0.0, 0.0]]), "{file}");
        let flat = load(&format!("file = '{file}'\nsmooth = false")).unwrap();
        assert!(normals(&flat).is_empty() && load(&format!("file = '{file}'\nsmooth = true")).is_ok());
    }
    let (obj, warnings) = (load("file = 'a.obj'").unwrap(), load("file = 'a.obj'").unwrap().warnings());
    assert_eq!(normals(&obj)[1], [DVec3::Z; 3], "an object without normals is flat");
    assert!(warnings[0].to_string().contains("at 3 corners"), "{warnings:?}");
    let message = load("file = 'bare.ply'\nsmooth = true").unwrap_err();
    assert!(message.contains("smooth needs normals, which file \"bare.ply\" does not have"), "{message}");
    assert!(normals(&load("file = 'bare.ply'").unwrap()).is_empty());
}
