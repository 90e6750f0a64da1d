"""Whole problems for every driver: what is compiled, what is done with it, what came out on lavapipe.

    python -m tests.drivers.whole [DEVICE]    writes tests/drivers/whole/NAME.json anew

In: CASES. Out: `write(name, profile, folder)`: NAME.dressi compiled for that profile, beside a copy of NAME.json, which has the
layout of the test vectors' (`make_vectors.py`). Small images: what a driver's compiler makes of a shader does not depend on them.
"""

from __future__ import annotations

import shutil
import sys
import tempfile
from pathlib import Path

import make_vectors
import numpy as np
from corpus import project

from dressi_edge import runtime
from dressi_edge.cache import bundle
from dressi_edge.cache.layout import Layout
from dressi_edge.cache.profile import Profile, misfit
from dressi_edge.compiler import Program, compile_program
from dressi_edge.compiler.graph.ir import Node
from dressi_edge.compiler.io.cameras import orbit
from dressi_edge.compiler.io.meshes import Mesh
from dressi_edge.compiler.io.shapes import icosphere
from dressi_edge.compiler.io.views import Views
from dressi_edge.compiler.render.atlas import Atlas
from dressi_edge.compiler.render.light import Light
from dressi_edge.compiler.render.optimizer import Adam, Sgd
from dressi_edge.compiler.render.raster import Softness, rasterized
from dressi_edge.compiler.render.topology import Topology
from dressi_edge.compiler.scene import PBR, Binned, Outline, Scene, Texture, Unlit, Vertex, l2, rigid
from dressi_edge.compiler.scene.problem import Loss, Problem

FOLDER = Path(__file__).parent / "whole"
SIZE, VIEWS, STEPS = 32, 2, 5
LIGHTS = (Light("directional", (0.6, 0.6, 0.6), (0.3, -0.5, -0.8)), Light("point", (0.4, 0.3, 0.3), (1.0, 1.5, 2.0)),
          Light("ambient", (0.2, 0.2, 0.2)))
MESH_LOSSES = [Loss("laplacian", 0.05), Loss("normal_consistency", 0.01)]


def _problem(**how) -> Problem:
    ball = icosphere(1, 0.5)
    mesh = Mesh(ball.positions, ball.faces, ball.uvs, ball.uv_faces)
    views = Views(targets(), orbit(VIEWS, (20.0, -20.0), 2.5, 50.0, (SIZE, SIZE)), ("front", "back"))
    return Problem(mesh, views, texture_size=(24, 16), **how)


def silhouettes() -> Problem:
    """Soft outlines of two views move the vertices."""
    made = _problem(albedo="constant")
    made.phase("fit", STEPS, {"vertices": Sgd(0.5, 0.9)}, [Loss("silhouette"), *MESH_LOSSES], Softness(2.0))
    return made


def colors3() -> Problem:
    """Three depth layers of colours move vertices and their colours: the largest backward pass of all."""
    made = _problem(albedo="colors")
    made.phase("fit", STEPS, {"vertices": Adam(0.005), "colors": Adam(0.03)}, [Loss("silhouette"), Loss("color"), *MESH_LOSSES],
               Softness(2.0, layers=3))
    made.render(softness=Softness(2.0, layers=3))
    return made


def texture() -> Problem:
    """A texture of a sphere that stays."""
    made = _problem(albedo="texture")
    made.phase("fit", STEPS, {"texture": Adam(0.03)}, [Loss("color")], Softness(2.0))
    made.render(softness=Softness(2.0))
    return made


def lambert() -> Problem:
    """Three kinds of light on a coloured sphere; vertices, colours, lights and poses move."""
    made = _problem(albedo="colors", shading="lambert", lights=LIGHTS, srgb=True)
    made.phase("fit", STEPS, {"vertices": Adam(0.005), "colors": Adam(0.03), "light0.vector": Adam(0.01), "rotation": Adam(0.001)},
               [Loss("silhouette"), Loss("color", masked=True), *MESH_LOSSES], Softness(2.0, distance="face"))
    made.render(softness=Softness(2.0, distance="face"))
    return made


def _scene(**look) -> tuple[Scene, Node]:
    """Two views of what is to be added, and the pictures that they are compared with."""
    made = Scene(orbit(VIEWS, (20.0, -20.0), 2.5, 50.0, (SIZE, SIZE)), **look)
    return made, made.input("photo", targets()[..., :3])


def material() -> Scene:
    """Reflectance under two lights on a sphere that stays: its roughness and a texture with mip levels are fitted."""
    (made, photo), ball = _scene(), icosphere(1, 0.5)
    image = made.parameter("texture", np.full((16, 24, 3), 0.5), 0.0, 1.0, kind="image")
    made.add(ball, material=PBR(Texture(image, mips=True), made.parameter("roughness", 0.5, 0.1, 1.0), 0.2, lights=(
        Light("directional", (1.6, 1.6, 1.6), (0.3, -0.5, -0.8)), LIGHTS[2])))
    made.phase("fit", STEPS, {"texture": Sgd(100.0), "roughness": Sgd(5.0)}, color=l2(made.frame().color, photo))
    return made


def contours() -> Scene:
    """A ball before another: its place and colours are moved by the contour between them."""
    (made, photo), front, back = _scene(), icosphere(1, 0.25), icosphere(1, 0.55)
    place = made.parameter("place", np.zeros(3))
    made.add(front, rigid(front.positions + (0.1, 0.1, 0.5), np.zeros(3), place),
             Unlit(Vertex(made.parameter("colors", np.full((42, 3), 0.7)))))
    made.add(back, material=Unlit((0.2, 0.4, 0.3)))
    made.phase("fit", STEPS, {"place": Adam(0.005), "colors": Adam(0.03)}, color=l2(made.frame(Outline(contours=True)).color, photo))
    return made


def binned() -> Scene:
    """Every face near a pixel has a say; lists by tile are counted by workgroups where the profile has them."""
    (made, photo), ball = _scene(background=(0.1, 0.2, 0.3)), icosphere(1, 0.5)
    colors = made.parameter("colors", np.full((42, 3), 0.5))
    made.add(ball, made.parameter("vertices", ball.positions), Unlit(Vertex(colors)))
    made.phase("fit", STEPS, {"vertices": Adam(0.005), "colors": Adam(0.03)},
               color=l2(made.frame(Binned(2.0, gamma=1e-2, over=True)).color, photo))
    return made


def behind() -> Program:
    """A triangle with a corner in the plane of the camera, by depth and by coverage: w is exactly 0, which some drivers do not draw."""
    made = Program()
    clip = made.input("clip", Layout("table", "vec4", count=3), project(np.array([(-0.9, -0.7, -3.0), (0.8, -0.6, -2.4), (0, 0.1, 0)]),
                                                                        (24, 24), 0.1))
    atlas, image = Atlas(24, 24, 1, 1), Layout("atlas", "int", 24, 24, 1, 1)
    made.plan("render", {}, {name: (rasterized(clip, Topology(np.array([(0, 1, 2)]), 3), atlas, Softness(), 0.1, faces).front >= 0, image)
                             for name, faces in (("depth", True), ("covered", False))})
    return made


CASES = {f.__name__: f for f in (silhouettes, colors3, texture, lambert, material, contours, binned, behind)}
OPTIONS = {"binned": {"compute": "ops"}}  # as `Options` of the compiler
# After steps. Adam, which makes a whole step of what is almost nothing, enlarges what rounding leaves: of a texture with mip levels, some
# of whose texels hardly anything samples, a step of 0.03 (so there plain descent: 1e-4 off on SwiftShader). Silhouettes, lit by their
# outline alone: on another grid of sub-pixels (SwiftShader's has 16 to a pixel, lavapipe's 256) other pixels are inside.
TOLERANCE = {"silhouettes": 2e-2, "colors3": 5e-3, "texture": 5e-3, "lambert": 1e-2, "material": 1e-3, "contours": 1e-2,
             "binned": 1e-2, "behind": 0}


def targets() -> np.ndarray:
    """Two views of a disk with coloured quarters, (VIEWS, SIZE, SIZE, 4)."""
    y, x = (np.mgrid[:SIZE, :SIZE] + 0.5) / SIZE * 2 - 1
    image = np.stack([x * 0.5 + 0.5, y * 0.5 + 0.5, (x * y > 0) * 0.8, np.clip((0.7 - np.hypot(x, y)) * SIZE / 2, 0, 1)], -1)
    return np.round(np.stack([image, image[:, ::-1] * [0.6, 1.0, 0.9, 1.0]]) * 255).astype(np.float32) / np.float32(255)


def steps(name: str) -> list[tuple]:
    """Loss, steps, loss, what was optimized."""
    if name == "behind":
        return [("get", "depth"), ("get", "covered")]
    changed = {"silhouettes": ["vertices"], "colors3": ["vertices", "colors"], "texture": ["texture"],
               "lambert": ["vertices", "colors", "light0.vector", "rotation"], "material": ["texture", "roughness"],
               "contours": ["place", "colors"], "binned": ["vertices", "colors"]}[name]
    return [("get", "fit.loss"), ("step", "fit", STEPS), ("get", "fit.loss"), *(("get", x) for x in changed)]


def write(name: str, profile: Profile | str, folder: Path) -> None:
    """NAME.dressi and NAME.json in that folder."""
    made = CASES[name]()
    compile_program(getattr(made, "program", made), profile, folder / f"{name}.dressi", **OPTIONS.get(name, {}))
    if (FOLDER / f"{name}.json").exists():
        shutil.copy(FOLDER / f"{name}.json", folder)


def vectors(profile: Profile, folder: Path) -> None:
    """The test vectors in that folder; those that ask more than this profile allows are compiled for it."""
    for path in make_vectors.FOLDER.iterdir():
        shutil.copy(path, folder)
    for path in folder.glob("*.dressi"):
        if all(misfit(x.description["needs"]["limits"], profile) for x in bundle.read(path).variants):
            compile_program(make_vectors.VECTORS[path.stem]()[0], profile, path, **make_vectors.OPTIONS.get(path.stem, {}))


def main() -> None:
    FOLDER.mkdir(exist_ok=True)
    with tempfile.TemporaryDirectory() as temporary:
        for name, make in CASES.items():
            path = Path(temporary) / f"{name}.dressi"
            write(name, "lavapipe", Path(temporary))
            with runtime.load(path, sys.argv[1] if sys.argv[1:] else "llvmpipe") as session:
                record = make_vectors.recorded(session, steps(name))
            print(name, make_vectors.write_record(FOLDER / f"{name}.json", make.__doc__, TOLERANCE[name], record), "bytes")


if __name__ == "__main__":
    main()
