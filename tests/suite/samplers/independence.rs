//! Renders of different seeds are independent of each other.

use crate::support::{Engine, render, scene, small};
use qtracer::math::luminance;
use qtracer::stats::{normal_two_sided_threshold, sidak};
use qtracer::{Image, RenderOptions, Sampler};

const SEEDS: u32 = 5;

/// Luminances of an image.
fn luminances(image: &Image) -> Vec<f32> {
    image.rgb.iter().map(|rgb| luminance((*rgb).into())).collect()
}

/// Signs of the differences, pixel by pixel: either is as likely if the two are alike and independent, whatever the noise's
/// distribution.
fn signs(a: &[f32], b: &[f32]) -> Vec<f64> {
    a.iter().zip(b).map(|(a, b)| f64::from((a - b).partial_cmp(&0.0).map_or(0, |o| o as i8))).collect()
}

/// How far two such maps are from independent, in standard deviations: pixels where one has no sign tell nothing.
fn z(a: &[f64], b: &[f64]) -> f64 {
    let products: Vec<f64> = a.iter().zip(b).map(|(a, b)| a * b).filter(|p| *p != 0.0).collect();
    products.iter().sum::<f64>() / (products.len() as f64).sqrt()
}

/// The noise of a render with one seed and that with the next, or one of the next few: no sign of either says anything of the
/// other's. α = 1e-3 for all pairs of an engine and a sampler together (Šidák).
#[test]
fn renders_of_consecutive_seeds_are_independent() {
    let scene = scene("cornell-box");
    for (engine, sampler) in [
        (Engine::Cpu, Sampler::Independent),
        (Engine::Cpu, Sampler::Stratified),
        (Engine::Megakernel, Sampler::Stratified),
    ] {
        let image = |seed: u32| {
            let options = RenderOptions { sampler, ..small(48, 48, seed) };
            luminances(&render(&scene, engine, &options, 4).image)
        };
        let images: Vec<Vec<f32>> = (0..2 * SEEDS).map(|i| image(1000 + i)).collect();
        // Seed k against seed k + 5, so that no two maps share a render.
        let maps: Vec<Vec<f64>> =
            (0..SEEDS as usize).map(|i| signs(&images[i], &images[i + SEEDS as usize])).collect();
        let pairs: Vec<(usize, usize)> = (0..maps.len()).flat_map(|i| (0..i).map(move |j| (i, j))).collect();
        let limit = normal_two_sided_threshold(sidak(1e-3, pairs.len()));
        for &(i, j) in &pairs {
            let z = z(&maps[i], &maps[j]);
            assert!(z.abs() < limit, "{engine:?}, {sampler:?}: seeds {i} and {j} of 1000: z = {z}");
        }
        // Negative controls: the same seed, and renders half of whose samples are of the same seed.
        assert!(z(&maps[0], &maps[0]) > 40.0);
        let half: Vec<f32> = images[0].iter().zip(&images[1]).map(|(a, b)| 0.5 * (a + b)).collect();
        assert!(z(&signs(&half, &images[6]), &maps[0]) > 6.0);
    }
}
