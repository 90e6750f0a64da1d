"""Mutated mesh files: whatever the bytes, a reader gives a mesh or an InputError of one line.

`python tests/fuzz_meshes.py 100000 7` tries so many mutations, seeded, over all formats, and prints those that raise anything else. A
mutation flips, cuts, repeats or inserts bytes, or puts numbers and words of the format where others were.
"""

import json
import random
import re
import struct
import sys
import tempfile
import warnings
from pathlib import Path

import numpy as np
from gltf_files import CORNER_UVS, GltfFile, checker
from PIL import Image

from dressi_edge.cache.errors import InputError
from dressi_edge.compiler.io.mesh import Mesh
from dressi_edge.compiler.io.meshes import load_mesh, load_parts
from dressi_edge.compiler.io.writers import save_mesh

OBJ = ("# a\nmtllib a.mtl\no one\nv 0 0 0 1 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nv .5 .5 1\nvt 0 0\nvt 1 0\nvt 1 1\nvn 0 0 1\nusemtl m\n"
       "f 1/1/1 2/2/1 3/3/1 4//1\nusemtl n\nf -1 -2 -3\nl 1 2\nf 1 2 3 \\\n 5\n")
MTL = "newmtl m\nKd 0.5 0.5 0.5\nmap_Kd -s 2 2 1 -o 0 0 skin.png\nd 0.5\nnewmtl n\nKd 1 0 0\nKe 1 1 1\nnorm skin.png\n"
OFF = ("COFF\n# a\n5 3 0\n0 0 0 255 0 0 255\n1 0 0 0 255 0 255\n1 1 0 0 0 0 1\n0 1 0 9 9 9 9\n0 0 1 1 1 1 1\n"
       "3 0 1 2\n4 0 1 2 3 255 0 0\n3 0 1 4\n")
PLY = ("ply\nformat ascii 1.0\ncomment TextureFile skin.png\nelement vertex 4\nproperty float x\nproperty double y\nproperty float z\n"
       "property uchar red\nproperty uchar green\nproperty uchar blue\nelement face 2\nproperty list uchar int vertex_indices\n"
       "property list uchar float texcoord\nend_header\n0 0 0 1 2 3\n1 0 0 4 5 6\n1 1 0 7 8 9\n0 1 0 9 9 9\n"
       "3 0 1 2 6 0 0 1 0 1 1\n4 0 1 2 3 8 0 0 1 0 1 1 0 1\n")
STL = "solid a\nfacet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 1 0 0\nvertex 0 1 0\nendloop\nendfacet\nendsolid a\n"
WORDS = [b"-1", b"0", b"1e400", b"nan", b"inf", b"99999999999999999999", b"2147483648", b"-2147483649", b"4294967296", b"0.5", b"x",
         b'""', b"null", b"[]", b"{}", b"true", b"\xff", b"\xf0\x9f\x98\x80", b"\\", b"/", b"//", b"#", b"\0",
         b"3", b"7", b"255", b"f", b"v", b"1e-320"]


def corpus(folder: Path) -> list[Path]:
    """Small files of every format, with what belongs beside them."""
    Image.fromarray(checker(2, 3)).save(folder / "skin.png")
    for name, text in (("a.obj", OBJ), ("a.mtl", MTL), ("a.off", OFF), ("a.ply", PLY), ("a.stl", STL)):
        (folder / name).write_text(text)
    rows = struct.pack("<12fH", 0, 0, 1, 0, 0, 0, 1, 0, 0, 0, 1, 0, 0)
    (folder / "b.stl").write_bytes(b"binary".ljust(80) + struct.pack("<I", 2) + rows * 2)
    points = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], float)
    save_mesh(folder / "b.ply", Mesh(points, [[0, 1, 2], [0, 2, 3]], colors=points))
    (folder / "c.ply").write_bytes(big_endian())
    g = GltfFile()
    info = {"extensions": {"KHR_texture_transform": {"offset": [0.5, 0], "rotation": 1.0}}}
    g.square(g.material((0.5, 1, 1, 1), g.texture(checker(2, 2)), info, name="m", alphaMode="MASK"), {
        "TEXCOORD_0": g.accessor(CORNER_UVS), "COLOR_0": g.accessor(np.full((4, 4), 200, np.uint8), normalized=True),
        "NORMAL": g.accessor(np.tile(np.float32((0, 0, 1)), (4, 1)))}, rotation=[0, 0, 1, 0])
    g.square(g.material((1, 0, 0, 1)), {"JOINTS_0": g.accessor(np.zeros((4, 4), np.uint8)),
                                        "WEIGHTS_0": g.accessor(np.tile(np.float32((1, 0, 0, 0)), (4, 1)))}, skin=0)
    g.add("skins", {"joints": [0]})
    g.json["meshes"][1]["primitives"][0] |= {"mode": 5, "targets": [{"POSITION": 2}]}
    g.json["meshes"][1]["weights"] = [0.5]
    sparse = {"count": 1, "indices": {"bufferView": g.view(b"\1"), "componentType": 5121}, "values": {"bufferView": g.view(bytes(12))}}
    g.json["accessors"][3]["sparse"] = sparse
    g.save(folder / "a.glb")
    del g.json["buffers"]
    g.save(folder / "a.gltf")
    return sorted(p for p in folder.iterdir() if p.suffix != ".png")


def big_endian() -> bytes:
    head = ("ply\nformat binary_big_endian 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\nelement face 2\n"
            "property list uchar int vertex_indices\nend_header\n")
    return head.encode() + struct.pack(">9f", 0, 0, 0, 1, 0, 0, 0, 1, 0) + struct.pack(">B3iB4i", 3, 0, 1, 2, 4, 0, 1, 2, 0)


def mutated(data: bytes, rng: random.Random, words: list[bytes]) -> bytes:
    """One to four changes of the bytes."""
    for _ in range(rng.choice((1, 1, 2, 4))):
        at, kind = rng.randrange(len(data) + 1), rng.randrange(8)
        if kind == 0 and data:
            at = min(at, len(data) - 1)
            data = data[:at] + bytes([data[at] ^ 1 << rng.randrange(8)]) + data[at + 1:]
        elif kind == 1:
            data = data[:at] if rng.random() < 0.3 else data[:at] + data[at + rng.randrange(1, 9):]
        elif kind == 2:
            end = min(len(data), at + rng.randrange(1, 40))
            data = data[:end] + data[at:end] + data[end:]
        elif kind == 3:
            data = data[:at] + rng.choice(words) + data[at:]
        elif kind == 4:
            data = data[:at] + rng.randbytes(rng.randrange(1, 5)) + data[at + 4:]
        else:  # a word or number of the text for another
            found = list(re.finditer(rb"-?[0-9.]+|[A-Za-z_]+", data[:20_000]))
            if found:
                match = rng.choice(found)
                data = data[:match.start()] + rng.choice(words) + data[match.end():]
    return data


def mutated_json(data: bytes, rng: random.Random) -> bytes:
    """The JSON of a .gltf with a value replaced, dropped or copied to another place."""
    document = json.loads(data)
    places = []

    def walk(value) -> None:
        for key in (value if isinstance(value, dict) else range(len(value))):
            places.append((value, key))
            if isinstance(value[key], (dict, list)):
                walk(value[key])

    walk(document)
    for _ in range(rng.choice((1, 1, 2, 3))):
        container, key = rng.choice(places)
        try:
            if rng.random() < 0.15 and isinstance(container, dict):
                container.pop(key, None)
            elif rng.random() < 0.3:
                other, where = rng.choice(places)
                container[key] = json.loads(json.dumps(other[where]))
            else:
                container[key] = rng.choice((-1, 0, 1, 2, 3, 7, 255, 5121, 5123, 5125, 5126, 2 ** 31, 2 ** 40, 10 ** 30, 1e400, -0.5,
                                             float("nan"), "", "x", None, True, [], {}, [0], [[]], {"a": 1}, "VEC2", "SCALAR", "MAT4"))
        except (IndexError, KeyError, ValueError):
            continue
    return json.dumps(document).encode()


def attempt(path: Path, parts: bool) -> str | None:
    """What the reader raised that it must not, or None."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error", RuntimeWarning)
            warnings.filterwarnings("ignore", category=UserWarning)
            (load_parts if parts else load_mesh)(path)
    except InputError as error:
        return "an error of several lines" if "\n" in str(error) else None
    except Exception as error:  # noqa: BLE001
        return f"{type(error).__name__}: {error}"
    return None


def run(count: int, seed: int) -> list[str]:
    """Tries `count` mutations; what went wrong, each with the file's name, the number and the seed."""
    rng, failures = random.Random(seed), []
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        files = {path: path.read_bytes() for path in corpus(folder)}
        names = list(files)
        for number in range(count):
            path = names[number % len(names)]
            data = files[path]
            data = mutated_json(data, rng) if path.suffix == ".gltf" and rng.random() < 0.8 else mutated(data, rng, WORDS)
            path.write_bytes(data)
            asked = folder / "a.obj" if path.suffix == ".mtl" else path
            if wrong := attempt(asked, number // len(names) % 2 == 1):
                failures.append(f"{path.name} mutation {number} of seed {seed}: {wrong}; {data[:2000]!r}")
            path.write_bytes(files[path])
    return failures


if __name__ == "__main__":
    count, seed = int(sys.argv[1]) if len(sys.argv) > 1 else 20_000, int(sys.argv[2]) if len(sys.argv) > 2 else 0
    wrong = run(count, seed)
    print(*wrong, sep="\n")
    print(f"{count} mutations of mesh files, {len(wrong)} that raise what they must not")
    sys.exit(bool(wrong))
