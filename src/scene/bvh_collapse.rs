//! Makes nodes of up to four children out of a binary tree: those with the least area in all, by which a ray through the scene
//! meets the fewest (Ylitie, Karras, Laine 2017, §3.2, for leaves of one shape).

use super::bvh::WIDTH;
use obvhs::bvh2::Bvh2;
use rayon::join;
use std::sync::atomic::{AtomicU8, Ordering::Relaxed};

/// A node of the hierarchy before it is packed.
#[derive(Clone, Debug)]
pub(super) struct WideNode {
    /// Nodes of the binary tree that its children are; inner ones first.
    pub children: Vec<u32>,
    /// How many of them are nodes; the others are shapes.
    pub inner: usize,
    /// Number of the first child that is a node; the others follow it.
    pub first_node: u32,
    /// Place of the first of its shapes in [`Wide::shapes`]; the others follow it.
    pub first_shape: u32,
}

/// Nodes, each in front of all below it, children side by side.
#[derive(Clone, Debug, Default)]
pub(super) struct Wide {
    pub nodes: Vec<WideNode>,
    /// Numbers of the shapes in the order in which the nodes hold them.
    pub shapes: Vec<u32>,
    /// Children that a walk may have to come back to at once.
    pub depth: u32,
}

/// Trees deeper than this are given up: they would be a walk's depth.
const DEEPEST: u32 = 256;

/// The nodes over a tree; None if it is too deep.
pub(super) fn collapsed(tree: &Bvh2) -> Option<Wide> {
    let choices = Choices(tree.nodes.iter().map(|_| AtomicU8::new(0)).collect());
    choices.choose(tree, 0, DEEPEST)?;
    let mut wide = Wide::default();
    wide.nodes.push(choices.node(tree, 0));
    // (number, children waiting above it); the node that is taken next lies next.
    let mut open = vec![(0usize, 0u32)];
    while let Some((at, waiting)) = open.pop() {
        let node = &mut wide.nodes[at];
        let waiting = waiting + node.children.len() as u32 - 1;
        wide.depth = wide.depth.max(waiting);
        let (inner, leaves) = node.children.split_at(node.inner);
        wide.shapes.extend(leaves.iter().map(|&leaf| shape(tree, leaf)));
        node.first_shape = (wide.shapes.len() - leaves.len()) as u32;
        let inner = inner.to_vec();
        let first = wide.nodes.len();
        wide.nodes[at].first_node = first as u32;
        wide.nodes.extend(inner.iter().map(|&child| choices.node(tree, child)));
        open.extend((first..wide.nodes.len()).rev().map(|child| (child, waiting)));
    }
    Some(wide)
}

fn is_leaf(tree: &Bvh2, node: u32) -> bool {
    tree.nodes[node as usize].prim_count > 0
}

fn shape(tree: &Bvh2, leaf: u32) -> u32 {
    tree.primitive_indices[tree.nodes[leaf as usize].first_index as usize]
}

/// How each subtree is best stood for by a node, by up to two, by up to three: bits as below.
struct Choices(Vec<AtomicU8>);

/// Two are better than one.
const TWO: u8 = 1;
/// Three are better than two …
const THREE: u8 = 2;
/// … and two of them lie in the first half.
const TWO_FIRST: u8 = 4;
/// Times the number of children of its node that lie in the first half.
const IN_FIRST: u8 = 8;

impl Choices {
    /// The area of all nodes in a subtree that is stood for by one, up to two, up to three; None if it is too deep.
    fn choose(&self, tree: &Bvh2, node: u32, depth: u32) -> Option<[f32; 3]> {
        if is_leaf(tree, node) {
            return Some([0.0; 3]);
        }
        let depth = depth.checked_sub(1)?;
        let first = tree.nodes[node as usize].first_index;
        // Small subtrees are not worth another thread; where they begin is not known, but they are deep.
        let (l, r) = match DEEPEST - depth < 12 {
            true => join(|| self.choose(tree, first, depth), || self.choose(tree, first + 1, depth)),
            false => (self.choose(tree, first, depth), self.choose(tree, first + 1, depth)),
        };
        let (l, r) = (l?, r?);
        let (area, in_first) = [l[0] + r[2], l[1] + r[1], l[2] + r[0]].into_iter().zip(1..).fold(
            (f32::INFINITY, 0),
            |best, next| if next.0 < best.0 { next } else { best },
        );
        let one = area + tree.nodes[node as usize].aabb.half_area();
        let (two, three, by_first) = (l[0] + r[0], (l[0] + r[1]).min(l[1] + r[0]), l[1] + r[0] < l[0] + r[1]);
        let best = [one, one.min(two), one.min(two).min(three)];
        let bit = |on: bool, bit: u8| if on { bit } else { 0 };
        let bits = bit(two < one, TWO) | bit(three < best[1], THREE) | bit(by_first, TWO_FIRST);
        self.0[node as usize].store(bits | IN_FIRST * in_first, Relaxed);
        Some(best)
    }

    /// What stands for a subtree by up to `count`.
    fn roots(&self, tree: &Bvh2, node: u32, count: u8, out: &mut Vec<u32>) {
        let bits = self.0[node as usize].load(Relaxed);
        let first = match count {
            _ if is_leaf(tree, node) => 0,
            3 if bits & THREE != 0 => 1 + u8::from(bits & TWO_FIRST != 0),
            2 | 3 if bits & TWO != 0 => return self.halves(tree, node, [1, 1], out),
            _ => 0,
        };
        match first {
            0 => out.push(node),
            first => self.halves(tree, node, [first, count - first], out),
        }
    }

    fn halves(&self, tree: &Bvh2, node: u32, counts: [u8; 2], out: &mut Vec<u32>) {
        let first = tree.nodes[node as usize].first_index;
        self.roots(tree, first, counts[0], out);
        self.roots(tree, first + 1, counts[1], out);
    }

    fn node(&self, tree: &Bvh2, node: u32) -> WideNode {
        let mut children = Vec::with_capacity(WIDTH);
        if is_leaf(tree, node) {
            children.push(node);
        } else {
            let in_first = self.0[node as usize].load(Relaxed) / IN_FIRST;
            self.halves(tree, node, [in_first, WIDTH as u8 - in_first], &mut children);
        }
        children.sort_by_key(|&child| is_leaf(tree, child));
        let inner = children.iter().filter(|&&child| !is_leaf(tree, child)).count();
        WideNode { children, inner, first_node: 0, first_shape: 0 }
    }
}
