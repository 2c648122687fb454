//! Environment maps: lookup and sampling against densities and f64, images against closed forms and Mitsuba 3.

mod renders;
mod sampling;

use crate::probe::Numbers;
use glam::DVec3;
use qtracer::Scene;
use qtracer::scene::{EnvironmentMap, Material, SceneBuilder};
use std::f64::consts::{PI, TAU};

/// A map of so many columns and rows, each texel by its column and row.
fn map_of(width: u32, height: u32, texel: impl Fn(u32, u32) -> [f32; 3]) -> EnvironmentMap {
    let texels = (0..height).flat_map(|row| (0..width).map(move |column| (column, row)));
    let texels = texels.map(|(column, row)| texel(column, row)).collect();
    EnvironmentMap::new(width, height, texels).unwrap()
}

/// One texel of 1e6 in darkness.
fn one_bright(width: u32, height: u32, column: u32, row: u32) -> EnvironmentMap {
    map_of(width, height, |c, r| if (c, r) == (column, row) { [1e6, 5e5, 1e6] } else { [0.0; 3] })
}

/// Maps with whatever is hard about them, none of them black.
fn maps() -> Vec<(&'static str, EnvironmentMap)> {
    let mut numbers = Numbers(5);
    let noise: Vec<[f32; 3]> =
        (0..12 * 7).map(|_| [(); 3].map(|()| numbers.of_any_size(1e-2, 10.0) as f32)).collect();
    let noise = EnvironmentMap::new(12, 7, noise).unwrap();
    vec![
        ("one texel", map_of(1, 1, |_, _| [0.5, 1.0, 2.0])),
        ("two texels", map_of(2, 1, |column, _| [column as f32, 0.25, 0.0])),
        ("noise", noise.clone()),
        ("noise, turned", noise.rotated(70.0)),
        ("uniform", map_of(16, 8, |_, _| [1.0; 3])),
        ("one bright texel", one_bright(16, 8, 5, 3)),
        ("bright at the seam", one_bright(16, 8, 15, 5).rotated(-33.0)),
        ("bright at a pole", one_bright(16, 8, 9, 0)),
        ("a bright row", map_of(9, 5, |_, row| if row == 4 { [3.0; 3] } else { [0.001; 3] })),
    ]
}

/// A scene under the map; shapes are added.
fn under(map: EnvironmentMap) -> SceneBuilder {
    Scene::builder("under a map")
        .camera([0.0, 0.0, 4.0], [0.0; 3], 40.0)
        .environment_map(map)
        .material("white", Material::diffuse([1.0; 3]))
        .material("grey", Material::diffuse([0.5; 3]))
}

/// A ball under the map.
fn ball_under(map: EnvironmentMap) -> Scene {
    under(map).sphere([0.0; 3], 1.0, "grey").build().unwrap()
}

/// The direction of a texel's centre, by the convention as it is written down.
fn direction_of(map: &EnvironmentMap, column: f64, row: f64) -> DVec3 {
    let longitude = TAU * ((column + 0.5) / f64::from(map.width()) - map.rotate_y_deg() / 360.0);
    let colatitude = PI * (row + 0.5) / f64::from(map.height());
    let sine = colatitude.sin();
    DVec3::new(sine * longitude.sin(), colatitude.cos(), -sine * longitude.cos())
}

/// Bilinear interpolation in f64 between the centres of the texels around.
fn radiance_of(map: &EnvironmentMap, d: DVec3) -> DVec3 {
    let (width, height) = (f64::from(map.width()), f64::from(map.height()));
    let turns = d.x.atan2(-d.z) / TAU + map.rotate_y_deg() / 360.0;
    let x = turns * width - 0.5;
    let y = (d.x.hypot(d.z).atan2(d.y) / PI * height - 0.5).clamp(0.0, height - 1.0);
    let texel = |column: f64, row: f64| {
        let column = column.rem_euclid(width) as usize;
        let row = row.min(height - 1.0) as usize;
        DVec3::from_array(map.texels()[row * map.width() as usize + column].map(f64::from))
    };
    let row = |row: f64| texel(x.floor(), row).lerp(texel(x.floor() + 1.0, row), x - x.floor());
    row(y.floor()).lerp(row(y.floor() + 1.0), y - y.floor())
}
