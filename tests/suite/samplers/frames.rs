//! Bases about normals.

use super::twins::{SIDES, Twins, World, Worst, all_obey};
use crate::guiding_maths::normal;
use crate::oracles::sampling::{ROUNDING, frame_error};
use crate::probe::{floats, row};
use glam::Vec3;
use proptest::prelude::*;
use qtracer::math::frame_around;
use qtracer::scene::rows::Row;

/// How far from orthonormal a basis may be, in roundings. The normal itself is off by one.
const BOUND: f64 = 10.0;

const FRAME: (&str, &str) = (
    "import package::base::vector::frame_around;",
    "let frame = frame_around(bitcast<vec3<f32>>(a.xyz));
    out0 = vec4<u32>(bitcast<vec3<u32>>(frame.tangent), 0u);
    out1 = vec4<u32>(bitcast<vec3<u32>>(frame.bitangent), 0u);",
);

fn frame(_: &World, [n]: &[Row; 1]) -> [Row; 2] {
    let (tangent, bitangent) = frame_around(floats(*n).0);
    [row(tangent, 0), row(bitangent, 0)]
}

/// Normals this close to a pole, from 2⁻³⁰ to 1.
fn near_a_pole() -> impl Strategy<Value = Vec3> {
    let off = || (-30.0f32..0.0, any::<bool>()).prop_map(|(e, s)| if s { e.exp2() } else { -e.exp2() });
    (off(), off(), any::<bool>())
        .prop_map(|(x, y, up)| Vec3::new(x, y, if up { 1.0 } else { -1.0 }).normalize())
}

/// The poles, their neighbours in f32, zeros of both signs, subnormal components.
fn edge_cases() -> Vec<Vec3> {
    let next_to_one = 1.0 - f32::EPSILON / 2.0;
    let sine = (1.0 - next_to_one * next_to_one).sqrt();
    let mut cases = Vec::new();
    for x in [0.0, -0.0, 1e-45, -1e-40, 1e-38] {
        cases.extend([1.0, -1.0, next_to_one, -next_to_one].map(|z| Vec3::new(x, -x, z)));
        cases.extend([Vec3::new(1.0, x, x), Vec3::new(x, -1.0, -x), Vec3::new(0.6, -0.8, x)]);
    }
    cases.extend([1.0, -1.0].map(|z: f32| Vec3::new(sine, 0.0, z * next_to_one)));
    cases.extend([1.0, -1.0].map(|z: f32| Vec3::new(0.0, -sine, z * next_to_one)));
    cases
}

#[test]
fn frames_are_orthonormal_and_right_handed_at_the_poles_and_everywhere() {
    let world = World::of_all_materials();
    let twins = Twins::new(&world, FRAME, frame);
    for side in SIDES {
        let worst = Worst::default();
        let faults = |normals: &[Vec3]| {
            let questions: Vec<_> = normals.iter().map(|n| [row(*n, 0)]).collect();
            let answers = twins.answer(side, &questions);
            let errors = normals.iter().zip(answers).map(|(n, [t, b])| {
                let basis = [floats(t).0, floats(b).0, *n];
                let error = worst.see(frame_error(basis) / ROUNDING);
                (!error.is_finite() || error > BOUND).then(|| format!("{basis:?} is {error} roundings off"))
            });
            errors.collect()
        };
        all_obey("poles", prop::sample::select(edge_cases()), 200, faults);
        all_obey("frames", prop_oneof![normal(), near_a_pole()], 30_000, faults);
        println!("{side:?}: frames are orthonormal to {} roundings", worst.get());
    }
}

/// The formula without Duff's sign loses its digits where n_z → −1, and the test sees it.
#[test]
fn a_frame_that_cancels_at_a_pole_is_found() {
    let frisvad = |n: Vec3| {
        let a = 1.0 / (1.0 + n.z);
        let b = -n.x * n.y * a;
        [Vec3::new(1.0 - n.x * n.x * a, b, -n.x), Vec3::new(b, 1.0 - n.y * n.y * a, -n.y), n]
    };
    let error = |z: f32| frame_error(frisvad(Vec3::new(1e-3, -2e-3, z).normalize())) / ROUNDING;
    assert!(error(1.0) < BOUND && error(-1.0) > 100.0, "{} {}", error(1.0), error(-1.0));
}
