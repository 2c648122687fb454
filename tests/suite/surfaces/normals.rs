//! Shading normals and texture coordinates between corners, normal maps, and how viewers see normals.

use super::{image, square, unseen, white};
use crate::probe::{Numbers, Probe, floats, row};
use crate::shapes::{ask, key};
use crate::support::{computes_to_the_letter, open_gpu};
use glam::{DVec3, Vec2, Vec3};
use qtracer::scene::compiled::{CompiledScene, KIND_DIFFUSE, KIND_MIRROR};
use qtracer::scene::rows::Row;
use qtracer::scene::shading::{keeps_side, viewed_normal};
use qtracer::scene::shapes::{Hit, Ray, Surface, surface_at};
use qtracer::scene::texels::textured;
use qtracer::scene::{MaterialTextures, MeshData, TextureRef};

/// Triangles in a row, none of them connected, with normals up to 75° off and coordinates far beyond an image.
fn some_triangles(numbers: &mut Numbers, count: usize) -> MeshData {
    let mut data = MeshData::default();
    for i in 0..count as u32 {
        let corners = [(); 3].map(|()| numbers.in_box(4.0));
        let [a, b, c] = corners;
        let own = (b - a).cross(c - a).normalize();
        data.positions.extend(corners);
        data.normals.extend([(); 3].map(|()| {
            let d = numbers.direction();
            let aside = (d - own * d.dot(own)).normalize() * numbers.between(0.0, 3.7);
            (own + aside) * numbers.of_any_size(1e-3, 1e3)
        }));
        data.uvs.extend([(); 3].map(|()| [(); 2].map(|()| numbers.between(-4.0, 4.0) as f32)));
        data.triangles.push([3 * i, 3 * i + 1, 3 * i + 2]);
    }
    data
}

/// A ray onto a point of triangle `i`, and what f64 says of that point.
struct Aimed {
    question: [Row; 2],
    hit: Hit,
    normal: DVec3,
    uv: [f64; 2],
}

fn aimed(numbers: &mut Numbers, data: &MeshData, i: usize) -> Aimed {
    let [a, b, c] = data.triangles[i].map(|corner| corner as usize);
    let (s, t) = (numbers.between(0.0, 1.0), numbers.between(0.0, 1.0));
    let (s, t) = if s + t > 1.0 { (1.0 - s, 1.0 - t) } else { (s, t) };
    let shares = [1.0 - s - t, s, t];
    let between = |v: &dyn Fn(usize) -> DVec3| -> DVec3 {
        [a, b, c].iter().zip(shares).map(|(&corner, share)| v(corner) * share).sum()
    };
    let p = between(&|corner| data.positions[corner].as_vec3().as_dvec3());
    let own =
        (data.positions[b] - data.positions[a]).cross(data.positions[c] - data.positions[a]).normalize();
    let (direction, t) = ((-own).as_vec3(), 2.0f32);
    let origin = p.as_vec3() - direction * t;
    let uv = [0, 1].map(|k| [a, b, c].iter().zip(shares).map(|(&i, s)| f64::from(data.uvs[i][k]) * s).sum());
    Aimed {
        question: [row(origin, i as u32), row(direction, t.to_bits())],
        hit: Hit { t, shape: i as u32 },
        normal: between(&|corner| data.normals[corner].normalize()).normalize(),
        uv,
    }
}

fn textured_scene(data: MeshData) -> CompiledScene {
    let texture = image(1, &[[255; 3]]);
    let builder = unseen().texture(texture).material("m", white().textured(super::color_texture(0)));
    CompiledScene::new(&builder.mesh(data, "m").build().unwrap())
}

/// Packed normals are within 4e-5 of what was given, and blends between normals far apart are short, which adds to that.
#[test]
fn normals_and_coordinates_are_those_between_the_corners() {
    let mut numbers = Numbers(41);
    let data = some_triangles(&mut numbers, 500);
    let scene = textured_scene(data.clone());
    assert!(scene.surfaces.normals.len() == 500 && scene.triangles.len() == 500);
    let all: Vec<Aimed> = (0..2000).map(|i| aimed(&mut numbers, &data, i % 500)).collect();
    let gpu = open_gpu();
    let imports = "import package::scene::shapes::{Hit, Ray, surface_at};";
    let body = "let ray = Ray(bitcast<vec3<f32>>(a.xyz), bitcast<vec3<f32>>(b.xyz));
        let surface = surface_at(ray, Hit(bitcast<f32>(b.w), a.w));
        out0 = vec4<u32>(bitcast<vec3<u32>>(surface.shading_normal), 0u);
        out1 = vec4<u32>(bitcast<vec2<u32>>(surface.uv), 0u, 0u);";
    let probe = Probe::<2, 2>::new(&gpu, &key(&scene), imports, body);
    let questions: Vec<[Row; 2]> = all.iter().map(|aimed| aimed.question).collect();
    let kernels = ask(&gpu, &probe, &scene, &[], &questions);
    let mut worst = [[0.0f64; 2]; 2];
    for (aimed, [normal, uv]) in all.iter().zip(kernels) {
        let [a, b] = aimed.question;
        let ray = Ray { origin: floats(a).0, direction: floats(b).0 };
        let cpu = surface_at(&scene, ray, aimed.hit);
        let kernel = (floats(normal).0, Vec2::new(f32::from_bits(uv[0]), f32::from_bits(uv[1])));
        for (twin, (normal, uv)) in [(cpu.shading_normal, cpu.uv), kernel].into_iter().enumerate() {
            let normal_error = (normal.as_dvec3() - aimed.normal).length();
            let uv_error = (uv.as_dvec2() - DVec3::new(aimed.uv[0], aimed.uv[1], 0.0).truncate()).length();
            worst[twin] = [worst[twin][0].max(normal_error), worst[twin][1].max(uv_error)];
        }
    }
    println!("worst errors of normals and coordinates: CPU {:?}, kernels {:?}", worst[0], worst[1]);
    for [normal, uv] in worst {
        assert!(normal < 2e-4 && uv < NEAR_UV, "{normal:e} {uv:e}");
    }
    // Negative control: the corner's own normals are not that near.
    assert!((all[0].normal - data.normals[0].normalize()).length() > 1e-2);
}

/// A triangle of size 4 with coordinates up to 4: a few dozen roundings of a position are that much.
const NEAR_UV: f64 = 6e-5;

/// A unit vector within `angle` radians of `axis`.
fn near(numbers: &mut Numbers, axis: DVec3, angle: f64) -> DVec3 {
    let d = numbers.direction();
    let aside = (d - axis * d.dot(axis)).normalize();
    let angle = numbers.between(0.0, angle);
    axis * angle.cos() + aside * angle.sin()
}

/// Shading normal, the shape's normal, and the direction to a viewer in front of it.
type View = [Row; 3];

fn some_views(count: usize) -> Vec<View> {
    let mut numbers = Numbers(43);
    let view = |numbers: &mut Numbers| {
        let facing = numbers.direction();
        let shading = near(numbers, facing, std::f64::consts::PI).as_vec3();
        let wo = near(numbers, facing, 0.4999 * std::f64::consts::PI).as_vec3();
        [row(shading, 0), row(facing.as_vec3(), 0), row(wo, 0)]
    };
    (0..count).map(|_| view(&mut numbers)).collect()
}

fn seen(&[shading, facing, wo]: &View, kind: u32) -> Vec3 {
    let surface =
        Surface { shading_normal: floats(shading).0, ..Surface::plain(Vec3::ZERO, floats(facing).0, 0.0) };
    viewed_normal(&surface, floats(facing).0, true, floats(wo).0, kind)
}

fn smooth_scene() -> CompiledScene {
    CompiledScene::new(&unseen().material("m", white()).mesh(super::smooth_sphere(0), "m").build().unwrap())
}

/// On the shape's side always; with a mirror direction on that side for all but diffuse surfaces; unchanged where it was so.
#[test]
fn viewers_see_normals_on_the_side_of_the_shape() {
    let views = some_views(20_000);
    let mut unchanged = 0;
    for view in &views {
        let [shading, facing, wo] = view.map(|row| floats(row).0);
        let diffuse = seen(view, KIND_DIFFUSE);
        assert!((diffuse.length() - 1.0).abs() < 1e-5 && diffuse.dot(facing) > 0.009, "{diffuse}");
        let mirror = seen(view, KIND_MIRROR);
        assert!((mirror.length() - 1.0).abs() < 1e-5 && mirror.dot(wo) > 0.0, "{mirror}");
        let reflected = mirror * (2.0 * mirror.dot(wo)) - wo;
        assert!(reflected.dot(facing) > 0.0 && mirror.dot(facing) > 0.0, "{reflected} is behind {facing}");
        assert!(keeps_side(mirror, facing, reflected));
        let before = shading * (2.0 * shading.dot(wo)) - wo;
        if shading.dot(facing) > 0.01 && before.dot(facing) > 0.01 {
            assert_eq!((diffuse, mirror), (shading, shading));
            unchanged += 1;
        }
        // A flat surface is what it was.
        let flat = [row(facing, 0), row(facing, 0), row(wo, 0)];
        assert_eq!([KIND_DIFFUSE, KIND_MIRROR].map(|kind| seen(&flat, kind)), [facing; 2]);
    }
    assert!((3000..15_000).contains(&unchanged), "{unchanged}");
}

#[test]
fn kernels_bend_normals_as_the_cpu_does() {
    let (gpu, views, scene) = (open_gpu(), some_views(4000), smooth_scene());
    let imports = "import package::scene::shapes::Surface;
        import package::scene::shading::{keeps_side, viewed_normal};";
    let body = "var surface: Surface;
        surface.shading_normal = bitcast<vec3<f32>>(a.xyz);
        let facing = bitcast<vec3<f32>>(b.xyz);
        let wo = bitcast<vec3<f32>>(c.xyz);
        let diffuse = viewed_normal(surface, facing, true, wo, 0u);
        let mirror = viewed_normal(surface, facing, true, wo, 1u);
        out0 = vec4<u32>(bitcast<vec3<u32>>(diffuse), u32(keeps_side(surface.shading_normal, facing, wo)));
        out1 = vec4<u32>(bitcast<vec3<u32>>(mirror), 0u);";
    let probe = Probe::<3, 2>::new(&gpu, &key(&scene), imports, body);
    let mut worst = 0f32;
    for (view, [diffuse, mirror]) in views.iter().zip(ask(&gpu, &probe, &scene, &[], &views)) {
        for (kind, found) in [(KIND_DIFFUSE, diffuse), (KIND_MIRROR, mirror)] {
            worst = worst.max(floats(found).0.distance(seen(view, kind)));
        }
        let [shading, facing, wo] = view.map(|row| floats(row).0);
        assert_eq!(diffuse[3] == 1, keeps_side(shading, facing, wo));
    }
    println!("worst difference of bent normals between the twins: {worst:e}");
    // Where a viewer grazes, a rounding of the direction is worth more of the normal.
    assert!(worst < if computes_to_the_letter(&gpu) { 1e-5 } else { 1e-3 }, "{worst:e}");
}

/// A viewer who moves by a little sees a normal that moves by little, wherever bending begins. Where both directions graze,
/// the normal of the mirror between them moves by up to a hundred times as much, so steps are small.
#[test]
fn bent_normals_are_continuous() {
    const STEPS: i32 = 64_000;
    // From 89.4° on one side to 89.4° on the other.
    let step = 2.0 * 1.56 / f64::from(STEPS);
    let largest_jump = |seen_from: &dyn Fn([Vec3; 3]) -> Vec3| {
        let mut numbers = Numbers(47);
        let mut largest = 0f32;
        for _ in 0..40 {
            let facing = numbers.direction();
            let shading = near(&mut numbers, facing, 1.5).as_vec3();
            let d = numbers.direction();
            let aside = (d - facing * d.dot(facing)).normalize();
            let at = |i: i32| {
                let angle = -1.56 + step * f64::from(i);
                let wo = (facing * angle.cos() + aside * angle.sin()).as_vec3();
                seen_from([shading, facing.as_vec3(), wo])
            };
            largest = (0..STEPS).fold(largest, |largest, i| largest.max(at(i).distance(at(i + 1))));
        }
        f64::from(largest)
    };
    let bent = largest_jump(&|view| seen(&view.map(|v| row(v, 0)), KIND_MIRROR));
    println!("a step of the viewer moves the normal by {:.1} times as much at most", bent / step);
    assert!(bent < 200.0 * step, "{bent:e} in a step of {step:e}");
    // Negative control: the shape's normal where the shading normal is seen from behind.
    let swapped = largest_jump(&|[shading, facing, wo]| if shading.dot(wo) > 0.0 { shading } else { facing });
    assert!(swapped > 0.1, "{swapped}");
}

/// Red along growing u, green along falling v, blue outwards, whichever way the image lies: turned, mirrored, or on a quad.
#[test]
fn normal_maps_tilt_normals_along_the_image() {
    let (x, y) = (Vec3::X, Vec3::Y);
    let laid = |u: Vec3, up: Vec3| {
        let along = |axis: Vec3, p: &DVec3| (1.0 + axis.dot(p.as_vec3())) / 2.0;
        let uvs = square().positions.iter().map(|p| [along(u, p), 1.0 - along(up, p)]).collect();
        (Some(MeshData { uvs, ..square() }), u, up)
    };
    // A quad, and the square with an image laid on it in every way: where u grows and where v falls.
    let mut ways = vec![(None, x, y)];
    let turned = [(x, y), (y, -x), (-x, -y), (-y, x), (-x, y), (y, x), (x, -y), (-y, -x)];
    ways.extend(turned.map(|(u, up)| laid(u, up)));
    // Coordinates of a point say nothing of directions.
    ways.push((Some(MeshData { uvs: vec![[0.5; 2]; 4], ..square() }), Vec3::ZERO, Vec3::ZERO));
    // (218 − 128) / 127 is 0.7087 in red and in blue: 45°. The last is no direction at all.
    let maps: [([u8; 3], f64, [f32; 3]); 6] = [
        ([128, 128, 255], 1.0, [0.0, 0.0, 1.0]),
        ([218, 128, 218], 1.0, [1.0, 0.0, 1.0]),
        ([128, 218, 218], 1.0, [0.0, 1.0, 1.0]),
        ([128, 38, 218], 2.0, [0.0, -2.0, 1.0]),
        ([218, 218, 128], 1.0, [1.0, 1.0, 0.0]),
        ([128, 128, 128], 1.0, [0.0, 0.0, 1.0]),
    ];
    let mut builder = unseen();
    for (i, &(texel, normal_scale, _)) in maps.iter().enumerate() {
        let textures =
            MaterialTextures { normal: Some(TextureRef::new(i)), normal_scale, ..Default::default() };
        builder = builder.texture(image(1, &[texel])).material(i.to_string(), white().textured(textures));
    }
    // Quads come first, and each square has two triangles, of which the first lies below on the right.
    let (mut expected, mut questions, mut triangles) = (Vec::new(), Vec::new(), maps.len() as u32);
    let (origin, direction) = (Vec3::new(0.3, -0.2, 2.0), Vec3::NEG_Z);
    for (data, u, up) in &ways {
        for (i, &(_, _, told)) in maps.iter().enumerate() {
            let shape = match data {
                Some(_) => triangles,
                None => i as u32,
            };
            builder = match data {
                Some(data) => builder.mesh(data.clone(), i.to_string()),
                None => builder.quad([-1.0, -1.0, 0.0], [2.0, 0.0, 0.0], [0.0, 2.0, 0.0], i.to_string()),
            };
            triangles += 2 * u32::from(data.is_some());
            let normal = *u * told[0] + *up * told[1] + Vec3::Z * told[2];
            expected.push(if *u == Vec3::ZERO { Vec3::Z } else { normal.normalize() });
            questions.push([row(origin, shape), row(direction, i as u32)]);
        }
    }
    let scene = CompiledScene::new(&builder.build().unwrap());
    let gpu = open_gpu();
    let imports = "import package::scene::shapes::{Hit, Ray, surface_at};
        import package::scene::data::material_maps_at;
        import package::scene::shading::mapped_normal;";
    let body =
        "let surface = surface_at(Ray(bitcast<vec3<f32>>(a.xyz), bitcast<vec3<f32>>(b.xyz)), Hit(2.0, a.w));
        out0 = vec4<u32>(bitcast<vec3<u32>>(mapped_normal(surface, material_maps_at(b.w))), 0u);";
    let probe = Probe::<2, 1>::new(&gpu, &key(&scene), imports, body);
    let kernels = ask(&gpu, &probe, &scene, &[], &questions);
    for ((&[a, b], [kernel]), expected) in questions.iter().zip(kernels).zip(expected) {
        let mut surface = surface_at(&scene, Ray { origin, direction }, Hit { t: 2.0, shape: a[3] });
        textured(&scene, b[3], &mut surface);
        for normal in [surface.shading_normal, floats(kernel).0] {
            assert!(
                normal.distance(expected) < 1e-6,
                "shape {}, map {}: {normal} for {expected}",
                a[3],
                b[3]
            );
        }
    }
}
