//! Lookup and sampler of maps, both twins.

use super::{ball_under, direction_of, map_of, maps, one_bright, radiance_of};
use crate::probe::{Numbers, floats, row};
use crate::samplers::twins::{SIDES, Twins, World};
use crate::samplers::{ALPHA, DRAW, DRAW_IMPORTS, WRONG, draw};
use glam::{DVec3, Vec3};
use qtracer::scene::EnvironmentMap;
use qtracer::scene::compiled::CompiledScene;
use qtracer::scene::rows::Row;
use qtracer::scene::sky::{sample_sky, sky_at};
use qtracer::stats::chi2_test;
use std::f64::consts::{PI, TAU};

fn world(map: EnvironmentMap) -> World {
    World::of(CompiledScene::new(&ball_under(map)))
}

/// What arrives from the direction a, and the density of that.
const LOOKUP: (&str, &str) = (
    "import package::scene::sky::sky_at;",
    "let s = sky_at(bitcast<vec3<f32>>(a.xyz));
    out0 = vec4<u32>(bitcast<vec3<u32>>(s.radiance), bitcast<u32>(s.pdf));",
);

fn lookup(world: &World, [a]: &[Row; 1]) -> [Row; 1] {
    let s = sky_at(world.scene.sky.as_ref().unwrap(), floats(*a).0);
    [row(s.radiance, s.pdf.to_bits())]
}

/// A direction by the program's own numbers, its density, and what arrives.
const SAMPLE: (&str, &str) = (
    "import package::scene::sky::sample_sky;",
    "let s = sample_sky(u);
    out0 = vec4<u32>(bitcast<vec3<u32>>(s.wi), bitcast<u32>(s.pdf));
    out1 = vec4<u32>(bitcast<vec3<u32>>(s.radiance), 0u);",
);

fn sample(world: &World, [a]: &[Row; 1]) -> [Row; 2] {
    let s = sample_sky(&world.scene, draw(a[3]));
    [row(s.wi, s.pdf.to_bits()), row(s.radiance, 0)]
}

/// Directions everywhere, and many at the poles, at the seam and at centres of texels.
fn directions(map: &EnvironmentMap) -> Vec<Vec3> {
    let mut numbers = Numbers(11);
    let mut all: Vec<DVec3> = (0..4000).map(|_| numbers.direction()).collect();
    all.extend([DVec3::Y, DVec3::NEG_Y, DVec3::NEG_Z, DVec3::Z, DVec3::X]);
    for _ in 0..300 {
        let near = numbers.in_box(1e-3);
        all.extend([DVec3::Y + near, DVec3::NEG_Y + near, DVec3::new(near.x, near.y * 900.0, -1.0)]);
        let texel = [map.width(), map.height()].map(|n| numbers.below(n as usize) as f64);
        all.push(direction_of(map, texel[0], texel[1]));
    }
    all.into_iter().map(|d| d.normalize().as_vec3()).collect()
}

/// Radiance is that of f64 to within a share of the four texels around: their packing, 2⁻¹⁸, and the place between them, of
/// which longitude and latitude are off by 1.5e-6 of a radian on the GPU of the tests.
#[test]
fn maps_are_looked_up_as_in_f64() {
    let mut worst = [0f64; 2];
    for (name, map) in maps() {
        let world = world(map.clone());
        let twins = Twins::new(&world, LOOKUP, lookup);
        let asked = directions(&map);
        let questions: Vec<_> = asked.iter().map(|d| [row(*d, 0)]).collect();
        let brightest = f64::from(map.brightest());
        for (worst, side) in worst.iter_mut().zip(SIDES) {
            for (d, [answer]) in asked.iter().zip(twins.answer(side, &questions)) {
                let expected = radiance_of(&map, d.as_dvec3());
                let error = (floats(answer).0.as_dvec3() - expected).abs().max_element() / brightest;
                // Near a pole longitude is as uncertain as the direction is long there.
                let sine = f64::from(d.x.hypot(d.z)).max(1e-6);
                *worst = worst.max(error * sine);
                assert!(
                    error < 4e-6 + 4e-6 * f64::from(map.width()) / sine,
                    "{side:?}, {name}, {d}: {error:e}"
                );
            }
        }
    }
    println!(
        "worst errors times the sine, of the brightest texel: {:.1e} and {:.1e} (CPU, GPU)",
        worst[0], worst[1]
    );
    // Negative control: a map turned by a hundredth of a texel is another.
    let (_, map) = maps().swap_remove(2);
    let turned = world(map.clone().rotated(0.3));
    let off = |d: &Vec3| {
        (sky_at(turned.scene.sky.as_ref().unwrap(), *d).radiance.as_dvec3() - radiance_of(&map, d.as_dvec3()))
            .length()
    };
    assert!(directions(&map).iter().filter(|d| off(d) > 1e-3).count() > 1000);
}

/// ∫ pdf dω by midpoints of a grid that refines the patches: pdf · sinθ is bilinear within each, so they are exact.
fn integral(world: &World, map: &EnvironmentMap) -> f64 {
    const FINE: u32 = 8;
    let (columns, rows) = (FINE * map.width(), 2 * FINE * map.height());
    let step = (TAU / f64::from(columns), PI / f64::from(rows));
    let places = (0..rows).flat_map(|row| (0..columns).map(move |column| (column, row)));
    let sum = places.map(|(column, row)| {
        let (x, y) = (
            (f64::from(column) + 0.5) / f64::from(FINE) - 0.5,
            (f64::from(row) + 0.5) / f64::from(2 * FINE) - 0.5,
        );
        let d = direction_of(map, x, y).as_vec3();
        f64::from(sky_at(world.scene.sky.as_ref().unwrap(), d).pdf) * f64::from(d.x.hypot(d.z))
    });
    sum.sum::<f64>() * step.0 * step.1
}

#[test]
fn densities_of_maps_integrate_to_one() {
    for (name, map) in maps() {
        let found = integral(&world(map.clone()), &map);
        println!("{name}: {:.1e}", found - 1.0);
        assert!((found - 1.0).abs() < 2e-5, "{name}: the density integrates to {found}");
    }
}

/// Wherever radiance is, directions are chosen, and not in the dark: density over radiance is the same everywhere but for the
/// solid angles that patches have by their sines, at most π/2 of each other in the coarsest map, and for patches raised to
/// 1/4096 of the average.
#[test]
fn densities_follow_radiance() {
    for (name, map) in maps() {
        let world = world(map.clone());
        let sky = world.scene.sky.as_ref().unwrap();
        for d in directions(&map).into_iter().filter(|d| d.x.hypot(d.z) > 0.02) {
            let met = sky_at(sky, d);
            let lit = f64::from(met.radiance.element_sum());
            assert_eq!(lit > 0.0, met.pdf > 0.0, "{name}, {d}: {met:?}");
            let ratio = f64::from(met.pdf) * sky.irradiance / lit;
            let patch = PI / f64::from(map.height());
            let sine = f64::from(d.x.hypot(d.z));
            let most = 1.001 + 0.6 * patch / sine;
            assert!(
                lit == 0.0 || (0.9 / most..most).contains(&ratio) || lit < 0.02 * sky.irradiance / 12.0,
                "{name}, {d}: {ratio}"
            );
        }
    }
}

/// What is sampled is what is looked up there: radiance and density, on both sides. The lookup finds its place in the map from
/// the direction, which f32 knows to 1e-7 of a radian, and divides by the sine.
#[test]
fn samples_of_maps_are_as_looked_up() {
    for (name, map) in maps() {
        let world = world(map.clone());
        let (imports, body) = (format!("{DRAW_IMPORTS}{}", SAMPLE.0), format!("{DRAW}{}", SAMPLE.1));
        let twins = Twins::new(&world, (&imports, &body), sample);
        let questions: Vec<_> = (0..4000).map(|i| [[0, 0, 0, i]]).collect();
        let brightest = map.brightest() * 3.0;
        let mut worst = 0f32;
        let [cpu, gpu] = SIDES.map(|side| twins.answer(side, &questions));
        for (i, answers) in cpu.iter().zip(&gpu).map(|(c, g)| [c, g]).enumerate() {
            for [wi, radiance] in answers {
                let ((wi, pdf), (radiance, _)) = (floats(*wi), floats(*radiance));
                let met = sky_at(world.scene.sky.as_ref().unwrap(), wi);
                let sine = wi.x.hypot(wi.z).max(1e-6);
                let size = map.width().max(map.height()) as f32;
                let radiance_error = (met.radiance - radiance).abs().max_element() / brightest * sine / size;
                // Beside a patch in the dark only the edge is known.
                let density_error = (met.pdf - pdf).abs() * sine * sine / size / met.pdf.max(pdf).max(0.05);
                worst = worst.max(radiance_error).max(density_error);
                assert!(
                    radiance_error < 3e-6 && density_error < 3e-5,
                    "{name}, {i}: {met:?} for {pdf}, {radiance}"
                );
                assert!((wi.length() - 1.0).abs() < 1e-6, "{name}, {i}: {wi}");
            }
            let [(c, _), (g, _)] = answers.map(|answer| floats(answer[0]));
            assert!((c - g).length() < 2e-6, "{name}, {i}: {c} and {g}");
        }
        println!("{name}: worst {worst:.1e}");
    }
}

/// Cells of equal longitude and colatitude in which directions are counted: some for each texel.
struct Grid<'a> {
    map: &'a EnvironmentMap,
    columns: u32,
    rows: u32,
}

impl Grid<'_> {
    fn new(map: &EnvironmentMap) -> Grid<'_> {
        Grid { map, columns: 2 * map.width().max(4), rows: 4 * map.height() }
    }

    fn find(&self, d: Vec3) -> usize {
        let d = d.as_dvec3();
        let turns = (d.x.atan2(-d.z) / TAU + self.map.rotate_y_deg() / 360.0).rem_euclid(1.0);
        let column = ((turns * f64::from(self.columns)) as u32).min(self.columns - 1);
        let row = (d.x.hypot(d.z).atan2(d.y) / PI * f64::from(self.rows)) as u32;
        (row.min(self.rows - 1) * self.columns + column) as usize
    }

    /// Integrals of a density over all cells, by midpoints.
    fn integrate(&self, pdf: impl Fn(Vec3) -> f64) -> Vec<f64> {
        const FINE: u32 = 8;
        let (columns, rows) = (FINE * self.columns, FINE * self.rows);
        let area = TAU / f64::from(columns) * PI / f64::from(rows);
        let mut cells = vec![0.0; (self.columns * self.rows) as usize];
        for (row, column) in (0..rows).flat_map(|row| (0..columns).map(move |column| (row, column))) {
            let texel = |i: u32, cells: u32, texels: u32| {
                (f64::from(i) + 0.5) / f64::from(cells) * f64::from(texels) - 0.5
            };
            let x = texel(column, columns, self.map.width());
            let d = direction_of(self.map, x, texel(row, rows, self.map.height())).as_vec3();
            let cell = row / FINE * self.columns + column / FINE;
            cells[cell as usize] += area * f64::from(d.x.hypot(d.z)) * pdf(d);
        }
        cells
    }

    /// p-value of directions against the integrals of a density.
    fn p_value(&self, draws: &[Vec3], integrals: &[f64]) -> f64 {
        let mut observed = vec![0u64; integrals.len()];
        draws.iter().for_each(|d| observed[self.find(*d)] += 1);
        let expected: Vec<f64> = integrals.iter().map(|p| (p * draws.len() as f64).max(1e-6)).collect();
        chi2_test(&observed, &expected).unwrap().p_value
    }
}

/// χ² on both sides (α = 1e-4 each). Negative controls: a density 4 % greater in every other column and 4 % less between, and one that forgets the
/// sine.
#[test]
fn directions_to_maps_follow_their_density() {
    for (name, map) in maps() {
        let world = world(map.clone());
        let sky = world.scene.sky.as_ref().unwrap();
        let grid = Grid::new(&map);
        let integrals = grid.integrate(|d| sky_at(sky, d).pdf.into());
        let sum: f64 = integrals.iter().sum();
        assert!((sum - 1.0).abs() < 1e-4, "{name}: the density integrates to {sum}");
        let normalised = |cells: Vec<f64>| {
            let sum: f64 = cells.iter().sum();
            cells.into_iter().map(|cell| cell / sum).collect::<Vec<f64>>()
        };
        let side = |i: usize| if i.is_multiple_of(2) { 1.04 } else { 0.96 };
        let askew = normalised(integrals.iter().enumerate().map(|(i, p)| p * side(i)).collect());
        let flat = normalised(grid.integrate(|d| f64::from(sky_at(sky, d).pdf) * f64::from(d.x.hypot(d.z))));
        let (imports, body) = (format!("{DRAW_IMPORTS}{}", SAMPLE.0), format!("{DRAW}{}", SAMPLE.1));
        let twins = Twins::new(&world, (&imports, &body), sample);
        let questions: Vec<_> = (0..1u32 << 18).map(|i| [[0, 0, 0, i]]).collect();
        for side in SIDES {
            let answers = twins.answer(side, &questions);
            let draws: Vec<Vec3> = answers.into_iter().map(|[wi, _]| floats(wi).0).collect();
            let p = grid.p_value(&draws, &normalised(integrals.clone()));
            assert!(p > ALPHA, "{side:?}, {name}: p = {p}");
            for wrong in [&askew, &flat] {
                let p = grid.p_value(&draws, wrong);
                assert!(p < WRONG, "{side:?}, {name}: a wrong density passes with p = {p}");
            }
        }
    }
}

/// The convention, said in words: the middle of the picture is +z, the quarter to its left +x, the top +y; a turn by 90° takes
/// the middle to +x.
#[test]
fn pictures_lie_as_they_are_said_to() {
    let found = |map: EnvironmentMap| {
        let scene = CompiledScene::new(&ball_under(map));
        let sky = scene.sky.unwrap();
        let axes = [Vec3::X, Vec3::Y, Vec3::Z, Vec3::NEG_X, Vec3::NEG_Y, Vec3::NEG_Z];
        let lit = axes.map(|axis| sky_at(&sky, axis).radiance.x > 1.0);
        lit.iter().position(|&lit| lit).filter(|_| lit.iter().filter(|&&lit| lit).count() == 1)
    };
    // Odd numbers of columns and rows have a middle.
    assert_eq!(found(one_bright(15, 9, 7, 4)), Some(2), "the middle is +z");
    assert_eq!(found(one_bright(16, 9, 4, 4)), Some(0), "the quarter to the left is +x");
    assert_eq!(found(one_bright(16, 9, 12, 4)), Some(3), "the quarter to the right is -x");
    assert_eq!(found(map_of(4, 9, |_, row| [f32::from(row as u8 == 0) * 9.0; 3])), Some(1), "the top is +y");
    assert_eq!(found(one_bright(15, 9, 7, 4).rotated(90.0)), Some(0), "turned by 90°, the middle is +x");
    assert_eq!(found(one_bright(16, 9, 4, 4).rotated(90.0)), Some(5), "turned by 90°, +x is -z, as of a box");
}
