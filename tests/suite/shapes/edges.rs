//! Edges that quads share: closed boxes seen from inside, by rays aimed at their edges.

use super::empty;
use super::twins::{Aimed, Twin, aimed, both_twins, with_hierarchy};
use crate::oracles::geometry::{ROUNDING, unit};
use crate::probe::{Numbers, floats};
use glam::DVec3;
use qtracer::scene::compiled::{CompiledScene, NONE};
use qtracer::scene::{Material, SceneBuilder};

/// A closed box of six quads: corner and three edges.
struct Room {
    name: &'static str,
    corner: DVec3,
    edges: [DVec3; 3],
}

impl Room {
    fn sides(&self) -> [(DVec3, DVec3, DVec3); 6] {
        let (c, [x, y, z]) = (self.corner, self.edges);
        [(c, x, y), (c, y, z), (c, z, x), (c + z, x, y), (c + x, y, z), (c + y, z, x)]
    }

    fn compiled(&self, material: &str) -> CompiledScene {
        let lamp = Material::diffuse([0.5; 3]).emitting([1.0; 3]);
        let add = |b: SceneBuilder, (corner, e1, e2)| b.quad(corner, e1, e2, material);
        let builder = self.sides().into_iter().fold(empty().material("lamp", lamp), add);
        CompiledScene::new(&builder.build().unwrap())
    }

    /// A ray from inside at an edge, past it by up to `beside` of the room's size, or none.
    fn ray(&self, numbers: &mut Numbers, beside: f64) -> Aimed {
        let mut inner = || numbers.between(0.01, 0.99);
        let from = DVec3::new(inner(), inner(), inner());
        let mut at = DVec3::new(inner(), inner(), inner());
        let along = numbers.below(3);
        for k in [1, 2] {
            let by = numbers.between(-beside, beside);
            at[(along + k) % 3] = [0.0, 1.0][numbers.below(2)] + by;
        }
        let point = |s: DVec3| self.corner + self.edges[0] * s.x + self.edges[1] * s.y + self.edges[2] * s.z;
        let origin = point(from).as_vec3();
        aimed(origin, unit(point(at) - origin.as_dvec3()), 0)
    }

    fn any_ray(&self, numbers: &mut Numbers) -> Aimed {
        let [a, b, c] = [(); 3].map(|()| numbers.between(0.01, 0.99));
        let origin = self.corner + self.edges[0] * a + self.edges[1] * b + self.edges[2] * c;
        aimed(origin.as_vec3(), unit(numbers.direction()), 0)
    }

    /// How closely the ray passes the edge nearest to where it leaves the box, in roundings of (largest coordinate + its
    /// length).
    fn distance_to_edge(&self, &[a, b]: &Aimed) -> f64 {
        let (origin, direction) = (floats(a).0.as_dvec3(), floats(b).0.as_dvec3());
        let [x, y, z] = self.edges;
        let normals = [y.cross(z), z.cross(x), x.cross(y)].map(DVec3::normalize);
        // Of two parallel planes it leaves through the one that it moves towards.
        let side =
            |k: usize| f64::from(u8::from(direction.dot(normals[k]) * self.edges[k].dot(normals[k]) > 0.0));
        let distance = |k: usize| {
            let from = origin - self.corner - self.edges[k] * side(k);
            -from.dot(normals[k]) / direction.dot(normals[k])
        };
        let mut planes = [0, 1, 2];
        planes.sort_by(|&j, &k| distance(j).total_cmp(&distance(k)));
        // It leaves through the nearest plane, past the edge where that meets the next, which runs along the third.
        let [first, next, along] = planes;
        let on_edge = self.corner + self.edges[first] * side(first) + self.edges[next] * side(next);
        let across = direction.cross(self.edges[along]).normalize();
        let (t, largest) = (distance(first), (on_edge.abs() + self.edges[along].abs()).max_element());
        (origin - on_edge).dot(across).abs() / (ROUNDING * (largest + t))
    }
}

fn rooms() -> Vec<Room> {
    let turned = |by: f64, v: DVec3| glam::DQuat::from_rotation_y(by) * glam::DQuat::from_rotation_x(0.3) * v;
    let axes = DVec3::AXES;
    vec![
        Room { name: "along axes", corner: DVec3::ZERO, edges: axes.map(|e| e * 555.0) },
        Room {
            name: "along axes, anywhere",
            corner: DVec3::new(-3.3, 0.7, 12.1),
            edges: axes.map(|e| e * 7.7),
        },
        Room { name: "turned", corner: DVec3::new(-0.5, 0.1, -0.4), edges: axes.map(|e| turned(0.7, e)) },
        Room {
            name: "turned, at 100 sizes",
            corner: DVec3::new(100.0, 30.0, -70.0),
            edges: axes.map(|e| turned(0.7, e)),
        },
        Room {
            name: "turned, at 10,000 sizes",
            corner: DVec3::new(1e4, 3e3, -7e3),
            edges: axes.map(|e| turned(0.7, e)),
        },
        Room {
            name: "slanted",
            corner: DVec3::new(-1.0, -0.2, 0.3),
            edges: [DVec3::new(2.0, 0.3, 0.1), DVec3::new(0.5, 1.4, -0.2), DVec3::new(-0.4, 0.9, 3.0)],
        },
    ]
}

/// What rays did that were aimed at edges.
#[derive(Debug, Default)]
struct Slipped {
    rays: usize,
    count: usize,
    /// How far from the nearest edge a ray that got out passed at most, in roundings of (largest coordinate + its length).
    worst: f64,
}

impl Slipped {
    fn add(&mut self, room: &Room, twin: &Twin, scene: &CompiledScene, rays: &[Aimed]) {
        self.rays += rays.len();
        for (ray, shape) in rays.iter().zip(twin.nearest(scene, rays)) {
            if shape == NONE {
                self.count += 1;
                self.worst = self.worst.max(room.distance_to_edge(ray));
            }
        }
    }
}

/// How far from an edge, in those roundings, rays may slip through where quads have no margin.
const SLIP_BOUND: f64 = 2.0;

/// Rays at the edges of a room of this material: within a millionth of its size, and within four roundings of its place.
fn slipped(twin: &Twin, room: &Room, material: &str, hierarchy: bool) -> Slipped {
    let all = room.compiled(material);
    let scene = if hierarchy { with_hierarchy(&all) } else { all };
    let mut slipped = Slipped::default();
    for beside in [1e-6, 4.0 * ROUNDING * room.corner.abs().max_element() / room.edges[0].length()] {
        let mut numbers = Numbers(31);
        let rays: Vec<Aimed> = (0..1 << 16).map(|_| room.ray(&mut numbers, beside)).collect();
        slipped.add(room, twin, &scene, &rays);
    }
    let by = if hierarchy { "hierarchy" } else { "all" };
    println!("{}, {material}, {} by {by}: {slipped:?}", room.name, twin.name());
    slipped
}

/// No ray gets out of a closed box of quads between two of them, however closely it passes their edge. Lamps have no margin
/// beyond their edges: out of a box of lamps rays slip within roundings of an edge, the negative control.
#[test]
fn no_ray_slips_between_quads_that_share_an_edge_unless_they_shine() {
    let twins = both_twins();
    for room in rooms() {
        for (twin, hierarchy) in [(0, false), (0, true), (1, false)] {
            let walls = slipped(&twins[twin], &room, "m", hierarchy);
            assert_eq!(walls.count, 0, "{}, seed 31: {walls:?}", room.name);
            let lamps = slipped(&twins[twin], &room, "lamp", hierarchy);
            assert!(lamps.count > 0 && lamps.worst < SLIP_BOUND, "{}, seed 31: {lamps:?}", room.name);
        }
    }
}

/// How often that is: rays from anywhere in the box into all directions.
#[test]
#[ignore = "long: 400 million rays on the CPU; tests/run --long"]
fn of_thirty_million_rays_in_a_box_none_slips_out() {
    for room in rooms() {
        for material in ["m", "lamp"] {
            let (scene, mut slipped) = (room.compiled(material), Slipped::default());
            for seed in 0..32 {
                let mut numbers = Numbers(seed);
                let rays: Vec<Aimed> = (0..1 << 20).map(|_| room.any_ray(&mut numbers)).collect();
                slipped.add(&room, &Twin::Cpu, &scene, &rays);
            }
            println!("{}, {material}: {slipped:?}", room.name);
            assert!(slipped.worst < SLIP_BOUND, "{}: {slipped:?}", room.name);
            assert!(material == "lamp" || slipped.count == 0, "{}: {slipped:?}", room.name);
        }
    }
}
