"""Round solids and images from formulas, as the bytes of files: what make_still_life.py and make_chess.py are made with.

A solid is (vertices, triangles): vertices of (position, normal, (u, v)), triangles of three numbers, counterclockwise from outside.
"""

import struct
import zlib
from math import cos, pi, sin, sqrt


def unit(v):
    size = sqrt(sum(x * x for x in v))
    return tuple(x / size for x in v)


def cross(a, b):
    return tuple(a[i] * b[j] - a[j] * b[i] for i, j in ((1, 2), (2, 0), (0, 1)))


def spline(points, steps):
    """A Catmull-Rom curve through `points` (tuples), of `steps` pieces between neighbours."""
    extended = lambda a, b: tuple(2 * x - y for x, y in zip(a, b))  # As if it went on straight.
    points = [extended(*points[:2]), *points, extended(*points[: -3 : -1])]

    def at(i, t):
        around = zip(*points[i : i + 4])
        return tuple(
            0.5 * (2 * q + (r - p) * t + (2 * p - 5 * q + 4 * r - s) * t * t + (3 * q - p - 3 * r + s) * t**3)
            for p, q, r, s in around
        )

    curve = [at(i, k / steps) for i in range(len(points) - 3) for k in range(steps)]
    return [*curve, points[-2]]


def revolved(profile, around, steps):
    """Turns a profile of (radius, height) about y: it starts and ends on the axis and has the solid on its left, as a
    line has that goes outwards below and up outside."""
    curve = [(max(radius, 1e-4), height) for radius, height in spline(profile, steps)]
    curve[0], curve[-1] = profile[0], profile[-1]
    pieces = [unit([b - a for a, b in zip(*ends)]) for ends in zip(curve, curve[1:])]
    vertices, triangles = [], []
    for j, (radius, height) in enumerate(curve):
        # Between those of the two pieces that meet here; level on the axis.
        dr, dy = (sum(d) for d in zip(*pieces[max(j - 1, 0) : j + 1]))
        axis = j in (0, len(curve) - 1)
        out, up = (0.0, -dr / abs(dr)) if axis else unit((dy, -dr))
        for i in range(around + 1):
            c, s = cos(2 * pi * i / around), -sin(2 * pi * i / around)
            if i == around:
                c, s = 1.0, 0.0
            vertices.append(((radius * c, height, radius * s), (out * c, up, out * s), (i / around, 1 - j / (len(curve) - 1))))
    row = around + 1
    for j in range(len(curve) - 1):
        for i in range(around):
            a, b = j * row + i, (j + 1) * row + i
            if j > 0:
                triangles.append((a, a + 1, b + 1))
            if j < len(curve) - 2:
                triangles.append((a, b + 1, b))
    return vertices, triangles


def tube(path, along, across, radius):
    """A closed tube about path(t), t from 0 to 1, and a second direction that is never along it: path(t) -> (point, side)."""
    vertices, triangles = [], []
    for i in range(along + 1):
        t = (i % along) / along
        (point, side), (after, _), (before, _) = path(t), path(t + 1e-4), path(t - 1e-4)
        forward = unit([b - a for a, b in zip(before, after)])
        beside = unit(cross(forward, side))
        above = cross(beside, forward)
        for j in range(across + 1):
            c, s = cos(2 * pi * j / across), sin(2 * pi * j / across)
            if j == across:
                c, s = 1.0, 0.0
            normal = tuple(c * a + s * b for a, b in zip(above, beside))
            vertices.append((tuple(p + radius * n for p, n in zip(point, normal)), normal, (i / along, j / across)))
    row = across + 1
    for i in range(along):
        for j in range(across):
            a, b = i * row + j, (i + 1) * row + j
            triangles += [(a, a + 1, b + 1), (a, b + 1, b)]
    return vertices, triangles


def moved(solid, move):
    """The solid with move(point) for its points and, as directions, its normals."""
    vertices, triangles = solid
    return [(move(p), unit(move(n)), uv) for p, n, uv in vertices], triangles


def standing(solid):
    """The solid with its lowest point at height 0."""
    vertices, triangles = solid
    low = min(p[1] for p, _, _ in vertices)
    return [((p[0], p[1] - low, p[2]), n, uv) for p, n, uv in vertices], triangles


def volume(solid):
    """By the divergence theorem: negative if the solid is inside out."""
    vertices, triangles = solid
    return sum(
        sum(x * y for x, y in zip(vertices[a][0], cross(vertices[b][0], vertices[c][0]))) for a, b, c in triangles
    ) / 6


def ply(solid, textured):
    """A binary PLY file, with texture coordinates where they are needed. PLY's v goes up."""
    vertices, triangles = solid
    names = "x y z nx ny nz".split() + (["u", "v"] if textured else [])
    header = "ply\nformat binary_little_endian 1.0\n" + f"element vertex {len(vertices)}\n"
    header += "".join(f"property float {name}\n" for name in names)
    header += f"element face {len(triangles)}\nproperty list uchar int vertex_indices\nend_header\n"
    rows = b"".join(struct.pack(f"<{len(names)}f", *p, *n, *((uv[0], 1 - uv[1]) if textured else ())) for p, n, uv in vertices)
    return header.encode() + rows + b"".join(struct.pack("<B3i", 3, *corners) for corners in triangles)


def png(width, height, texel):
    """An 8-bit RGB image of texel(x, y) -> three numbers from 0 to 255."""

    def chunk(kind, data):
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    rows = b""
    for y in range(height):
        rows += b"\0" + bytes(max(0, min(255, int(c))) for x in range(width) for c in texel(x, y))
    header = struct.pack(">2I5B", width, height, 8, 2, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + chunk(b"IDAT", zlib.compress(rows, 9)) + chunk(b"IEND", b"")


def at_point(x, y, salt=0):
    """A number in 0..1 that belongs to a point with whole coordinates (by the finaliser of MurmurHash3)."""
    h = (x * 0x9E3779B1 ^ y * 0x85EBCA77 ^ salt * 0xC2B2AE35) & 0xFFFFFFFF
    h = (h ^ h >> 16) * 0x85EBCA6B & 0xFFFFFFFF
    h = (h ^ h >> 13) * 0xC2B2AE35 & 0xFFFFFFFF
    return (h ^ h >> 16) / 2**32


def noise(x, y, period_x, period_y, salt=0):
    """Smooth noise in 0..1 that repeats after whole periods."""
    x0, y0 = int(x // 1), int(y // 1)
    u, v = (t * t * (3 - 2 * t) for t in (x - x0, y - y0))
    point = lambda i, j: at_point((x0 + i) % period_x, (y0 + j) % period_y, salt)
    near = point(0, 0) + (point(1, 0) - point(0, 0)) * u
    far = point(0, 1) + (point(1, 1) - point(0, 1)) * u
    return near + (far - near) * v
