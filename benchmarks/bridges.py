"""A step of the Spot problem in other people's loops: our own step, and the same driven by NumPy, by PyTorch and by JAX, taking turns.

    python benchmarks/bridges.py [--quick] [--seconds N] [--size PIXELS] [--data DIR] [--device NAME] [--profile NAME] [--json FILE]

The problem: benchmarks/sphere_to_spot.py, six views of 256x256, an icosphere of 1280 faces, silhouettes + 0.05 Laplacian, Adam. Without
DIR/meshes/spot the target is the pear. --quick takes small pictures.

ours      the phase: drawing, losses, gradients and Adam in the bundle, each step submitted and waited for by itself
vjp       the pictures and their gradients alone: vertices in, silhouettes out, gradients in, gradients out
numpy     the same with losses and Adam written in NumPy
torch     dressi_edge.torch.Render with losses in PyTorch and its Adam
torch Adam       the losses in the scene, gradients by Render.accumulate, PyTorch's Adam
torch functions  silhouettes by the rasterize and antialias of dressi_edge.primitives (which blend over one pixel), the rest in PyTorch
jax       dressi_edge.jax.function in a jitted step with losses and Adam in JAX
cpu       processor time, all threads together; ratios are of it, by rounds in which all take their turn
after     the loss after so many steps, of each: they walk the same way
"""
from __future__ import annotations

import argparse
import importlib.util
import json
import os
import platform
import statistics
import tempfile
from pathlib import Path

import numpy as np
from sphere_to_spot import cameras
from step import ROOT, Meter, rounded, take_turns

from dressi_edge import runtime
from dressi_edge.bridges import Pure
from dressi_edge.compiler.io.meshes import load_mesh, normalize
from dressi_edge.compiler.scene import Adam, Outline, Scene, icosphere, l2, pear, uniform_laplacian

INSTALLED = {name: importlib.util.find_spec(name) is not None for name in ("torch", "jax")}
RATE, WEIGHT, BETAS, EPSILON = 0.01, 0.05, (0.9, 0.999), 1e-8
COMPARED = 10  # steps after which losses are compared


def target_mesh(data: Path | None):
    path = (data or ROOT.parent / "shared") / "meshes" / "spot" / "spot.obj"
    return normalize(load_mesh(path)) if path.is_file() else pear(64)


class Case:
    """The problem in a bundle: a phase, and a vjp of the silhouettes."""

    def __init__(self, folder: Path, options: argparse.Namespace):
        views, level = cameras(options.size), 2 if options.quick else 3
        target, self.ball = target_mesh(options.data), icosphere(level, 0.6)
        s = Scene(views)
        s.add(target)
        s.output("look", alpha=s.frame(Outline(r=2.0)).alpha)
        s.compile(options.profile, folder / "target.dressi")
        with runtime.load(folder / "target.dressi", options.device) as session:
            self.masks, self.device = session.get("look.alpha"), session.report()["driver"]
        s = Scene(views)
        x = s.parameter("vertices", self.ball.positions)
        part = s.add(self.ball, x)
        alpha = s.frame(Outline(r=2.0)).alpha
        masks = s.input("masks", self.masks)
        s.phase("fit", 100, {"vertices": Adam(RATE)}, alpha=l2(alpha, masks),
                smooth=(WEIGHT, uniform_laplacian(x, part.topology)))
        s.vjp("render", ["vertices"], alpha=alpha)
        s.vjp("whole", ["vertices"], loss=l2(alpha, masks) + WEIGHT * uniform_laplacian(x, part.topology))
        self.path, self.topology = folder / "fit.dressi", part.topology
        s.compile(options.profile, self.path)
        self.where, self.views = options.device, views

    def open(self):
        return runtime.load(self.path, self.where)

    @property
    def neighbours(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Of each vertex as a table (V, degree), its own number where it has fewer; and whether each is one; and 1 / degree."""
        rows, cols = self.topology.neighbours
        degree = rows[:, 1] - rows[:, 0]
        table = np.repeat(np.arange(len(rows))[:, None], degree.max(), 1)
        real = np.arange(degree.max()) < degree[:, None]
        table[real] = cols
        return table, real.astype(np.float32), (1.0 / degree).astype(np.float32)


class Ours:
    def __init__(self, case: Case, session):
        self.session = session

    def step(self) -> None:
        self.session.step(1, "fit")

    def loss(self) -> float:
        self.session.phase = "fit"
        return self.session.loss()


class Vjp:
    """Nothing but the renderer: what the others share."""

    def __init__(self, case: Case, session):
        self.pure, self.vertices = Pure(session, "render"), case.ball.positions.astype(np.float32)
        self.gradient = np.random.default_rng(0).normal(size=case.masks.shape).astype(np.float32)

    def step(self) -> None:
        _, call = self.pure.forward({"vertices": self.vertices})
        self.pure.backward(call, {"alpha": self.gradient})

    def loss(self) -> None:
        """It has none."""


class Numpy:
    """The same loop, by hand."""

    def __init__(self, case: Case, session):
        self.pure, self.masks, self.count = Pure(session, "render"), case.masks, 0
        self.vertices = case.ball.positions.astype(np.float32)
        self.m = self.v = np.zeros_like(self.vertices)
        self.near, self.real, self.inverse = case.neighbours

    def values(self) -> tuple:
        pictures, call = self.pure.forward({"vertices": self.vertices})
        apart = pictures["alpha"] - self.masks
        d = self.vertices - (self.vertices[self.near] * self.real[..., None]).sum(1) * self.inverse[:, None]
        return call, apart, d, np.linalg.norm(d, axis=1, keepdims=True)

    def loss(self) -> float:
        _, apart, _, far = self.values()
        return float(np.mean(apart * apart) + WEIGHT * far.mean())

    def step(self) -> None:
        call, apart, d, far = self.values()
        g = self.pure.backward(call, {"alpha": apart * np.float32(2 / apart.size)})["vertices"]
        unit = d / np.maximum(far, 1e-30) * (WEIGHT / len(d))
        spread = unit * self.inverse[:, None]
        g = g + unit
        np.subtract.at(g, self.near, spread[:, None] * self.real[..., None])
        self.count += 1
        self.m = BETAS[0] * self.m + (1 - BETAS[0]) * g
        self.v = BETAS[1] * self.v + (1 - BETAS[1]) * g * g
        m, v = self.m / (1 - BETAS[0] ** self.count), self.v / (1 - BETAS[1] ** self.count)
        self.vertices = (self.vertices - RATE * m / (np.sqrt(v) + EPSILON)).astype(np.float32)


class Torch:
    def __init__(self, case: Case, session):
        import torch

        import dressi_edge.torch as bridge
        torch.set_num_threads(1)  # its threads wait busily, where the driver's want to run
        self.render, self.masks = bridge.Render(session, "render"), torch.from_numpy(case.masks)
        self.near, self.real, self.inverse = map(torch.from_numpy, case.neighbours)
        self.optimizer = torch.optim.Adam(self.render.parameters(), RATE, BETAS, EPSILON)

    def values(self):
        x = self.render.vertices
        d = x - (x[self.near] * self.real[..., None]).sum(1) * self.inverse[:, None]
        return (self.render()["alpha"] - self.masks).square().mean() + WEIGHT * d.norm(dim=1).mean()

    def loss(self) -> float:
        return float(self.values().detach())

    def step(self) -> None:
        self.optimizer.zero_grad()
        self.values().backward()
        self.optimizer.step()


class TorchAdam:
    """Losses in the scene, the optimizer in PyTorch."""

    def __init__(self, case: Case, session):
        import torch

        import dressi_edge.torch as bridge
        self.render = bridge.Render(session, "whole")
        self.optimizer = torch.optim.Adam(self.render.parameters(), RATE, BETAS, EPSILON)

    def loss(self) -> float:
        return float(self.render()["loss"].detach())

    def step(self) -> None:
        self.optimizer.zero_grad()
        self.render.accumulate(loss=1.0)
        self.optimizer.step()


class Functions:
    """Silhouettes by rasterize and antialias of dressi_edge.primitives, losses and Adam in PyTorch."""

    def __init__(self, case: Case, session):
        import torch

        import dressi_edge.primitives.torch as dr
        torch.set_num_threads(1)
        self.dr, self.context = dr, dr.Context(case.where, output_db=False)
        self.masks = torch.from_numpy(case.masks)[..., None].flip(1)
        rows = []
        for c in case.views:
            to_clip = np.array([[2 * c.fx / c.width, 0, 1 - 2 * c.cx / c.width, 0], [0, 2 * c.fy / c.height, 2 * c.cy / c.height - 1, 0],
                                [0, 0, -(c.far + c.near) / (c.far - c.near), -2 * c.far * c.near / (c.far - c.near)], [0, 0, -1, 0]])
            rows.append((to_clip @ c.world_to_camera).T)
        self.matrices, self.tri = torch.tensor(np.array(rows), dtype=torch.float32), torch.tensor(np.array(case.ball.faces, np.int32))
        self.vertices = torch.tensor(case.ball.positions, dtype=torch.float32, requires_grad=True)
        self.near, self.real, self.inverse = map(torch.from_numpy, case.neighbours)
        self.optimizer = torch.optim.Adam([self.vertices], RATE, BETAS, EPSILON)

    def values(self):
        import torch
        x, dr = self.vertices, self.dr
        pos = torch.nn.functional.pad(x, (0, 1), value=1.0) @ self.matrices
        with torch.no_grad():
            rast, _ = dr.rasterize(self.context, pos, self.tri, self.masks.shape[1:3])
        alpha = dr.antialias((rast[..., 3:] > 0).float(), rast, pos, self.tri)
        d = x - (x[self.near] * self.real[..., None]).sum(1) * self.inverse[:, None]
        return (alpha - self.masks).square().mean() + WEIGHT * d.norm(dim=1).mean()

    def loss(self) -> float:
        return float(self.values().detach())

    def step(self) -> None:
        self.optimizer.zero_grad()
        self.values().backward()
        self.optimizer.step()


class Jax:
    def __init__(self, case: Case, session):
        import jax
        import jax.numpy as jnp

        import dressi_edge.jax as bridge
        render, masks = bridge.function(session, "render"), jnp.asarray(case.masks)
        near, real, inverse = map(jnp.asarray, case.neighbours)
        start = jnp.asarray(case.ball.positions, jnp.float32)
        self.state = start, jnp.zeros_like(start), jnp.zeros_like(start), 0

        def values(x):
            d = x - (x[near] * real[..., None]).sum(1) * inverse[:, None]
            return jnp.square(render(vertices=x)["alpha"] - masks).mean() + WEIGHT * jnp.linalg.norm(d, axis=1).mean()

        def step(state):
            x, m, v, count = state
            g, count = jax.grad(values)(x), count + 1
            m, v = BETAS[0] * m + (1 - BETAS[0]) * g, BETAS[1] * v + (1 - BETAS[1]) * g * g
            far = (m / (1 - BETAS[0] ** count)) / (jnp.sqrt(v / (1 - BETAS[1] ** count)) + EPSILON)
            return x - RATE * far, m, v, count

        self.values, self.next = jax.jit(values), jax.jit(step)

    def loss(self) -> float:
        return float(self.values(self.state[0]))

    def step(self) -> None:
        self.state = self.next(self.state)
        self.state[0].block_until_ready()


LOOPS = {"ours": Ours, "vjp": Vjp, "numpy": Numpy, "torch": Torch, "torch Adam": TorchAdam,
         "torch functions": Functions, "jax": Jax}


def versions() -> dict:
    from importlib.metadata import version
    return {"python": platform.python_version(), "numpy": np.__version__, **{k: version(k) for k, there in INSTALLED.items() if there}}


def main(arguments: list[str] | None = None) -> list[dict]:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="64x64 and few rounds")
    parser.add_argument("--seconds", type=float, help="measure for at least so long (default 30; 0 with --quick)")
    parser.add_argument("--size", type=int, help="pixels a side of a view (default 256; 64 with --quick)")
    parser.add_argument("--data", type=Path, metavar="DIR", help="the folder of meshes/ (default: ../shared)")
    parser.add_argument("--device", help="an index or a part of the device's name")
    parser.add_argument("--profile", default="lavapipe", help="the device profile to compile for (default lavapipe)")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the results there")
    options = parser.parse_args(arguments)
    options.size = options.size or (64 if options.quick else 256)
    seconds = options.seconds if options.seconds is not None else 0.0 if options.quick else 30.0
    results, opened = [], []
    with tempfile.TemporaryDirectory() as folder:
        case = Case(Path(folder), options)
        try:
            names = [name for name in LOOPS if INSTALLED.get(name.split()[0], True)]
            loops = {}
            for name in names:
                opened.append(case.open())
                loops[name] = LOOPS[name](case, opened[-1])
            after = {}
            for name, loop in loops.items():  # warm, and compared
                for _ in range(COMPARED):
                    loop.step()
                after[name] = loop.loss()
            meters = {name: Meter(loop.step) for name, loop in loops.items()}
            take_turns(list(meters.values()), seconds, 3, 2 if options.quick else 5)
        finally:
            for session in opened:
                session.close()
    for name, meter in meters.items():
        ratios = [mine / own for mine, own in zip(meter.cpus, meters["ours"].cpus)]
        walls = [mine / own for mine, own in zip(meter.walls, meters["ours"].walls)]
        results.append({"case": name, **meter.row, "ratio": rounded(statistics.median(ratios)),
                        "wall_ratio": rounded(statistics.median(walls)), "loss_after": after[name]})
        row = results[-1]
        print(f"{name:16s} {row['ms']:8.2f} ms {row['cpu_ms']:8.2f} ms cpu  {row['ratio']:5.2f} x cpu {row['wall_ratio']:5.2f} x wall  "
              f"loss after {COMPARED}: {row['loss_after']}")
    for name in set(INSTALLED) - set(names):
        print(f"{name:16s} is not installed: left out")
    if options.json:
        load = os.getloadavg()[0] if hasattr(os, "getloadavg") else None
        options.json.write_text(json.dumps({"device": case.device, "versions": versions(), "load": load, "size": options.size,
                                            "results": results}, indent=1) + "\n", encoding="utf-8")
    return results


if __name__ == "__main__":
    main()
