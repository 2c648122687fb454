//! Looking textures up, against f64.

use super::{color_texture, unseen, white};
use crate::probe::{Numbers, Probe, floats};
use crate::shapes::{ask, key};
use crate::support::open_gpu;
use glam::{Vec2, Vec3};
use qtracer::scene::Texture;
use qtracer::scene::compiled::CompiledScene;
use qtracer::scene::rows::{self, Row};
use qtracer::scene::texels::{
    WRAP_CLAMP, WRAP_MIRROR, WRAP_REPEAT, WRAP_U_SHIFT, WRAP_V_SHIFT, texture_bytes, texture_color,
};

const SIZES: [[u32; 2]; 6] = [[1, 1], [2, 1], [3, 5], [7, 4], [64, 33], [1, 9]];
const WRAPS: [u32; 3] = [WRAP_REPEAT, WRAP_CLAMP, WRAP_MIRROR];

fn some_textures() -> Vec<Texture> {
    let mut numbers = Numbers(53);
    let texture = |[width, height]: [u32; 2]| {
        let rgba: Vec<u8> = (0..4 * width * height).map(|_| numbers.below(256) as u8).collect();
        Texture::new("noise", width, height, rgba)
    };
    SIZES.map(texture).to_vec()
}

/// A quad for each texture.
fn scene_of(textures: &[Texture]) -> CompiledScene {
    let quad = |builder: qtracer::scene::SceneBuilder, (i, texture): (usize, &Texture)| {
        let name = i.to_string();
        let builder = builder.texture(texture.clone()).material(&name, white().textured(color_texture(i)));
        builder.quad([0.0, 0.0, i as f64], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], name)
    };
    CompiledScene::new(&textures.iter().enumerate().fold(unseen(), quad).build().unwrap())
}

/// IEC 61966-2-1.
fn decoded(byte: u8) -> f64 {
    let v = f64::from(byte) / 255.0;
    if v <= 0.04045 { v / 12.92 } else { ((v + 0.055) / 1.055).powf(2.4) }
}

/// The texel at any place of the plane that the image goes on over.
fn place(i: i64, size: i64, wrap: u32) -> i64 {
    match wrap {
        WRAP_CLAMP => i.max(0).min(size - 1),
        WRAP_REPEAT => i.rem_euclid(size),
        _ if i.div_euclid(size) % 2 == 0 => i.rem_euclid(size),
        _ => size - 1 - i.rem_euclid(size),
    }
}

/// Bilinear in f64 over texels at half-whole places; `value` decodes a byte.
fn bilinear(texture: &Texture, wraps: [u32; 2], uv: [f64; 2], value: fn(u8) -> f64) -> [f64; 3] {
    let (width, height) = (i64::from(texture.width), i64::from(texture.height));
    let (x, y) = (uv[0] * width as f64 - 0.5, uv[1] * height as f64 - 0.5);
    let mut sum = [0.0; 3];
    for (right, lower) in [(0, 0), (1, 0), (0, 1), (1, 1)] {
        let column = place(x.floor() as i64 + right, width, wraps[0]);
        let row = place(y.floor() as i64 + lower, height, wraps[1]);
        let share = |v: f64, far: i64| if far == 1 { v - v.floor() } else { 1.0 - (v - v.floor()) };
        let weight = share(x, right) * share(y, lower);
        let texel = 4 * (row * width + column) as usize;
        (0..3).for_each(|c| sum[c] += weight * value(texture.rgba[texel + c]));
    }
    sum
}

/// Points all over, on borders of images and texels and a hair beside them.
fn some_points(texture: &Texture, numbers: &mut Numbers) -> Vec<[f32; 2]> {
    let mut along = |size: u32| -> f32 {
        let texels = f64::from(size);
        let whole = numbers.below(6 * size as usize) as f64 / texels - 3.0;
        let half = whole + 0.5 / texels;
        let near = numbers.sign() * numbers.of_any_size(1e-8, 1e-2);
        [numbers.between(-3.0, 3.0), whole, half, whole + near, 0.0, 1.0][numbers.below(6)] as f32
    };
    (0..60).map(|_| [along(texture.width), along(texture.height)]).collect()
}

/// A lookup: the word of a texture, and where.
struct Case {
    question: [Row; 1],
    texture: usize,
    wraps: [u32; 2],
    uv: [f32; 2],
}

fn cases(textures: &[Texture]) -> Vec<Case> {
    let mut numbers = Numbers(59);
    let mut all = Vec::new();
    for (i, texture) in textures.iter().enumerate() {
        for wraps in WRAPS.iter().flat_map(|&u| WRAPS.map(|v| [u, v])) {
            let word = i as u32 | wraps[0] << WRAP_U_SHIFT | wraps[1] << WRAP_V_SHIFT;
            all.extend(some_points(texture, &mut numbers).into_iter().map(|uv| Case {
                question: [[word, uv[0].to_bits(), uv[1].to_bits(), 0]],
                texture: i,
                wraps,
                uv,
            }));
        }
    }
    all
}

/// What both twins say of each case: colours as sRGB, and bytes.
fn answers(scene: &CompiledScene, cases: &[Case]) -> [Vec<[Vec3; 2]>; 2] {
    let cpu = cases.iter().map(|Case { question: [[word, ..]], uv, .. }| {
        let uv = Vec2::from_array(*uv);
        [texture_color(scene, *word, uv), texture_bytes(scene, *word, uv)]
    });
    let gpu = open_gpu();
    let imports = "import package::scene::texels::{texture_bytes, texture_color};";
    let body = "let uv = bitcast<vec2<f32>>(a.yz);
        out0 = vec4<u32>(bitcast<vec3<u32>>(texture_color(a.x, uv)), 0u);
        out1 = vec4<u32>(bitcast<vec3<u32>>(texture_bytes(a.x, uv)), 0u);";
    let probe = Probe::<1, 2>::new(&gpu, &key(scene), imports, body);
    let questions: Vec<[Row; 1]> = cases.iter().map(|case| case.question).collect();
    let kernels = ask(&gpu, &probe, scene, &rows::hot(scene), &questions);
    [cpu.collect(), kernels.into_iter().map(|rows| rows.map(|row| floats(row).0)).collect()]
}

fn worst_error(textures: &[Texture], cases: &[Case], answers: &[[Vec3; 2]]) -> [f64; 2] {
    let mut worst = [0.0f64; 2];
    for (case, found) in cases.iter().zip(answers) {
        let uv = case.uv.map(f64::from);
        for (k, value, scale) in [(0, decoded as fn(u8) -> f64, 1.0), (1, f64::from as fn(u8) -> f64, 255.0)]
        {
            let expected = bilinear(&textures[case.texture], case.wraps, uv, value);
            for c in 0..3 {
                worst[k] = worst[k].max((f64::from(found[k][c]) - expected[c]).abs() / scale);
            }
        }
    }
    worst
}

/// A coordinate of 3 on 64 texels is known to 3 · 64 · 2⁻²⁴ texels, which is what may be missing of a step from 0 to 1.
const LOOKUP_BOUND: f64 = 3.0 * 64.0 / 16_777_216.0 * 2.0;

#[test]
fn textures_are_blended_as_in_f64() {
    let textures = some_textures();
    let (scene, cases) = (scene_of(&textures), cases(&textures));
    let twins = answers(&scene, &cases);
    for (name, answers) in ["CPU", "kernels"].iter().zip(&twins) {
        let worst = worst_error(&textures, &cases, answers);
        println!(
            "{} look-ups, {name}: worst errors of colours {:.1e}, of bytes {:.1e}",
            cases.len(),
            worst[0],
            worst[1]
        );
        assert!(worst[0] < LOOKUP_BOUND && worst[1] < LOOKUP_BOUND, "{name}: {worst:?}");
    }
    let apart = twins[0].iter().zip(&twins[1]).map(|(a, b)| a[0].distance(b[0])).fold(0.0, f32::max);
    println!("worst difference between the twins: {apart:e}");
    assert!(apart < 2e-5, "{apart:e}");
    // Negative controls: another way to go on, or blending before decoding, is not that near.
    let turned: Vec<Case> =
        cases.into_iter().map(|c| Case { wraps: [c.wraps[1], c.wraps[0]], ..c }).collect();
    assert!(worst_error(&textures, &turned, &twins[0])[0] > 0.1);
    let late = bilinear(&textures[2], [0; 2], [0.4, 0.4], f64::from).map(|v| decoded(v as u8));
    let early = bilinear(&textures[2], [0; 2], [0.4, 0.4], decoded);
    assert!((0..3).any(|c| (late[c] - early[c]).abs() > 0.01), "{late:?} {early:?}");
}

/// All bytes, each by itself.
#[test]
fn every_byte_is_decoded_by_the_srgb_curve() {
    let ramp: Vec<u8> = (0..=255).flat_map(|byte| [byte, 255 - byte, byte / 2, 255]).collect();
    let textures = [Texture::new("ramp", 256, 1, ramp)];
    let scene = scene_of(&textures);
    let case = |byte: u32| {
        let uv = [(byte as f32 + 0.5) / 256.0, 0.5];
        Case { question: [[0, uv[0].to_bits(), uv[1].to_bits(), 0]], texture: 0, wraps: [0; 2], uv }
    };
    let cases: Vec<Case> = (0..256).map(case).collect();
    for answers in answers(&scene, &cases) {
        for (byte, [color, _]) in (0..=255u8).zip(&answers) {
            let expected = [byte, 255 - byte, byte / 2].map(decoded);
            for c in 0..3 {
                assert!((f64::from(color[c]) - expected[c]).abs() < 1e-7, "byte {byte}: {color}");
            }
        }
        assert!((answers[128][0].x - 0.215_860_5).abs() < 1e-6, "the middle grey of the standard's table");
    }
}
