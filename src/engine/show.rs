//! What was learnt, seen through the camera: Bansal's figure 11. Few rays, so always by the CPU twins.

use crate::accel::Search;
use crate::bsdf::{bsdf_sample, lambert_share};
use crate::film::{GuideLayers, srgb_to_linear};
use crate::guiding::octant::{octant_shares, octant_signs};
use crate::guiding::quadtree::{leaf_depth, ticket_direction};
use crate::guiding::table::{Cell, NO_CELL, octants};
use crate::guiding::{GuideMode, GuideTable, Learner};
use crate::random::{DIMENSION_CAMERA, SampleKey, Sampler, dimension_bsdf, sample4};
use crate::scene::camera::camera_ray;
use crate::scene::compiled::{CompiledScene, Uniforms};
use crate::scene::shading::viewed_normal;
use crate::scene::shapes::{shape_info, spawn_ray, surface_at};
use crate::scene::texels::textured;
use glam::{Vec2, Vec3, Vec4Swizzles};
use rayon::prelude::*;
use std::f32::consts::FRAC_1_PI;
use std::fmt;

/// Paths per pixel: edges are smoothed as in the image.
const SAMPLES: u32 = 16;
/// Mirrors and glass that are looked through at most.
const MOST_BOUNCES: u32 = 16;

/// Pictures of what was learnt.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum GuideView {
    /// Mean radiance as grey.
    Illumination,
    /// Mean direction of the light: red x, green y, blue z, half of each for 0.
    Direction,
    /// A colour per cell.
    Cells,
    /// How widely light comes in: white from everywhere alike, dark from one direction.
    Entropy,
}

impl fmt::Display for GuideView {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            GuideView::Illumination => "illumination",
            GuideView::Direction => "direction",
            GuideView::Cells => "cells",
            GuideView::Entropy => "entropy",
        })
    }
}

impl GuideView {
    /// The picture in linear RGB; black where nothing was learnt. Illumination is radiance; the values of the others are
    /// found in the bytes of a .png.
    pub fn picture(self, layers: &GuideLayers) -> Vec<[f32; 3]> {
        let shown = |value: f32| srgb_to_linear(value.clamp(0.0, 1.0));
        match self {
            GuideView::Illumination => layers.illumination.iter().map(|&value| [value; 3]).collect(),
            GuideView::Direction => layers.direction.iter().map(|&d| colour_of(d).map(shown)).collect(),
            GuideView::Cells => layers.cell.iter().map(|&cell| cell_colour(cell).map(shown)).collect(),
            GuideView::Entropy => layers.entropy.iter().map(|&value| [shown(value); 3]).collect(),
        }
    }
}

fn colour_of(direction: [f32; 3]) -> [f32; 3] {
    if direction == [0.0; 3] { direction } else { direction.map(|d| 0.5 + 0.5 * d) }
}

/// Random, the same for the same number, and never dark.
fn cell_colour(cell: f32) -> [f32; 3] {
    if cell < 0.0 {
        return [0.0; 3];
    }
    let key = SampleKey { pixel: cell as u32, sample: 0, seed: 0 };
    let u = sample4(Sampler::Independent, key, 0);
    [u.x, u.y, u.z].map(|channel| 0.2 + 0.8 * channel)
}

/// What a cell has learnt about where light comes from.
#[derive(Clone, Copy, Debug, Default)]
struct Summary {
    /// Of any length.
    direction: Vec3,
    /// As in [`GuideLayers::entropy`].
    entropy: f32,
}

/// A part of the sphere of directions: its probability, its share of the sphere, a direction in its middle.
struct Part {
    probability: f32,
    area: f32,
    direction: Vec3,
}

impl Summary {
    /// The entropy of parts of even density, h = −Σ p ln(p/a), tells how much of the sphere they effectively cover: eʰ.
    fn new(parts: impl Iterator<Item = Part>) -> Summary {
        let (mut direction, mut entropy) = (Vec3::ZERO, 0.0);
        for part in parts.filter(|part| part.probability > 0.0) {
            direction += part.probability * part.direction;
            entropy -= part.probability * (part.probability / part.area).ln();
        }
        // Surfaces see one hemisphere, half of the sphere.
        Summary { direction, entropy: (2.0 * entropy.exp()).min(1.0) }
    }
}

/// Leaves of an adaptive cell, by their tickets.
fn leaves(table: &GuideTable, cell: &Cell) -> Vec<Part> {
    let tickets: Vec<u32> = (0..1 << cell.log_tickets).map(|i| table.table_word(cell.at + i)).collect();
    let of_leaf = |same: &[u32]| {
        let area = 0.125 * 0.25f32.powi(leaf_depth(same[0]) as i32);
        let probability = same.len() as f32 / tickets.len() as f32;
        Part { probability, area, direction: ticket_direction(same[0], Vec2::splat(0.5)) }
    };
    tickets.chunk_by(|a, b| a == b).map(of_leaf).collect()
}

/// Octants of a cell as a surface with this normal sees them, each with its share of the cosine lobe.
fn octant_parts(cell: &Cell, normal: Vec3) -> impl Iterator<Item = Part> {
    let shares = octant_shares(normal);
    let weights: [f32; 8] = std::array::from_fn(|a| cell.octants[a] * shares[a]);
    let total: f32 = weights.iter().sum();
    (0..8).filter(move |_| total > 0.0).map(move |a| Part {
        probability: weights[a] / total,
        area: 0.125,
        direction: octant_signs(a as u32).normalize(),
    })
}

/// The table and what can be told about its cells once and for all.
struct Learnt {
    mode: GuideMode,
    table: GuideTable,
    /// Adaptive: per cell.
    summaries: Vec<Summary>,
}

impl Learnt {
    fn new(learner: &Learner) -> Learnt {
        let (mode, table) = (learner.mode(), learner.snapshot());
        let adaptive = mode == GuideMode::Adaptive;
        let cells = if adaptive { table.cells() } else { Vec::new() };
        let summary = |cell: Cell| {
            let known = cell.irradiance > 0.0;
            if known { Summary::new(leaves(&table, &cell).into_iter()) } else { Summary::default() }
        };
        let summaries = cells.into_par_iter().map(summary).collect();
        Learnt { mode, table, summaries }
    }

    /// What is known at a surface point: mean radiance, the rest, the cell. None where there is no cell.
    fn at(&self, position: Vec3, normal: Vec3) -> Option<(f32, Summary, u32)> {
        let place = self.table.place(position, normal);
        if place.cell == NO_CELL {
            return None;
        }
        let (number, cell) = (place.cell, self.table.cell(place.row));
        Some(match self.mode {
            GuideMode::Adaptive => (cell.irradiance * FRAC_1_PI, self.summaries[number as usize], number),
            _ => {
                let mean = octants::radiance(&cell, &octant_shares(normal));
                let known = mean > 0.0;
                let summary =
                    if known { Summary::new(octant_parts(&cell, normal)) } else { Summary::default() };
                (mean, summary, number)
            }
        })
    }
}

/// What a scene's surfaces have learnt, through its camera.
struct Viewer<'a> {
    scene: &'a CompiledScene,
    search: Search<'a>,
    uniforms: &'a Uniforms,
    learnt: Learnt,
}

impl Viewer<'_> {
    /// What is known where the path of a sample first meets a Lambertian surface, mirrors and glass passed.
    fn look(&self, pixel: u32, key: SampleKey, u: Vec2) -> Option<(f32, Summary, u32)> {
        let width = self.uniforms.width;
        let mut ray = camera_ray(self.uniforms, [pixel % width, pixel / width], u);
        for bounce in 0..MOST_BOUNCES {
            let hit = self.search.intersect(ray)?;
            let mut surface = surface_at(self.scene, ray, hit);
            let index = shape_info(self.scene, hit.shape).material;
            let material = &match self.scene.surfaces.is_textured() {
                false => self.scene.materials[index as usize],
                true => textured(self.scene, index, &mut surface),
            };
            let outside = ray.direction.dot(surface.normal) < 0.0;
            let facing = if outside { surface.normal } else { -surface.normal };
            let normal = viewed_normal(&surface, facing, outside, -ray.direction, material.kind);
            if lambert_share(material) > 0.0 {
                return self.learnt.at(surface.position, normal);
            }
            let u = sample4(Sampler::Stratified, key, dimension_bsdf(bounce)).xyz();
            ray = spawn_ray(&surface, bsdf_sample(material, normal, -ray.direction, outside, u).wi);
        }
        None
    }

    /// Illumination, direction, cell and entropy of a pixel.
    fn pixel(&self, pixel: u32) -> (f32, [f32; 3], f32, f32) {
        let (mut illumination, mut direction, mut entropy) = (0.0, Vec3::ZERO, 0.0);
        for sample in 0..SAMPLES {
            let key = SampleKey { pixel, sample, seed: self.uniforms.seed };
            let u = sample4(Sampler::Stratified, key, DIMENSION_CAMERA);
            let Some((mean, summary, _)) = self.look(pixel, key, u.xy()) else { continue };
            illumination += mean;
            direction += summary.direction.normalize_or_zero();
            entropy += summary.entropy;
        }
        let key = SampleKey { pixel, sample: 0, seed: self.uniforms.seed };
        let cell = self.look(pixel, key, Vec2::splat(0.5)).map_or(-1.0, |(_, _, cell)| cell as f32);
        let share = 1.0 / SAMPLES as f32;
        (illumination * share, direction.normalize_or_zero().to_array(), cell, entropy * share)
    }
}

/// Means over each pixel, the cell at its middle.
pub fn guide_layers(scene: &CompiledScene, uniforms: &Uniforms, learner: &Learner) -> GuideLayers {
    let viewer = Viewer { scene, search: Search::new(scene), uniforms, learnt: Learnt::new(learner) };
    let pixels: Vec<_> =
        (0..uniforms.width * uniforms.height).into_par_iter().map(|pixel| viewer.pixel(pixel)).collect();
    GuideLayers {
        illumination: pixels.iter().map(|p| p.0).collect(),
        direction: pixels.iter().map(|p| p.1).collect(),
        cell: pixels.iter().map(|p| p.2).collect(),
        entropy: pixels.iter().map(|p| p.3).collect(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn part(probability: f32, area: f32, direction: Vec3) -> Part {
        Part { probability, area, direction }
    }

    #[test]
    fn entropy_is_the_share_of_the_hemisphere_that_light_comes_from() {
        let hemisphere = Summary::new([part(1.0, 0.5, Vec3::Z)].into_iter());
        assert!((hemisphere.entropy - 1.0).abs() < 1e-6);
        let cut = [part(0.25, 0.125, Vec3::Z), part(0.75, 0.375, Vec3::X), part(0.0, 0.5, Vec3::Y)];
        assert!((Summary::new(cut.into_iter()).entropy - 1.0).abs() < 1e-6);
        let lamp = Summary::new([part(1.0, 0.005, Vec3::X)].into_iter());
        assert!((lamp.entropy - 0.01).abs() < 1e-6);
        assert_eq!(lamp.direction, Vec3::X);
        let sphere = Summary::new([part(1.0, 1.0, Vec3::X)].into_iter());
        assert_eq!(sphere.entropy, 1.0);
    }

    #[test]
    fn octants_are_seen_by_their_share_of_the_cosine() {
        let cell = Cell { octants: [1.0; 8], irradiance: 1.0, trust: 1.0, ..Default::default() };
        let summary = Summary::new(octant_parts(&cell, Vec3::Z));
        assert!((summary.entropy - 1.0).abs() < 1e-5 && summary.direction.normalize().z > 0.999);
        let dark = Cell { octants: [0.0; 8], ..cell };
        assert_eq!(octant_parts(&dark, Vec3::Z).count(), 0);
    }

    #[test]
    fn pictures_are_black_where_nothing_was_learnt() {
        let layers = GuideLayers {
            illumination: vec![0.0, 2.0],
            direction: vec![[0.0; 3], [1.0, 0.0, 0.0]],
            cell: vec![-1.0, 3.0],
            entropy: vec![0.0, 0.5],
        };
        for view in [GuideView::Illumination, GuideView::Direction, GuideView::Cells, GuideView::Entropy] {
            let picture = view.picture(&layers);
            assert_eq!(picture[0], [0.0; 3], "{view}");
            assert!(picture[1][0] > 0.02, "{view}: {:?}", picture[1]);
        }
        assert_ne!(cell_colour(3.0), cell_colour(4.0));
    }
}
