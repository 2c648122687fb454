"""A scene of qtracer (scenes/*.toml, or JSON with the same keys) as a scene of Mitsuba 3.

`mitsuba.set_variant(...)` must have been called before `load`.
"""

import json
import math
import tomllib
from pathlib import Path

import drjit as dr
import mitsuba as mi
import numpy as np


def read(path):
    """The scene file as a dictionary."""
    text = Path(path).read_text(encoding="utf-8")
    return json.loads(text) if str(path).endswith(".json") else tomllib.loads(text)


def load(description, size, max_depth, roulette_depth, folder=Path(".")):
    """Mitsuba's scene: its path integrator (direct light and MIS), a box filter of one pixel, independent samples. Meshes and
    textures lie in `folder`."""
    scene = {
        "type": "scene",
        "integrator": {"type": "path", "max_depth": max_depth, "rr_depth": roulette_depth},
        "sensor": _camera(description["camera"], size),
    }
    environment = description.get("environment", {})
    radiance = environment.get("radiance", [0, 0, 0])
    if "map" in environment:
        scene["environment"] = _map(environment, Path(folder))
    elif max(radiance) > 0:
        scene["environment"] = {"type": "constant", "radiance": _rgb(radiance)}
    materials = description.get("materials", {})
    for name, material in materials.items():
        scene[f"material_{name}"] = {**_material(material, folder), "id": f"material_{name}"}
    for i, (material, shape) in enumerate(_shapes(description, folder)):
        shape["bsdf"] = {"type": "ref", "id": f"material_{material}"}
        emission = materials[material].get("emission", [0, 0, 0])
        if max(emission) > 0:
            shape["emitter"] = {"type": "area", "radiance": _rgb(emission)}
        scene[f"shape_{i:04}"] = shape
    return mi.load_dict(scene)


def _map(environment, folder):
    """Mitsuba's first and last rows lie at the poles, qtracer's half a texel from them. Interpolation is linear, so rows at
    every half texel are the same function: those of the map and the means between them."""
    texels = np.array(mi.Bitmap(str(folder / environment["map"])).convert(mi.Bitmap.PixelFormat.RGB, mi.Struct.Type.Float32))
    padded = np.concatenate([texels[:1], texels, texels[-1:]]).astype(np.float64)
    rows = np.empty((2 * texels.shape[0] + 1, *texels.shape[1:]))
    rows[1::2] = texels
    rows[0::2] = (padded[1:] + padded[:-1]) / 2
    tint = np.array(environment.get("radiance", [1, 1, 1])) * environment.get("scale", 1)
    turn = environment.get("rotate_y_deg", 0)
    return {
        "type": "envmap",
        "bitmap": mi.Bitmap((rows * tint).astype(np.float32)),
        "to_world": mi.ScalarTransform4f().rotate([0, 1, 0], turn),
    }


def _rgb(colour):
    return {"type": "rgb", "value": [float(c) for c in colour]}


def _camera(camera, size):
    width, height = size
    near = 1e-3 if max(abs(x) for x in camera["origin"]) < 20 else 1e-2
    up = camera.get("up", [0, 1, 0])
    return {
        "type": "perspective",
        "fov": camera["fov_y_deg"],
        "fov_axis": "y",
        "near_clip": near,
        "far_clip": 1e5,
        "to_world": mi.ScalarTransform4f().look_at(origin=camera["origin"], target=camera["target"], up=up),
        "film": {
            "type": "hdrfilm",
            "width": width,
            "height": height,
            "rfilter": {"type": "box"},
            "pixel_format": "rgb",
            "component_format": "float32",
        },
        "sampler": {"type": "independent"},
    }


def _colour(material, folder):
    """The colour, or the texture times the colour, which must be grey."""
    given = material.get("color", [1, 1, 1])
    if "color_texture" not in material:
        return _rgb(given)
    if len(set(given)) > 1:
        raise ValueError("a color beside a color_texture must be grey")
    bitmap = mi.Bitmap(str(folder / material["color_texture"])).convert(mi.Bitmap.PixelFormat.RGB, mi.Struct.Type.Float32, False)
    linear = np.array(bitmap) * float(given[0])
    wrap = {"repeat": "repeat", "clamp": "clamp", "mirror": "mirror"}[material.get("texture_wrap", "repeat")]
    return {"type": "bitmap", "bitmap": mi.Bitmap(linear.astype(np.float32)), "raw": True, "wrap_mode": wrap}


def _material(material, folder):
    """What reflects on both sides in qtracer is made two-sided here."""
    kind = material["type"]
    if kind == "dielectric":
        tint = _rgb(material.get("tint", [1, 1, 1]))
        return {
            "type": "dielectric",
            "int_ior": float(material["ior"]),
            "ext_ior": 1.0,
            "specular_reflectance": tint,
            "specular_transmittance": tint,
        }
    if kind == "rough-dielectric":
        _register_rough()
        tint = material.get("tint", [1, 1, 1])
        return {"type": "qtracer_rough_glass", "alpha": _alpha(material), "ior": float(material["ior"]), "color": _rgb(tint)}
    colour = _colour(material, folder)
    diffuse = {"type": "diffuse", "reflectance": colour}
    if kind == "diffuse":
        return {"type": "twosided", "side": diffuse}
    if kind == "mirror":
        mirror = {"type": "conductor", "material": "none", "specular_reflectance": colour}
        level = float(material.get("level", 1.0))
        return {"type": "twosided", "side": {"type": "blendbsdf", "weight": level, "a": diffuse, "b": mirror}}
    if kind == "glossy":
        _register_glossy()
        lobe = {"type": "qtracer_glossy", "exponent": float(material["exponent"]), "color": colour}
        return {"type": "twosided", "side": lobe}
    if kind in ("metal", "metallic-roughness"):
        _register_rough()
        metallic = float(material.get("metallic", 1.0))
        lobe = {"type": "qtracer_coated", "alpha": _alpha(material), "metallic": metallic, "color": colour}
        return {"type": "twosided", "side": lobe}
    raise ValueError(f"unknown material type {kind}")


def _alpha(material):
    return max(float(material["roughness"]) ** 2, 1e-3)


def _shapes(description, folder):
    """(material, shape without it); boxes become six quads, outward."""
    for shape in description.get("shapes", []):
        kind = shape["type"]
        if kind == "sphere":
            inward = bool(shape.get("inward", False))
            sphere = {"type": "sphere", "center": shape["center"], "radius": shape["radius"], "flip_normals": inward}
            yield shape["material"], sphere
        elif kind == "quad":
            yield shape["material"], _quad(shape["corner"], shape["e1"], shape["e2"])
        elif kind == "mesh":
            yield shape["material"], _mesh(shape, folder)
        elif kind == "box":
            for side in _box(shape):
                yield shape["material"], _quad(*side)
        else:
            raise ValueError(f"unknown shape type {kind}")


def _mesh(shape, folder):
    """A mesh of a PLY or OBJ file: scaled, then turned, then moved. Its v goes up from the lower edge of images, Mitsuba's down
    from the upper."""
    path = Path(folder) / shape["file"]
    place = mi.ScalarTransform4f().translate(shape.get("translate", [0, 0, 0]))
    place = place.rotate([0, 1, 0], shape.get("rotate_y_deg", 0.0)).scale(shape.get("scale", 1.0))
    return {
        "type": path.suffix[1:].lower(),
        "filename": str(path),
        "to_world": place,
        "face_normals": not shape.get("smooth", True),
        "flip_tex_coords": True,
    }


def _quad(corner, e1, e2):
    """The parallelogram of `corner`, outward e1 × e2: Mitsuba's rectangle spans -1 to 1 and faces +z."""
    corner, e1, e2 = (np.asarray(v, dtype=float) for v in (corner, e1, e2))
    normal = np.cross(e1, e2)
    matrix = np.eye(4)
    matrix[:3, 0] = e1 / 2
    matrix[:3, 1] = e2 / 2
    matrix[:3, 2] = normal / np.linalg.norm(normal)
    matrix[:3, 3] = corner + e1 / 2 + e2 / 2
    return {"type": "rectangle", "to_world": mi.ScalarTransform4f(matrix)}


def _box(shape):
    """(corner, e1, e2) of the six sides."""
    angle = math.radians(shape.get("rotate_y_deg", 0.0))
    sin, cos = math.sin(angle), math.cos(angle)
    width, height, depth = shape["size"]
    x = np.array([cos, 0, -sin]) * width
    y = np.array([0.0, 1, 0]) * height
    z = np.array([sin, 0, cos]) * depth
    low = np.asarray(shape["center"], dtype=float) - (x + y + z) / 2
    return [(low, z, y), (low + x, y, z), (low, x, z), (low + y, z, x), (low, y, x), (low + z, x, y)]


_registered = set()


def _register_glossy():
    """qtracer's glossy lobe, which Mitsuba lacks: f·cosθ = color · (n+1)/2π · (cosⁿα + cosⁿα′), where α is the angle to the
    mirror direction and α′ that of the direction reflected in the surface: what falls below it is folded up."""
    if mi.variant() in _registered:
        return
    if mi.variant().startswith("scalar"):
        raise ValueError("its glossy material is written in Python, which scalar variants run far too slowly")
    _registered.add(mi.variant())

    class Glossy(mi.BSDF):
        def __init__(self, props):
            mi.BSDF.__init__(self, props)
            self.exponent = float(props["exponent"])
            color = props["color"]
            self.color = mi.Color3f(color[0], color[1], color[2])
            flags = mi.BSDFFlags.GlossyReflection | mi.BSDFFlags.FrontSide
            self.m_components = [flags]
            self.m_flags = flags

        def traverse(self, callback):
            pass

        def _density(self, wi, wo):
            scale = (self.exponent + 1) / (2 * math.pi)
            mirrored = mi.Vector3f(-wi.x, -wi.y, wi.z)
            above = dr.maximum(dr.dot(mirrored, wo), 0)
            below = dr.maximum(dr.dot(mirrored, mi.Vector3f(wo.x, wo.y, -wo.z)), 0)
            power = lambda cosine: dr.select(cosine > 0, dr.power(cosine, self.exponent), 0)
            return scale * (power(above) + power(below))

        def sample(self, ctx, si, sample1, sample2, active):
            wi = si.wi
            cosine = dr.power(sample2.x, 1 / (self.exponent + 1))
            sine = dr.safe_sqrt(1 - cosine * cosine)
            phi = 2 * math.pi * sample2.y
            lobe = mi.Frame3f(mi.Vector3f(-wi.x, -wi.y, wi.z))
            wo = lobe.to_world(mi.Vector3f(sine * dr.cos(phi), sine * dr.sin(phi), cosine))
            wo = mi.Vector3f(wo.x, wo.y, dr.abs(wo.z))
            active = active & (wi.z > 0) & (wo.z > 0)
            found = mi.BSDFSample3f()
            found.wo = wo
            found.pdf = dr.select(active, self._density(wi, wo), 0)
            found.eta = 1
            found.sampled_type = +mi.BSDFFlags.GlossyReflection
            found.sampled_component = 0
            return found, dr.select(active & (found.pdf > 0), self.color, 0)

        def eval(self, ctx, si, wo, active):
            return self.color * self.pdf(ctx, si, wo, active)

        def pdf(self, ctx, si, wo, active):
            return dr.select(active & (si.wi.z > 0) & (wo.z > 0), self._density(si.wi, wo), 0)

        def eval_pdf(self, ctx, si, wo, active):
            return self.eval(ctx, si, wo, active), self.pdf(ctx, si, wo, active)

        def to_string(self):
            return f"Glossy[exponent={self.exponent}]"

    mi.register_bsdf("qtracer_glossy", Glossy)


def _schlick(f0, cosine):
    return f0 + (1 - f0) * dr.power(dr.maximum(1 - cosine, 0), 5)


def _shadowing(alpha, a, b):
    """What Smith's height-correlated masking and shadowing is of Mitsuba's, which multiplies the two as if independent."""
    def smith(v):
        tan2 = (v.x * v.x + v.y * v.y) / (v.z * v.z)
        return (dr.sqrt(1 + alpha * alpha * tan2) - 1) / 2

    x, y = smith(a), smith(b)
    return dr.select((a.z == 0) | (b.z == 0), 0, (1 + x) * (1 + y) / (1 + x + y))


_rough_registered = set()


def _register_rough():
    """qtracer's rough materials, of Mitsuba's roughconductor and roughdielectric (GGX: facets, Jacobians, Fresnel, sampling),
    but for the correlation of masking and shadowing, Schlick's reflectance, and the base beneath the coat."""
    if mi.variant() in _rough_registered:
        return
    if mi.variant().startswith("scalar"):
        raise ValueError("its rough materials are written in Python, which scalar variants run far too slowly")
    _rough_registered.add(mi.variant())

    class RoughGlass(mi.BSDF):
        def __init__(self, props):
            mi.BSDF.__init__(self, props)
            self.alpha = float(props["alpha"])
            color = props["color"]
            self.color = mi.Color3f(color[0], color[1], color[2])
            self.inner = mi.load_dict({
                "type": "roughdielectric",
                "distribution": "ggx",
                "alpha": self.alpha,
                "int_ior": float(props["ior"]),
                "ext_ior": 1.0,
            })
            sides = mi.BSDFFlags.FrontSide | mi.BSDFFlags.BackSide
            self.m_components = [
                mi.BSDFFlags.GlossyReflection | sides,
                mi.BSDFFlags.GlossyTransmission | mi.BSDFFlags.NonSymmetric | sides,
            ]
            self.m_flags = self.m_components[0] | self.m_components[1]

        def traverse(self, callback):
            pass

        def sample(self, ctx, si, sample1, sample2, active):
            found, weight = self.inner.sample(ctx, si, sample1, sample2, active)
            return found, weight * self.color * _shadowing(self.alpha, si.wi, found.wo)

        def eval(self, ctx, si, wo, active):
            return self.inner.eval(ctx, si, wo, active) * self.color * _shadowing(self.alpha, si.wi, wo)

        def pdf(self, ctx, si, wo, active):
            return self.inner.pdf(ctx, si, wo, active)

        def eval_pdf(self, ctx, si, wo, active):
            return self.eval(ctx, si, wo, active), self.pdf(ctx, si, wo, active)

        def to_string(self):
            return f"RoughGlass[alpha={self.alpha}]"

    class Coated(mi.BSDF):
        """Metal by `metallic`, else a base under a coat that reflects 4 %, which light passes on its way in and out."""

        def __init__(self, props):
            mi.BSDF.__init__(self, props)
            self.alpha = float(props["alpha"])
            self.metallic = float(props["metallic"])
            color = props["color"]
            self.color = mi.Color3f(color[0], color[1], color[2])
            self.facets = mi.load_dict(
                {"type": "roughconductor", "material": "none", "distribution": "ggx", "alpha": self.alpha}
            )
            self.base = mi.load_dict({"type": "diffuse", "reflectance": {"type": "rgb", "value": [1.0, 1.0, 1.0]}})
            self.m_components = [mi.BSDFFlags.GlossyReflection | mi.BSDFFlags.FrontSide]
            self.m_flags = self.m_components[0]

        def traverse(self, callback):
            pass

        def eval(self, ctx, si, wo, active):
            facets = self.facets.eval(ctx, si, wo, active) * _shadowing(self.alpha, si.wi, wo)
            middle = dr.normalize(si.wi + wo)
            head_on = 0.04 * (1 - self.metallic) + self.color * self.metallic
            reflected = facets * _schlick(head_on, dr.dot(middle, wo))
            passed = (1 - _schlick(0.04, si.wi.z)) * (1 - _schlick(0.04, wo.z)) / 0.916
            base = self.base.eval(ctx, si, wo, active) * self.color * ((1 - self.metallic) * passed)
            return dr.select(active & (si.wi.z > 0) & (wo.z > 0), reflected + base, 0)

        def _half(self):
            return 0.0 if self.metallic == 1 else 0.5

        def pdf(self, ctx, si, wo, active):
            facets, base = self.facets.pdf(ctx, si, wo, active), self.base.pdf(ctx, si, wo, active)
            both = facets * (1 - self._half()) + base * self._half()
            return dr.select(active & (si.wi.z > 0) & (wo.z > 0), both, 0)

        def sample(self, ctx, si, sample1, sample2, active):
            found, _ = self.facets.sample(ctx, si, sample1, sample2, active)
            other, _ = self.base.sample(ctx, si, sample1, sample2, active)
            found.wo = dr.select(sample1 < self._half(), other.wo, found.wo)
            found.pdf = self.pdf(ctx, si, found.wo, active)
            found.eta = 1
            found.sampled_type = +mi.BSDFFlags.GlossyReflection
            found.sampled_component = 0
            weight = self.eval(ctx, si, found.wo, active) / found.pdf
            return found, dr.select(active & (found.pdf > 0), weight, 0)

        def eval_pdf(self, ctx, si, wo, active):
            return self.eval(ctx, si, wo, active), self.pdf(ctx, si, wo, active)

        def to_string(self):
            return f"Coated[alpha={self.alpha}, metallic={self.metallic}]"

    mi.register_bsdf("qtracer_rough_glass", RoughGlass)
    mi.register_bsdf("qtracer_coated", Coated)
