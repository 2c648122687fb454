use glam::Vec3;
use obvhs::{Boundable, BvhBuildParams, aabb::Aabb, ploc::*, bvh2::builder::build_bvh2};
struct B(Aabb);
impl Boundable for B { fn aabb(&self) -> Aabb { self.0 } }
fn tri(a: Vec3, b: Vec3, c: Vec3) -> B {
    let (lo, hi) = (a.min(b).min(c), a.max(b).max(c));
    let m = 2e-6 * lo.abs().max(hi.abs()).max_element();
    B(Aabb { min: (lo - m).to_array().into(), max: (hi + m).to_array().into() })
}
fn main() {
    let a: Vec<String> = std::env::args().skip(1).collect();
    let n: usize = a[1].parse().unwrap();
    let shapes: Vec<B> = match a[0].as_str() {
        "fan" => (0..n).map(|i| { let p = |k: usize| { let t = k as f32 / n as f32 * 6.2831; Vec3::new(t.cos(), t.sin(), 0.3 * t.cos()) }; tri(p(0), p(i), p(i + 1)) }).collect(),
        "shells" => (0..n).map(|i| { let r = 1.0 + i as f32 / n as f32; tri(Vec3::splat(-r), Vec3::splat(r), Vec3::ZERO) }).collect(),
        "same" => (0..n).map(|i| { let r = i as f32 * 1e-7 / n as f32; tri(Vec3::splat(-1.0), Vec3::splat(1.0), Vec3::splat(r)) }).collect(),
        "needles" => (0..n).map(|i| { let x = i as f32 / n as f32; tri(Vec3::new(x, 0.0, 0.0), Vec3::new(x, 1000.0, 0.0), Vec3::new(x, 0.0, 0.001)) }).collect(),
        "cross" => (0..n).map(|i| { let x = (i * 7919 % n) as f32 / n as f32; let y = (i * 104729 % n) as f32 / n as f32; tri(Vec3::new(x, 0.0, y), Vec3::new(1.0 - x, 1.0, 1.0 - y), Vec3::new(y, 0.5, x)) }).collect(),
        "grid" => { let k = (n as f32 / 2.0).sqrt() as usize; (0..k * k).flat_map(|i| { let (x, y) = ((i % k) as f32, (i / k) as f32); let h = |x: f32, y: f32| 5.0 * (x * 0.1).sin() * (y * 0.13).cos(); let p = |x, y| Vec3::new(x, h(x, y), y); [tri(p(x, y), p(x + 1.0, y), p(x, y + 1.0)), tri(p(x + 1.0, y), p(x + 1.0, y + 1.0), p(x, y + 1.0))] }).collect() }
        _ => panic!(),
    };
    for ratio in a[2..].iter() {
        let ratio: f32 = ratio.parse().unwrap();
        let start = std::time::Instant::now();
        let tree = build_bvh2(&shapes, BvhBuildParams { pre_split: false, ploc_search_distance: PlocSearchDistance::Medium, search_depth_threshold: 3, reinsertion_batch_ratio: ratio, post_collapse_reinsertion_batch_ratio_multiplier: 0.0, sort_precision: SortPrecision::U64, max_prims_per_leaf: 1, collapse_traversal_cost: 1.0 }, &mut Default::default());
        let seconds = start.elapsed().as_secs_f64();
        let mut open = vec![(0usize, 1u32)]; let mut deep = 0; let mut area = 0.0f64;
        while let Some((i, d)) = open.pop() { deep = deep.max(d); let node = &tree.nodes[i]; area += node.aabb.half_area() as f64; if node.prim_count == 0 { open.push((node.first_index as usize, d + 1)); open.push((node.first_index as usize + 1, d + 1)); } }
        println!("{} {} ratio {ratio}: {seconds:.3} s, depth {deep}, max_depth {}, sah {:.2}", a[0], shapes.len(), tree.max_depth, area / tree.nodes[0].aabb.half_area() as f64);
    }
}
