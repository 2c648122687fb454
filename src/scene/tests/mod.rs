//! Laws of scene descriptions.

mod errors;
mod files;
mod fuzz;
mod meaning;

/// A valid scene; tests replace parts of it.
const ROOM: &str = r#"name = "room"
[camera]
origin = [0, 1, 4]
target = [0, 0, 0]
fov_y_deg = 40
width = 320
height = 240
[render]
spp = 16
[materials.white]
type = "diffuse"
color = [0.7, 0.7, 0.7]
[materials.glass]
type = "dielectric"
ior = 1.5
[materials.polished]
type = "mirror"
color = [0.9, 0.9, 0.9]
level = 0.5
[materials.shiny]
type = "glossy"
color = [0.5, 0.5, 0.5]
exponent = 20
[materials.lamp]
type = "diffuse"
color = [0, 0, 0]
emission = [15, 15, 15]
[[shapes]]
type = "quad"
corner = [-1, 0, -1]
e1 = [0, 0, 2]
e2 = [2, 0, 0]
material = "white"
[[shapes]]
name = "lamp"
type = "sphere"
center = [0, 3, 0]
radius = 0.5
material = "lamp"
[[shapes]]
type = "box"
center = [0, 1, 0]
size = [1, 2, 3]
material = "glass"
"#;
