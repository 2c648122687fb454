#!/usr/bin/env python3
"""scenes/models/chess.glb, a glTF 2.0 model such as other programs write: nothing but formulas, so anyone may have it.

    python3 benches/peers/make_chess.py scenes

An end game: nested nodes with moves, turns and scales; meshes that many nodes share, in two colours; embedded PNGs (colour and
metallic-roughness of the board); glass (transmission, ior), metal, a lamp (emissive strength), a camera.
"""

import json
import struct
import sys
from math import cos, pi, sin
from pathlib import Path

from solids import at_point, noise, png, revolved, volume

# Profiles of (radius, height), of pieces on fields of side 1.
FOOT = [(0, 0.02), (0.2, 0.0), (0.34, 0.0), (0.37, 0.04), (0.35, 0.11), (0.28, 0.15), (0.26, 0.2), (0.19, 0.28)]
PAWN = FOOT + [(0.12, 0.44), (0.1, 0.56), (0.19, 0.61), (0.12, 0.66), (0.19, 0.74), (0.21, 0.83), (0.16, 0.95), (0, 1.01)]
BISHOP = FOOT + [
    (0.13, 0.48), (0.1, 0.76), (0.2, 0.81), (0.12, 0.86), (0.19, 0.98), (0.2, 1.08), (0.12, 1.25), (0.045, 1.32),
    (0.075, 1.37), (0.045, 1.42), (0, 1.43),
]
QUEEN = FOOT + [
    (0.14, 0.52), (0.11, 0.9), (0.22, 0.97), (0.13, 1.02), (0.16, 1.16), (0.25, 1.4), (0.22, 1.42), (0.14, 1.38),
    (0.09, 1.42), (0.1, 1.49), (0.06, 1.56), (0, 1.57),
]
ROOK = FOOT + [
    (0.18, 0.45), (0.17, 0.72), (0.25, 0.79), (0.26, 0.9), (0.26, 1.0), (0.24, 1.01), (0.19, 1.0), (0.18, 0.94), (0.17, 0.89),
    (0, 0.885),
]
# Numbers that glTF has for types of components.
U16, F32 = 5123, 5126


class Model:
    """A .glb in the making: lists of JSON and one buffer."""

    def __init__(self):
        self.lists, self.binary = {}, b""

    def add(self, kind, **what):
        self.lists.setdefault(kind, []).append(what)
        return len(self.lists[kind]) - 1

    def view(self, data):
        self.binary += b"\0" * (-len(self.binary) % 4)
        offset = len(self.binary)
        self.binary += data
        return self.add("bufferViews", buffer=0, byteOffset=offset, byteLength=len(data))

    def accessor(self, component, kind, rows, **bounds):
        letter = {U16: "H", F32: "f"}[component]
        data = b"".join(struct.pack(f"<{len(row)}{letter}", *row) for row in rows)
        kept = {"componentType": component, "type": kind, "count": len(rows), **bounds}
        return self.add("accessors", bufferView=self.view(data), **kept)

    def shape(self, solid, textured=False):
        """A primitive without its material."""
        vertices, triangles = solid
        points = [tuple(struct.unpack("<3f", struct.pack("<3f", *p))) for p, _, _ in vertices]
        bounds = {"min": [min(axis) for axis in zip(*points)], "max": [max(axis) for axis in zip(*points)]}
        attributes = {
            "POSITION": self.accessor(F32, "VEC3", points, **bounds),
            "NORMAL": self.accessor(F32, "VEC3", [n for _, n, _ in vertices]),
        }
        if textured:
            attributes["TEXCOORD_0"] = self.accessor(F32, "VEC2", [uv for _, _, uv in vertices])
        return {"attributes": attributes, "indices": self.accessor(U16, "SCALAR", [(i,) for t in triangles for i in t])}

    def mesh(self, name, shape, material):
        return self.add("meshes", name=name, primitives=[{**shape, "material": material}])

    def texture(self, name, data):
        image = self.add("images", name=name, mimeType="image/png", bufferView=self.view(data))
        return {"index": self.add("textures", source=image)}

    def material(self, name, color, metallic, roughness, textures=None, **rest):
        model = {"baseColorFactor": [*color, 1], "metallicFactor": metallic, "roughnessFactor": roughness, **(textures or {})}
        return self.add("materials", name=name, pbrMetallicRoughness=model, **rest)

    def glb(self, roots, extensions):
        root = {"asset": {"version": "2.0", "generator": "make_chess.py"}, "scene": 0, "scenes": [{"nodes": roots}]}
        root |= self.lists | {"extensionsUsed": extensions, "buffers": [{"byteLength": len(self.binary)}]}

        def chunk(kind, data, fill):
            data += fill * (-len(data) % 4)
            return struct.pack("<I", len(data)) + kind + data

        text = json.dumps(root, separators=(",", ":")).encode()
        chunks = chunk(b"JSON", text, b" ") + chunk(b"BIN\0", self.binary, b"\0")
        return b"glTF" + struct.pack("<2I", 2, 12 + len(chunks)) + chunks


def field(x, y, size=128):
    """Which of 8 x 8 fields a texel is of, or None on the joints."""
    across, down = x * 8 / size, y * 8 / size
    joint = min(across % 1, down % 1) < 0.06
    return None if joint else (int(across), int(down))


def board_color(x, y):
    found = field(x, y)
    if found is None:
        return 30, 22, 16
    dark = sum(found) % 2 == 0
    number = found[0] + 8 * found[1]
    grain = 0.8 + 0.12 * at_point(number, 3) + 0.18 * noise(x / 4, y / 16, 32, 8, number)
    return tuple(round(c * grain / 4) * 4 for c in ((70, 44, 30) if dark else (226, 196, 150)))


def board_roughness(x, y):
    """Green is roughness and blue metalness: light fields are polished, dark ones and joints are not."""
    found = field(x, y)
    rough = 0.9 if found is None else (0.45 if sum(found) % 2 == 0 else 0.18)
    return 0, 255 * rough, 0


def slab(half, height):
    """A box about the origin with its top at height 0, and the image on its top alone (elsewhere one texel of it)."""
    vertices, triangles = [], []
    for axis, sign in ((0, 1), (0, -1), (1, 1), (1, -1), (2, 1), (2, -1)):
        first = len(vertices)
        normal = [0, 0, 0]
        normal[axis] = sign
        for a, b in ((-1, -1), (1, -1), (1, 1), (-1, 1)):
            unit = [0, 0, 0]
            unit[axis], unit[(axis + 1) % 3], unit[(axis + 2) % 3] = sign, a, b
            point = half * unit[0], (unit[1] - 1) * height / 2, half * unit[2]
            uv = ((unit[0] + 1) / 2, (unit[2] + 1) / 2) if (axis, sign) == (1, 1) else (0, 0)
            vertices.append((point, tuple(normal), uv))
        corners = (0, 1, 2, 3) if sign > 0 else (0, 3, 2, 1)
        a, b, c, d = (first + corner for corner in corners)
        triangles += [(a, b, c), (a, c, d)]
    return vertices, triangles


def about_x(degrees):
    """A quaternion."""
    return [sin(degrees * pi / 360), 0, 0, cos(degrees * pi / 360)]


def about_y(degrees):
    return [0, sin(degrees * pi / 360), 0, cos(degrees * pi / 360)]


def pieces(model):
    """Meshes by name: six of a few shapes, which colours share."""
    ivory = model.material("ivory", (0.83, 0.76, 0.62), 0, 0.25)
    ebony = model.material("ebony", (0.035, 0.03, 0.03), 0, 0.2)
    gold = model.material("gold", (1, 0.77, 0.34), 1, 0.15)
    clear = {"KHR_materials_transmission": {"transmissionFactor": 1}, "KHR_materials_ior": {"ior": 1.5}}
    glass = model.material("glass", (0.97, 1, 0.98), 0, 0, extensions=clear)
    frosted = model.material("frosted glass", (0.75, 0.9, 1), 0, 0.3, extensions=clear)
    solids = {"pawn": PAWN, "bishop": BISHOP, "queen": QUEEN, "rook": ROOK}
    shapes = {}
    for name, profile in solids.items():
        solid = revolved(profile, 28, 1 if name == "pawn" else 2)
        assert volume(solid) > 0
        shapes[name] = model.shape(solid)
    made = [("pawn", "ivory", ivory), ("pawn", "ebony", ebony), ("bishop", "glass", glass), ("bishop", "frosted", frosted)]
    made += [("queen", "gold", gold), ("queen", "ebony", ebony), ("rook", "ivory", ivory), ("rook", "ebony", ebony)]
    return {f"{color} {name}": model.mesh(f"{color} {name}", shapes[name], material) for name, color, material in made}


# Which piece stands on which column and row, counted from the left and from the front.
GAME = [
    ("ivory pawn", 1, 1), ("ivory pawn", 2, 2), ("ivory pawn", 5, 1), ("ivory pawn", 6, 1), ("ivory rook", 0, 0),
    ("glass bishop", 4, 2), ("gold queen", 3, 3), ("ebony pawn", 1, 5), ("ebony pawn", 4, 4), ("ebony pawn", 6, 5),
    ("ebony pawn", 7, 6), ("frosted bishop", 2, 5), ("ebony queen", 5, 6), ("ebony rook", 0, 7), ("ebony rook", 6, 7),
]


def chess():
    model = Model()
    meshes = pieces(model)
    maps = {
        "baseColorTexture": model.texture("fields", png(128, 128, board_color)),
        "metallicRoughnessTexture": model.texture("polish", png(128, 128, board_roughness)),
    }
    wood = model.material("fields", (1, 1, 1), 1, 1, maps)
    cloth = model.material("cloth", (0.1, 0.2, 0.19), 0, 0.9)
    strength = {"KHR_materials_emissive_strength": {"emissiveStrength": 36}}
    lamp = model.material("lamp", (0, 0, 0), 0, 1, emissiveFactor=[1, 0.9, 0.76], extensions=strength)
    dim = {"KHR_materials_emissive_strength": {"emissiveStrength": 5}}
    window = model.material("window", (0, 0, 0), 0, 1, emissiveFactor=[0.6, 0.8, 1], extensions=dim)
    plane = model.shape(slab(1, 0.02))

    standing = [
        model.add("nodes", name=name, mesh=meshes[name], translation=[column - 3.5, 0, 3.5 - row], rotation=about_y(40 * row))
        for name, column, row in GAME
    ]
    # One that is out of the game: it lies beside the board.
    lying = model.add("nodes", name="taken", mesh=meshes["ivory pawn"], rotation=about_x(-79))
    standing.append(model.add("nodes", children=[lying], translation=[4.75, 0.008, 1.2], rotation=about_y(35)))
    board = model.mesh("board", model.shape(slab(4, 0.35), textured=True), wood)
    standing.append(model.add("nodes", name="board", mesh=board))
    game = model.add("nodes", name="game", children=standing, scale=[0.5, 0.5, 0.5], rotation=about_y(28))
    table = model.add("nodes", mesh=model.mesh("table", plane, cloth), translation=[0, -0.175, 0], scale=[9, 1, 9])
    above = model.add(
        "nodes", name="lamp", mesh=model.mesh("lamp", plane, lamp), translation=[-1.6, 3.6, -0.4],
        rotation=about_x(180), scale=[0.8, 1, 0.8],
    )
    beside = model.add(
        "nodes", name="window", mesh=model.mesh("window", plane, window), translation=[0, 2.4, -6],
        rotation=about_x(75), scale=[4, 1, 2],
    )
    lens = model.add("cameras", type="perspective", perspective={"yfov": 0.45, "aspectRatio": 4 / 3, "znear": 0.1})
    camera = model.add("nodes", name="player", camera=lens, translation=[0.2, 3.35, 6.7], rotation=about_x(-27))
    used = [f"KHR_materials_{name}" for name in ("emissive_strength", "ior", "transmission")]
    return model.glb([game, table, above, beside, camera], used)


def main():
    if len(sys.argv) != 2:
        sys.exit(__doc__)
    path = Path(sys.argv[1]) / "models/chess.glb"
    path.parent.mkdir(parents=True, exist_ok=True)
    data = chess()
    path.write_bytes(data)
    print(f"{path}: {len(data)} bytes")


if __name__ == "__main__":
    main()
