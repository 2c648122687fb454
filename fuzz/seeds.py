"""Writes small first inputs for every fuzz target into corpus/TARGET: python3 seeds.py [FOLDER]. Standard library only."""

import base64
import itertools
import json
import struct
import sys
import zlib
from pathlib import Path

HERE = Path(__file__).resolve().parent
ROOT = HERE.parent
OUT = Path(sys.argv[1]) if len(sys.argv) > 1 else HERE / "corpus"


def write(target, name, data):
    folder = OUT / target
    folder.mkdir(parents=True, exist_ok=True)
    (folder / name).write_bytes(data if isinstance(data, bytes) else data.encode())


def copy(target, paths, largest):
    """Files of the repository that are small enough."""
    for path in paths:
        if path.stat().st_size <= largest:
            write(target, path.name, path.read_bytes())


# Scenes

FEATURES = """name = "all kinds"
[camera]
origin = [0, 1, 4]
target = [0, 0, 0]
up = [0, 1, 0]
fov_y_deg = 40
width = 4
height = 3
[environment]
radiance = [0.1, 0.1, 0.1]
[render]
spp = 4
max_bounces = 5
direct_light = true
roulette = false
[materials.lamp]
type = "diffuse"
color = [0, 0, 0]
emission = [15, 15, 15]
"""
KINDS = {
    "mirror": "color = [1, 1, 1]\nlevel = 0.5",
    "glossy": "color = [1, 1, 1]\nexponent = 20",
    "dielectric": "tint = [1, 1, 1]\nior = 1.5",
    "metal": "color = [1, 1, 1]\nroughness = 0.2",
    "metallic-roughness": "color = [1, 1, 1]\nmetallic = 0.5\nroughness = 0.3",
    "rough-dielectric": "tint = [1, 1, 1]\nior = 1.5\nroughness = 0.2",
}


def scenes():
    copy("scene", sorted((ROOT / "scenes").glob("*.toml")), 8192)
    text = FEATURES
    for number, (kind, keys) in enumerate(KINDS.items()):
        text += f'[materials.m{number}]\ntype = "{kind}"\n{keys}\n'
        text += f'[[shapes]]\ntype = "sphere"\ncenter = [{number}, 0, 0]\nradius = 0.4\nmaterial = "m{number}"\n'
    text += '[[shapes]]\ntype = "quad"\ncorner = [0, 2, 0]\ne1 = [1, 0, 0]\ne2 = [0, 0, 1]\nmaterial = "lamp"\n'
    text += '[[shapes]]\ntype = "box"\ncenter = [0, -1, 0]\nsize = [1, 1, 1]\nrotate_y_deg = 30\nmaterial = "m1"\n'
    write("scene", "all-kinds.toml", text)
    lamps = "".join(
        f'[[shapes]]\ntype = "sphere"\ncenter = [{x}, {y}, 0]\nradius = 0.1\nmaterial = "lamp"\n'
        for x, y in itertools.product(range(6), repeat=2)
    )
    write("scene", "lamps.toml", FEATURES + lamps)
    camera = {"origin": [0, 1, 4], "target": [0, 0, 0], "fov_y_deg": 40, "width": 4, "height": 3}
    ball = {"type": "sphere", "center": [0, 0, 0], "radius": 1, "material": "white"}
    white = {"type": "diffuse", "color": [0.7, 0.7, 0.7], "emission": [1, 1, 1]}
    document = {"name": "ball", "camera": camera, "materials": {"white": white}, "shapes": [ball]}
    write("scene", "ball.json", json.dumps(document))


# Meshes

CORNERS = [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (0.5, 0.5, 1)]
FACES = [(0, 1, 2, 3), (0, 1, 4), (1, 2, 4), (2, 3, 4), (3, 0, 4)]


def ply_header(form):
    axes = "".join(f"property float {axis}\n" for axis in ("x", "y", "z", "nx", "ny", "nz", "u", "v"))
    return (
        f"ply\nformat {form} 1.0\ncomment seed\nelement vertex {len(CORNERS)}\n{axes}"
        f"element face {len(FACES)}\nproperty list uchar int vertex_indices\nend_header\n"
    )


def ply_binary(order):
    out = ply_header({"<": "binary_little_endian", ">": "binary_big_endian"}[order]).encode()
    for corner in CORNERS:
        out += struct.pack(order + "8f", *corner, 0, 0, 1, corner[0], corner[1])
    for face in FACES:
        out += struct.pack(f"{order}B{len(face)}i", len(face), *face)
    return out


def plies():
    text = ply_header("ascii")
    text += "".join(f"{x} {y} {z} 0 0 1 {x} {y}\n" for x, y, z in CORNERS)
    text += "".join(f"{len(face)} {' '.join(map(str, face))}\n" for face in FACES)
    write("ply", "ascii.ply", text)
    write("ply", "little.ply", ply_binary("<"))
    write("ply", "big.ply", ply_binary(">"))
    odd = (
        "ply\nformat ascii 1.0\nobj_info x\nelement other 1\nproperty list ushort double list\nproperty char c\n"
        "element vertex 3\nproperty double x\nproperty double y\nproperty double z\nproperty uchar red\n"
        "element face 1\nproperty list uint uint vertex_index\nproperty list uchar float texcoord\n"
        "end_header\n2 1 2 3\n0 0 0 255\n1 0 0 0\n0 1 0 0\n3 0 1 2 2 0.5 0.5\n"
    )
    write("ply", "odd.ply", odd)


def objs():
    text = "# seed\nmtllib a.mtl\no pyramid\n" + "".join(f"v {x} {y} {z}\n" for x, y, z in CORNERS)
    plain = text + "".join("f " + " ".join(str(i + 1) for i in face) + "\n" for face in FACES)
    write("obj", "plain.obj", plain)
    full = text + "vt 0 0\nvt 1 0\nvt 1 1\nvn 0 0 1\nvn 0 1 0\n"
    full += "".join("f " + " ".join(f"{i + 1}/{i % 3 + 1}/{i % 2 + 1}" for i in face) + "\n" for face in FACES)
    full += "g more\nusemtl red\ns 1\nf -1//-1 -2//-1 -3//-2\nl 1 2\np 1\nv 1 2 3 0.5\nv 1 1 1 1 0 0\\\n\nf 1 6 7\n"
    write("obj", "full.obj", full)


# glTF


def gltf_parts():
    """A pyramid with everything: its description without buffers, and its bytes."""
    floats = lambda rows: b"".join(struct.pack(f"<{len(row)}f", *row) for row in rows)
    triangles = [corner for face in FACES for i in range(1, len(face) - 1) for corner in (face[0], face[i], face[i + 1])]
    parts = [
        floats(CORNERS),
        floats([(0, 0, 1)] * 5),
        floats([(x, y) for x, y, _ in CORNERS]),
        struct.pack(f"<{len(triangles)}H", *triangles),
        struct.pack("<2H", 0, 4) + floats([(0, 0, 0.1), (0.5, 0.5, 2)]),
        png(4, 4, 8, 2),
    ]
    views, data = [], b""
    for part in parts:
        data += b"\0" * (-len(data) % 4)
        views.append({"buffer": 0, "byteOffset": len(data), "byteLength": len(part)})
        data += part
    accessor = lambda view, component, count, kind, **more: {
        "bufferView": view, "componentType": component, "count": count, "type": kind, **more
    }
    box = {"min": [0, 0, 0], "max": [1, 1, 2]}
    sparse = {
        "count": 2,
        "indices": {"bufferView": 4, "componentType": 5123},
        "values": {"bufferView": 4, "byteOffset": 4},
    }
    slot = {"index": 0}
    materials = [
        {
            "name": "all",
            "pbrMetallicRoughness": {
                "baseColorFactor": [1, 0.5, 0.2, 1], "metallicFactor": 0.5, "roughnessFactor": 0.4,
                "baseColorTexture": slot, "metallicRoughnessTexture": slot,
            },
            "normalTexture": {"index": 0, "scale": 0.5},
            "emissiveTexture": slot, "emissiveFactor": [1, 1, 1], "alphaMode": "MASK", "doubleSided": True,
            "extensions": {"KHR_materials_emissive_strength": {"emissiveStrength": 4}},
        },
        {"extensions": {"KHR_materials_transmission": {"transmissionFactor": 1}, "KHR_materials_ior": {"ior": 1.4}}},
        {"extensions": {"KHR_materials_unlit": {}}},
    ]
    attributes = {"POSITION": 0, "NORMAL": 1, "TEXCOORD_0": 2}
    lights = [
        {"type": "point", "intensity": 5, "color": [1, 1, 1]},
        {"type": "spot", "spot": {"innerConeAngle": 0.1, "outerConeAngle": 0.5}},
        {"type": "directional", "name": "sun"},
    ]
    description = {
        "asset": {"version": "2.0"},
        "extensionsUsed": [
            "KHR_lights_punctual", "KHR_materials_transmission", "KHR_materials_ior", "KHR_materials_unlit",
            "KHR_materials_emissive_strength",
        ],
        "scene": 0,
        "scenes": [{"nodes": [0, 3]}],
        "nodes": [
            {"mesh": 0, "children": [1, 2], "translation": [1, 0, 0], "rotation": [0, 0, 0.7, 0.7], "scale": [1, 2, 1]},
            {"mesh": 1, "matrix": [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 2, 0, 0, 1], "name": "copy"},
            {"extensions": {"KHR_lights_punctual": {"light": 0}}},
            {"camera": 0, "translation": [0, 1, 5], "children": [4, 5]},
            {"extensions": {"KHR_lights_punctual": {"light": 1}}},
            {"extensions": {"KHR_lights_punctual": {"light": 2}}},
        ],
        "cameras": [{"type": "perspective", "perspective": {"yfov": 0.7, "znear": 0.1, "aspectRatio": 1.5}}],
        "meshes": [
            {"name": "pyramid", "primitives": [{"attributes": attributes, "indices": 3, "material": 0}]},
            {
                "primitives": [
                    {"attributes": {"POSITION": 4}, "mode": 5, "material": 1},
                    {"attributes": {"POSITION": 0}, "mode": 6, "material": 2},
                    {"attributes": {"POSITION": 0}, "indices": 3},
                ]
            },
        ],
        "materials": materials,
        "textures": [{"source": 0, "sampler": 0}],
        "samplers": [{"wrapS": 33071, "wrapT": 33648}],
        "images": [{"bufferView": 5, "mimeType": "image/png"}],
        "accessors": [
            accessor(0, 5126, 5, "VEC3", **box),
            accessor(1, 5126, 5, "VEC3"),
            accessor(2, 5126, 5, "VEC2"),
            accessor(3, 5123, len(triangles), "SCALAR"),
            accessor(0, 5126, 5, "VEC3", sparse=sparse, **box),
        ],
        "bufferViews": views,
        "extensions": {"KHR_lights_punctual": {"lights": lights}},
    }
    return description, data


def gltfs():
    description, data = gltf_parts()
    padded = data + b"\0" * (-len(data) % 4)
    uri = "data:application/octet-stream;base64," + base64.b64encode(data).decode()
    for buffer, name in (({"byteLength": len(data), "uri": uri}, "all.gltf"), ({"byteLength": len(data)}, "all.glb")):
        text = json.dumps({**description, "buffers": [buffer]}, separators=(",", ":")).encode()
        if name.endswith(".glb"):
            text += b" " * (-len(text) % 4)
            chunks = struct.pack("<I4s", len(text), b"JSON") + text + struct.pack("<I4s", len(padded), b"BIN\0") + padded
            text = struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks
        write("gltf", name, text)
    small = {
        "asset": {"version": "2.0"},
        "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}}]}],
        "accessors": [{"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3"}],
        "bufferViews": [{"buffer": 0, "byteLength": 36}],
    }
    triangle = struct.pack("<9f", 0, 0, 0, 1, 0, 0, 0, 1, 0)
    uri = "data:;base64," + base64.b64encode(triangle).decode()
    small["buffers"] = [{"byteLength": 36, "uri": uri}]
    write("gltf", "small.gltf", json.dumps(small))


# Images

CHANNELS = {0: 1, 2: 3, 3: 1, 4: 2, 6: 4}


def png(width, height, bits, colour, interlaced=0):
    """Of any kind; interlaced ones are one pixel wide and high, where it makes no difference."""
    chunk = lambda kind, data: struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))
    row = (width * bits * CHANNELS[colour] + 7) // 8
    rows = b"".join(bytes([y % 5]) + bytes((x * 37 + y * 11) % 256 for x in range(row)) for y in range(height))
    palette = b""
    if colour == 3:
        palette = chunk(b"PLTE", bytes(i % 256 for i in range(3 << bits))) + chunk(b"tRNS", b"\x80")
    head = chunk(b"IHDR", struct.pack(">IIBBBBB", width, height, bits, colour, 0, 0, interlaced))
    return b"\x89PNG\r\n\x1a\n" + head + palette + chunk(b"IDAT", zlib.compress(rows)) + chunk(b"IEND", b"")


def exr_header(width, height, compression, channels, kind):
    attribute = lambda name, kind, data: name + b"\0" + kind + b"\0" + struct.pack("<I", len(data)) + data
    listed = b"".join(name + b"\0" + struct.pack("<IIii", kind, 0, 1, 1) for name in channels) + b"\0"
    box = struct.pack("<4i", 0, 0, width - 1, height - 1)
    return (
        b"\x76\x2f\x31\x01" + struct.pack("<I", 2)
        + attribute(b"channels", b"chlist", listed)
        + attribute(b"compression", b"compression", bytes([compression]))
        + attribute(b"dataWindow", b"box2i", box)
        + attribute(b"displayWindow", b"box2i", box)
        + attribute(b"lineOrder", b"lineOrder", b"\0")
        + attribute(b"pixelAspectRatio", b"float", struct.pack("<f", 1))
        + attribute(b"screenWindowCenter", b"v2f", struct.pack("<2f", 0, 0))
        + attribute(b"screenWindowWidth", b"float", struct.pack("<f", 1))
        + b"\0"
    )


LINES = {0: 1, 1: 1, 2: 1, 3: 16, 4: 32, 5: 16, 6: 32, 7: 32}


def exr(width, height, compression, channels=(b"B", b"G", b"R"), kind=1):
    """Blocks hold raw numbers, which every compression allows where it would gain nothing."""
    head = exr_header(width, height, compression, channels, kind)
    sample = {0: struct.pack("<I", 7), 1: struct.pack("<e", 0.5), 2: struct.pack("<f", 0.5)}[kind]
    blocks, table = [], b""
    count = -(-height // LINES[compression])
    at = len(head) + 8 * count
    for block in range(count):
        first = block * LINES[compression]
        lines = min(LINES[compression], height - first)
        data = sample * (width * lines * len(channels))
        table += struct.pack("<Q", at)
        blocks.append(struct.pack("<iI", first, len(data)) + data)
        at += len(blocks[-1])
    return head + table + b"".join(blocks)


def hdr(width, height, packed, magic="#?RADIANCE"):
    head = f"{magic}\nFORMAT=32-bit_rle_rgbe\nEXPOSURE=1.0\n\n-Y {height} +X {width}\n".encode()
    if not packed:
        return head + bytes([128, 64, 32, 129]) * (width * height)
    line = bytes([2, 2, width >> 8, width & 255]) + bytes([128 + width, 100]) * 3 + bytes([128 + width, 129])
    return head + line * height


def images():
    kinds = [(0, 1), (0, 2), (0, 4), (0, 8), (0, 16), (2, 8), (2, 16), (3, 1), (3, 4), (3, 8), (4, 8), (4, 16), (6, 8), (6, 16)]
    for target in ("texture", "image"):
        for colour, bits in kinds:
            write(target, f"{colour}-{bits}.png", png(5, 4, bits, colour))
        write(target, "interlaced.png", png(1, 1, 8, 2, interlaced=1))
        for name, text in JPEGS.items():
            write(target, f"{name}.jpg", base64.b64decode(text))
    copy("texture", sorted((ROOT / "scenes/textures").glob("*.png")), 8192)
    for target in ("environment", "image"):
        for compression in LINES:
            write(target, f"half-{compression}.exr", exr(4, 2, compression))
        for kind in (0, 2):
            write(target, f"kind-{kind}.exr", exr(4, 2, 0, kind=kind))
        write(target, "lum.exr", exr(4, 2, 0, channels=(b"Y",)))
        write(target, "rgba.exr", exr(4, 2, 3, channels=(b"A", b"B", b"G", b"R")))
        write(target, "packed.hdr", hdr(8, 4, True))
        write(target, "flat.hdr", hdr(4, 2, False, "#?RGBE"))
    copy("environment", sorted((ROOT / "scenes/maps").glob("*.hdr")), 4096)
    copy("image", sorted((ROOT / "tests/references").glob("*.exr")), 20000)
    copy("environment", sorted((ROOT / "tests/references").glob("*.exr")), 7000)


# Guides


def guides():
    section = lambda name, data: name + struct.pack("<Q", len(data)) + data
    for mode in (1, 2, 3, 4):
        sectors = 6 if mode == 4 else 1
        head = b"QTGUIDE\n" + struct.pack("<IIQQI", 1, mode, 7, 16, 2)
        grid = struct.pack("<3f", -1, -1, -1) + struct.pack("<2f4I", 0.5, 1e-3, 1, 1, 1, sectors)
        cells, nodes = b"", b""
        for cell in range(sectors):
            roots, count = (3, 3) if mode == 4 else (0, 0)
            cells += struct.pack("<16f4I", *[1.0] * 16, roots, 0, count, cell)
            if mode == 4:
                for child, mask in ((2, 1), (3, 0), (3, 0)):
                    nodes += struct.pack("<4fI", 1, 2, 3, 4, 16 * child + mask)
        index = struct.pack(f"<{sectors}I", *range(sectors))
        body = section(b"INDX", index) + section(b"CELL", cells) + section(b"NODE", nodes)
        write("guide", f"mode-{mode}", head + grid + body)
    # One cell, cut once; all eighths share it.
    head = b"QTGUIDE\n" + struct.pack("<IIQQI", 1, 3, 7, 16, 2)
    grid = struct.pack("<3f", -1, -1, -1) + struct.pack("<2f4I", 0.5, 1e-3, 1, 1, 1, 1)
    index = struct.pack("<9I", (1 << 31) + 1, *[0] * 8)
    cell = struct.pack("<16f4I", *[1.0] * 16, 0, 1, 0, 1)
    write("guide", "cut", head + grid + section(b"INDX", index) + section(b"CELL", cell) + section(b"NODE", b""))


JPEGS = {
    "baseline": """
        /9j/4AAQSkZJRgABAQAAAQABAAD/2wBDABsSFBcUERsXFhceHBsgKEIrKCUlKFE6PTBCYFVlZF9VXVtqeJmBanGQc1tdhbWGkJ6jq62r
        Z4C8ybqmx5moq6T/2wBDARweHigjKE4rK06kbl1upKSkpKSkpKSkpKSkpKSkpKSkpKSkpKSkpKSkpKSkpKSkpKSkpKSkpKSkpKSkpKSk
        pKT/wAARCAAQABADASIAAhEBAxEB/8QAFQABAQAAAAAAAAAAAAAAAAAABAX/xAAXEAADAQAAAAAAAAAAAAAAAAAAAwRh/8QAFQEBAQAA
        AAAAAAAAAAAAAAAAAQT/xAAYEQACAwAAAAAAAAAAAAAAAAAABAECEv/aAAwDAQACEQMRAD8AkKmwYqXBaZsHplwmi2hWZP/Z
    """,
    "progressive": """
        /9j/4AAQSkZJRgABAQAAAQABAAD/2wBDABsSFBcUERsXFhceHBsgKEIrKCUlKFE6PTBCYFVlZF9VXVtqeJmBanGQc1tdhbWGkJ6jq62r
        Z4C8ybqmx5moq6T/2wBDARweHigjKE4rK06kbl1upKSkpKSkpKSkpKSkpKSkpKSkpKSkpKSkpKSkpKSkpKSkpKSkpKSkpKSkpKSkpKSk
        pKT/wgARCAAQABADASIAAhEBAxEB/8QAFQABAQAAAAAAAAAAAAAAAAAAAwT/xAAVAQEBAAAAAAAAAAAAAAAAAAAAA//aAAwDAQACEAMQ
        AAABjZnk/8QAFhAAAwAAAAAAAAAAAAAAAAAAAAEC/9oACAEBAAEFAlIpFIpP/8QAFREBAQAAAAAAAAAAAAAAAAAAAwD/2gAIAQMBAT8B
        NL//xAAVEQEBAAAAAAAAAAAAAAAAAAARAP/aAAgBAgEBPwFb/8QAFBABAAAAAAAAAAAAAAAAAAAAIP/aAAgBAQAGPwIf/8QAFBABAAAA
        AAAAAAAAAAAAAAAAIP/aAAgBAQABPyEDf//aAAwDAQACAAMAAAAQ3//EABQRAQAAAAAAAAAAAAAAAAAAAAD/2gAIAQMBAT8Qf//EABUR
        AQEAAAAAAAAAAAAAAAAAAAAB/9oACAECAQE/EIP/xAAVEAEBAAAAAAAAAAAAAAAAAAAAYf/aAAgBAQABPxCaSKD/2Q==
    """,
    "grey": """
        /9j/4AAQSkZJRgABAQAAAQABAAD/2wBDABsSFBcUERsXFhceHBsgKEIrKCUlKFE6PTBCYFVlZF9VXVtqeJmBanGQc1tdhbWGkJ6jq62r
        Z4C8ybqmx5moq6T/wAALCAAQABABAREA/8QAFQABAQAAAAAAAAAAAAAAAAAABAX/xAAXEAADAQAAAAAAAAAAAAAAAAAAAwRh/9oACAEB
        AAA/AJCpsGKlwWmbB6ZcP//Z
    """,
}


for make in (scenes, plies, objs, gltfs, images, guides):
    make()
