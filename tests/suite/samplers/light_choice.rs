//! Which light is sampled: every number that may be drawn is counted.

use super::twins::{SIDES, Side, Twins, World};
use super::{ALPHA, WRONG, draw};
use crate::support::{open_gpu, quad_index};
use proptest::prelude::*;
use qtracer::sampling::{AliasTable, alias_row};
use qtracer::scene::compiled::{CompiledScene, Light};
use qtracer::scene::rows::Row;
use qtracer::scene::{Material as SceneMaterial, Scene};
use qtracer::stats::chi2_test;
use qtracer::transport::light::choose_by_power;

const DRAWABLE: u32 = 1 << 24;
/// Numbers that one invocation tries.
const TRIED: u32 = 1 << 12;

/// Lamps of these powers, spheres and quads in turn.
fn lamps(powers: &[f64]) -> CompiledScene {
    let mut builder = Scene::builder("lamps").camera([0.0, 0.0, 9.0], [0.0; 3], 40.0);
    for (i, power) in powers.iter().enumerate() {
        let lamp = SceneMaterial::diffuse([0.0; 3]).emitting([*power, power / 2.0, power / 4.0]);
        let (name, x) = (format!("lamp {i}"), 3.0 * i as f64);
        builder = builder.material(name.as_str(), lamp);
        builder = match i % 2 {
            0 => builder.sphere([x, 2.0, 0.0], 0.5, name),
            _ => builder.quad([x, 2.0, 0.0], [0.0, 0.0, 1.0], [-1.5, 0.0, 0.0], name),
        };
    }
    CompiledScene::new(&builder.build().unwrap())
}

/// Area × radiance, of both sides of a sphere and one of a quad.
fn power(scene: &CompiledScene, light: &Light) -> f64 {
    let emission = scene.materials[light.material as usize].emission.as_dvec3().element_sum();
    let area = match quad_index(scene, light.shape) {
        None => 4.0 * std::f64::consts::PI * f64::from(scene.spheres[light.shape as usize].radius).powi(2),
        Some(i) => scene.quads[i].area.into(),
    };
    emission * area
}

/// How often each of twelve lights is chosen by the numbers from a.x on.
const COUNT: (&str, &str) = (
    "import package::transport::light::choose_by_power;",
    "var counts: array<u32, 12>;
    for (var k = 0u; k < 4096u; k++) { counts[choose_by_power(f32(a.x + k) / 16777216.0)] += 1u; }
    out0 = vec4<u32>(counts[0], counts[1], counts[2], counts[3]);
    out1 = vec4<u32>(counts[4], counts[5], counts[6], counts[7]);
    out2 = vec4<u32>(counts[8], counts[9], counts[10], counts[11]);",
);

fn count(world: &World, [[first, ..]]: &[Row; 1]) -> [Row; 3] {
    let mut counts = [0u32; 12];
    for k in *first..first + TRIED {
        counts[choose_by_power(&world.scene, k as f32 / DRAWABLE as f32) as usize] += 1;
    }
    let (rows, _) = counts.as_chunks();
    [rows[0], rows[1], rows[2]]
}

/// Of all 2²⁴ numbers exactly the share that pick_probability says chooses each light, so that nothing is biased, however
/// rare a light is. Where drivers fuse a product with a difference, a number at a threshold may move.
#[test]
fn each_light_is_chosen_by_exactly_the_numbers_that_its_probability_counts() {
    let fuses = !open_gpu().summary.software;
    let scenes = [
        vec![1.0, 1e8],
        vec![1e8, 1.0],
        vec![1e8, 1.0, 3.0],
        vec![1.0, 0.01, 3.0, 3.0, 1e-6, 10.0, 0.5],
        (0..11).map(|i| 10f64.powi(i - 3)).collect(),
    ];
    for powers in scenes {
        let world = World::of(lamps(&powers));
        let twins = Twins::new(&world, COUNT, count);
        let questions: Vec<_> =
            (0..DRAWABLE).step_by(TRIED as usize).map(|first| [[first, 0, 0, 0]]).collect();
        for side in SIDES {
            let slack = if side == Side::Gpu && fuses { 2.0 * powers.len() as f32 } else { 0.0 };
            let mut counts = [0u32; 12];
            for answer in twins.answer(side, &questions) {
                counts.iter_mut().zip(answer.as_flattened()).for_each(|(sum, count)| *sum += count);
            }
            for (light, counted) in world.scene.lights.iter().zip(counts) {
                let off = counted as f32 - light.pick_probability * DRAWABLE as f32;
                assert!(off.abs() <= slack, "{side:?}: {powers:?}: {light:?} of {counts:?}");
                assert!(counted > 0);
            }
        }
        // Negative control: by power alone, the rarest light is chosen many times too often.
        let total: f64 = world.scene.lights.iter().map(|light| power(&world.scene, light)).sum();
        let ratio = |light: &Light| f64::from(light.pick_probability) * total / power(&world.scene, light);
        assert!(world.scene.lights.iter().map(ratio).fold(0.0, f64::max) > 10.0, "{powers:?}");
    }
}

proptest! {
    #![proptest_config(crate::guiding_maths::cases(300))]

    /// Probabilities add up to one, are counted rightly, and go by weight down to 1/4096 of the average, for tables of any size.
    #[test]
    fn alias_tables_draw_by_weight(weights in prop::collection::vec((-8.0f64..0.0).prop_map(|e| 10f64.powf(e)), 1..200)) {
        let table = AliasTable::new(&weights);
        let n = weights.len() as f64;
        let least = weights.iter().sum::<f64>() / n / 4096.0;
        let total: f64 = weights.iter().map(|w| w.max(least)).sum();
        let sum: f64 = table.rows.iter().map(|row| f64::from(row.probability)).sum();
        prop_assert_eq!(sum, 1.0);
        for (row, weight) in table.rows.iter().zip(&weights) {
            let expected = weight.max(least) / total;
            // Each row of the table rounds to a number or two of the 2²⁴ where it is cut.
            let steps = (f64::from(row.probability) - expected).abs() * f64::from(DRAWABLE);
            prop_assert!(steps <= 2.0 * n && row.probability > 0.0, "{row:?} for {expected}: {steps} steps");
        }
    }
}

/// Counting by bisection is counting.
#[test]
fn probabilities_of_large_tables_count_every_number() {
    let weights: Vec<f64> = (0..777).map(|i| 1e-8f64.powf(f64::from(i) / 777.0)).collect();
    let rows = AliasTable::new(&weights).rows;
    let mut counts = vec![0u32; rows.len()];
    for k in 0..DRAWABLE {
        let (i, share) = alias_row(rows.len() as u32, k as f32 / DRAWABLE as f32);
        let row = rows[i as usize];
        counts[if share >= row.threshold { row.alias } else { i } as usize] += 1;
    }
    for (row, counted) in rows.iter().zip(counts) {
        assert_eq!(counted as f32, row.probability * DRAWABLE as f32);
    }
    // Ten thousand, half of them dark: each is drawn by at least a few numbers.
    let many: Vec<f64> = (0..10_000).map(|i| if i % 2 == 0 { 1.0 } else { 1e-8 }).collect();
    let least = AliasTable::new(&many).rows.iter().map(|row| row.probability).fold(1.0, f32::min);
    assert!(least * 16_777_216.0 >= 8.0, "{least}");
    assert!(AliasTable::new(&[]).rows.is_empty());
}

/// By the program's own numbers. α = 1e-4 each side.
#[test]
fn lights_are_chosen_as_often_as_their_probability_says() {
    const CHOOSE: (&str, &str) = (
        "import package::base::random::{SampleKey, sample4};
        import package::transport::light::choose_by_power;",
        "out0.x = choose_by_power(sample4(SampleKey(3u, a.w, 41u), 7u).x);",
    );
    let world = World::of(lamps(&[1.0, 5.0, 0.2, 2.0, 20.0]));
    let scene = &world.scene;
    let twins =
        Twins::new(&world, CHOOSE, |world, [[.., i]]| [[choose_by_power(&world.scene, draw(*i).x), 0, 0, 0]]);
    let n = 1 << 19;
    let questions: Vec<_> = (0..n).map(|i| [[0, 0, 0, i]]).collect();
    let share = |p: f64| p * f64::from(n);
    let expected: Vec<f64> = scene.lights.iter().map(|light| share(light.pick_probability.into())).collect();
    for side in SIDES {
        let mut observed = vec![0u64; 5];
        twins.answer(side, &questions).iter().for_each(|[answer]| observed[answer[0] as usize] += 1);
        let p = chi2_test(&observed, &expected).unwrap().p_value;
        assert!(p > ALPHA, "{side:?}: {observed:?} for {expected:?}");
        // Negative control: the brightest has 3 % less.
        let most = (0..5).max_by(|a, b| expected[*a].total_cmp(&expected[*b])).unwrap();
        let askew: Vec<f64> = (0..5).map(|i| expected[i] * if i == most { 0.97 } else { 1.03 }).collect();
        assert!(chi2_test(&observed, &askew).unwrap().p_value < WRONG, "{side:?}");
    }
    let total: f64 = scene.lights.iter().map(|light| power(scene, light)).sum();
    for light in &scene.lights {
        assert!((f64::from(light.pick_probability) - power(scene, light) / total).abs() < 1e-6, "{light:?}");
    }
}
