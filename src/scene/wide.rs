//! Experiment: wide hierarchies with quantised boxes.

use super::bvh::LEAF;
use super::rows::Row;
use glam::Vec3;
use obvhs::aabb::Aabb;
use obvhs::bvh2::Bvh2;

/// Which walk is to be tried: QT_WALK.
pub fn variant() -> &'static str {
    static NAME: std::sync::OnceLock<String> = std::sync::OnceLock::new();
    NAME.get_or_init(|| std::env::var("QT_WALK").unwrap_or_default())
}

#[derive(Debug, Default)]
pub struct Wide {
    pub rows: Vec<Row>,
    /// Old numbers of triangles in their new order.
    pub order: Vec<u32>,
    pub nodes: usize,
    pub levels: u32,
}

const NODE_COST: f32 = 1.0;

#[derive(Clone, Copy, Default)]
struct Costs {
    cost: [f32; 8],
    choice: [u8; 9],
    count: u32,
}

struct Collapse<'a> {
    tree: &'a Bvh2,
    costs: Vec<Costs>,
    width: usize,
}

impl<'a> Collapse<'a> {
    fn new(tree: &'a Bvh2, width: usize, most: u32, shape_cost: f32) -> Self {
        let mut order = Vec::with_capacity(tree.nodes.len());
        let mut open = vec![0usize];
        while let Some(n) = open.pop() {
            order.push(n);
            let node = &tree.nodes[n];
            if node.prim_count == 0 {
                open.extend([node.first_index as usize, node.first_index as usize + 1]);
            }
        }
        let mut costs = vec![Costs::default(); tree.nodes.len()];
        for &n in order.iter().rev() {
            let node = &tree.nodes[n];
            let area = node.aabb.half_area();
            let mut c = Costs { cost: [f32::INFINITY; 8], ..Default::default() };
            if node.prim_count > 0 {
                c.count = node.prim_count;
                c.cost = [area * node.prim_count as f32 * shape_cost; 8];
                c.choice[1] = 1;
                costs[n] = c;
                continue;
            }
            let (l, r) = (&costs[node.first_index as usize], &costs[node.first_index as usize + 1]);
            c.count = l.count + r.count;
            let split = |roots: usize| {
                let mut best = (f32::INFINITY, 1u8);
                for k in 1..roots {
                    let cost = l.cost[k.min(7)] + r.cost[(roots - k).min(7)];
                    if cost < best.0 {
                        best = (cost, k as u8);
                    }
                }
                best
            };
            let (inner, k) = split(width);
            c.choice[width] = k;
            let inner = inner + area * NODE_COST;
            let leaf = if c.count <= most { area * c.count as f32 * shape_cost } else { f32::INFINITY };
            c.cost[1] = inner.min(leaf);
            c.choice[1] = u8::from(leaf < inner);
            for i in 2..width {
                let (cost, k) = split(i);
                c.cost[i] = c.cost[i - 1];
                if cost < c.cost[i] {
                    c.cost[i] = cost;
                    c.choice[i] = k;
                }
            }
            costs[n] = c;
        }
        Collapse { tree, costs, width }
    }

    fn roots(&self, n: usize, i: usize, out: &mut Vec<usize>) {
        let node = &self.tree.nodes[n];
        if i == 1 || node.prim_count > 0 {
            return out.push(n);
        }
        match self.costs[n].choice[i] {
            0 => self.roots(n, i - 1, out),
            k => self.split(n, i, k, out),
        }
    }

    fn split(&self, n: usize, i: usize, k: u8, out: &mut Vec<usize>) {
        let first = self.tree.nodes[n].first_index as usize;
        self.roots(first, k as usize, out);
        self.roots(first + 1, i - k as usize, out);
    }

    fn children(&self, n: usize) -> Vec<usize> {
        let mut out = Vec::with_capacity(8);
        if self.is_leaf(n) {
            out.push(n);
        } else {
            self.split(n, self.width, self.costs[n].choice[self.width], &mut out);
        }
        out
    }

    fn is_leaf(&self, n: usize) -> bool {
        self.tree.nodes[n].prim_count > 0 || self.costs[n].choice[1] == 1
    }

    fn shapes(&self, n: usize, out: &mut Vec<u32>) {
        let node = &self.tree.nodes[n];
        let first = node.first_index as usize;
        if node.prim_count > 0 {
            out.extend(&self.tree.primitive_indices[first..first + node.prim_count as usize]);
        } else {
            self.shapes(first, out);
            self.shapes(first + 1, out);
        }
    }
}

/// A wide node before it is packed.
struct Node {
    /// Box, number of the inner node or none, shapes.
    slots: [Option<(Aabb, Option<u32>, Vec<u32>)>; 8],
}

/// `first_triangle`: number of the first triangle among shapes.
pub fn build(
    tree: &Bvh2,
    width: usize,
    most: u32,
    first_triangle: u32,
    emits: impl Fn(u32) -> bool,
) -> Wide {
    let collapse = Collapse::new(tree, width, most, 0.3);
    let mut nodes: Vec<Node> = vec![Node { slots: Default::default() }];
    let mut bases = vec![0u32];
    let mut levels = 1;
    let mut order = Vec::new();
    // (tree node, wide node, level)
    let mut open = vec![(0usize, 0usize, 1u32)];
    while let Some((n, at, level)) = open.pop() {
        levels = levels.max(level);
        let children = collapse.children(n);
        let around = children.iter().fold(Aabb::INVALID, |all, &c| all.union(&collapse.tree.nodes[c].aabb));
        let slots = assign(tree, &children, &around, width);
        let base = nodes.len();
        bases[at] = base as u32;
        for (slot, child) in slots.into_iter().enumerate() {
            let Some(c) = child else { continue };
            let aabb = tree.nodes[c].aabb;
            if collapse.is_leaf(c) {
                let mut shapes = Vec::new();
                collapse.shapes(c, &mut shapes);
                order.extend(shapes.iter().copied().filter(|&s| s >= first_triangle));
                nodes[at].slots[slot] = Some((aabb, None, shapes));
            } else {
                let number = nodes.len();
                nodes.push(Node { slots: Default::default() });
                bases.push(0);
                nodes[at].slots[slot] = Some((aabb, Some(number as u32), vec![]));
            }
        }
        let inner: Vec<(usize, usize)> = nodes[at]
            .slots
            .iter()
            .zip(assign(tree, &children, &around, width))
            .filter_map(|(slot, c)| Some((c?, slot.as_ref()?.1? as usize)))
            .collect();
        open.extend(inner.into_iter().rev().map(|(c, number)| (c, number, level + 1)));
    }
    order.sort_by_key(|&s| !emits(s - first_triangle));
    let mut renamed: Vec<u32> = (0..first_triangle + order.len() as u32).collect();
    for (i, &old) in order.iter().enumerate() {
        renamed[old as usize] = first_triangle + i as u32;
    }
    for node in &mut nodes {
        for (_, _, shapes) in node.slots.iter_mut().flatten() {
            for shape in shapes {
                *shape = renamed[*shape as usize];
            }
        }
    }
    let node_rows = if width == 4 { 3 } else { 5 };
    let mut rows = Vec::with_capacity(nodes.len() * node_rows);
    let mut lists: Vec<Row> = Vec::new();
    let first_list = nodes.len() * node_rows;
    for (node, &base) in nodes.iter().zip(&bases) {
        let shapes: Vec<u32> = node.slots.iter().flatten().flat_map(|s| s.2.iter().copied()).collect();
        let row = shapes.windows(2).all(|w| w[1] == w[0] + 1);
        let leaf_base = if row {
            shapes.first().copied().unwrap_or(0)
        } else {
            let at = LEAF | (first_list + lists.len()) as u32;
            for four in shapes.chunks(4) {
                let mut row = Row::default();
                row[..four.len()].copy_from_slice(four);
                lists.push(row);
            }
            at
        };
        if width == 4 {
            rows.extend(pack4(node, base, leaf_base));
        } else {
            rows.extend(pack8(node, base, leaf_base));
        }
    }
    rows.extend(lists);
    order.iter_mut().for_each(|s| *s -= first_triangle);
    Wide { rows, order, nodes: nodes.len(), levels }
}

/// Which child lies in which slot: of eight, so that going through slots in the order of a ray's octant goes from near to far.
fn assign(tree: &Bvh2, children: &[usize], around: &Aabb, width: usize) -> [Option<usize>; 8] {
    let mut slots = [None; 8];
    if width == 4 {
        for (slot, &c) in slots.iter_mut().zip(children) {
            *slot = Some(c);
        }
        return slots;
    }
    let middle = around.center();
    let mut left: Vec<usize> = children.to_vec();
    while !left.is_empty() {
        let mut best = (f32::INFINITY, 0, 0);
        for (i, &c) in left.iter().enumerate() {
            let d = tree.nodes[c].aabb.center() - middle;
            for (slot, taken) in slots.iter().enumerate() {
                if taken.is_none() {
                    let sign = |bit: usize| if slot >> bit & 1 == 1 { -1.0 } else { 1.0 };
                    let cost = d.x * sign(2) + d.y * sign(1) + d.z * sign(0);
                    if cost < best.0 {
                        best = (cost, i, slot);
                    }
                }
            }
        }
        slots[best.2] = Some(left.remove(best.1));
    }
    slots
}

const MARGIN: f64 = 1.0 / (1 << 19) as f64;

struct Grid {
    origin: Vec3,
    exponents: [u32; 3],
    low: [[u8; 8]; 3],
    high: [[u8; 8]; 3],
}

fn quantise(node: &Node) -> Grid {
    let around = node.slots.iter().flatten().fold(Aabb::INVALID, |all, s| all.union(&s.0));
    let mut grid = Grid { origin: Vec3::ZERO, exponents: [1; 3], low: [[0; 8]; 3], high: [[0; 8]; 3] };
    for k in 0..3 {
        let (low, high) = (f64::from(around.min[k]), f64::from(around.max[k]));
        let margin = (high - low) * MARGIN;
        let mut origin = (low - margin) as f32;
        if f64::from(origin) > low - margin {
            origin = origin.next_down();
        }
        let extent = high + margin - f64::from(origin);
        let mut exponent = ((extent / 255.0).log2().ceil() as i32 + 127).clamp(1, 254);
        if (extent / f64::from(f32::from_bits((exponent as u32) << 23))).ceil() > 255.0 {
            exponent += 1;
        }
        let step = f64::from(f32::from_bits((exponent as u32) << 23));
        grid.origin[k] = origin;
        grid.exponents[k] = exponent as u32;
        for (i, slot) in node.slots.iter().enumerate() {
            if let Some((aabb, ..)) = slot {
                let at = |x: f32, by: f64| (f64::from(x) + by - f64::from(origin)) / step;
                grid.low[k][i] = at(aabb.min[k], -margin).floor().clamp(0.0, 255.0) as u8;
                grid.high[k][i] = at(aabb.max[k], margin).ceil().clamp(0.0, 255.0) as u8;
            }
        }
    }
    grid
}

fn word(bytes: &[u8]) -> u32 {
    u32::from_le_bytes(bytes[..4].try_into().unwrap())
}

fn pack4(node: &Node, base: u32, leaf_base: u32) -> [Row; 3] {
    let Grid { origin, exponents: [ex, ey, ez], low, high } = quantise(node);
    let mut mask = 0;
    for (i, slot) in node.slots.iter().enumerate() {
        if let Some((_, inner, _)) = slot {
            mask |= if inner.is_some() { 1 } else { 16 } << i;
        }
    }
    let [x, y, z] = origin.to_array().map(f32::to_bits);
    [
        [x, y, z, ex | ey << 8 | ez << 16 | mask << 24],
        [word(&low[0]), word(&low[1]), word(&low[2]), base],
        [word(&high[0]), word(&high[1]), word(&high[2]), leaf_base],
    ]
}

fn pack8(node: &Node, base: u32, leaf_base: u32) -> [Row; 5] {
    let Grid { origin, exponents: [ex, ey, ez], low, high } = quantise(node);
    let mut mask = 0;
    let mut meta = [0u8; 8];
    let mut next = 0;
    for (i, slot) in node.slots.iter().enumerate() {
        if let Some((_, inner, shapes)) = slot {
            if inner.is_some() {
                mask |= 1 << i;
                meta[i] = 0x20 | (24 + i) as u8;
            } else {
                meta[i] = [0u8, 0x20, 0x60, 0xe0][shapes.len()] | next;
                next += shapes.len() as u8;
            }
        }
    }
    let [x, y, z] = origin.to_array().map(f32::to_bits);
    [
        [x, y, z, ex | ey << 8 | ez << 16 | mask << 24],
        [base, leaf_base, word(&meta), word(&meta[4..])],
        [word(&low[0]), word(&low[0][4..]), word(&low[1]), word(&low[1][4..])],
        [word(&low[2]), word(&low[2][4..]), word(&high[0]), word(&high[0][4..])],
        [word(&high[1]), word(&high[1][4..]), word(&high[2]), word(&high[2][4..])],
    ]
}
