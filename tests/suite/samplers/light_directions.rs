//! Directions to lamps of a scene, counted.

use super::lights::distance;
use super::twins::{SIDES, Side, Twins, World};
use super::{Cells, DRAW, DRAW_IMPORTS, WRONG, draw};
use crate::probe::{floats, row};
use glam::{DVec3, Vec2, Vec3, Vec4Swizzles};
use qtracer::scene::compiled::CompiledScene;
use qtracer::scene::rows::Row;
use qtracer::scene::shapes::T_MISS;
use qtracer::scene::triangle::double_area;
use qtracer::scene::{Material as SceneMaterial, MeshData, Scene, SceneBuilder};
use qtracer::transport::light::{pdf_light, sample_light};

/// A scene of one lamp.
fn lamp(shape: impl FnOnce(SceneBuilder) -> SceneBuilder) -> CompiledScene {
    let builder = Scene::builder("lamp")
        .camera([0.0, 0.0, 9.0], [0.0; 3], 40.0)
        .material("lamp", SceneMaterial::diffuse([0.0; 3]).emitting([1.0; 3]));
    CompiledScene::new(&shape(builder).build().unwrap())
}

/// The density of a light as pdf_light says it, 0 where its bright side is not met.
fn light_density(scene: &CompiledScene, origin: Vec3) -> impl Fn(Vec3) -> f64 {
    move |wi| match distance(scene, 0, origin, wi) {
        T_MISS => 0.0,
        _ if scene.quads.first().is_some_and(|quad| quad.normal.dot(wi) >= 0.0) => 0.0,
        _ if scene.triangles.first().is_some_and(|t| double_area(t.a, t.b, t.c).dot(wi) >= 0.0) => 0.0,
        t => pdf_light(scene, origin, 0, wi, t).into(),
    }
}

/// A lamp that looks down.
const TRIANGLE: [DVec3; 3] =
    [DVec3::new(-1.0, 2.0, -1.0), DVec3::new(1.0, 2.0, -0.5), DVec3::new(-0.5, 2.3, 1.5)];

fn triangle() -> CompiledScene {
    let data = MeshData { positions: TRIANGLE.to_vec(), triangles: vec![[0, 1, 2]], ..Default::default() };
    lamp(|b| b.mesh(data, "lamp"))
}

/// Scenes of one lamp, a point that it lights, and cells that hold it.
fn lit_points() -> Vec<(&'static str, CompiledScene, Vec3, Cells)> {
    let sphere = |radius: f64| lamp(|b| b.sphere([1.0, 2.0, 3.0], radius, "lamp"));
    let centre = Vec3::new(1.0, 2.0, 3.0);
    let quad = || lamp(|b| b.quad([-1.0, 2.0, -1.0], [2.0, 0.0, 0.5], [0.0, 0.3, 2.0], "lamp"));
    // e1 × e2 points down.
    let below = Vec3::new(0.2, 0.5, 0.3);
    let grazing = Vec3::new(-4.0, 1.6, 0.0);
    // Directions to a quad are nearest to that of its middle in a cap that its corners bound.
    let around = |scene: &CompiledScene, origin: Vec3| {
        let quad = &scene.quads[0];
        let at = |a: f32, b: f32| (quad.corner + quad.e1 * a + quad.e2 * b - origin).normalize();
        let axis = at(0.5, 0.5);
        let corners = [at(0.0, 0.0), at(1.0, 0.0), at(0.0, 1.0), at(1.0, 1.0)];
        let bottom = corners.iter().map(|c| f64::from(axis.dot(*c))).fold(1.0, f64::min) - 1e-4;
        Cells { axis, bottom, top: 1.0, rows: 24, columns: 24 }
    };
    let around_triangle = |origin: Vec3| {
        let corners = TRIANGLE.map(|corner| (corner.as_vec3() - origin).normalize());
        let axis = corners.iter().sum::<Vec3>().normalize();
        let bottom = corners.iter().map(|c| f64::from(axis.dot(*c))).fold(1.0, f64::min) - 1e-4;
        Cells { axis, bottom, top: 1.0, rows: 24, columns: 24 }
    };
    let aslant = Vec3::new(-3.0, 1.2, 0.3);
    let cone = |radius: f64, origin: Vec3| {
        let sin2 = radius * radius / f64::from((centre - origin).length_squared());
        Cells { bottom: (1.0 - sin2).sqrt(), rows: 12, ..Cells::hemisphere((centre - origin).normalize()) }
    };
    let (near, far) = (Vec3::new(1.0, 2.0, 1.9), Vec3::new(-4.0, 0.0, 1.0));
    vec![
        ("sphere, far", sphere(1.0), far, cone(1.0, far)),
        ("sphere, almost touched", sphere(1.0), near, cone(1.0, near)),
        (
            "sphere that shines inwards",
            lamp(|b| b.inward_sphere([1.0, 2.0, 3.0], 2.0, "lamp")),
            Vec3::new(1.5, 2.5, 2.0),
            Cells::sphere(Vec3::Z),
        ),
        ("quad, near", quad(), below, around(&quad(), below)),
        ("quad, grazing", quad(), grazing, around(&quad(), grazing)),
        ("triangle, near", triangle(), below, around_triangle(below)),
        ("triangle, aslant", triangle(), aslant, around_triangle(aslant)),
    ]
}

/// A direction to the lamp from b by the program's own numbers, and its density.
const DIRECT: (&str, &str) = (
    "import package::transport::light::sample_light;",
    "let s = sample_light(bitcast<vec3<f32>>(b.xyz), 0u, u.xy);
    out0 = vec4<u32>(bitcast<vec3<u32>>(s.wi), bitcast<u32>(s.pdf));",
);

fn direct(world: &World, [a, b]: &[Row; 2]) -> [Row; 1] {
    let s = sample_light(&world.scene, floats(*b).0, 0, draw(a[3]).xy());
    [row(s.wi, s.pdf.to_bits())]
}

/// Of the lamp seen from there.
fn light_draws(scene: CompiledScene, origin: Vec3, side: Side) -> Vec<Option<Vec3>> {
    let world = World::of(scene);
    let (imports, body) = (format!("{DRAW_IMPORTS}{}", DIRECT.0), format!("{DRAW}{}", DIRECT.1));
    let twins = Twins::new(&world, (&imports, &body), direct);
    let questions: Vec<_> = (0..1u32 << 18).map(|i| [[0, 0, 0, i], row(origin, 0)]).collect();
    let direction = |(wi, pdf)| Some(wi).filter(|_| pdf > 0.0);
    twins.answer(side, &questions).into_iter().map(|[answer]| direction(floats(answer))).collect()
}

#[test]
fn light_directions_follow_their_density() {
    for (name, scene, origin, cells) in lit_points() {
        let integrals = cells.integrate(light_density(&scene, origin));
        let integral: f64 = integrals.iter().sum();
        assert!((integral - 1.0).abs() < 2e-3, "{name}: the density integrates to {integral}");
        for side in SIDES {
            let draws = light_draws(scene.clone(), origin, side);
            cells.are_followed(&format!("{side:?}: {name}"), &draws, &integrals);
        }
    }
    // Negative control: a quad's solid angle taken as uniform.
    let (_, scene, origin, cells) = lit_points().remove(3);
    let density = light_density(&scene, origin);
    let uniform = cells.integrate(|wi| f64::from(u8::from(density(wi) > 0.0)));
    let solid_angle: f64 = uniform.iter().sum();
    let draws = light_draws(scene.clone(), origin, Side::Gpu);
    let uniform: Vec<f64> = uniform.iter().map(|cell| cell / solid_angle).collect();
    assert!(cells.chi2_of(|i| draws[i as usize], &uniform) < WRONG);
}

/// No light where none arrives: behind a quad, outside a sphere that shines inwards, inside one that shines outwards.
#[test]
fn a_light_seen_from_its_dark_side_is_not_sampled() {
    let quad = lamp(|b| b.quad([-1.0, 2.0, -1.0], [2.0, 0.0, 0.0], [0.0, 0.0, 2.0], "lamp"));
    let outward = lamp(|b| b.sphere([0.0; 3], 1.0, "lamp"));
    let inward = lamp(|b| b.inward_sphere([0.0; 3], 1.0, "lamp"));
    let above = Vec3::new(0.0, 3.0, 0.0);
    for (scene, dark) in
        [(quad, above), (triangle(), above), (outward, Vec3::splat(0.1)), (inward, Vec3::splat(2.0))]
    {
        assert_eq!(sample_light(&scene, dark, 0, Vec2::splat(0.4)).pdf, 0.0);
    }
}
