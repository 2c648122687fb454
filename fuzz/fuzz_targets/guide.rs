//! Files of what a guide has learnt; their checksum is made right, else nothing behind it would be met.
#![no_main]

use std::sync::Arc;

use libfuzzer_sys::fuzz_target;
use qtracer::RenderOptions;
use qtracer::guiding::{GuideOptions, Learner};
use qtracer::math::fnv1a;
use qtracer::scene::Material;

fuzz_target!(init: qtracer_fuzz::prepare(), |body: &[u8]| {
    let bytes = [body, &fnv1a([body]).to_le_bytes()].concat();
    let learner = match Learner::from_bytes(&bytes) {
        Ok(learner) => learner,
        Err(error) => return assert!(!error.to_string().is_empty()),
    };
    learner.snapshot();
    let scene = qtracer_fuzz::square().material("grey", Material::diffuse([0.5; 3])).build();
    let guide = GuideOptions { mode: learner.mode(), ..GuideOptions::default() };
    let options = RenderOptions { guide, guide_table: Some(Arc::new(learner)), ..RenderOptions::cpu() };
    qtracer_fuzz::render(&scene.expect("a valid scene"), options);
});
