"""Random scenes by the thousand through few bundles: every image, gradient and optimizer state must be finite.

`python tests/fuzz_scenes.py 10000 --seed 3` runs them on lavapipe and prints the seeds of those that are not. A scene is its seed
alone: `scene(seed)` gives its vertices again. Topologies and programs are compiled once; scenes differ by what a session can set.
"""

import argparse
import tempfile
from pathlib import Path

import numpy as np
from corpus import icosahedron

from dressi_edge.cache.layout import CHANNELS
from dressi_edge.compiler.io.cameras import Camera
from dressi_edge.compiler.io.meshes import Mesh
from dressi_edge.compiler.render.light import Light
from dressi_edge.compiler.render.optimizer import Adam, Sgd
from dressi_edge.compiler.render.raster import Softness
from dressi_edge.compiler.scene.problem import Loss, Problem

SIZE, VIEWS = (20, 17), 2
BALL, FACES = icosahedron()
FACES = np.concatenate([FACES, [[0, 5, 1], [3, 3, 7], [2, 11, 9]]])  # twice the same face, a vertex twice, three faces at an edge
NEAR = 0.1


def cameras():
    result = []
    for k in range(VIEWS):
        pose = np.eye(4)
        pose[0, 3], pose[2, 3] = 0.3 * k, -3.0
        result.append(Camera(pose, 25.0, 24.0, 10.2, 8.4, *SIZE, near=NEAR, far=20.0))
    return result


def _normal(rng):
    return BALL + rng.normal(scale=0.2, size=BALL.shape)


def _soup(rng):
    return rng.normal(scale=10.0 ** rng.uniform(-1, 1), size=BALL.shape)


def _scaled(rng):
    return _soup(rng) * 10.0 ** rng.uniform(-6, 6)


def _mixed(rng):
    return rng.normal(size=BALL.shape) * 10.0 ** rng.uniform(-6, 6, BALL.shape)


def _collapsed(rng):
    return np.zeros(BALL.shape) + rng.normal(size=3) * rng.choice([0, 1, 10])


def _line(rng):
    return rng.normal(size=(len(BALL), 1)) * rng.normal(size=3) + rng.normal(size=3)


def _plane(rng):
    return _soup(rng) * rng.permutation([1.0, 1.0, 0.0])


def _lattice(rng):
    """Many ties: vertices on pixel centres, corners and each other."""
    return rng.integers(-2, 3, BALL.shape) / rng.choice([1.0, 2.0, 8.0])


def _at_camera(rng):
    """Vertices in the plane of the eye, at the eye, and on the near plane."""
    p = _soup(rng)
    p[:, 2] = rng.choice([3.0, 3.0 - NEAR, np.nextafter(np.float32(3.0 - NEAR), np.float32(0)), 3.0 + 1e-6, 0.0], len(p))
    p[rng.integers(len(p))] = 0, 0, 3
    return p


def _sliver(rng):
    return _soup(rng) * rng.permutation([1.0, 1.0, 1e-5]) + rng.normal(scale=0.3, size=3)


FAMILIES = (_normal, _soup, _scaled, _mixed, _collapsed, _line, _plane, _lattice, _at_camera, _sliver)


def scene(seed):
    """What the session is given for this seed, by name; arrays in the user's shape."""
    rng = np.random.default_rng(seed)
    vertices = FAMILIES[seed % len(FAMILIES)](rng)
    targets = rng.uniform(size=(VIEWS, *SIZE[::-1], 4))
    targets[..., 3] = rng.choice([np.zeros_like(targets[..., 3]), np.ones_like(targets[..., 3]), targets[..., 3]])
    big = 10.0 ** rng.uniform(-3, 3)
    return {"vertices": vertices, "targets": targets, "texture": rng.uniform(size=(4, 4, 3)), "rotation": rng.normal(size=(VIEWS, 3)) * big,
            "translation": rng.normal(scale=0.2, size=(VIEWS, 3)), "light0.power": rng.uniform(0, 9, 3),
            "light0.vector": rng.choice([np.zeros(3), vertices[0], rng.normal(size=3) * big]), "light1.vector": rng.normal(size=3),
            "go.step": np.array(rng.choice([0, 1, 999, 10 ** 6, 2 ** 30]))}


def problem(softness, norm, texture_grad="exact"):
    """Everything at once: two views, a textured lit mesh, all parameters, every loss."""
    rng = np.random.default_rng(1)
    mesh = Mesh(BALL, FACES, rng.uniform(-2, 3, (30, 2)), rng.integers(0, 30, (len(FACES), 3)), texture=np.full((4, 4, 3), 0.5))
    lights = [Light("point", 3.0, (1.0, 2.0, 3.0)), Light("directional", 1.0, (0.2, -1.0, 0.1)), Light("ambient", 0.2)]
    p = Problem(mesh, cameras(), shading="lambert", lights=lights, srgb=norm == "l1", texture_grad=texture_grad)
    optimize = {"vertices": Adam(0.5), "texture": Sgd(0.5, 0.9), "rotation": Adam(0.1), "translation": Sgd(1e-3),
                "light0.power": Adam(0.1), "light0.vector": Adam(0.1), "light1.vector": Sgd(0.1)}
    losses = [Loss("silhouette", norm=norm), Loss("color", norm=norm, masked=norm == "l2"), Loss("laplacian"),
              Loss("cotangent_laplacian", power=2), Loss("normal_consistency")]
    p.phase("go", 2, optimize, losses, softness)
    p.render("view", softness)
    return p


PROBLEMS = {"K=1": lambda: problem(Softness(2.0), "l2"), "K=3": lambda: problem(Softness(3.0, sigma=1.0, layers=3), "l1"),
            "sharp": lambda: problem(Softness(1.0, sigma=1e-6, delta=4.0), "l2", "inverse_uv")}


def broken(session, seed, steps=2):
    """Names of the values that are not finite at this seed. Moments hold the gradients of the last step."""
    for name, value in session.values.items():
        if value["role"] == "state" and (name.endswith(("adam_m", "adam_v", "momentum"))):
            session.set(name, np.zeros(session.shape(name)))
    for name, array in scene(seed).items():
        session.set(name, array)
    bad = [name for name in ("view.color", "go.loss") if not np.isfinite(session.get(name)).all()]
    session.step(steps, "go")
    states = [name for name, value in session.values.items() if value["role"] == "state" and CHANNELS[value["type"]] > 1]
    return bad + [name for name in states if not np.isfinite(session.get(name)).all()]


def main():
    from gpu import Gpu
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("count", type=int)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    found = 0
    with tempfile.TemporaryDirectory() as folder:
        gpu = Gpu(Path(folder))
        for k, (name, build) in enumerate(PROBLEMS.items()):
            with gpu.open(build().program) as session:
                for seed in range(options.seed + k, options.seed + options.count, len(PROBLEMS)):
                    bad = broken(session, seed)
                    if bad:
                        found += 1
                        print(f"{name} seed {seed} ({FAMILIES[seed % len(FAMILIES)].__name__[1:]}): {' '.join(bad)}", flush=True)
        gpu.device.close()
    print(f"{options.count} scenes, {found} with values that are not finite")
    return found > 0


if __name__ == "__main__":
    raise SystemExit(main())
