#!/usr/bin/env python3
"""Converged images by Mitsuba 3 with tighter tolerances than its own path integrator has: what docs/ACCURACY.md compares with.

    python3 -m venv ~/mitsuba && ~/mitsuba/bin/pip install mitsuba numpy
    ~/mitsuba/bin/python benches/peers/mitsuba_reference.py scenes/cornell-box.toml --spp 32768 --offset 2e-6 --out cornell.exr

Mitsuba's `path` starts rays 8.9e-5 · (1 + largest coordinate) off the surface and ends shadow rays at 1 − 8.9e-4 of their
length. Light leaks under edges by the first and past whatever stands close to a lamp by the second, 0.02 % and 0.08 % of two
scenes' means. Here the same estimator (direct light, MIS by the power heuristic, no roulette) is written over Mitsuba's shapes,
materials, lights and camera, with the first a choice and the second gone: a shadow ray is free if the first thing it meets is
the light. So intersection, materials, sampling of lights and random numbers are all Mitsuba's own, nothing of qtracer's.

Writes OUT and OUT's name with .se.exr, standard errors from independent runs. Exit codes: 0 done, 2 bad input.
"""

import argparse
import sys
import time
from pathlib import Path

import drjit as dr
import mitsuba as mi
import numpy as np

from mitsuba_peer import find_libraries, positive

MITSUBA_OFFSET = 8.9407e-5


def arguments():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    add = parser.add_argument
    add("scene", type=Path, help="a scene file of qtracer")
    add("--variant", default="llvm_ad_rgb", help="cuda_ad_rgb or llvm_ad_rgb")
    add("--size", nargs=2, type=positive, help="width and height; by default the scene's")
    add("--spp", type=positive, default=1024, help="samples per pixel of all runs together")
    add("--runs", type=positive, default=16, help="independent runs; their spread is the standard error")
    add("--seed", type=int, default=0, help="first seed")
    add("--max-bounces", type=positive, default=64, help="levels of a path")
    add("--offset", type=float, default=MITSUBA_OFFSET, help="where rays start: this times 1 + the largest coordinate")
    add("--direct-light", choices=["on", "off"], default="on")
    add("--wave", type=positive, default=1 << 26, help="most samples (of all pixels) of one launch")
    add("--out", type=Path, required=True)
    given = parser.parse_args()
    if given.runs < 2 or given.spp < given.runs:
        parser.error("at least two runs of at least one sample are needed to know the error")
    return given


def power(pdf, other):
    """The power heuristic, as a ratio so that no square overflows."""
    ratio = dr.select(pdf > 0, other / pdf, 0)
    return 1 / (1 + ratio * ratio)


def register():
    """The integrator, as a class of the current variant."""

    class TightPath(mi.SamplingIntegrator):
        def __init__(self, props):
            super().__init__(props)
            self.levels = props.get("max_depth", 64)
            self.offset = props.get("offset", MITSUBA_OFFSET)
            self.direct_light = props.get("direct_light", True)

        def leave(self, si, direction):
            """A ray off the surface, on the side to which it goes."""
            distance = self.offset * (1 + dr.max(dr.abs(si.p)))
            side = dr.mulsign(distance, dr.dot(si.n, direction))
            return mi.Ray3f(si.p + si.n * side, direction)

        def sample_light(self, scene, sampler, si, bsdf, active):
            """Direct light at a surface, weighted against the chance that the material finds it."""
            context = mi.BSDFContext()
            active = active & mi.has_flag(bsdf.flags(), mi.BSDFFlags.Smooth)
            light, weight = scene.sample_emitter_direction(si, sampler.next_2d(active), False, active)
            active &= light.pdf > 0
            value, pdf = bsdf.eval_pdf(context, si, si.to_local(light.d), active)
            first = scene.ray_intersect(self.leave(si, light.d), active)
            # Nothing met is the sky.
            seen = active & (first.emitter(scene, active) == light.emitter)
            mis = power(light.pdf, dr.select(light.delta, 0, pdf))
            return dr.select(seen, value * weight * mis, 0)

        @dr.syntax
        def sample(self, scene, sampler, ray, medium=None, active=True):
            context = mi.BSDFContext()
            ray = mi.Ray3f(ray)
            radiance, throughput = mi.Color3f(0), mi.Color3f(1)
            depth, active = mi.UInt32(0), mi.Bool(active)
            before, density, delta = dr.zeros(mi.Interaction3f), mi.Float(1), mi.Bool(True)
            while active:
                si = scene.ray_intersect(ray, active)
                emitter = si.emitter(scene, active)
                there = mi.DirectionSample3f(scene, si, before)
                other = scene.pdf_emitter_direction(before, there, ~delta & active)
                other = dr.select(delta | (not self.direct_light), 0, other)
                radiance += dr.select(active, throughput * emitter.eval(si, active) * power(density, other), 0)
                # As Mitsuba counts: a path of n levels sees light behind n surfaces but the last.
                active &= si.is_valid() & (depth + 1 < self.levels)
                bsdf = si.bsdf(ray)
                if dr.hint(self.direct_light, mode="scalar"):
                    radiance += throughput * self.sample_light(scene, sampler, si, bsdf, active)
                found, weight = bsdf.sample(context, si, sampler.next_1d(active), sampler.next_2d(active), active)
                ray = self.leave(si, si.to_world(found.wo))
                throughput *= weight
                before, density = mi.Interaction3f(si), found.pdf
                delta = mi.has_flag(found.sampled_type, mi.BSDFFlags.Delta)
                depth += 1
                active &= dr.max(throughput) > 0
            return radiance, mi.Bool(True), []

    mi.register_integrator("qtracer_tight_path", lambda props: TightPath(props))


def render(given, size):
    """Means of the runs, as an array of runs × height × width × 3."""
    import mitsuba_scene

    scene = mitsuba_scene.load(mitsuba_scene.read(given.scene), size, given.max_bounces, 1 << 20, given.scene.parent)
    register()
    integrator = mi.load_dict({
        "type": "qtracer_tight_path",
        "max_depth": given.max_bounces,
        "offset": given.offset,
        "direct_light": given.direct_light == "on",
    })
    most = max(1, given.wave // (size[0] * size[1]))
    each = given.spp // given.runs
    runs, launches = [], 0
    for run in range(given.runs):
        total, left = 0, each
        while left:
            count = min(left, most)
            seed = (given.seed + run) * 100_000 + launches
            image = mi.render(scene, integrator=integrator, spp=count, seed=seed)
            total = total + count * np.array(image, dtype=np.float64).reshape(size[1], size[0], 3)
            left, launches = left - count, launches + 1
        runs.append(total / each)
    return np.stack(runs)


def main():
    given = arguments()
    if not given.scene.exists():
        print(f"error: no scene file {given.scene}", file=sys.stderr)
        return 2
    find_libraries([given.variant])
    if given.variant not in mi.variants() or given.variant.startswith("scalar"):
        print(f"error: no variant {given.variant}: cuda_ad_rgb or llvm_ad_rgb", file=sys.stderr)
        return 2
    mi.set_variant(given.variant)
    import mitsuba_scene

    camera = mitsuba_scene.read(given.scene)["camera"]
    size = tuple(given.size or (camera["width"], camera["height"]))
    start = time.perf_counter()
    try:
        runs = render(given, size)
    except ValueError as error:
        print(f"error: {given.scene}: {error}", file=sys.stderr)
        return 2
    mean, error = runs.mean(axis=0), runs.std(axis=0, ddof=1) / np.sqrt(given.runs)
    given.out.parent.mkdir(parents=True, exist_ok=True)
    for path, values in [(given.out, mean), (given.out.with_suffix(".se.exr"), error)]:
        mi.Bitmap(values.astype(np.float32)).write(str(path))
    whole = runs.mean(axis=(1, 2))
    spread = whole.std(axis=0, ddof=1) / np.sqrt(given.runs)
    figures = " ".join(f"{m:.6f} ({s / m if m else 0:.1e})" for m, s in zip(whole.mean(axis=0), spread))
    samples = given.spp // given.runs * given.runs
    print(f"{given.scene.stem}: {samples} samples in {time.perf_counter() - start:.1f} s; means {figures}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
