//! Tables that have learnt made-up light: what the tests of the guide look up, draw from and upload.

use glam::{Vec3, Vec4, Vec4Swizzles};
use qtracer::Sampler;
use qtracer::guiding::lessons::MISSING;
use qtracer::guiding::octant::octant_of;
use qtracer::guiding::table::{Cell, NO_CELL, adaptive};
use qtracer::guiding::{GuideMode, GuideOptions, GuideTable, Learner, LessonLayout, LessonSums, Transition};
use qtracer::math::to_world;
use qtracer::random::{SampleKey, sample4};
use qtracer::sampling::{sample_cone, sample_cosine};

/// Corners of the box that holds the made-up surface points.
pub const LOW: Vec3 = Vec3::new(-1.0, 0.0, -2.0);
pub const HIGH: Vec3 = Vec3::new(3.0, 2.5, 1.0);
/// Edge of a base cell.
pub const CELL_SIZE: f32 = 0.5;
/// Lessons of a pass, and passes after which quadtrees are as deep as they get and cells were cut several times.
const LESSONS: u32 = 40_000;
/// Paths that a lesson stands for.
const LESSON_PATHS: f32 = 32.0;
const PASSES: u32 = 9;

/// The modes that have a table of their own.
pub const MODES: [GuideMode; 4] =
    [GuideMode::Adaptive, GuideMode::Octant, GuideMode::Bansal, GuideMode::BansalReweighted];

/// A learner after its passes, and the table that it made.
pub struct Learnt {
    pub mode: GuideMode,
    light: Light,
    pub learner: Learner,
    pub table: GuideTable,
}

pub fn random(seed: u32, i: u32, dimension: u32) -> Vec4 {
    sample4(Sampler::Independent, SampleKey { pixel: 17, sample: i, seed }, dimension)
}

pub fn uniform_direction(seed: u32, i: u32) -> Vec3 {
    let u = random(seed, i, 900);
    let z = 2.0 * u.x - 1.0;
    let (sin, cos) = (std::f32::consts::TAU * u.y).sin_cos();
    let r = (1.0 - z * z).max(0.0).sqrt();
    Vec3::new(r * cos, r * sin, z)
}

/// Surface points: half of them crowd in one corner, and half of these in its tip, so that cells there are cut. Normals
/// along axes and askew.
pub fn surface_point(seed: u32, i: u32) -> (Vec3, Vec3) {
    let u = random(seed, i, 901);
    let crowd = [0.01, 1.0, 0.1, 1.0][i as usize % 4];
    let normals = [Vec3::Y, Vec3::NEG_X, Vec3::new(0.5, -0.3, 0.9).normalize()];
    (LOW + u.xyz() * crowd * (HIGH - LOW), normals[(3.0 * u.w) as usize])
}

/// Three lobes of light, from a few degrees to less than one.
struct Light {
    lobes: [(Vec3, f32); 3],
}

impl Light {
    fn new(seed: u32) -> Light {
        Light {
            lobes: [0, 1, 2]
                .map(|i| (uniform_direction(seed, 1_000_000 + i), [5.0, 80.0, 5000.0][i as usize])),
        }
    }

    fn radiance(&self, direction: Vec3) -> f32 {
        let lobe = |(axis, sharpness): &(Vec3, f32)| (sharpness * (axis.dot(direction) - 1.0)).exp();
        0.05 + self.lobes.iter().map(lobe).sum::<f32>()
    }

    /// Directions of the hemisphere, many of them where light comes from.
    fn direction(&self, seed: u32, i: u32, normal: Vec3) -> Vec3 {
        let u = random(seed, i, 902);
        let direction = match (5.0 * u.z) as usize {
            lobe @ 0..3 => {
                let (axis, sharpness) = self.lobes[lobe];
                to_world(sample_cone(u.xy(), (3.0 / sharpness).min(1.0)), axis)
            }
            _ => to_world(sample_cosine(u.xy()), normal),
        };
        if normal.dot(direction) > 0.0 { direction } else { -direction }
    }
}

/// What a path that met this point would teach.
fn lesson(mode: GuideMode, table: &GuideTable, light: &Light, seed: u32, i: u32) -> Transition {
    let (position, normal) = surface_point(seed, i);
    let place = table.place(position, normal);
    if place.cell == NO_CELL {
        return Transition { visited: MISSING | place.base, visit: 1.0, ..Default::default() };
    }
    let direction = light.direction(seed, i, normal);
    let cosine = normal.dot(direction);
    let octant_slot = 8 * place.cell + octant_of(direction);
    let slot = match mode {
        GuideMode::Adaptive => adaptive::density(table, &table.cell(place.row), direction).slot,
        _ => octant_slot,
    };
    let (visited, visit) = match mode {
        GuideMode::Adaptive => (8 * place.cell + place.eighth, 1.0),
        GuideMode::Octant => (octant_slot, cosine),
        _ => (octant_slot, 1.0),
    };
    let value = light.radiance(direction) * cosine * LESSON_PATHS;
    Transition { slot, value, visited, visit: visit * LESSON_PATHS }
}

pub fn new_learner(mode: GuideMode) -> Learner {
    let options = GuideOptions { mode, cell_size: Some(CELL_SIZE), alpha: Some(0.5), ..Default::default() };
    Learner::new(options, LOW, HIGH, 4.0).unwrap()
}

/// A table that learnt the light of this seed.
pub fn learnt(mode: GuideMode, seed: u32) -> Learnt {
    let mut learner = new_learner(mode);
    let light = Light::new(seed);
    for pass in 0..PASSES {
        let table = learner.table(true, &[]);
        let mut sums = LessonSums::new(LessonLayout::new(&table.uniforms));
        for i in 0..LESSONS {
            sums.learn(&table, &lesson(mode, &table, &light, seed, pass * LESSONS + i));
        }
        learner.learn(&sums.take(), 1);
    }
    let table = learner.table(true, &[]);
    Learnt { mode, light, learner, table }
}

impl Learnt {
    /// The `i`-th of directions like those of its lessons, and what such a lesson brings.
    pub fn taught(&self, i: u32, normal: Vec3) -> (Vec3, f32) {
        let direction = self.light.direction(70, i, normal);
        (direction, self.light.radiance(direction) * normal.dot(direction))
    }

    /// The row of the index that tells of the `i`-th of them.
    pub fn row(&self, i: u32) -> u32 {
        let (position, normal) = surface_point(77, i);
        self.table.place(position, normal).row
    }

    /// The `i`-th of some cells in which surfaces are, and the normal there.
    pub fn cell(&self, i: u32) -> (Cell, Vec3) {
        let (position, normal) = surface_point(77, i);
        let place = self.table.place(position, normal);
        assert_ne!(place.cell, NO_CELL, "no cell was made at {position}");
        (self.table.cell(place.row), normal)
    }

    /// Octant guides: has the `i`-th of them know that.
    pub fn set_octants(&mut self, i: u32, octants: [f32; 8]) {
        let (row, at) = (self.row(i) as usize, self.cell(i).0.at as usize);
        let first = 4 * self.table.uniforms.words_at as usize + at;
        self.table.rows.as_flattened_mut()[first..first + 8].copy_from_slice(&octants.map(f32::to_bits));
        self.table.rows[row][2] = octants.iter().sum::<f32>().to_bits();
    }
}
