"""PyTorch3D itself: its rasterizer on the CPU with its `softmax_rgb_blend`, beside `Binned.pytorch3d` of the same settings.

    python benchmarks/peers_pytorch3d.py [--quick] [--json FILE] [--device NAME] [--profile NAME]

small    80 faces in 24x20 under a wide blur, K = 80
682      one view of 256x256, r = 2 pixels and their default sigma, K = 50
far      320 faces in 64x64 under a wide blur, K = 320: as many layers as there are faces

image, alpha, gradient: |found - exact| / |exact|, norms over everything, exact being ours in float64, of 256x256 (which takes NumPy
minutes) ours by the device; found theirs (C++, float32, one thread), or ours by the device in float32. The gradient is that of a fixed
random weighting of colours and alpha by the vertices. typical: the median over vertices of the same. off: vertices whose gradient is a
hundredth off or more; the largest of these is printed beside central differences of both pictures. ms: wall; cpu: of all threads;
medians. full: pixels with K faces, whose rest PyTorch3D leaves out; ours has no K.

It needs torch and PyTorch3D (BSD licence), of which there is no wheel for the CPU on PyPI; from its source, without CUDA:
    pip install torch iopath fvcore && pip install --no-build-isolation 'git+https://github.com/facebookresearch/pytorch3d.git'
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT), str(ROOT / "benchmarks")]

from reconstruct import versions  # noqa: E402
from step import bumpy, table  # noqa: E402

from dressi_edge import runtime  # noqa: E402
from dressi_edge.compiler.graph.reference_session import ReferenceSession  # noqa: E402
from dressi_edge.compiler.io.cameras import orbit  # noqa: E402
from dressi_edge.compiler.io.mesh import Mesh  # noqa: E402
from dressi_edge.compiler.io.shapes import icosphere  # noqa: E402
from dressi_edge.compiler.render.material import Unlit, Vertex  # noqa: E402
from dressi_edge.compiler.render.raster import Binned  # noqa: E402
from dressi_edge.compiler.scene import F, Scene  # noqa: E402

BACK = (0.2, 0.4, 0.6)
NEAR, FAR = 1.0, 100.0
COLUMNS = ("case", "who", "image", "alpha", "gradient", "typical", "off", "forward_ms", "both_ms", "forward_cpu", "both_cpu", "full")


@dataclass(frozen=True)
class Case:
    """A mesh in one view. blur: in pixels; sigma, gamma: theirs; layers: K."""

    name: str
    mesh: Mesh
    size: tuple[int, int]
    blur: float | None
    sigma: float
    gamma: float
    layers: int

    @property
    def radius(self) -> float:
        """Their blur_radius: the square of a length in half shorter sides."""
        return float(np.log(1e4 - 1) * self.sigma) if self.blur is None else (2.0 * self.blur / min(self.size)) ** 2

    @property
    def small(self) -> bool:
        """Whether float64 does not take minutes."""
        return self.size[0] <= 64

    @property
    def camera(self):
        return orbit(1, [20.0], 2.7, 40.0, self.size)[0]

    @property
    def colors(self) -> np.ndarray:
        return 0.5 + 0.4 * np.sin(5.0 * np.asarray(self.mesh.positions) + [0, 1, 2])

    def weights(self) -> np.ndarray:
        """(h, w, 4): what colours and alpha count in the loss."""
        return np.random.default_rng(0).normal(size=(*self.size[::-1], 4))


def cases(quick: bool) -> list[Case]:
    two = (2.0 * 2.0 / 256) ** 2 / float(np.log(1e4 - 1))  # sigma whose blur of 1e-4 is two pixels
    small = Case("small", icosphere(1, 0.8), (24, 20), 3.0, 3e-3, 1e-2, 80)
    if quick:
        return [small]
    body = bumpy(31, 12)
    return [small, Case("682 r=2", body, (256, 256), None, two, 1e-4, 50), Case("682 default", body, (256, 256), None, 1e-4, 1e-4, 50),
            Case("far", icosphere(2, 0.8), (64, 64), 6.0, 3e-3, 1e-2, 320)]


def timed(work: Callable, repeats: int, again: Callable = lambda: None) -> tuple[float, float]:
    """Milliseconds on the clock, and of the processors."""
    walls, cpus = [], []
    for _ in range(repeats):
        again()
        wall, cpu = time.perf_counter(), time.process_time()
        work()
        walls.append(time.perf_counter() - wall)
        cpus.append(time.process_time() - cpu)
    return 1e3 * float(np.median(walls)), 1e3 * float(np.median(cpus))


def theirs(case: Case, repeats: int) -> tuple[np.ndarray, np.ndarray, dict, Callable]:
    """Picture (h, w, 4), the gradient by the vertices, what it took, and what gives the loss of other vertices."""
    import torch
    from pytorch3d.ops import interpolate_face_attributes
    from pytorch3d.renderer.blending import BlendParams, softmax_rgb_blend
    from pytorch3d.renderer.mesh.rasterize_meshes import rasterize_meshes
    from pytorch3d.renderer.mesh.rasterizer import Fragments
    from pytorch3d.structures import Meshes

    camera, (width, height), unit = case.camera, case.size, min(case.size) / 2.0
    pose = torch.tensor(camera.world_to_camera, dtype=torch.float64)
    x = torch.tensor(np.asarray(case.mesh.positions, float), requires_grad=True)
    faces = torch.tensor(np.asarray(case.mesh.faces, np.int64))
    colors = torch.tensor(case.colors, dtype=torch.float32)[faces]
    blend = BlendParams(case.sigma, case.gamma, BACK)
    how = {"image_size": (height, width), "blur_radius": case.radius, "faces_per_pixel": case.layers, "perspective_correct": True,
           "clip_barycentric_coords": True, "cull_backfaces": False}

    def draw(x=x):
        seen = x @ pose[:3, :3].T + pose[:3, 3]
        ahead = -seen[:, 2]
        across = (width / 2.0 - (camera.cx + camera.fx * seen[:, 0] / ahead)) / unit  # to the left
        up = (height / 2.0 - (camera.cy - camera.fy * seen[:, 1] / ahead)) / unit
        meshes = Meshes([torch.stack([across, up, ahead], 1).float()], [faces])
        found = rasterize_meshes(meshes, **how, bin_size=0)
        fragments = Fragments(*found)
        mixed = interpolate_face_attributes(fragments.pix_to_face, fragments.bary_coords, colors)
        return softmax_rgb_blend(mixed, fragments, blend, NEAR, FAR)[0], fragments

    weights = torch.tensor(case.weights())

    def both():
        x.grad = None
        picture, fragments = draw()
        (picture.double() * weights).sum().backward()
        return picture.detach().double().numpy(), fragments

    picture, fragments = both()
    gradient = x.grad.numpy().copy()
    row = {"full": int((fragments.pix_to_face[0, ..., -1] >= 0).sum())}
    if repeats:
        with torch.no_grad():
            row["forward_ms"], row["forward_cpu"] = timed(draw, repeats)
        row["both_ms"], row["both_cpu"] = timed(both, 1)


    def loss(positions: np.ndarray) -> float:
        with torch.no_grad():
            return float((draw(torch.tensor(positions))[0].double() * weights).sum())

    return picture, gradient, row, loss


def ours(case: Case, folder: Path, options: argparse.Namespace, repeats: int):
    """(picture, gradient) in float64, or of large pictures by the device; the same by the device; what the device took; about it; and the
    loss of other vertices in float64."""
    scene = Scene([case.camera], BACK)
    p = np.asarray(case.mesh.positions, float)
    scene.add(case.mesh, scene.parameter("x", p), Unlit(Vertex(F.constant_table(case.colors))))
    seen = scene.frame(Binned.pytorch3d(case.size, case.sigma, case.gamma, case.radius, NEAR, FAR))
    scene.vjp("look", ["x"], color=seen.color, alpha=seen.alpha)
    scene.compile(options.profile, folder / "p3d.dressi", cache=False)

    def picture_and_gradient(session):
        session.set("look.color.grad", case.weights()[None, ..., :3])
        session.set("look.alpha.grad", case.weights()[None, ..., 3])
        picture = np.concatenate([session.get("look.color")[0], np.asarray(session.get("look.alpha")[0])[..., None]], axis=2)
        return np.asarray(picture, float), np.asarray(session.get("look.x.grad"), float)

    def loss(positions: np.ndarray) -> float:
        with ReferenceSession(scene.program) as session:
            session.set("x", positions)
            return float((session.get("look.color")[0] * case.weights()[..., :3]).sum()
                         + (np.asarray(session.get("look.alpha")[0]) * case.weights()[..., 3]).sum())

    exact = None
    if case.small:
        with ReferenceSession(scene.program) as session:
            exact = picture_and_gradient(session)
    with runtime.load(folder / "p3d.dressi", options.device) as session:
        found, about, row = picture_and_gradient(session), session.report(), {}
        if repeats:
            for key, name in (("forward", "look.color"), ("both", "look.x.grad")):
                row[f"{key}_ms"], row[f"{key}_cpu"] = timed(lambda name=name: session.get(name), max(repeats, 15),
                                                            lambda: session.set("x", p))
    return exact or found, found, row, about, loss


def apart(a: np.ndarray, b: np.ndarray) -> float:
    return float(np.linalg.norm(a - b) / np.linalg.norm(b))


def slope(loss: Callable, p: np.ndarray, vertex: int, h: float) -> list[float]:
    """The loss's central differences by a vertex."""
    out = []
    for axis in range(3):
        moved = [p.copy(), p.copy()]
        moved[0][vertex, axis] += h
        moved[1][vertex, axis] -= h
        out.append((loss(moved[0]) - loss(moved[1])) / (2.0 * h))
    return out


def measured(case: Case, folder: Path, options: argparse.Namespace) -> tuple[list[dict], dict]:
    repeats = 0 if options.quick else 3
    exact, device, took, about, own = ours(case, folder, options, repeats)
    peer = theirs(case, repeats)
    rows, size = [], np.linalg.norm(exact[1], axis=1)
    for who, found, spent in (("PyTorch3D", peer[:2], peer[2]), ("device", device, took)):
        each = np.linalg.norm(found[1] - exact[1], axis=1) / np.maximum(size, 1e-9 * size.max())
        rows.append({"case": case.name, "who": who, "faces": len(case.mesh.faces), "K": case.layers,
                     "image": apart(found[0][..., :3], exact[0][..., :3]), "alpha": apart(found[0][..., 3], exact[0][..., 3]),
                     "gradient": apart(found[1], exact[1]), "typical": float(np.median(each)), "off": int((each > 0.01).sum()), **spent})
    if not case.small:
        for key in ("image", "alpha", "gradient", "typical", "off"):
            del rows[1][key]
    if rows[0]["off"] and case.small:
        p, worst = np.asarray(case.mesh.positions, float), int(np.argmax(np.linalg.norm(peer[1] - exact[1], axis=1)))
        rows[0] |= {"worst": peer[1][worst].tolist(), "worst_ours": exact[1][worst].tolist(), "worst_exact": slope(own, p, worst, 1e-6),
                    "worst_theirs_differences": slope(peer[3], p, worst, 1e-3)}
    return rows, about


def main(arguments: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="the small case alone")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the results there")
    parser.add_argument("--device", help="an index or a part of the device's name")
    parser.add_argument("--profile", default="lavapipe", help="the device profile to compile for (default lavapipe)")
    options = parser.parse_args(arguments)
    try:
        import pytorch3d
        import torch
    except ImportError as error:
        raise SystemExit(f"{error.name} is not installed; how to get torch and PyTorch3D: benchmarks/peers_pytorch3d.py --help") from None
    results, about = [], {}
    with tempfile.TemporaryDirectory(prefix="dressi-p3d-") as folder:
        for case in cases(options.quick):
            rows, about = measured(case, Path(folder), options)
            results += rows
            print(table([{k: f"{x:.3g}" if isinstance(x, float) else x for k, x in row.items()} for row in rows], COLUMNS), flush=True)
            for key in ("worst", "worst_theirs_differences", "worst_ours", "worst_exact"):
                if key in rows[0]:
                    print(f"  {key:26}", " ".join(f"{x:10.4g}" for x in rows[0][key]), flush=True)
            if options.json is not None:
                options.json.parent.mkdir(parents=True, exist_ok=True)
                found = {**versions(about), "torch": torch.__version__, "pytorch3d": pytorch3d.__version__}
                options.json.write_text(json.dumps({"device": about["device"], "versions": found, "results": results}, indent=1) + "\n",
                                        encoding="utf-8")
    print(f"{about['device']}, {about['driver']}; PyTorch3D {pytorch3d.__version__}, torch {torch.__version__}")


if __name__ == "__main__":
    main()
