//! Committing: sums of a pass become what is known, and without quadtrees rows of the table, as Rust says, and Rust as
//! arithmetic in f64 says.

use super::*;
use crate::probe::Numbers;
use crate::tables::MODES;
use qtracer::gpu::stage::CELLS_AT_ONCE;
use qtracer::guiding::commit::{OCTANT_WORDS, TRUSTED_VISITS, commit};
use qtracer::guiding::lessons::VISIT_UNIT;
use qtracer::guiding::state::{CellState, CellTrees};
use qtracer::guiding::{GuideState, GuideTable, GuideUniforms, LessonLayout, Lessons};

/// Rows before and behind those of the index, and behind those of octants.
const MARGIN: u32 = 3;
/// Numbers below this may be flushed to zero on their way.
const TINY: f64 = 1e-30;
/// Twin against f64. A sum is three roundings of 2⁻²⁴ off, the visits of a cell 6 more, a blend 5, and each of up to seven
/// levels of a tree adds 3.
const ROUNDINGS: f64 = 35.0 / 16_777_216.0;
/// Bansal's rule: … times an exponent of up to 80, which two roundings went into.
const ROUNDINGS_BANSAL: f64 = ROUNDINGS + 80.0 * 4.0 / 16_777_216.0;
/// Kernel against twin: divisions of 2.5 units in the last place and fused products. Measured on lavapipe: 0.
const KERNEL: f64 = 2e-6;
/// … and exponentials of up to −80, which may be 3 + 2 · 80 units off.
const KERNEL_BANSAL: f64 = KERNEL + 163.0 / 8_388_608.0;

/// A state and the lessons of a pass about it.
struct Case {
    mode: GuideMode,
    uniforms: GuideUniforms,
    state: GuideState,
    lessons: Lessons,
}

/// Trees of a cell, breadth first: each of its nodes has each child with this chance, down to `depth`.
fn trees(numbers: &mut Numbers, chance: f64, depth: u32) -> (u32, Vec<u32>) {
    let mask = |numbers: &mut Numbers, bits: u32, open: bool| {
        (0..bits).map(|i| u32::from(open && numbers.between(0.0, 1.0) < chance) << i).sum::<u32>()
    };
    let roots = mask(numbers, 8, depth > 0);
    let mut levels = vec![1; roots.count_ones() as usize];
    let mut children = Vec::new();
    while children.len() < levels.len() {
        let level = levels[children.len()];
        let below = mask(numbers, 4, level < depth && levels.len() < 1500);
        children.push((levels.len() as u32) << 4 | below);
        levels.extend(vec![level + 1; below.count_ones() as usize]);
    }
    (roots, children)
}

fn energy(numbers: &mut Numbers) -> f32 {
    if numbers.below(5) == 0 { 0.0 } else { numbers.of_any_size(1e-12, 1e12) as f32 }
}

/// Sums of any size, those at the ends of 32 and 64 bits included.
fn sum(numbers: &mut Numbers) -> u64 {
    let edges = [0, 1, u64::from(u32::MAX), 1 << 32, (1 << 32) + 1, u64::MAX];
    match numbers.below(12) {
        at @ 0..6 => edges[at],
        _ => numbers.of_any_size(1.0, 1.8e19) as u64,
    }
}

/// Cells without trees, with few nodes, with thin deep trees and with broad ones; a third of them not met.
fn case(mode: GuideMode, cells: u32, memory: f32, seed: u64) -> Case {
    let mut numbers = Numbers(seed);
    let adaptive = mode == GuideMode::Adaptive;
    let mut state = GuideState::default();
    for i in 0..cells {
        let (chance, depth) = [(0.0, 0), (0.5, 1), (0.3, 7), (0.28, 7), (0.9, 3)][i as usize % 5];
        let (roots, children) = if adaptive { trees(&mut numbers, chance, depth) } else { (0, Vec::new()) };
        let weight = energy(&mut numbers);
        let cell = CellState {
            octants: [(); 8].map(|()| energy(&mut numbers)),
            visits: [(); 8].map(|()| if adaptive { weight } else { energy(&mut numbers) }),
        };
        let first_node = state.nodes.len() as u32;
        // Not in the order of the cells, and with rows between them that lead to none.
        let row = MARGIN + 2 * (cells - 1 - i);
        state.trees.push(CellTrees { roots, first_node, nodes: children.len() as u32, row });
        state.cells.push(cell);
        state.nodes.extend(children.iter().map(|_| [(); 4].map(|()| energy(&mut numbers))));
        state.children.extend(children);
    }
    let words_at = 2 * cells + 2 * MARGIN;
    let uniforms = GuideUniforms {
        words_at,
        pixels_at: words_at + OCTANT_WORDS / 4 * cells,
        cell_count: cells,
        node_count: state.nodes.len() as u32,
        // Lamps of any brightness.
        unit: (numbers.below(60) as f32 + 4.0).exp2(),
        memory,
        cells_x: 2,
        cells_y: 1,
        cells_z: 1,
        sectors: 1,
        ..Default::default()
    };
    let layout = LessonLayout::new(&uniforms);
    let mut visits = vec![0; layout.visits as usize];
    for of_cell in visits.chunks_mut(8) {
        if numbers.below(3) == 0 {
            continue;
        }
        of_cell.iter_mut().for_each(|v| *v = if numbers.below(3) == 0 { 0 } else { sum(&mut numbers) });
    }
    let values = (0..layout.slots).map(|_| sum(&mut numbers)).collect();
    Case { mode, uniforms, state, lessons: Lessons { values, visits, missing: vec![0; 2] } }
}

/// Cases of all modes: what a pass leaves nothing, some, all.
fn cases() -> Vec<Case> {
    let memories = |mode: GuideMode| if mode.is_bansal() { [0.0, 1e-4, 1e20] } else { [0.0, 0.25, 1.0] };
    let all = MODES.into_iter().flat_map(|mode| memories(mode).map(|memory| (mode, memory)));
    let case = |((mode, memory), seed)| case(mode, [1, 33, 300][seed as usize % 3], memory, 7 * seed + 1);
    all.zip(0u64..).map(case).collect()
}

/// What is known after a pass, what was met, and the table.
#[derive(Clone)]
struct After {
    state: GuideState,
    met: Vec<[f32; 8]>,
    table: GuideTable,
}

impl Case {
    fn marked_rows(&self) -> Vec<[u32; 4]> {
        vec![[UNTOUCHED; 4]; (self.uniforms.pixels_at + MARGIN) as usize]
    }

    fn by_twin(&self) -> After {
        let (mut state, mut rows) = (self.state.clone(), self.marked_rows());
        let met = commit(self.mode, &self.uniforms, &self.lessons, &mut state, &mut rows);
        After { state, met, table: GuideTable { uniforms: self.uniforms, rows } }
    }

    fn by_kernel(&self) -> After {
        let harness = Harness::guided(
            Stage::Commit,
            &CompiledScene::new(&scene("cornell-box")),
            Schedule::Fused,
            self.mode,
        );
        let split = |sums: &[u64]| -> Vec<u32> {
            let low = sums.iter().map(|sum| *sum as u32);
            low.chain(sums.iter().map(|sum| (sum >> 32) as u32)).collect()
        };
        let lessons = [split(&self.lessons.values), split(&self.lessons.visits), vec![0; 2]].concat();
        let adaptive = self.mode == GuideMode::Adaptive;
        let (cells, nodes) = (self.state.cells.len(), self.state.nodes.len());
        let met = vec![UNTOUCHED; if adaptive { 8 * cells } else { 0 }];
        let known: Vec<u32> = [
            bytemuck::pod_collect_to_vec(&self.state.cells),
            bytemuck::pod_collect_to_vec(&self.state.nodes),
            met,
        ]
        .concat();
        let shape: Vec<u32> =
            [bytemuck::pod_collect_to_vec(&self.state.trees), self.state.children.clone()].concat();
        let rows = self.marked_rows();
        let read = harness.run(
            Uniforms::zeroed(),
            &[
                ("guide", bytemuck::bytes_of(&self.uniforms)),
                ("guide_rows", bytemuck::cast_slice(&rows)),
                ("guide_state", bytemuck::cast_slice(&known)),
                ("guide_trees", bytemuck::cast_slice(&shape)),
                ("lessons", bytemuck::cast_slice(&lessons)),
            ],
            // One more than there need be: cells that are none change nothing.
            (cells as u32).div_ceil(CELLS_AT_ONCE) + 1,
            &["guide_state", "guide_rows"],
        );
        let (cell_bytes, rest) = read[0].split_at(size_of::<CellState>() * cells);
        let (node_bytes, met) = rest.split_at(16 * nodes);
        let state = GuideState {
            cells: bytemuck::pod_collect_to_vec(cell_bytes),
            nodes: bytemuck::pod_collect_to_vec(node_bytes),
            ..self.state.clone()
        };
        let rows = bytemuck::pod_collect_to_vec(&read[1]);
        let met = bytemuck::pod_collect_to_vec(met);
        After { state, met, table: GuideTable { uniforms: self.uniforms, rows } }
    }

    /// Visits of a counter.
    fn visits(&self, counter: usize) -> f64 {
        self.lessons.visits[counter] as f64 / f64::from(VISIT_UNIT)
    }

    fn is_met(&self, cell: usize) -> bool {
        self.lessons.visits[8 * cell..8 * cell + 8].iter().any(|v| *v > 0)
    }
}

/// The largest relative difference of two lists of numbers.
fn difference(a: &[f64], b: &[f64]) -> f64 {
    assert_eq!(a.len(), b.len());
    let relative = |(a, b): (&f64, &f64)| {
        let off = ((a - b).abs() - TINY).max(0.0);
        if off > 0.0 { off / a.abs().max(b.abs()) } else { off }
    };
    let all = a.iter().zip(b).map(relative);
    all.fold(0.0, |worst, off| if off <= worst { worst } else { off })
}

fn wide(values: &[f32]) -> Vec<f64> {
    values.iter().map(|v| f64::from(*v)).collect()
}

/// Numbers of what is known.
fn known(after: &After) -> Vec<f64> {
    let cells = wide(bytemuck::cast_slice(&after.state.cells));
    [cells, wide(after.state.nodes.as_flattened())].concat()
}

/// Irradiance and trust of all cells that the table has, and its other words.
fn table(after: &After) -> (Vec<f64>, Vec<u32>) {
    let (index, behind) = after.table.rows.split_at(after.table.uniforms.words_at as usize);
    let cells = index.iter().filter(|row| **row != [UNTOUCHED; 4]);
    let numbers = cells.flat_map(|row| [row[2], row[3]].map(|word| f64::from(f32::from_bits(word))));
    let words = index.iter().flat_map(|row| [row[0], row[1]]);
    (numbers.collect(), words.chain(behind.iter().flatten().copied()).collect())
}

/// What was met is the same to the bit, as are cells that were not met; energies, weights and what the index tells are the same
/// to a few units in the last place. Octants lie in the table as they are known, whatever lies around them is untouched, and
/// with quadtrees there is nothing but that.
#[test]
fn commits_are_the_same_on_the_gpu() {
    let mut worst = [0.0f64; 2];
    for (number, case) in cases().iter().enumerate() {
        let (mode, expected, found) = (case.mode, case.by_twin(), case.by_kernel());
        assert!(found.met == expected.met, "{mode}, case {number}: what was met");
        let (numbers, mut words) = table(&found);
        let (expected_numbers, expected_words) = table(&expected);
        for (cell, trees) in case.state.trees.iter().enumerate().filter(|(cell, _)| !case.is_met(*cell)) {
            assert_eq!(found.state.cells[cell], case.state.cells[cell], "{mode}, case {number}: cell {cell}");
            assert_eq!(found.state.nodes[trees.range()], case.state.nodes[trees.range()]);
        }
        assert_eq!(numbers.len(), if mode == GuideMode::Adaptive { 0 } else { 2 * case.state.cells.len() });
        // What the kernel knows may differ from what the twin does; what it wrote may not.
        let octants = words.iter_mut().skip(2 * case.uniforms.words_at as usize);
        let known_octants = expected.state.cells.iter().flat_map(|cell| cell.octants);
        let found_octants = found.state.cells.iter().flat_map(|cell| cell.octants);
        for ((word, found), expected) in octants.zip(found_octants).zip(known_octants) {
            if *word == found.to_bits() && mode != GuideMode::Adaptive {
                *word = expected.to_bits();
            }
        }
        assert_eq!(words, expected_words, "{mode}, case {number}");
        let bansal = usize::from(mode.is_bansal());
        let off = difference(&known(&found), &known(&expected));
        let table_off = difference(&numbers, &expected_numbers);
        worst[bansal] = worst[bansal].max(off).max(table_off);
        let bound = [KERNEL, KERNEL_BANSAL][bansal];
        assert!(off < bound && table_off < bound, "{mode}, case {number}: {off:e}, {table_off:e}");
        // Negative control: half as many visits.
        let mut other = Case { lessons: case.lessons.clone(), state: case.state.clone(), ..*case };
        other.lessons.visits.iter_mut().for_each(|v| *v /= 2);
        let off = difference(&known(&found), &known(&other.by_twin()));
        let learns =
            case.lessons.visits.iter().any(|v| *v > 0) && !(mode.is_bansal() && case.uniforms.memory == 0.0);
        assert!(off > bound || !learns, "{mode}, case {number}: other lessons pass");
    }
    println!("kernel against twin: {:.1e}, Bansal's rule {:.1e}", worst[0], worst[1]);
}

/// The energy below a part of a cell in f64, leaves by [`blended`].
fn energy_below(children: &[u32], child: u32, leaf: &dyn Fn(usize, usize) -> f64) -> f64 {
    let word = children[child as usize];
    let mut next = word >> 4;
    let quarter = |q: usize| match word >> q & 1 {
        0 => leaf(child as usize, q),
        _ => {
            next += 1;
            energy_below(children, next - 1, leaf)
        }
    };
    (0..4).map(quarter).sum()
}

/// What the pass makes of a number: (kept · known + value) / (kept + visits).
fn blended(case: &Case, known: f32, weight: f32, slot: usize, visits: f64) -> f64 {
    let kept = f64::from(case.uniforms.memory) * f64::from(weight);
    let value = case.lessons.values[slot] as f64 / f64::from(case.uniforms.unit);
    (kept * f64::from(known) + value) / (kept + visits)
}

/// Eight energies of a cell that was met, by definition and in f64.
fn octants_in_f64(case: &Case, cell: usize) -> [f64; 8] {
    let (known, trees) = (&case.state.cells[cell], &case.state.trees[cell]);
    let children = &case.state.children[trees.range()];
    let all: f64 = (0..8).map(|i| case.visits(8 * cell + i)).sum();
    let first_slot = 8 * case.uniforms.cell_count as usize + 4 * trees.first_node as usize;
    let nodes = &case.state.nodes[trees.range()];
    let leaf = |node: usize, q: usize| {
        blended(case, nodes[node][q], known.visits[0], first_slot + 4 * node + q, all)
    };
    let mut root = 0;
    std::array::from_fn(|a| {
        let (slot, visits) = (8 * cell + a, case.visits(8 * cell + a));
        match case.mode {
            GuideMode::Adaptive if trees.roots >> a & 1 == 1 => {
                root += 1;
                energy_below(children, root - 1, &leaf)
            }
            GuideMode::Adaptive => blended(case, known.octants[a], known.visits[0], slot, all),
            _ if visits == 0.0 => f64::from(known.octants[a]),
            GuideMode::Octant => blended(case, known.octants[a], known.visits[a], slot, visits),
            _ => {
                // More than 80 are as good as 80.
                let forgotten = (f64::from(case.uniforms.memory) * visits).min(80.0);
                let mean = case.lessons.values[slot] as f64 / f64::from(case.uniforms.unit) / visits;
                (-forgotten).exp() * f64::from(known.octants[a]) - (-forgotten).exp_m1() * mean
            }
        }
    })
}

/// A cell without quadtrees lies in the table as it is known, with the sum of its octants and what its visits are worth.
fn check_cell(case: &Case, after: &After, number: usize) {
    let (cell, lies) = (&after.state.cells[number], after.table.cell(case.state.trees[number].row));
    let irradiance: f64 = wide(&cell.octants).iter().sum();
    let visits: f64 = wide(&cell.visits).iter().sum();
    let trust = match case.mode {
        _ if irradiance <= 0.0 => 0.0,
        GuideMode::Octant => visits / (visits + f64::from(TRUSTED_VISITS)),
        _ => 1.0,
    };
    let off = difference(&wide(&[lies.irradiance, lies.trust]), &[irradiance, trust]);
    assert!(off < 1e-6 && lies.octants == cell.octants, "{}, cell {number}: {off:e}: {lies:?}", case.mode);
    assert_eq!((lies.index, lies.at), (number as u32, OCTANT_WORDS * number as u32));
}

/// Energies of cells, from the leaves up, and how cells lie in the table, against f64.
#[test]
fn commits_are_right_to_a_few_roundings() {
    let mut worst = [0.0f64; 2];
    for case in cases() {
        let after = case.by_twin();
        for (i, cell) in after.state.cells.iter().enumerate() {
            let expected = if case.is_met(i) {
                octants_in_f64(&case, i).to_vec()
            } else {
                wide(&case.state.cells[i].octants)
            };
            let off = difference(&wide(&cell.octants), &expected);
            let bansal = usize::from(case.mode.is_bansal());
            worst[bansal] = worst[bansal].max(off);
            assert!(
                off < [ROUNDINGS, ROUNDINGS_BANSAL][bansal],
                "{}, cell {i}: {off:e}: {:?} {expected:?}",
                case.mode,
                cell.octants
            );
            if case.mode != GuideMode::Adaptive {
                check_cell(&case, &after, i);
            }
        }
    }
    println!("twin against f64: {:.1e}, Bansal's rule {:.1e}", worst[0], worst[1]);
    // Negative control: what is known counts a hundredth more.
    let case = case(GuideMode::Adaptive, 33, 0.25, 3);
    let wrong = Case { uniforms: GuideUniforms { memory: 0.2525, ..case.uniforms }, ..case };
    let right = Case {
        uniforms: GuideUniforms { memory: 0.25, ..wrong.uniforms },
        lessons: wrong.lessons.clone(),
        state: wrong.state.clone(),
        ..wrong
    };
    let met: Vec<usize> = (0..33).filter(|&cell| right.is_met(cell)).collect();
    let octants = |case: &Case| met.iter().flat_map(|&cell| octants_in_f64(case, cell)).collect::<Vec<_>>();
    assert!(difference(&octants(&right), &octants(&wrong)) > ROUNDINGS);
}
