//! Guided directions against their densities, on the CPU: octants, quadtrees, Bansal's rule, and each of them mixed with
//! the material's own choice.
//!
//! As in samplers/, each χ² test has α = 1e-4, and a density a few per cent off must have a chance below 1e-9.

use crate::samplers::{ALPHA, Cells, WRONG};
use crate::support::scene;
use crate::tables::*;
use glam::{Vec3, Vec4Swizzles};
use qtracer::Sampler;
use qtracer::accel::Search;
use qtracer::guiding::octant::{
    Draws, acceptance, octant_of, octant_shares, octant_wholes, propose_in_octant,
};
use qtracer::guiding::table::{adaptive, bansal, octants};
use qtracer::guiding::{GuideMode, LessonLayout, LessonSums};
use qtracer::random::{SampleKey, sample4};
use qtracer::sampling::pdf_cosine;
use qtracer::scene::compiled::{CompiledScene, KIND_DIFFUSE, KIND_MIRROR, Material, Uniforms};
use qtracer::scene::shapes::Surface;
use qtracer::transport::guide::{Guidance, GuidePoint, MOST_PROPOSED};
use qtracer::transport::path::Transport;
use std::f32::consts::FRAC_1_PI;

/// Cells whose quadrature has the edges of octants and of all quadtree leaves between its points.
fn compass() -> Cells {
    Cells { rows: 16, columns: 32, ..Cells::sphere(Vec3::Z) }
}

fn key(sample: u32) -> SampleKey {
    SampleKey { pixel: 3, sample, seed: 43 }
}

/// The numbers of a guided choice.
fn numbers(i: u32) -> glam::Vec4 {
    sample4(Sampler::Independent, key(i), qtracer::random::dimension_guide(0, 0))
}

/// p-value of draws against their density, which must integrate to 1.
fn follows(what: &str, sample: impl Fn(u32) -> Vec3, pdf: impl Fn(Vec3) -> f32) {
    let pdf = |d: Vec3| f64::from(pdf(d));
    let integrals = compass().integrate(pdf);
    let integral: f64 = integrals.iter().sum();
    assert!((integral - 1.0).abs() < 1e-3, "{what}: the density integrates to {integral}");
    let p = compass().chi2_of(|i| Some(sample(i)), &integrals);
    assert!(p > ALPHA, "{what}: p = {p}");
}

/// The same draws do not follow this density.
fn does_not_follow(what: &str, sample: impl Fn(u32) -> Vec3, pdf: impl Fn(Vec3) -> f32) {
    let p = compass().chi2(|i| Some(sample(i)), |d| f64::from(pdf(d)));
    assert!(p < WRONG, "{what}: a wrong density passes with p = {p}");
}

/// Where the `i`-th direction's further numbers come from.
fn draws(i: u32) -> Draws {
    Draws { sampler: Sampler::Independent, key: key(i), bounce: 0 }
}

/// Along an axis, almost, close to the diagonal, askew, in the plane between two axes.
fn normals() -> [Vec3; 6] {
    [
        Vec3::Y,
        Vec3::new(1e-4, -1.0, 1e-3),
        Vec3::new(0.55, 0.6, -0.58),
        Vec3::new(-0.1, 0.3, 0.95),
        Vec3::new(0.7, -0.7, 0.0),
        Vec3::new(-0.9, -0.2, 0.05),
    ]
    .map(Vec3::normalize)
}

/// Inside an octant, and only there, proposals have the density Σ max(0, n_i·ω_i)/(π·whole).
#[test]
fn proposals_in_an_octant_follow_their_density() {
    let (mut whole, mut cut) = (0, 0);
    for normal in normals() {
        let wholes = octant_wholes(normal);
        for octant in (0..8).filter(|&octant| octant_shares(normal)[octant as usize] > 1e-3) {
            let sample = |i| propose_in_octant(normal, octant, numbers(i).yz());
            let inside = |d: Vec3, pdf: f32| if octant_of(d) == octant { pdf } else { 0.0 };
            let pdf = |d| inside(d, acceptance(normal, d).proposed * FRAC_1_PI / wholes[octant as usize]);
            follows(&format!("octant {octant} about {normal}"), sample, pdf);
            let is_cut = (normal * qtracer::guiding::octant::octant_signs(octant)).min_element() < 0.0;
            *if is_cut { &mut cut } else { &mut whole } += 1;
            // Negative control: the cosine, which the horizon makes of them.
            if is_cut && octant_shares(normal)[octant as usize] < 0.8 * wholes[octant as usize] {
                let share = octant_shares(normal)[octant as usize];
                does_not_follow("cosine", sample, |d| inside(d, pdf_cosine(normal.dot(d)) / share));
            }
        }
    }
    assert!(whole >= 6 && cut >= 10, "{whole} whole octants, {cut} cut ones");
}

/// What a proposal comes to is the integral of its density before it is made one: of positive terms of the cosine.
#[test]
fn proposals_of_octants_come_to_no_less_than_their_shares() {
    for normal in normals() {
        let (shares, wholes) = (octant_shares(normal), octant_wholes(normal));
        for octant in 0..8 {
            let (share, whole) = (shares[octant], wholes[octant]);
            assert!(share <= whole + 1e-6, "{normal}, octant {octant}: {share} of {whole}");
            let signs = qtracer::guiding::octant::octant_signs(octant as u32);
            if (normal * signs).min_element() >= 0.0 {
                assert!((share - whole).abs() < 1e-6, "{normal}, octant {octant}: {share} is not {whole}");
            }
        }
        // Four octants lie on the positive side of each axis.
        let total = wholes.iter().sum::<f32>();
        assert!((total - normal.abs().element_sum()).abs() < 1e-6, "{normal}: {total}");
    }
}

/// Octants alone, whatever their cell's trust: what they propose and the horizon keeps, the cosine lobe in place of the rest.
#[test]
fn octant_directions_follow_their_density() {
    let world = World::new(GuideMode::Octant, 5);
    let transport = world.transport();
    for (i, normal) in normals().into_iter().enumerate() {
        let point = GuidePoint { mixture: 1.0 - 1e-6, ..world.point(i as u32, normal, &diffuse()) };
        let sample = |i| transport.guided_direction(&point, normal, numbers(i).yz(), &draws(i));
        let cosine = |d: Vec3| pdf_cosine(normal.dot(d));
        let pdf = |d| octants::density(&point.cell, point.mean, point.proposed, cosine(d), d).pdf;
        follows(&format!("octants about {normal}"), sample, pdf);
        // Negative control: 10 % more in one octant of those that matter.
        let most = (0..8).max_by_key(|&a| {
            (point.cell.octants[a as usize] * octant_shares(normal)[a as usize] * 1e6) as u32
        });
        let wrong = |d| if Some(octant_of(d)) == most { 1.1 * pdf(d) } else { pdf(d) };
        does_not_follow("a tenth more", sample, wrong);
        // And as if the horizon kept all.
        if point.mean < 0.9 * point.proposed {
            let kept_all = |d| octants::density(&point.cell, point.mean, point.mean, cosine(d), d).pdf;
            does_not_follow("exact product", sample, kept_all);
        }
    }
}

/// Where the horizon turns proposals down, more are made: as many directions follow the octants as were asked for, and no density
/// is lower than the material's own leaves it.
#[test]
fn as_many_directions_are_guided_as_were_asked_for() {
    let world = World::new(GuideMode::Octant, 9);
    let transport = world.transport();
    let (mut all, mut most) = (0, 0);
    for (i, normal) in normals().into_iter().enumerate() {
        let point = world.point(i as u32, normal, &diffuse());
        let asked = point.cell.trust * world.learnt.table.uniforms.mixture;
        let guided = point.mixture * point.mean / point.proposed;
        assert!(
            guided <= asked + 1e-6 && point.mixture <= MOST_PROPOSED + 1e-6,
            "{normal}: {guided} for {asked}"
        );
        match point.mixture < 0.999 * MOST_PROPOSED {
            true => assert!((guided - asked).abs() < 1e-5, "{normal}: {guided} for {asked}"),
            false => most += 1,
        }
        all += 1;
        for d in uniform_directions() {
            let own = (1.0 - asked) * pdf_cosine(normal.dot(d));
            let pdf = transport.guided_pdf(&point, normal, d);
            assert!(pdf >= 0.999 * own, "{normal}: {pdf} towards {d}, below {own}");
        }
    }
    assert!(most < all, "all are at the limit");
}

#[test]
fn quadtree_directions_follow_their_density() {
    for seed in [6, 7] {
        let learnt = learnt(GuideMode::Adaptive, seed);
        for i in [0, 1, 2, 11, 25] {
            let (cell, _) = learnt.cell(i);
            let sample = |i| adaptive::sample(&learnt.table, &cell, numbers(i).yz()).0;
            let pdf = |d| adaptive::density(&learnt.table, &cell, d).pdf;
            follows(&format!("quadtrees of cell {}", cell.index), sample, pdf);
            let uniform = 0.25 * std::f32::consts::FRAC_1_PI;
            does_not_follow("a twentieth uniform", sample, |d| 0.95 * pdf(d) + 0.05 * uniform);
        }
    }
}

/// What a transport needs besides its table.
struct World {
    scene: &'static CompiledScene,
    search: Search<'static>,
    uniforms: Uniforms,
    learnt: Learnt,
    sums: LessonSums,
}

impl World {
    fn new(mode: GuideMode, seed: u32) -> World {
        let scene: &CompiledScene = Box::leak(Box::new(CompiledScene::new(&scene("cornell-box"))));
        let learnt = learnt(mode, seed);
        let sums = LessonSums::new(LessonLayout::new(&learnt.table.uniforms));
        World { search: Search::new(scene), uniforms: Uniforms::default(), scene, learnt, sums }
    }

    fn transport(&self) -> Transport<'_> {
        let guidance = Guidance { mode: self.learnt.mode, table: &self.learnt.table, sums: &self.sums };
        Transport { guidance: Some(guidance), ..Transport::plain(self.scene, &self.search, &self.uniforms) }
    }

    /// What the guide knows at the `i`-th surface point, at a surface that turns `normal` that way.
    fn point(&self, i: u32, normal: Vec3, material: &Material) -> GuidePoint {
        let surface = Surface::plain(surface_point(77, i).0, normal, 0.0);
        self.transport().guide_point(&surface, normal, material).expect("a Lambertian lobe")
    }
}

fn diffuse() -> Material {
    Material { color: Vec3::splat(0.5), kind: KIND_DIFFUSE, ..Default::default() }
}

/// The numbers with which a material draws its own directions.
fn own_numbers(i: u32) -> glam::Vec2 {
    sample4(Sampler::Independent, key(i), 1).xy()
}

#[test]
fn redrawn_directions_follow_the_density_that_bansal_left_out() {
    let world = World::new(GuideMode::BansalReweighted, 8);
    let transport = world.transport();
    let threshold = world.learnt.table.uniforms.threshold;
    let mut rules = 0;
    for (i, normal) in normals().into_iter().enumerate() {
        let point = world.point(4 * i as u32, normal, &diffuse());
        let sample = |i| transport.guided_direction(&point, normal, own_numbers(i), &draws(i));
        let pdf = |d| bansal::pdf(&point.cell, threshold, normal, d);
        follows(&format!("Bansal's rule about {normal}"), sample, pdf);
        assert!(uniform_directions().all(|d| pdf(d) == transport.guided_pdf(&point, normal, d)));
        let accepted: f32 = (0..8)
            .filter(|&a| bansal::accepts(&point.cell, threshold, a))
            .map(|a| octant_shares(normal)[a as usize])
            .sum();
        // Negative control: the cosine, which Bansal divides by.
        if (0.02..0.98).contains(&accepted) {
            rules += 1;
            does_not_follow("the cosine alone", sample, |d| pdf_cosine(normal.dot(d)));
        }
    }
    assert!(rules >= 3, "in {rules} cells only does the rule redraw");
}

fn uniform_directions() -> impl Iterator<Item = Vec3> {
    (0..500).map(|i| uniform_direction(31, i))
}

/// What a surface chooses in all: the guide's directions and its own, in cells that trust their guide.
#[test]
fn mixed_directions_follow_their_density() {
    for mode in [GuideMode::Adaptive, GuideMode::Octant] {
        let world = World::new(mode, 9);
        let transport = world.transport();
        for i in 0..6 {
            let material = match i % 2 {
                0 => diffuse(),
                _ => Material { kind: KIND_MIRROR, parameter: 0.3, ..diffuse() },
            };
            let normal =
                if mode == GuideMode::Octant { normals()[i as usize] } else { surface_point(77, i).1 };
            let point = world.point(i, normal, &material);
            assert!(point.mixture > 0.2, "{mode}: cell {i} is hardly guided: {}", point.mixture);
            let sample = |i| transport.guided_direction(&point, normal, own_numbers(i), &draws(i));
            let pdf = |d| transport.guided_pdf(&point, normal, d) / point.share;
            follows(&format!("{mode}, cell {i}"), sample, pdf);
            assert!(uniform_directions().all(|d| {
                transport.guided_density(&point, normal, d).pdf == transport.guided_pdf(&point, normal, d)
            }));
            // Negative control: up to a fifth more towards one side.
            does_not_follow(&format!("{mode}: askew"), sample, |d| pdf(d) * (1.0 + 0.2 * d.x));
        }
    }
}

/// Whatever octants know, the weights of their directions are 1 on average: light behind the surface alone, next to an axis, where shares
/// are smaller than their errors; too little light for quotients; very uneven light. 4.5 standard errors, about 1e-5 each.
#[test]
fn weights_of_octants_are_one_on_average_whatever_was_learnt() {
    const DRAWS: u32 = 100_000;
    let behind = |octant: usize| std::array::from_fn(|a| if a == octant { 1.0 } else { 0.0 });
    let askew = Vec3::new(-0.1, 0.3, 0.95);
    let cases: [(Vec3, [f32; 8], bool); 8] = [
        (Vec3::new(2.4e-8, 2.07e-5, 1.0), behind(6), false),
        (Vec3::new(3.284_103e-8, 4.868_87e-8, 1.0), behind(4), false),
        (Vec3::new(1.0, 1.278_653_5e-7, 7.397_488e-7), behind(5), false),
        (Vec3::new(0.2, 0.1, 1.0), behind(6), true),
        (Vec3::new(0.1, 0.02, 1.0), [1e-3, 0.0, 0.0, 0.0, 1.0, 1.0, 1.0, 1.0], true),
        (askew, [1e-31, 2e-31, 3e-31, 4e-31, 1e-31, 1e-31, 1e-31, 5e-31], false),
        (askew, [1e-6, 0.0, 1.0, 0.0, 0.0, 0.0, 1e3, 0.0], true),
        (askew, [1e36; 8], true),
    ];
    let mut world = World::new(GuideMode::Octant, 9);
    for (normal, octants, guided) in cases {
        let normal = normal.normalize();
        world.learnt.set_octants(0, octants);
        let transport = world.transport();
        let point = world.point(0, normal, &diffuse());
        assert_eq!(point.mixture > 0.0, guided, "{normal} {octants:?}: {}", point.mixture);
        let weights: Vec<f64> = (0..DRAWS)
            .map(|i| {
                let d = transport.guided_direction(&point, normal, own_numbers(i), &draws(i));
                let pdf = transport.guided_pdf(&point, normal, d);
                if pdf > 0.0 { f64::from(pdf_cosine(normal.dot(d)) / pdf) } else { 0.0 }
            })
            .collect();
        let mean = weights.iter().sum::<f64>() / f64::from(DRAWS);
        let variance = weights.iter().map(|w| (w - mean).powi(2)).sum::<f64>() / f64::from(DRAWS);
        let error = (variance / f64::from(DRAWS)).sqrt().max(1e-6);
        assert!((mean - 1.0).abs() < 4.5 * error, "{normal} {octants:?}: {mean} ± {error}");
    }
}

/// Before a cell has learnt, and where there is none, directions are the material's own.
#[test]
fn where_nothing_was_learnt_nothing_is_guided() {
    for mode in MODES {
        let mut world = World::new(mode, 10);
        world.learnt.table = new_learner(mode).table(true, &[]);
        let transport = world.transport();
        let normal = normals()[3];
        let point = world.point(0, normal, &diffuse());
        assert_eq!((point.mixture, point.mean), (0.0, 0.0), "{mode}");
        for d in uniform_directions() {
            assert_eq!(transport.guided_pdf(&point, normal, d), pdf_cosine(normal.dot(d)), "{mode}");
        }
    }
}
