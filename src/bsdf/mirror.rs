//! With probability `parameter` a perfect mirror, else Lambertian; both tinted (Bansal 2018: "specular").
//! GPU twin: kernels/bsdf/mirror.wesl

use super::{BsdfSample, BsdfValue};
use crate::math::{mirrored, to_world};
use crate::sampling::{pdf_cosine, sample_cosine};
use crate::scene::compiled::Material;
use glam::{Vec3, Vec3Swizzles};

/// The diffuse part; the mirror is a delta lobe, which no direction chosen elsewhere can meet.
#[inline]
pub fn evaluate(material: &Material, normal: Vec3, wi: Vec3) -> BsdfValue {
    let pdf = (1.0 - material.parameter) * pdf_cosine(normal.dot(wi));
    BsdfValue { value: material.color * pdf, pdf }
}

#[inline]
pub fn sample(material: &Material, normal: Vec3, wo: Vec3, u: Vec3) -> BsdfSample {
    if u.z < material.parameter {
        return BsdfSample { wi: mirrored(-wo, normal), weight: material.color, pdf: 0.0 };
    }
    let local = sample_cosine(u.xy());
    BsdfSample {
        wi: to_world(local, normal),
        weight: material.color,
        pdf: (1.0 - material.parameter) * pdf_cosine(local.z),
    }
}
