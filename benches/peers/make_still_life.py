#!/usr/bin/env python3
"""The meshes and textures of scenes/still-life.toml: nothing but formulas, so anyone may have them.

    python3 benches/peers/make_still_life.py scenes

Writes goblet, carafe, vase, bowl, pear and knot (.ply, normals; the vase with texture coordinates) into DIR/meshes, and planks.png,
porcelain.png into DIR/textures.
"""

import sys
from math import atan2, cos, hypot, pi, sin
from pathlib import Path

from solids import at_point, moved, noise, ply, png, revolved, standing, tube, volume

# Profiles of (radius, height). Glass has a wall: up outside, over the rim, down inside.
GOBLET = [
    (0, 0.012), (0.2, 0.0), (0.4, 0.0), (0.435, 0.018), (0.4, 0.036), (0.25, 0.06), (0.09, 0.11), (0.05, 0.22),
    (0.042, 0.45), (0.05, 0.66), (0.1, 0.74), (0.28, 0.83), (0.42, 0.98), (0.475, 1.18), (0.46, 1.4), (0.412, 1.635),
    (0.4085, 1.66), (0.399, 1.669), (0.3895, 1.66), (0.393, 1.635), (0.43, 1.4), (0.444, 1.18), (0.39, 1.0), (0.26, 0.87), (0.1, 0.8), (0, 0.79),
]
CARAFE = [
    (0, 0.03), (0.25, 0.0), (0.5, 0.0), (0.6, 0.03), (0.66, 0.12), (0.66, 0.4), (0.58, 0.74), (0.37, 1.02), (0.21, 1.24),
    (0.17, 1.5), (0.19, 1.78), (0.27, 1.95), (0.262, 1.975), (0.235, 1.96), (0.15, 1.78), (0.125, 1.5), (0.16, 1.24),
    (0.32, 0.98), (0.52, 0.72), (0.6, 0.4), (0.6, 0.16), (0.53, 0.09), (0.25, 0.075), (0, 0.08),
]
VASE = [
    (0, 0.02), (0.2, 0.0), (0.38, 0.0), (0.42, 0.04), (0.4, 0.12), (0.5, 0.34), (0.66, 0.68), (0.72, 1.0), (0.64, 1.32),
    (0.44, 1.58), (0.3, 1.74), (0.27, 1.9), (0.33, 2.06), (0.44, 2.16), (0.435, 2.19), (0.4, 2.18), (0.29, 2.06),
    (0.225, 1.9), (0.25, 1.74), (0.38, 1.56), (0.5, 1.2), (0.4, 0.6), (0.2, 0.36), (0, 0.34),
]
BOWL = [
    (0, 0.03), (0.2, 0.0), (0.32, 0.0), (0.35, 0.03), (0.36, 0.08), (0.6, 0.22), (0.78, 0.42), (0.856, 0.62), (0.863, 0.655),
    (0.85, 0.672), (0.836, 0.655), (0.828, 0.62), (0.745, 0.44), (0.57, 0.26), (0.3, 0.14), (0, 0.11),
]
PEAR = [
    (0, 0.05), (0.06, 0.02), (0.15, 0.0), (0.27, 0.06), (0.335, 0.2), (0.32, 0.36), (0.23, 0.52), (0.155, 0.66), (0.125, 0.77),
    (0.075, 0.83), (0.03, 0.815), (0.026, 0.84), (0.026, 0.93), (0.03, 0.97), (0.014, 0.98), (0, 0.98),
]


def knot():
    """A trefoil, upright: a line that goes twice around a ring while it goes three times through it."""

    def path(t):
        a, b = 2 * 2 * pi * t, 3 * 2 * pi * t
        out = 0.46 + 0.2 * cos(b)
        side = cos(b) * cos(a), cos(b) * sin(a), sin(b)
        return (out * cos(a), out * sin(a), 0.2 * sin(b)), side

    turn = pi / 2
    upright = lambda p: (p[0] * cos(turn) - p[1] * sin(turn), p[0] * sin(turn) + p[1] * cos(turn), p[2])
    return standing(moved(tube(path, 168, 18, 0.105), upright))


def planks(x, y, width=192, height=192, rows=6):
    """Boards along x, two a row, dark joints; grain that is stretched and warped."""
    row, within = y * rows // height, y * rows / height % 1
    shifted = (x + (row % 2) * width // 3 + row * 17) % width
    board, end = 2 * row + shifted * 2 // width, shifted * 2 / width % 1
    if within < 0.035 or end < 0.012:
        return 42, 26, 16
    tone = 0.78 + 0.3 * at_point(board, 1)
    warp = noise(x / 24, y / 8, 8, 24, board)
    rings = 0.5 + 0.5 * sin(2 * pi * (within * 5 + 2.4 * warp + at_point(board, 2)))
    fibre = noise(x / 12, y / 1.0, 16, 192, 7)
    light = tone * (0.72 + 0.2 * rings + 0.16 * fibre)
    return tuple(round(c * light / 4) * 4 for c in (150, 96, 56))


def porcelain(x, y, width=256, height=256):
    """White, with blue bands and two rows of flowers. The lower half of the picture is the outside, bottom up."""
    white, blue = (238, 240, 238), (28, 62, 150)
    u, v = (x + 0.5) / width, 1 - (y + 0.5) / height
    mix = lambda s: tuple(a + (b - a) * max(0.0, min(1.0, s)) for a, b in zip(white, blue))
    edge = 0.5 * height
    bands = [(0.17, 0.006), (0.19, 0.002), (0.41, 0.002), (0.425, 0.006), (0.515, 0.003), (0.575, 0.01)]
    inked = max(edge * (half - abs(v - middle)) for middle, half in bands)
    for middle, count, size in ((0.3, 6, 0.075), (0.475, 12, 0.028)):
        # Flowers of six petals, about as wide as high on the vase.
        across = ((u * count) % 1 - 0.5) / count * (1.05 if count == 6 else 0.85)
        up = (v - middle) * (0.55 if count == 6 else 0.6) * 1.6
        far, angle = hypot(across, up), atan2(up, across)
        petal = size * (0.55 + 0.45 * abs(cos(3 * angle)))
        inked = max(inked, 2.2 * edge * min(petal - far, far - size * 0.22 if far > size * 0.1 else size * 0.1 - far))
        # A vine between them.
        if count == 6:
            wave = middle + 0.055 * sin(2 * pi * count * u)
            inked = max(inked, edge * (0.004 - abs(v - wave)) if far > size * 1.05 else inked)
    return mix(0.5 + inked)


def main():
    if len(sys.argv) != 2:
        sys.exit(__doc__)
    solids = {
        "goblet": revolved(GOBLET, 78, 2),
        "carafe": revolved(CARAFE, 84, 2),
        "vase": revolved(VASE, 56, 2),
        "bowl": revolved(BOWL, 100, 2),
        "pear": revolved(PEAR, 56, 3),
        "knot": knot(),
    }
    files = {}
    for name, solid in solids.items():
        assert volume(solid) > 0, f"{name} is inside out"
        files[f"meshes/{name}.ply"] = ply(solid, textured=name == "vase")
    files["textures/planks.png"] = png(192, 192, planks)
    files["textures/porcelain.png"] = png(256, 256, porcelain)
    for name, data in files.items():
        path = Path(sys.argv[1]) / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(data)
        print(f"{name}: {len(data)} bytes")


if __name__ == "__main__":
    main()
