//! Independent images: six scenes against Mitsuba 3, by z-test. tests/references holds block means of its converged
//! images with their standard errors, made by examples/shrink_reference; a small pixel covers exactly one block, so
//! rendering at the small size estimates the same values. Box filter, 64 levels, no roulette there.

use crate::support::*;
use qtracer::film::read_image;
use qtracer::gpu::stage::Schedule;
use qtracer::stats::{Comparison, ComparisonOptions, ZTestOptions};
use qtracer::transport::roulette::Roulette;
use qtracer::{Image, RenderOptions};

pub fn reference(name: &str) -> Image {
    read_image(&root().join(format!("tests/references/{name}.exr"))).unwrap()
}

pub fn compare(image: &Image, reference: &Image) -> Comparison {
    let z_test = ZTestOptions { alpha: 1e-3, ..Default::default() };
    Comparison::new(&image.view(), &reference.view(), &ComparisonOptions { z_test, ..Default::default() })
        .unwrap()
}

/// Errors as large as the reference says that a render of `spp` samples has, or as the render itself says if that is
/// more. Where light is rare, most renders of few samples have not met it and claim errors near zero; the reference, of
/// up to two million samples for each of these pixels, has.
pub fn with_expected_errors(mut image: Image, reference: &Image, spp: u32) -> Image {
    let (errors, samples) = (reference.standard_error.as_ref().unwrap(), reference.samples.as_ref().unwrap());
    for (i, own) in image.standard_error.iter_mut().flatten().enumerate() {
        let ratio = (samples[i] / spp as f32).sqrt();
        (0..3).for_each(|c| own[c] = own[c].max(errors[i][c] * ratio));
    }
    image
}

/// Renders a scene and compares it with its reference: α = 1e-3 that a right image fails. An image 2 % brighter must
/// fail the same test, so the samples are enough to see that much.
fn agrees_with_mitsuba(file: &str, reference_name: &str, engine: Engine, spp: u32, seed: u32) {
    let reference = reference(reference_name);
    let options = RenderOptions {
        direct_light: Some(true),
        roulette: Some(Roulette::Throughput),
        max_bounces: Some(64),
        ..small(reference.width, reference.height, seed)
    };
    let image = render(&scene(file), engine, &options, spp).image;
    let image = with_expected_errors(image, &reference, spp);
    let comparison = compare(&image, &reference);
    println!("{file} on {engine:?}\n{comparison}");
    assert_eq!(comparison.passes(), Some(true), "{file} on {engine:?}, {spp} samples:\n{comparison}");
    let control = compare(&brightened(&image, 1.02), &reference);
    assert_eq!(control.passes(), Some(false), "2 % brighter passes: {file} on {engine:?}\n{control}");
}

#[test]
fn cornell_box_agrees_with_mitsuba() {
    agrees_with_mitsuba("cornell-box", "cornell", Engine::Cpu, 1024, 21);
    agrees_with_mitsuba("cornell-box", "cornell", Engine::Wavefront(Schedule::Fused), 1024, 22);
}

#[test]
fn bansal_room_1_agrees_with_mitsuba() {
    agrees_with_mitsuba("bansal-room-1", "seed1", Engine::Cpu, 512, 23);
}

#[test]
fn bansal_room_5_agrees_with_mitsuba() {
    agrees_with_mitsuba("bansal-room-5", "seed5", Engine::Cpu, 512, 24);
}

/// The light is in the other room: the noisiest of the five, and so the most samples.
#[test]
fn door_ajar_agrees_with_mitsuba() {
    agrees_with_mitsuba("door-ajar", "door", Engine::Cpu, 3072, 27);
}

#[test]
fn mesh_agrees_with_mitsuba() {
    agrees_with_mitsuba("mesh", "mesh", Engine::Cpu, 1024, 28);
    agrees_with_mitsuba("mesh", "mesh", Engine::Wavefront(Schedule::Fused), 512, 29);
}

/// All light of the caustic is found by chance, so its noise has a long tail.
#[test]
fn glass_caustic_agrees_with_mitsuba() {
    agrees_with_mitsuba("glass-caustic", "caustic", Engine::Cpu, 1024, 26);
}
