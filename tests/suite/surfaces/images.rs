//! Pictures of textured and of smooth surfaces: against closed forms, and engine against engine.

use super::{color_texture, image, smooth_sphere, square, unseen, white};
use crate::engines::mean_z;
use crate::guiding_renders::guided;
use crate::support::*;
use glam::DVec3;
use qtracer::guiding::GuideMode;
use qtracer::scene::compiled::CompiledScene;
use qtracer::scene::{Material, MaterialTextures, MeshData, Scene, Texture, TextureRef, Wrap};
use qtracer::stats::differences;
use qtracer::transport::roulette::Roulette;
use qtracer::{Image, RenderOptions, Renderer};

/// Four by three colours, none like another.
fn patches() -> Texture {
    let texel = |i: u32| [(20 * i + 10) as u8, (250 - 15 * i) as u8, (i * i * 2) as u8];
    image(4, &(0..12).map(texel).collect::<Vec<_>>())
}

/// What `patches` say in f64, clamped at the edges, of the point (x, y) of the square; upside down if `turned`.
fn patch_at(x: f64, y: f64, turned: bool) -> [f64; 3] {
    let linear = |byte: u8| {
        let v = f64::from(byte) / 255.0;
        if v <= 0.04045 { v / 12.92 } else { ((v + 0.055) / 1.055).powf(2.4) }
    };
    let v = if turned { (1.0 + y) / 2.0 } else { (1.0 - y) / 2.0 };
    let (column, row) = ((1.0 + x) / 2.0 * 4.0 - 0.5, v * 3.0 - 0.5);
    let texture = patches();
    let at = |i: f64, j: f64, c: usize| {
        let (i, j) = (i.clamp(0.0, 3.0) as usize, j.clamp(0.0, 2.0) as usize);
        linear(texture.rgba[4 * (4 * j + i) + c])
    };
    let (left, upper) = (column.floor(), row.floor());
    let (s, t) = (column - left, row - upper);
    std::array::from_fn(|c| {
        let above = at(left, upper, c) * (1.0 - s) + at(left + 1.0, upper, c) * s;
        let below = at(left, upper + 1.0, c) * (1.0 - s) + at(left + 1.0, upper + 1.0, c) * s;
        above * (1.0 - t) + below * t
    })
}

const SIDE: u32 = 24;

/// The square as a camera sees it that just does not see its edges: pixel means in f64.
fn expected(turned: bool) -> Vec<[f64; 3]> {
    let fine = 16;
    let pixel = |i: u32| {
        let mut mean = [0.0; 3];
        for k in 0..fine * fine {
            let x = f64::from(i % SIDE) + (f64::from(k % fine) + 0.5) / f64::from(fine);
            let y = f64::from(i / SIDE) + (f64::from(k / fine) + 0.5) / f64::from(fine);
            let [x, y] = [x, y].map(|v| (2.0 * v / f64::from(SIDE) - 1.0) * 0.99);
            let value = patch_at(x, -y, turned);
            (0..3).for_each(|c| mean[c] += value[c] / f64::from(fine * fine));
        }
        mean
    };
    (0..SIDE * SIDE).map(pixel).collect()
}

/// The largest difference in standard errors; sums over a pixel's fine grid are known to 5e-4.
fn worst_z(image: &Image, expected: &[[f64; 3]]) -> f64 {
    let errors = image.standard_error.as_ref().unwrap();
    let z = |i: usize, c: usize| {
        (f64::from(image.rgb[i][c]) - expected[i][c]).abs() / (f64::from(errors[i][c]) + 5e-4)
    };
    (0..expected.len()).flat_map(|i| (0..3).map(move |c| z(i, c))).fold(0.0, f64::max)
}

/// Seen under a white sky, a surface that sees nothing of itself sends back its albedo; and a lamp what it emits. On meshes
/// and on quads. 1,728 values a picture, none beyond 5 standard errors: α = 1e-3.
#[test]
fn textured_surfaces_look_like_their_images() {
    let fov = 2.0 * (0.99f64 / 3.0).atan().to_degrees();
    let clamped = Some(TextureRef { texture: 0, wrap_u: Wrap::Clamp, wrap_v: Wrap::Clamp });
    let color = MaterialTextures { color: clamped, ..Default::default() };
    let emission = MaterialTextures { emission: clamped, ..Default::default() };
    let lamp = Material::diffuse([0.0; 3]).emitting([1.0; 3]).textured(emission);
    for (material, sky) in [(white().textured(color), 1.0), (lamp, 0.0)] {
        for mesh in [true, false] {
            let builder = Scene::builder("patches").camera([0.0, 0.0, 3.0], [0.0; 3], fov);
            let builder = builder.environment([sky; 3]).texture(patches()).material("m", material.clone());
            let scene = match mesh {
                true => builder.mesh(square(), "m"),
                false => builder.quad([-1.0, -1.0, 0.0], [2.0, 0.0, 0.0], [0.0, 2.0, 0.0], "m"),
            }
            .build()
            .unwrap();
            let options = RenderOptions {
                max_bounces: Some(2),
                roulette: Some(Roulette::Off),
                ..small(SIDE, SIDE, 67)
            };
            for engine in [Engine::Cpu, Engine::Megakernel] {
                let image = render(&scene, engine, &options, 64).image;
                let (worst, turned) = (worst_z(&image, &expected(false)), worst_z(&image, &expected(true)));
                println!("sky {sky}, mesh {mesh}, {engine:?}: worst z {worst:.1}, upside down {turned:.1}");
                assert!(worst < 5.0, "sky {sky}, mesh {mesh}, {engine:?}: {worst}");
                assert!(turned > 20.0, "negative control: {turned}");
            }
        }
    }
}

/// Dark on one side, bright on the other, and a ramp between: 0.5 + x, clamped to 0 … 1, of the lamp's emission.
fn ramp(turned: bool) -> Texture {
    let texels = [[0, 0, 0], [255, 255, 255]];
    image(2, &if turned { [texels[1], texels[0]] } else { texels })
}

/// A square lamp of side 2 at height 1 that shines down, its image from −x to x.
fn lamp_mesh() -> MeshData {
    let corners = [[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]];
    MeshData {
        positions: corners.map(|[x, z]| DVec3::new(x, 1.0, z)).to_vec(),
        uvs: corners.map(|[x, z]| [(1.0 + x as f32) / 2.0, (1.0 + z as f32) / 2.0]).to_vec(),
        triangles: vec![[0, 1, 2], [0, 2, 3]],
        ..Default::default()
    }
}

/// Light that a white floor at (0.7, 0, 0.2) sends back: an integral over the lamp in f64.
fn floor_radiance() -> f64 {
    let n = 400;
    let mut sum = 0.0;
    for (i, k) in (0..n).flat_map(|i| (0..n).map(move |k| (i, k))) {
        let [x, z] = [i, k].map(|v| (f64::from(v) + 0.5) * 2.0 / f64::from(n) - 1.0);
        let to = DVec3::new(x - 0.7, 1.0, z - 0.2);
        let square = to.length_squared();
        sum += (0.5 + x).clamp(0.0, 1.0) * 3.0 / (square * square);
    }
    sum * (2.0 / f64::from(n)).powi(2) / std::f64::consts::PI
}

fn lit_floor(turned: bool, wide: f64) -> Scene {
    let clamped = Some(TextureRef { texture: 0, wrap_u: Wrap::Clamp, wrap_v: Wrap::Clamp });
    let textures = MaterialTextures { emission: clamped, ..Default::default() };
    Scene::builder("textured lamp")
        .camera([0.7, 0.5, 0.2], [0.7, 0.0, 0.2001], wide)
        .texture(ramp(turned))
        .material("lamp", Material::diffuse([0.0; 3]).emitting([3.0; 3]).textured(textures))
        .material("floor", white())
        .mesh(lamp_mesh(), "lamp")
        .quad([-9.0, 0.0, 9.0], [18.0, 0.0, 0.0], [0.0, 0.0, -18.0], "floor")
        .build()
        .unwrap()
}

/// By shadow rays and by chance; 4 standard errors, α = 6e-5 each, and 1e-3 for the size of the spot.
#[test]
fn a_textured_lamp_lights_as_its_integral_says() {
    let expected = floor_radiance();
    for direct_light in [true, false] {
        let options = RenderOptions {
            direct_light: Some(direct_light),
            max_bounces: Some(2),
            roulette: Some(Roulette::Off),
            ..small(8, 8, 71)
        };
        for engine in [Engine::Cpu, Engine::Megakernel] {
            let of = |turned| {
                let image = render(&lit_floor(turned, 0.5), engine, &options, 1024).image;
                crate::furnace::mean_and_relative_error(&image)
            };
            let (mean, error) = of(false);
            println!("direct light {direct_light}, {engine:?}: {mean:.5} ({error:.1e}) for {expected:.5}");
            assert!(
                (mean / expected - 1.0).abs() < 4.0 * error + 1e-3,
                "{mean} for {expected}, s.e. {error}"
            );
            // Negative control: the lamp's image the other way around.
            assert!((of(true).0 / expected - 1.0).abs() > 0.1);
        }
    }
}

/// A lamp is chosen by what it sends out, which is the mean over its texels.
#[test]
fn textured_lamps_are_chosen_by_their_mean() {
    let textures = MaterialTextures { emission: Some(TextureRef::new(0)), ..Default::default() };
    let scene = unseen()
        .texture(image(2, &[[0, 0, 0], [255, 255, 255], [0, 0, 0], [0, 0, 0]]))
        .material("plain", Material::diffuse([0.0; 3]).emitting([1.0; 3]))
        .material("image", Material::diffuse([0.0; 3]).emitting([2.0; 3]).textured(textures))
        .quad([0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], "plain")
        .quad([2.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], "image")
        .build()
        .unwrap();
    let scene = CompiledScene::new(&scene);
    let chances: Vec<f32> = scene.lights.iter().map(|light| light.pick_probability).collect();
    assert!((chances[0] - 2.0 / 3.0).abs() < 1e-6 && (chances[1] - 1.0 / 3.0).abs() < 1e-6, "{chances:?}");
    // What is textured is another picture.
    let other = |texel: u8| {
        let builder =
            unseen().texture(image(1, &[[texel; 3]])).material("m", white().textured(color_texture(0)));
        CompiledScene::new(&builder.mesh(square(), "m").build().unwrap()).light_fingerprint()
    };
    assert_ne!(other(1), other(2));
}

/// Smooth and flat meshes and quads, of every material; textures for colour, light and normals; some meshes with neither.
pub fn everything() -> Scene {
    let of = |i: usize| Some(TextureRef { texture: i, wrap_u: Wrap::Mirror, wrap_v: Wrap::Repeat });
    let bumps: Vec<[u8; 3]> = (0..16).map(|i| [100 + 4 * i, 160 - 5 * i, 230]).collect();
    let color = MaterialTextures { color: of(0), ..Default::default() };
    let normal = MaterialTextures { normal: of(1), normal_scale: 1.5, ..Default::default() };
    let both = MaterialTextures { color: of(0), ..normal };
    let light = MaterialTextures { emission: of(0), ..Default::default() };
    let ball = |x: f64, y: f64, z: f64| {
        let data = smooth_sphere(1);
        let uvs = data.positions.iter().map(|p| [3.0 * p.x as f32, 2.0 * p.y as f32]).collect();
        let positions = data.positions.iter().map(|p| *p * 0.6 + DVec3::new(x, y, z)).collect();
        MeshData { uvs, positions, ..data }
    };
    let flat = |data: MeshData| MeshData { normals: Vec::new(), ..data };
    let bare = |data: MeshData| MeshData { normals: Vec::new(), uvs: Vec::new(), ..data };
    Scene::builder("everything")
        .camera([0.0, 1.0, 5.0], [0.0; 3], 45.0)
        .environment([0.2, 0.3, 0.4])
        .texture(patches())
        .texture(image(4, &bumps))
        .material("tiles", Material::diffuse([0.9; 3]).textured(color))
        .material("bumps", Material::diffuse([0.7; 3]).textured(normal))
        .material("gloss", Material::glossy([0.8; 3], 30.0).textured(both))
        .material("mirror", Material::mirror([0.9; 3], 0.7).textured(normal))
        .material("glass", Material::dielectric([1.0; 3], 1.5).textured(color))
        .material("lamp", Material::diffuse([0.3; 3]).emitting([9.0; 3]).textured(light))
        .material("plain", Material::diffuse([0.6; 3]))
        .mesh(ball(-1.8, 0.0, 0.0), "tiles")
        .mesh(flat(ball(-0.6, 0.0, 0.0)), "gloss")
        .mesh(ball(0.6, 0.0, 0.0), "mirror")
        .mesh(ball(1.8, 0.0, 0.0), "glass")
        .mesh(ball(-1.2, 0.0, -1.5), "gloss")
        .mesh(bare(ball(0.0, 0.0, -1.5)), "plain")
        .mesh(flat(ball(1.2, 2.0, -1.5)), "lamp")
        .quad([-4.0, -0.6, 4.0], [8.0, 0.0, 0.0], [0.0, 0.0, -8.0], "bumps")
        .quad([-1.0, 3.0, -1.0], [2.0, 0.0, 0.0], [0.0, 0.0, 2.0], "lamp")
        .build()
        .unwrap()
}

/// Bit for bit on software adapters, as in engines.rs.
fn engines_agree(scene: &Scene, mode: GuideMode) {
    let exact = open_gpu().summary.software;
    let roulette = if mode == GuideMode::Off { Roulette::Throughput } else { Roulette::Learnt };
    let options = guided(16, 12, 73, mode, roulette);
    let reference = render(scene, Engine::Megakernel, &options, 6);
    for engine in &GPU_ENGINES[1..] {
        let other = render(scene, *engine, &options, 6);
        let differing = differing_pixels(&reference.film, &other.film);
        println!("{mode}, {engine:?}: {differing} pixels differ from the megakernel's");
        assert!(!exact || differing == 0, "{mode}, {engine:?}: {differing} pixels differ");
    }
}

#[test]
fn engines_agree_on_every_kind_of_surface() {
    let scene = everything();
    assert!(scene.warnings().is_empty(), "{:?}", scene.warnings());
    engines_agree(&scene, GuideMode::Off);
}

#[test]
#[ignore = "long: kernels of four engines for each guide; tests/run --long"]
fn guided_engines_agree_on_every_kind_of_surface() {
    engines_agree(&everything(), GuideMode::Adaptive);
    engines_agree(&everything(), GuideMode::Octant);
}

/// The CPU's image but for paths that rounding sends elsewhere, with a guide as well.
#[test]
fn the_cpu_agrees_with_a_gpu_on_every_kind_of_surface() {
    let scene = everything();
    for (mode, roulette) in [(GuideMode::Off, Roulette::Throughput), (GuideMode::Adaptive, Roulette::Learnt)]
    {
        let options = guided(16, 12, 73, mode, roulette);
        let [cpu, gpu] = [Engine::Cpu, Engine::Megakernel].map(|engine| render(&scene, engine, &options, 6));
        let found = differences(&cpu.image.view(), &gpu.image.view()).unwrap();
        println!("{mode}: {:.2} % of pixels within 1e-3 of the CPU's", 100.0 * found.share_within_1e3);
        assert!(found.share_within_1e3 > 0.97, "{mode}: {found:?}");
    }
}

/// Guides change the noise, not the answer; nor do shadow rays: |z| of each channel's mean stays below 4, α = 6e-4 in all.
#[test]
fn guides_and_shadow_rays_agree_on_every_kind_of_surface() {
    let scene = everything();
    let with = |mode, direct_light, seed| {
        let roulette = if mode == GuideMode::Off { Roulette::Throughput } else { Roulette::Learnt };
        let options =
            RenderOptions { direct_light: Some(direct_light), ..guided(24, 18, seed, mode, roulette) };
        render(&scene, Engine::Cpu, &options, 254).image
    };
    let plain = with(GuideMode::Off, true, 79);
    for (mode, direct_light) in
        [(GuideMode::Off, false), (GuideMode::Adaptive, true), (GuideMode::Octant, true)]
    {
        let z = mean_z(&with(mode, direct_light, 83), &plain);
        println!("{mode}, direct light {direct_light}: z {z:.2}");
        assert!(z < 4.0, "{mode}, direct light {direct_light}: {z}");
    }
    // Negative control: a tenth more light.
    let z = mean_z(&brightened(&with(GuideMode::Off, true, 89), 1.1), &plain);
    assert!(z > 4.0, "{z}");
}

/// The layer of albedo shows the texture, that of normals the smooth normal.
#[test]
fn first_hit_layers_show_textures_and_smooth_normals() {
    let scene = Scene::builder("layers")
        .camera([0.0, 0.0, 4.0], [0.0; 3], 0.1)
        .texture(image(1, &[[255, 188, 0]]))
        .material("m", Material::diffuse([0.5; 3]).textured(color_texture(0)))
        .mesh(MeshData { normals: vec![DVec3::new(0.6, 0.0, 0.8); 4], ..square() }, "m")
        .build()
        .unwrap();
    let renderer = Renderer::new(&scene, Engine::Cpu.with(&small(2, 2, 1))).unwrap();
    let features = renderer.image_with_features().features.unwrap();
    for pixel in 0..4 {
        let albedo = features.albedo[pixel].map(f64::from);
        let expected = [0.5, 0.5 * 0.502_886_5, 0.0];
        assert!((0..3).all(|c| (albedo[c] - expected[c]).abs() < 1e-5), "{albedo:?}");
        let normal = DVec3::from_array(features.normal[pixel].map(f64::from));
        assert!(normal.distance(DVec3::new(0.6, 0.0, 0.8)) < 1e-4, "{normal}");
    }
}
