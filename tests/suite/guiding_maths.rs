//! The guide's table on the CPU: every point has a cell, every direction a leaf, shares of octants are exact, and what is
//! no radiance never gets in.

use crate::tables::*;
use glam::{DVec3, Vec2, Vec3};
use proptest::prelude::*;
use proptest::test_runner::RngSeed;
use qtracer::guiding::lessons::{VISIT_UNIT, fixed};
use qtracer::guiding::octant::{octant_of, octant_shares, octant_signs};
use qtracer::guiding::quadtree::{
    BLOCK_WORDS, FINER_BLOCK, MAX_DEPTH, TICKET_BITS, find_leaf, leaf_density, leaf_depth, leaf_number,
    octant_coordinates, octant_direction, ticket_direction,
};
use qtracer::guiding::table::{CELL_BITS, Cell, FINER, MAX_CELL_LEVELS, NO_CELL, adaptive, normal_sector};
use qtracer::guiding::{GuideMode, GuideTable, LessonSums, Transition};
use std::collections::BTreeMap;
use std::f64::consts::{FRAC_PI_2, PI};
use std::sync::LazyLock;

static ADAPTIVE: LazyLock<Learnt> = LazyLock::new(|| learnt(GuideMode::Adaptive, 1));

pub fn cases(count: u32) -> ProptestConfig {
    ProptestConfig {
        cases: count,
        failure_persistence: None,
        rng_seed: RngSeed::Fixed(5),
        ..Default::default()
    }
}

/// Numbers of every kind: zeros, subnormal ones, edges of cells, huge ones.
pub fn finite() -> impl Strategy<Value = f32> {
    prop_oneof![
        -4.0f32..4.0,
        (-8i32..8).prop_map(|i| i as f32 * CELL_SIZE),
        prop::sample::select(vec![0.0, -0.0, 1e-45, -1e-45, 1e-38, 1e30, -1e30, f32::MAX, f32::MIN]),
        prop::num::f32::NORMAL | prop::num::f32::SUBNORMAL,
    ]
}

pub fn vector(component: impl Strategy<Value = f32>) -> impl Strategy<Value = Vec3> {
    prop::array::uniform3(component).prop_map(Vec3::from)
}

/// Anything at all, NaN and infinities included.
pub fn anything() -> impl Strategy<Value = f32> {
    prop_oneof![4 => finite(), 1 => prop::num::f32::ANY]
}

/// Unit normals: any, along axes, and within a hair of axes and planes between them.
pub fn normal() -> impl Strategy<Value = Vec3> {
    let component = prop_oneof![
        4 => -1.0f32..1.0,
        1 => Just(0.0f32),
        1 => Just(-0.0f32),
        2 => (-30.0f32..-1.0, prop::bool::ANY).prop_map(|(e, s)| if s { e.exp2() } else { -e.exp2() }),
    ];
    vector(component).prop_filter("a direction", |n| n.length() > 1e-12).prop_map(|n| n.normalize())
}

/// What is wrong with a place, if anything.
fn place_fault(table: &GuideTable, position: Vec3, normal: Vec3) -> Option<String> {
    let place = table.place(position, normal);
    let in_range = place.base < table.uniforms.base_words()
        && place.eighth < 8
        && (place.cell == NO_CELL || place.cell < table.uniforms.cell_count);
    (!in_range).then(|| format!("{position} {normal}: {place:?}"))
}

/// Base cell of a place, per axis.
fn base_cell(table: &GuideTable, base: u32) -> [i64; 3] {
    let u = &table.uniforms;
    let i = base / u.sectors;
    [i % u.cells_x, i / u.cells_x % u.cells_y, i / u.cells_x / u.cells_y].map(i64::from)
}

/// The cell of a position, by bisection of boxes in f64. None outside the grid and close to edges.
fn cell_by_boxes(table: &GuideTable, position: Vec3, normal: Vec3) -> Option<(u32, u32)> {
    let u = &table.uniforms;
    let lifted = position.as_dvec3() + normal.as_dvec3() * f64::from(u.lift);
    let p = (lifted - u.origin.as_dvec3()) * f64::from(u.inverse_size);
    let corner = p.floor();
    if p.min_element() < 0.0 {
        return None;
    }
    let sector = if u.sectors > 1 { normal_sector(normal) } else { 0 };
    let [x, y, z] = corner.to_array().map(|v| v as u32);
    let row = |i: u32| table.rows[i as usize];
    let mut at = row(((z * u.cells_y + y) * u.cells_x + x) * u.sectors + sector);
    let (mut low, mut size) = (corner, 1.0);
    for _ in 0..=MAX_CELL_LEVELS {
        size *= 0.5;
        let inside = (p - low) / size - 1.0;
        if inside.abs().min_element() < 1e-3 || (inside.abs() - 1.0).abs().min_element() < 1e-3 {
            return None;
        }
        let high = DVec3::from(inside.to_array().map(|v| f64::from(u8::from(v > 0.0))));
        let eighth = (high.x + 2.0 * high.y + 4.0 * high.z) as u32;
        if at[1] == NO_CELL {
            return Some((NO_CELL, eighth));
        }
        if at[1] & FINER == 0 {
            return Some((at[1] & ((1 << CELL_BITS) - 1), eighth));
        }
        at = row(at[0] + eighth);
        low += high * size;
    }
    panic!("cells are cut more than {MAX_CELL_LEVELS} times");
}

proptest! {
    #![proptest_config(cases(20_000))]

    /// Total and in range, wherever the point is and whatever the normal.
    #[test]
    fn every_point_has_a_cell(position in vector(anything()), normal in vector(anything())) {
        prop_assert_eq!(place_fault(&ADAPTIVE.table, position, normal), None);
    }

    /// The cell is the one whose box holds the point.
    #[test]
    fn cells_hold_their_points(u in prop::array::uniform3(0.0f32..1.0), crowd in 0.02f32..1.0, n in normal()) {
        let position = LOW + Vec3::from(u) * crowd * (HIGH - LOW);
        let place = ADAPTIVE.table.place(position, n);
        if let Some(expected) = cell_by_boxes(&ADAPTIVE.table, position, n) {
            prop_assert_eq!((place.cell, place.eighth), expected);
        }
    }

    /// A step of one cell's edge leads into the next cell, a shorter one at most there.
    #[test]
    fn neighbouring_points_have_neighbouring_cells(
        u in prop::array::uniform3(0.0f32..1.0), axis in 0usize..3, step in 0.0f32..1.0, n in normal()
    ) {
        let table = &ADAPTIVE.table;
        let position = LOW + 0.05 + Vec3::from(u) * (HIGH - LOW - CELL_SIZE);
        let place = |length: f32| {
            let at = position + Vec3::AXES[axis] * (length * CELL_SIZE);
            base_cell(table, table.place(at, n).base)
        };
        let (here, near, next) = (place(0.0), place(step), place(1.0));
        for i in 0..3 {
            let moved = i64::from(i == axis);
            prop_assert!((here[i]..=here[i] + moved).contains(&near[i]), "{here:?} {near:?}");
            // Rounding may hold a point at an edge back, or push it on.
            let exact = ((position - table.uniforms.origin + n * table.uniforms.lift) * table.uniforms.inverse_size)[i];
            prop_assert!(next[i] == here[i] + moved || (exact - exact.round()).abs() < 1e-4, "{here:?} {next:?}");
        }
    }

    /// Octant ↔ signs: a bit is set exactly where a component is not above zero, and −0 is 0.
    #[test]
    fn octants_are_patterns_of_signs(direction in vector(finite())) {
        let octant = octant_of(direction);
        for axis in 0..3 {
            prop_assert_eq!(octant >> axis & 1 == 1, direction[axis] <= 0.0);
            prop_assert_eq!(octant_signs(octant)[axis], if direction[axis] <= 0.0 { -1.0 } else { 1.0 });
        }
        prop_assert_eq!(octant_of(octant_signs(octant)), octant);
    }

    #[test]
    fn every_direction_has_an_octant_and_a_leaf(direction in vector(anything())) {
        let octant = octant_of(direction);
        prop_assert!(octant < 8);
        let (cell, _) = ADAPTIVE.cell(0);
        let density = adaptive::density(&ADAPTIVE.table, &cell, direction);
        let u = &ADAPTIVE.table.uniforms;
        prop_assert!(density.slot < 8 * u.cell_count + 4 * u.node_count);
    }

    /// Direction → coordinates → direction. Where |z| is close to 1, its last place moves the direction more.
    #[test]
    fn octant_coordinates_and_directions_are_inverse(n in normal(), octant in 0u32..8, x in 0.0f32..1.0, y in 0.0f32..1.0) {
        let back = octant_direction(octant_of(n), octant_coordinates(n));
        let radius = (1.0 - n.z * n.z).max(0.0).sqrt();
        prop_assert!((back - n).length() < 4e-7 + (2e-7 / radius.max(1e-9)).min(5e-4), "{n} {back}");
        let p = octant_coordinates(octant_direction(octant, Vec2::new(x, y)));
        prop_assert!(p.y == y && (p.x - x).abs() < 1e-6, "{x} {y} {p}");
    }
}

/// A square of the map as recursion from an octant's block finds it.
struct Square {
    octant: u32,
    low: Vec2,
    size: f32,
    leaf: u32,
}

fn map_of(cell: &Cell) -> u32 {
    cell.at + (1 << cell.log_tickets)
}

fn squares(table: &GuideTable, cell: &Cell) -> Vec<Square> {
    let mut found = Vec::new();
    let mut open: Vec<_> = (0..8).map(|octant| (octant, octant, Vec2::ZERO, 1.0f32)).collect();
    while let Some((octant, block, low, size)) = open.pop() {
        for i in 0..BLOCK_WORDS {
            let size = 0.25 * size;
            let low = low + Vec2::new((i % 4) as f32, (i / 4) as f32) * size;
            match table.table_word(map_of(cell) + BLOCK_WORDS * block + i) {
                finer if finer & FINER_BLOCK != 0 => open.push((octant, finer & !FINER_BLOCK, low, size)),
                leaf => found.push(Square { octant, low, size, leaf }),
            }
        }
    }
    found
}

/// The cell's tickets.
fn tickets(table: &GuideTable, cell: &Cell) -> Vec<u32> {
    (0..1 << cell.log_tickets).map(|i| table.table_word(cell.at + i)).collect()
}

/// Tickets, map and points agree: the squares of a leaf make up its area, a leaf's points lead to it, each ticket's direction
/// lies in the leaf that it names, and leaves cover the sphere. The density of a leaf is its share of the tickets over its
/// solid angle.
#[test]
fn leaves_cover_the_sphere_and_hold_their_points() {
    let table = &ADAPTIVE.table;
    let (mut deepest, mut checked) = (0, 0);
    for cell in table.cells().iter().step_by(7) {
        let squares = squares(table, cell);
        let mut leaves: BTreeMap<u32, (u32, f64)> = BTreeMap::new();
        for (i, square) in squares.iter().enumerate() {
            let (leaf, area) = leaves.entry(leaf_number(square.leaf)).or_insert((square.leaf, 0.0));
            *area += f64::from(square.size * square.size);
            assert_eq!(*leaf, square.leaf, "one leaf, two words");
            let u = random(3, i as u32, square.octant);
            let p = square.low + Vec2::new(u.x, u.y) * square.size;
            let found = find_leaf(|i| table.table_word(i), map_of(cell), square.octant, p);
            assert_eq!(found, square.leaf, "{p}");
            checked += 1;
        }
        let tickets = tickets(table, cell);
        let (mut sphere, mut probability) = (0.0, 0.0);
        for &(leaf, area) in leaves.values() {
            assert_eq!(area, 0.25f64.powi(leaf_depth(leaf) as i32), "squares of a leaf");
            let density = f64::from(leaf_density(leaf, cell.log_tickets));
            sphere += FRAC_PI_2 * area;
            probability += FRAC_PI_2 * area * density;
            deepest = deepest.max(leaf_depth(leaf));
        }
        assert!((sphere / (4.0 * PI) - 1.0).abs() < 1e-12, "leaves cover {sphere}");
        assert!((probability - 1.0).abs() < 1e-5, "cell {}: {probability}", cell.index);
        for (i, ticket) in tickets.iter().enumerate() {
            let u = random(4, i as u32, 0);
            let direction = ticket_direction(*ticket, 0.01 + 0.98 * Vec2::new(u.x, u.y));
            let leaf = find_leaf(
                |i| table.table_word(i),
                map_of(cell),
                octant_of(direction),
                octant_coordinates(direction),
            );
            let count = tickets.iter().filter(|other| *other == ticket).count() as f64;
            let density = count / tickets.len() as f64 / (FRAC_PI_2 * leaves[&leaf_number(leaf)].1);
            for told in [leaf_density(*ticket, cell.log_tickets), leaf_density(leaf, cell.log_tickets)] {
                assert!((f64::from(told) / density - 1.0).abs() < 1e-6, "{told} for {density}");
            }
        }
    }
    assert_eq!(deepest, MAX_DEPTH, "no tree is as deep as it may be");
    assert!(checked > 10_000, "{checked}");
}

/// Shares of 4 × 4 squares of each octant among weighted directions.
fn shares(directions: impl Iterator<Item = (Vec3, f32)>) -> [f64; 128] {
    let mut shares = [0.0; 128];
    for (direction, weight) in directions {
        let [x, y] = (4.0 * octant_coordinates(direction)).to_array().map(|v| (v as usize).min(3));
        shares[16 * octant_of(direction) as usize + 4 * y + x] += f64::from(weight);
    }
    let sum: f64 = shares.iter().sum();
    shares.map(|share| share / sum)
}

/// How much of one must move to make the other: 0 to 1.
fn distance(a: [f64; 128], b: [f64; 128]) -> f64 {
    0.5 * a.iter().zip(&b).map(|(a, b)| (a - b).abs()).sum::<f64>()
}

/// Directions are drawn where lessons found light, but for what few lessons and the normals of a sector blur; turned about an
/// axis they are not.
#[test]
fn directions_go_where_light_comes_from() {
    const DRAWS: u32 = 4000;
    let (mut right, mut turned, mut cells) = (0.0, 0.0, 0.0);
    for i in (0..97).filter(|i| i % 4 == 1) {
        let (cell, normal) = ADAPTIVE.cell(i);
        let taught = shares((0..DRAWS).map(|i| ADAPTIVE.taught(i, normal)));
        let drawn = |i| {
            let u = random(71, i, 0);
            adaptive::sample(&ADAPTIVE.table, &cell, Vec2::new(u.x, u.y)).0
        };
        right += distance(shares((0..DRAWS).map(|i| (drawn(i), 1.0))), taught);
        let turn = |d: Vec3| Vec3::new(-d.y, d.x, d.z);
        turned += distance(shares((0..DRAWS).map(|i| (turn(drawn(i)), 1.0))), taught);
        cells += 1.0;
    }
    println!("{:.3} off, {:.3} where turned", right / cells, turned / cells);
    assert!(right < 0.3 * cells && turned > 0.6 * cells, "{} {}", right / cells, turned / cells);
}

/// What is wrong with a table's numbers, if anything.
fn table_fault(table: &GuideTable) -> Option<String> {
    let adaptive = table.uniforms.sectors > 1;
    for cell in table.cells() {
        let right = cell.octants.iter().all(|q| q.is_finite() && *q >= 0.0)
            && cell.irradiance.is_finite()
            && cell.irradiance >= 0.0
            && (0.0..=1.0).contains(&cell.trust);
        if !right {
            return Some(format!("{cell:?}"));
        }
        if adaptive && cell.trust > 0.0 {
            let tickets = tickets(table, &cell);
            let whole = |same: &[u32]| same[0] & ((1 << TICKET_BITS) - 1) == same.len() as u32;
            if !tickets.chunk_by(|a, b| a == b).all(whole) {
                return Some(format!("tickets of {cell:?}"));
            }
        }
    }
    None
}

#[test]
fn learnt_tables_hold_probabilities() {
    for mode in MODES {
        let table = learnt(mode, 2).table;
        assert_eq!(table_fault(&table), None, "{mode}");
        let cells = table.cells();
        assert!(
            cells.iter().filter(|cell| cell.irradiance > 0.0).count() > 100,
            "{mode} learnt next to nothing"
        );
        // Negative control: a NaN, an infinity or a negative number in a cell is found, and a ticket that is another leaf's.
        let row = table.rows.iter().position(|row| row[1] & FINER == 0).unwrap();
        for wrong in [f32::NAN, f32::INFINITY, -1.0] {
            let mut table = table.clone();
            table.rows[row][2] = wrong.to_bits();
            assert!(table_fault(&table).is_some(), "{mode}: {wrong} was not found");
        }
        if mode == GuideMode::Adaptive {
            let mut table = table.clone();
            let known = cells.iter().find(|cell| cell.trust > 0.0).unwrap();
            let words = 4 * table.uniforms.words_at as usize;
            table.rows.as_flattened_mut()[words + known.at as usize] ^= 1;
            assert!(table_fault(&table).is_some(), "a wrong ticket was not found");
        }
    }
    let index = &ADAPTIVE.table.rows[..ADAPTIVE.table.uniforms.words_at as usize];
    let cuts = index.iter().filter(|row| row[1] != NO_CELL && row[1] & FINER != 0).count();
    assert!(cuts > 8, "{cuts} cells were cut");
}

proptest! {
    #![proptest_config(cases(20_000))]

    /// Sums take what is a number of units, and nothing else.
    #[test]
    fn fixed_point_numbers_are_right_to_half_a_unit(value in anything(), exponent in -20i32..60) {
        let unit = (exponent as f32).exp2();
        let scaled = f64::from(value * unit);
        let units = fixed(value, unit) as f64;
        if scaled.is_finite() && scaled > 0.0 {
            let expected = scaled.min(281_474_976_710_656.0);
            prop_assert!((units - expected).abs() <= 0.5 + expected * 1e-7, "{value} · {unit}: {units}");
        } else {
            prop_assert_eq!(units, 0.0);
        }
    }
}

/// A pass of lessons that are no radiance leaves no trace, whatever slot they name; the same pass of right ones does.
#[test]
fn what_is_no_radiance_never_reaches_the_table() {
    for mode in MODES {
        let learner = learnt(mode, 3).learner;
        let before = learner.table(true, &[]);
        let learn = |value: f32, visit: f32| {
            let mut learner = learner.clone();
            let mut sums = LessonSums::new(learner.layout());
            for slot in 0..8 * before.uniforms.cell_count {
                sums.learn(&before, &Transition { slot, value, visited: slot, visit });
            }
            let lessons = sums.take();
            learner.learn(&lessons, 1);
            (lessons, learner.table(true, &[]))
        };
        for wrong in [f32::NAN, -f32::NAN, f32::INFINITY, f32::NEG_INFINITY, -1.0, -0.0, f32::MIN] {
            let (lessons, after) = learn(wrong, wrong);
            assert!(lessons.values.iter().chain(&lessons.visits).all(|sum| *sum == 0), "{mode}: {wrong}");
            assert_eq!(after.rows, before.rows, "{mode}: {wrong}");
        }
        assert_ne!(learn(1.0, 1.0).1.rows, before.rows, "{mode} learns nothing at all");
        assert_eq!(table_fault(&learn(f32::MAX, f32::MAX).1), None, "{mode}");
    }
    assert_eq!(fixed(1.0, VISIT_UNIT), 1 << 20);
}

/// ∫ max(0, n·ω)/π over an octant: over z in closed form, over φ by midpoints.
fn share_by_quadrature(normal: Vec3, octant: u32) -> f64 {
    const STEPS: usize = 4096;
    let s = (normal * octant_signs(octant)).as_dvec3();
    let inner = |phi: f64| {
        let across = s.x * phi.cos() + s.y * phi.sin();
        // Antiderivative of across·√(1 − z²) + s.z·z, which changes its sign at most once.
        let at = |z: f64| 0.5 * across * (z * (1.0 - z * z).max(0.0).sqrt() + z.asin()) + 0.5 * s.z * z * z;
        let zero = across.abs() / (across * across + s.z * s.z).sqrt().max(1e-300);
        match (across > 0.0, s.z > 0.0) {
            (true, true) => at(1.0),
            (false, false) => 0.0,
            (true, false) => at(zero.min(1.0)),
            (false, true) => at(1.0) - at(zero.min(1.0)),
        }
    };
    let step = FRAC_PI_2 / STEPS as f64;
    (0..STEPS).map(|i| step * inner(step * (i as f64 + 0.5))).sum::<f64>() / PI
}

pub fn share_error(normal: Vec3, octant: u32, share: f32) -> f64 {
    (f64::from(share) - share_by_quadrature(normal, octant)).abs()
}

proptest! {
    #![proptest_config(cases(400))]

    #[test]
    fn octant_shares_are_right_to_a_millionth(n in normal()) {
        let shares = octant_shares(n);
        prop_assert!((shares.iter().sum::<f32>() - 1.0).abs() < 1e-6, "{n:?}: {shares:?}");
        for octant in 0..8 {
            let error = share_error(n, octant, shares[octant as usize]);
            prop_assert!(error < 1e-6, "{n:?}, octant {octant}: {} is {error:e} off", shares[octant as usize]);
        }
    }
}

#[test]
fn octant_shares_are_right_at_axes_and_next_to_them() {
    for axis in Vec3::AXES.into_iter().flat_map(|axis| [axis, -axis]) {
        for octant in 0..8 {
            let expected = if axis.dot(octant_signs(octant)) > 0.0 { 0.25 } else { 0.0 };
            assert!((octant_shares(axis)[octant as usize] - expected).abs() < 1e-7, "{axis}");
        }
        for tilt in [1e-8f32, 1e-5, 1e-4, 3e-4, 1e-3, 1e-2] {
            for towards in [Vec3::new(0.3, 0.6, -0.7), Vec3::new(-1.0, 0.0, 0.5), Vec3::ONE] {
                let n = (axis + tilt * towards).normalize();
                for octant in 0..8 {
                    let error = share_error(n, octant, octant_shares(n)[octant as usize]);
                    assert!(error < 1e-6, "{n:?}, octant {octant}: {error:e} off");
                }
            }
        }
    }
    // Negative control: a normal a thousandth off is found.
    let n = Vec3::new(0.6, -0.5, 0.3).normalize();
    assert!(share_error(n, 0, octant_shares((n + Vec3::X * 1e-3).normalize())[0]) > 1e-5);
}
