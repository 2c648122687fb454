#!/usr/bin/env python3
"""Mitsuba 3 on qtracer's scenes: rows for the plots of `speed_vs_error`, with the same estimator and error.

    python3 -m venv ~/mitsuba && ~/mitsuba/bin/pip install mitsuba numpy
    ~/mitsuba/bin/python benches/peers/mitsuba_peer.py --variants llvm_ad_rgb --budget 2 --out results/mitsuba.jsonl
    speed_vs_error --report results --out results

Its path integrator samples lights directly and combines by MIS, like qtracer's; roulette is off unless --roulette on. The
clock runs from a render's first sample until its image is in the host's memory; what is compiled on the way was compiled
before, in an untimed warm-up. A row is written at once, so an interrupted run keeps its rows. With --speed no error is
measured and no reference needed. Exit codes: 0 done, 1 something failed, 2 bad input.
"""

import argparse
import ctypes
import datetime
import glob
import json
import os
import subprocess
import sys
import time
from pathlib import Path

import numpy as np

SCENES = ["cornell-box", "bansal-room-1", "bansal-room-5", "door-ajar", "glass-caustic"]
# How tests/references calls them.
ALIASES = {
    "cornell-box": "cornell",
    "bansal-room-1": "seed1",
    "bansal-room-5": "seed5",
    "door-ajar": "door",
    "glass-caustic": "caustic",
}
REPOSITORY = Path(__file__).resolve().parents[2]


def arguments():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    add = parser.add_argument
    default_scenes = [str(REPOSITORY / "scenes" / f"{name}.toml") for name in SCENES]
    add("--scenes", nargs="+", default=default_scenes, help="scene files; by default the five that have references")
    add("--variants", nargs="+", default=["llvm_ad_rgb"], help="cuda_ad_rgb, llvm_ad_rgb, scalar_rgb")
    add("--references", type=Path, default=REPOSITORY / "tests/references", help="folder of SCENE.exr")
    add("--size", nargs=2, type=positive, help="width and height; by default the reference's")
    add("--budget", type=float, default=2.0, help="seconds of one render (about)")
    add("--checks", type=positive, default=5, help="check points, each at twice the samples of the one before")
    add("--spp", type=positive, help="samples per pixel of one render, instead of --budget")
    add("--seeds", type=positive, default=10)
    add("--max-bounces", type=positive, default=64, help="levels of a path")
    add("--roulette", choices=["on", "off"], default="off", help="on: from the fifth level, as is Mitsuba's custom")
    add("--epsilon", type=float, default=0.01, help="added to squares of the reference in relMSE")
    add("--wave", type=positive, default=1 << 26, help="most samples (of all pixels) of one launch")
    add("--speed", action="store_true", help="measure samples per second alone")
    add("--device", help="name of the device in the rows; by default what the machine says")
    add("--out", type=Path, default=Path("mitsuba.jsonl"), help="rows are appended here")
    given = parser.parse_args()
    if not (given.budget > 0 and given.epsilon > 0):
        parser.error("--budget and --epsilon must be above 0")
    return given


def positive(text):
    value = int(text)
    if value < 1:
        raise argparse.ArgumentTypeError("must be above 0")
    return value


class Reference:
    """A converged image and what its own noise adds to a relMSE, per pixel."""

    def __init__(self, mi, folder, scene, size, epsilon):
        names = [scene, ALIASES.get(scene, scene)]
        path = next((folder / f"{n}.exr" for n in names if (folder / f"{n}.exr").exists()), None)
        if path is None:
            raise ValueError(f"no reference {scene}.exr in {folder}; give --references, or --speed")
        self.name = path.stem
        layers = _layers(mi, path)
        rgb = layers["rgb"]
        errors = layers.get("stderr")
        beside = path.with_suffix(".se.exr")
        if errors is None and beside.exists():
            errors = _layers(mi, beside)["rgb"]
        if errors is None:
            raise ValueError(f"{path} has no standard errors")
        width, height = size or (rgb.shape[1], rgb.shape[0])
        self.rgb = _block_means(rgb, width, height, path)
        blocks = rgb.shape[0] // height * (rgb.shape[1] // width)
        variance = _block_means(errors**2, width, height, path) / blocks
        self.scale = self.rgb**2 + epsilon
        self.pixel_noise = (variance / self.scale).mean(axis=2).ravel()
        self.noise = float(self.pixel_noise.mean())
        self.size = (width, height)

    def error_of(self, image):
        """relMSE of all pixels, and without the worst 0.1 %; the reference's own noise subtracted."""
        errors = ((image - self.rgb) ** 2 / self.scale).mean(axis=2).ravel()
        if not np.isfinite(errors).all():
            raise ValueError("the image holds values that are no finite numbers")
        own = errors - self.pixel_noise
        kept = np.argsort(errors, kind="stable")[: len(errors) - len(errors) // 1000]
        return float(own.mean()), float(own[kept].mean())


def _layers(mi, path):
    """Three-channel layers of an EXR file by name, as f64. The colours themselves are "rgb"."""
    layers = {}
    for name, bitmap in mi.Bitmap(str(path)).split():
        # Channels are in no certain order, and others may be among them.
        places = {field.name.split(".")[-1]: at for at, field in enumerate(bitmap.struct_())}
        if {"R", "G", "B"} <= places.keys():
            values = np.array(bitmap, dtype=np.float64)
            layers["rgb" if name == "<root>" else name] = values[:, :, [places[c] for c in "RGB"]]
    return layers


def _block_means(values, width, height, path):
    """Averages blocks of pixels, which with a box filter are the pixels of the smaller image."""
    side = values.shape[1] // width
    if side == 0 or (height * side, width * side) != values.shape[:2]:
        raise ValueError(f"{path}: {values.shape[1]} x {values.shape[0]} pixels can't be averaged to {width} x {height}")
    return values.reshape(height, side, width, side, 3).mean(axis=(1, 3))


class Render:
    """A scene in the current variant, rendered progressively."""

    def __init__(self, mi, scene, size, wave):
        self.mi, self.scene, self.size = mi, scene, size
        self.most = max(1, wave // (size[0] * size[1]))

    def launch(self, samples, seed):
        """The mean of some samples, in the host's memory."""
        image = self.mi.render(self.scene, spp=samples, seed=seed)
        return np.array(image, dtype=np.float32).reshape(self.size[1], self.size[0], 3)

    def launches(self, samples):
        """Cuts samples into launches that fit."""
        while samples > 0:
            count = min(samples, self.most)
            yield count
            samples -= count

    def warm_up(self, steps):
        """Compiles what each size of launch needs."""
        for count in sorted({count for step in steps for count in self.launches(step)}):
            self.launch(count, 999_999_000)

    def rate(self):
        """Samples per pixel in a second, from launches that grow until they take a fifth of a second."""
        samples = 1
        while True:
            self.launch(samples, 999_999_001)
            start = time.perf_counter()
            self.launch(samples, 999_999_002)
            seconds = time.perf_counter() - start
            if seconds > 0.2 or samples >= self.most:
                return samples / seconds
            samples = min(self.most, samples * (2 if seconds > 0.05 else 4))

    def run(self, steps, seed):
        """(samples, seconds, image) after each step."""
        total = np.zeros((self.size[1], self.size[0], 3))
        samples, seconds, launches = 0, 0.0, 0
        for step in steps:
            start = time.perf_counter()
            for count in self.launches(step):
                total += count * self.launch(count, seed * 100_000 + launches).astype(np.float64)
                samples, launches = samples + count, launches + 1
            seconds += time.perf_counter() - start
            yield samples, seconds, total / samples


def steps(total, checks):
    """Samples to add at each check point, so that the sums double and end near `total`."""
    first = max(1, round(total / 2 ** (checks - 1)))
    sums = [first * 2**k for k in range(checks) if k == 0 or first * 2**k <= 1.5 * total]
    return [b - a for a, b in zip([0, *sums], sums)]


def measure(mi, given, path, write):
    """The rows of one scene in the current variant."""
    import mitsuba_scene

    description = mitsuba_scene.read(path)
    name = description["name"]
    size = tuple(given.size) if given.size else None
    reference = None if given.speed else Reference(mi, given.references, name, size, given.epsilon)
    camera = description["camera"]
    size = size or (reference.size if reference else (camera["width"], camera["height"]))
    roulette_depth = 5 if given.roulette == "on" else 1 << 20
    start = time.perf_counter()
    scene = mitsuba_scene.load(description, size, given.max_bounces, roulette_depth, path.parent)
    render = Render(mi, scene, size, given.wave)
    plan = steps(given.spp or render.rate() * given.budget, given.checks)
    render.warm_up(plan)
    setup = time.perf_counter() - start
    same = {
        "scene": name,
        "renderer": "mitsuba",
        "engine": mi.variant(),
        "variant": "off:throughput" if given.roulette == "on" else "off:off",
        "direct_light": True,
        "max_bounces": given.max_bounces,
        "sampler": "independent",
        "width": size[0],
        "height": size[1],
        "setup_seconds": setup,
        "epsilon": 0.0 if given.speed else given.epsilon,
        "truth": f"independent reference {reference.name}" if reference else "",
        "truth_noise": reference.noise if reference else 0.0,
        "commit": f"mitsuba {mi.__version__}",
        "date": datetime.datetime.now(datetime.timezone.utc).date().isoformat(),
        **machine(mi.variant(), given.device),
    }
    for seed in range(1, given.seeds + 1):
        for samples, seconds, image in render.run(plan, seed):
            plain, trimmed = reference.error_of(image) if reference else (None, None)
            found = {"relative_mse": plain, "trimmed": trimmed}
            write({**same, "seed": seed, "goal": f"{samples} samples", "samples": samples, "seconds": seconds, **found})
    speed = size[0] * size[1] * samples / seconds / 1e6
    error = "" if plain is None else f", relMSE {plain:.3e}"
    print(f"{name} {mi.variant()}: {samples} samples in {seconds:.3f} s, {speed:.2f} Msamples/s{error}", file=sys.stderr)


def machine(variant, device):
    """Device and driver, as qtracer's rows call them."""
    if variant.startswith("cuda"):
        query = ["nvidia-smi", "--query-gpu=name,driver_version", "--format=csv,noheader"]
        try:
            found = subprocess.run(query, capture_output=True, text=True, check=True).stdout.splitlines()[0]
            name, driver = (part.strip() for part in found.split(","))
        except (OSError, subprocess.CalledProcessError, IndexError, ValueError):
            name, driver = "unknown GPU", ""
        return {"device": device or name, "driver": f"CUDA {driver}".strip()}
    model = "CPU"
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
        model = next(" ".join(line.split(": ")[1].split()) for line in lines if line.startswith("model name"))
    except (OSError, StopIteration, IndexError):
        pass
    return {"device": device or f"{model}, {len(os.sched_getaffinity(0))} threads", "driver": ""}


def find_libraries(variants):
    """Mitsuba looks for OptiX and LLVM where these variables say; LLVM 15 aborts it."""
    if any(v.startswith("cuda") for v in variants) and "DRJIT_LIBOPTIX_PATH" not in os.environ:
        folders = ["/usr/lib/x86_64-linux-gnu", "/usr/lib64", "/usr/local/nvidia/lib64", "/usr/local/nvidia/lib"]
        for library in (path for folder in folders for path in sorted(glob.glob(f"{folder}/libnvoptix.so*"))):
            try:
                ctypes.CDLL(library, mode=ctypes.RTLD_GLOBAL)
            except OSError:
                continue
            os.environ["DRJIT_LIBOPTIX_PATH"] = library
            break
    if any(v.startswith("llvm") for v in variants) and "DRJIT_LIBLLVM_PATH" not in os.environ:
        patterns = ["/usr/lib/x86_64-linux-gnu/libLLVM*19*", "/usr/lib/llvm-1[6-9]/lib/libLLVM*.so*"]
        found = [path for pattern in patterns for path in sorted(glob.glob(pattern))]
        if found:
            os.environ["DRJIT_LIBLLVM_PATH"] = found[0]


def main():
    given = arguments()
    find_libraries(given.variants)
    try:
        import mitsuba as mi
    except ImportError as error:
        print(f"error: {error}; pip install mitsuba", file=sys.stderr)
        return 2
    unknown = [variant for variant in given.variants if variant not in mi.variants()]
    missing = [path for path in given.scenes if not Path(path).exists()]
    if unknown or missing:
        problem = f"no variant {unknown[0]}; there are {mi.variants()}" if unknown else f"no scene file {missing[0]}"
        print(f"error: {problem}", file=sys.stderr)
        return 2
    given.out.parent.mkdir(parents=True, exist_ok=True)
    failures = 0
    with open(given.out, "a", encoding="utf-8") as file:

        def write(row):
            file.write(json.dumps(row) + "\n")
            file.flush()

        for variant in given.variants:
            mi.set_variant(variant)
            for path in given.scenes:
                try:
                    measure(mi, given, path, write)
                except Exception as error:  # One scene or variant that fails must not cost the others.
                    failures += 1
                    cause = f" ({error.__cause__})" if error.__cause__ else ""
                    print(f"{path} {variant}: {error}{cause}", file=sys.stderr)
    return 1 if failures else 0


if __name__ == "__main__":
    sys.exit(main())
