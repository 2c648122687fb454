//! Spheres and parallelograms in f64.

use glam::{DVec3, Vec3};
use qtracer::scene::compiled::{Quad, Sphere};

/// Half the distance of 1 from the next f32: the relative error of one operation.
pub const ROUNDING: f64 = f32::EPSILON as f64 / 2.0;

/// A unit vector in single precision: what a ray's direction is.
pub fn unit(v: DVec3) -> Vec3 {
    v.normalize().as_vec3()
}

/// Where the line of a ray meets a sphere: middle and half length of the chord, which is NaN if there is none.
pub fn chord(origin: Vec3, direction: Vec3, center: Vec3, radius: f64) -> (f64, f64) {
    let (f, d) = (origin.as_dvec3() - center.as_dvec3(), direction.as_dvec3());
    let length = d.length();
    let middle = -f.dot(d) / (length * length);
    let approach = f + d * middle;
    (middle, (radius * radius - approach.length_squared()).sqrt() / length)
}

/// How far outside the sphere the point at `t` lies; negative inside. Worked out from the centre, so that no digits go to
/// where the sphere is.
pub fn height_over_sphere(sphere: &Sphere, origin: Vec3, direction: Vec3, t: f64) -> f64 {
    let from_center = origin.as_dvec3() - sphere.center.as_dvec3();
    (from_center + direction.as_dvec3() * t).length() - f64::from(sphere.radius)
}

/// A parallelogram with exactly the corner and the sides that the program holds of it; not its rounded normal and duals.
pub struct Parallelogram {
    pub corner: DVec3,
    pub e1: DVec3,
    pub e2: DVec3,
    pub normal: DVec3,
}

impl Parallelogram {
    pub fn new(quad: &Quad) -> Self {
        let [corner, e1, e2] = [quad.corner, quad.e1, quad.e2].map(|v| v.as_dvec3());
        Parallelogram { corner, e1, e2, normal: e1.cross(e2).normalize() }
    }

    /// The point of a ray at `t`, from the corner.
    pub fn at(&self, origin: Vec3, direction: Vec3, t: f64) -> DVec3 {
        origin.as_dvec3() - self.corner + direction.as_dvec3() * t
    }

    /// How far over the plane a point lies, on the side of the normal.
    pub fn height(&self, from_corner: DVec3) -> f64 {
        self.normal.dot(from_corner)
    }

    /// Where the line of a ray meets the plane: infinite or NaN if it is parallel.
    pub fn plane_distance(&self, origin: Vec3, direction: Vec3) -> f64 {
        -self.height(self.at(origin, direction, 0.0)) / self.normal.dot(direction.as_dvec3())
    }

    /// How far a point, put onto the plane, lies within the nearest of the four edges' lines; negative outside.
    pub fn within(&self, from_corner: DVec3) -> f64 {
        let (u, v) = (self.e2.cross(self.normal), self.normal.cross(self.e1));
        let share = |dual: DVec3, edge: DVec3| dual.dot(from_corner) / dual.dot(edge);
        let (a, b) = (share(u, self.e1), share(v, self.e2));
        // The height of the parallelogram over each side turns shares into lengths.
        let heights = [self.e1.dot(u).abs() / u.length(), self.e2.dot(v).abs() / v.length()];
        (a.min(1.0 - a) * heights[0]).min(b.min(1.0 - b) * heights[1])
    }
}
