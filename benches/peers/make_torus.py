#!/usr/bin/env python3
"""The mesh and the texture of scenes/surfaces.toml: nothing but formulas, so anyone may have them.

    python3 benches/peers/make_torus.py scenes

Writes DIR/meshes/torus.ply (a bumpy torus of 4,096 triangles with normals and texture coordinates) and DIR/textures/tiles.png.
"""

import struct
import sys
import zlib
from math import cos, hypot, pi, sin
from pathlib import Path

AROUND, ACROSS = 64, 32
RING, TUBE, BUMP = 1.0, 0.4, 0.05
TILES = 48, 36


def point(u, v):
    """u goes around the ring, v around the tube, both 0 to 1."""
    tube = TUBE + BUMP * cos(2 * pi * 5 * u)
    out = RING + tube * cos(2 * pi * v)
    return out * cos(2 * pi * u), tube * sin(2 * pi * v), -out * sin(2 * pi * u)


def normal(u, v, step=1e-5):
    """Of the surface itself, by central differences."""
    along, across = (
        [(b - a) for a, b in zip(point(u - du, v - dv), point(u + du, v + dv))] for du, dv in ((step, 0), (0, step))
    )
    x, y, z = (
        along[i] * across[k] - along[k] * across[i] for i, k in ((1, 2), (2, 0), (0, 1))
    )
    size = hypot(x, y, z)
    return x / size, y / size, z / size


def mesh():
    """A seam of double vertices, since texture coordinates do not close."""
    grid = [(i / AROUND, j / ACROSS) for i in range(AROUND + 1) for j in range(ACROSS + 1)]
    vertices = b"".join(struct.pack("<8f", *point(u, v), *normal(u, v), 6 * u, 2.5 * v) for u, v in grid)
    faces = b""
    for i in range(AROUND):
        for j in range(ACROSS):
            a, b = i * (ACROSS + 1) + j, (i + 1) * (ACROSS + 1) + j
            faces += struct.pack("<B3iB3i", 3, a, b, b + 1, 3, a, b + 1, a + 1)
    names = "x y z nx ny nz u v".split()
    header = "ply\nformat binary_little_endian 1.0\n" + f"element vertex {len(grid)}\n"
    header += "".join(f"property float {name}\n" for name in names)
    header += f"element face {2 * AROUND * ACROSS}\nproperty list uchar int vertex_indices\nend_header\n"
    return header.encode() + vertices + faces


def texel(x, y):
    """Tiles of three colours with dark joints, and no two rows or columns alike."""
    if x % 12 == 0 or y % 12 == 0:
        return 60, 55, 50
    red, green, blue = [(220, 90, 60), (240, 220, 170), (50, 110, 180)][(x // 12 + 2 * (y // 12)) % 3]
    return red - x // 2, green - y, blue - (x + y) // 4


def png(width, height):
    """An 8-bit RGB image."""

    def chunk(kind, data):
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    rows = b"".join(b"\0" + bytes(c for x in range(width) for c in texel(x, y)) for y in range(height))
    header = struct.pack(">2I5B", width, height, 8, 2, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + chunk(b"IDAT", zlib.compress(rows, 9)) + chunk(b"IEND", b"")


def main():
    if len(sys.argv) != 2:
        sys.exit(__doc__)
    for name, data in (("meshes/torus.ply", mesh()), ("textures/tiles.png", png(*TILES))):
        path = Path(sys.argv[1]) / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(data)


if __name__ == "__main__":
    main()
