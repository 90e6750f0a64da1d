"""How near the gradient of a colour picture is to the derivative of the picture itself, where surfaces hide each other.

    python benchmarks/contours.py [--sizes 128 256] [--radii 1 2 4] [--cases balls ring ...] [--json FILE]

Meshes of several pieces or folds, painted by a smooth function of place; the loss is the picture times a smooth image. The truth is a
caster in float64: 256 samples a pixel (64 in 256 x 256), nearest face in front, colour by perspective; central differences of half a pixel
along 19 displacement fields of the vertices on screen (two translations, scale, 16 waves). Relative L2 error and cosine over the fields, of
`Outline(r)` and of `Outline(r, contours=True)`, on lavapipe. `spot` needs DIR/meshes/spot/spot.obj, by default DIR is `shared` beside
the checkout. Where Mitsuba 3 is installed, its own estimate of the gradient by boundary samples is beside ours.
"""
from __future__ import annotations

import argparse
import importlib.util
import json
import platform
import sys
import tempfile
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT), str(ROOT / "tests")]

from test_hardsoftras import torus  # noqa: E402

from dressi_edge import runtime  # noqa: E402
from dressi_edge.compiler.io.meshes import load_mesh, normalize  # noqa: E402
from dressi_edge.compiler.scene import Mesh, Outline, Scene, Unlit, Vertex, icosphere, look_at  # noqa: E402
from dressi_edge.runtime.device import Device  # noqa: E402

STEP = 0.5  # pixels
WAVES = 16


def together(*pieces):
    """Pieces (positions, faces) as one mesh."""
    first = np.cumsum([0, *(len(p) for p, _ in pieces)])
    return np.concatenate([p for p, _ in pieces]), np.concatenate([f + k for (_, f), k in zip(pieces, first)])


def rod(start, end, radius, level=2):
    """A ball drawn out from start to end."""
    ball, (start, end) = icosphere(level, 1.0), np.array((start, end), float)
    along = (end - start) / np.linalg.norm(end - start)
    side = ball.positions @ along > 0
    return ball.positions * radius + np.where(side[:, None], end, start), ball.faces


def cases(folder):
    """name: (positions, faces), seen from +z, about 1.6 wide."""
    ball = icosphere(3, 1.0)
    found = {"balls": together((ball.positions * 0.3 + (0.05, 0.02, 0.9), ball.faces), (ball.positions * 0.8, ball.faces)),
             "crossing": together((ball.positions * 0.4 + (0.25, 0.1, 0.9), ball.faces),
                                  (ball.positions * 0.7 - (0.1, 0.0, 0.0), ball.faces))}
    ring, faces = torus(64, 28)
    turn = np.array([[1, 0, 0], [0, np.cos(1.15), -np.sin(1.15)], [0, np.sin(1.15), np.cos(1.15)]])
    found["ring"] = ring / np.abs(ring).max() * 0.85 @ turn.T, faces
    palm = ball.positions * (0.75, 0.65, 0.15) - (0.0, 0.1, 0.3), ball.faces
    found["hand"] = together(palm, *(rod((0.32 * k - 0.48, -0.35, 0.2), (0.36 * k - 0.54, 0.5 + 0.05 * (k % 2), 0.3), 0.1)
                                     for k in range(4)))
    plate, teeth = (ball.positions * (0.8, 0.8, 0.1) - (0.0, 0.0, 0.4), ball.faces), np.linspace(-0.5, 0.5, 6)
    found["comb"] = together(plate, *(rod((x, -0.55, 0.1), (x, 0.55, 0.1), 0.04) for x in teeth))
    path = folder / "meshes" / "spot" / "spot.obj"
    if path.exists():
        spot = normalize(load_mesh(path))
        a = 2.4  # from behind an ear
        found["spot"] = spot.positions @ np.array([[np.cos(a), 0, np.sin(a)], [0, 1, 0], [-np.sin(a), 0, np.cos(a)]]).T, spot.faces
    else:
        print(f"no {path}, so without Spot", file=sys.stderr)
    return found


def paint(positions):
    return 0.5 + 0.4 * np.sin(positions @ np.array([[3.0, 1.0, -2.0], [1.0, 4.0, 1.5], [-6.0, 5.0, 7.0]]) + (0.3, 1.1, 2.0))


def picture(screen, depth, colors, faces, size, samples):
    """Mean colours (size, size, 3), black where nothing is: screen (V, 2) in pixels, depth (V,) along the axis."""
    n = size * samples
    p = screen * samples
    a, b, c = (p[faces[:, k]] for k in range(3))
    area = (b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0]
    faces = faces[area < 0]  # rows grow downwards: these turn to the eye
    corners = p[faces]
    low = np.clip(np.ceil(corners.min(1) - 0.5), 0, n).astype(np.int64)
    high = np.clip(np.ceil(corners.max(1) - 0.5), 0, n).astype(np.int64)
    total, weight = np.zeros((n * n, 3)), np.full(n * n, np.inf)
    spans = np.maximum(high - low, 0)
    counts = spans.prod(1)
    for part in np.array_split(np.arange(len(faces)), max(1, int(counts.sum() // 2_000_000))):
        k = np.repeat(part, counts[part])
        at = np.arange(len(k)) - np.repeat(np.cumsum(counts[part]) - counts[part], counts[part])
        x, y = low[k, 0] + at % np.maximum(spans[k, 0], 1), low[k, 1] + at // np.maximum(spans[k, 0], 1)
        a, b, c = (corners[k, j] - np.stack([x + 0.5, y + 0.5], 1) for j in range(3))
        e = [u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0] for u, v in ((b, c), (c, a), (a, b))]
        inside = (e[0] <= 0) & (e[1] <= 0) & (e[2] <= 0)
        k, x, y, e = k[inside], x[inside], y[inside], [v[inside] for v in e]
        w = np.stack(e, 1) / depth[faces[k]]
        nearness = w.sum(1) / sum(e)
        texel, away = y * n + x, 1.0 / nearness
        order = np.lexsort((away, texel))
        first = order[np.unique(texel[order], return_index=True)[1]]
        first = first[away[first] < weight[texel[first]]]
        weight[texel[first]] = away[first]
        total[texel[first]] = (w[first, :, None] / w[first].sum(1)[:, None, None] * colors[faces[k[first]]]).sum(1)
    return total.reshape(size, samples, size, samples, 3).mean((1, 3))


def fields(screen):
    """(3 + WAVES, V, 2) pixels: two translations, scale, and waves, the longest step a pixel."""
    rng, size = np.random.default_rng(0), np.ptp(screen, 0).max()
    found = [np.tile(axis, (len(screen), 1)) for axis in np.eye(2)] + [screen - screen.mean(0)]
    for _ in range(WAVES):
        wave = np.sin((screen - screen.mean(0)) @ rng.normal(0, 2 * np.pi / size, 2) + rng.uniform(0, 2 * np.pi))
        angle = rng.uniform(0, 2 * np.pi)
        found.append(wave[:, None] * (np.cos(angle), np.sin(angle)))
    return np.array([f / np.linalg.norm(f, axis=1).max() for f in found])


def measure(positions, faces, size, radii, device, folder):
    """Rows: r, contours (or peer), error, cosine."""
    camera = look_at((0, 0, 4), (0, 0, 0), (0, 1, 0), 28, size, size)
    matrix = np.asarray(camera.world_to_camera)
    seen = positions @ matrix[:3, :3].T + matrix[:3, 3]
    depth = -seen[:, 2]
    scale = np.array((camera.fx, -camera.fy))
    screen = seen[:, :2] / depth[:, None] * scale + (camera.cx, camera.cy)
    y, x = np.mgrid[:size, :size] / size
    weight = np.stack([np.sin(3 * x + 1) + y, np.cos(4 * y) + x, np.sin(6 * x * y)], -1)
    samples, along, truth = 16 if size <= 128 else 8, fields(screen), []
    for field in along:
        plus, minus = (picture(screen + s * STEP * field, depth, paint(positions), faces, size, samples) for s in (1, -1))
        truth.append(((plus - minus) * weight).sum() / (2 * STEP))
    truth, rows = np.array(truth), []
    moved = along * depth[:, None] / scale  # of a pixel on screen, in the camera's axes

    def compared(gradient, **what):
        found = (moved @ matrix[:2, :3] * gradient).sum((1, 2))
        rows.append({**what, "error": float(np.linalg.norm(found - truth) / np.linalg.norm(truth)),
                     "cosine": float(found @ truth / np.linalg.norm(found) / np.linalg.norm(truth))})

    if importlib.util.find_spec("mitsuba"):
        from peers import mitsuba_gradient  # which takes what others need not have
        compared(mitsuba_gradient(Mesh(positions, faces), camera, weight, 256, paint(positions)), peer="mitsuba")
    for r in radii:
        for contours in (False, True):
            s = Scene([camera])
            p = s.parameter("positions", positions)
            s.add(Mesh(positions, faces), p, Unlit(Vertex(s.parameter("paint", paint(positions)))))
            s.vjp("v", ["positions"], color=s.frame(Outline(r, contours=contours)).color)
            path = Path(folder) / "x.dressi"
            s.compile("lavapipe", path)
            with runtime.load(path, device) as session:
                session.forward("v")
                compared(session.backward("v", color=weight[None])["positions"].astype(float), r=r, contours=contours)
    return rows


def main() -> None:
    arguments = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    arguments.add_argument("--sizes", type=int, nargs="+", default=[128, 256])
    arguments.add_argument("--radii", type=float, nargs="+", default=[1.0, 2.0, 4.0])
    arguments.add_argument("--cases", nargs="+")
    arguments.add_argument("--folder", type=Path, default=ROOT.parent / "shared")
    arguments.add_argument("--json", type=Path)
    options = arguments.parse_args()
    rows = []
    with Device.open() as device, tempfile.TemporaryDirectory() as folder:
        print("| | size | r | error without | with contours | cosine without | with |\n|---|---|---|---|---|---|---|")
        for name, mesh in cases(options.folder).items():
            if options.cases and name not in options.cases:
                continue
            for size in options.sizes:
                found = measure(*mesh, size, options.radii, device, folder)
                rows += [{"case": name, "size": size, **row} for row in found]
                for row in found:
                    if "peer" in row:
                        print(f"| {name} | {size} | {row['peer']} | | {row['error']:.3f} | | {row['cosine']:.4f} |", flush=True)
                found = [row for row in found if "peer" not in row]
                for one, other in zip(found[::2], found[1::2]):
                    print(f"| {name} | {size} | {one['r']:g} | {one['error']:.3f} | {other['error']:.3f} | {one['cosine']:.4f} | "
                          f"{other['cosine']:.4f} |", flush=True)
        if options.json:
            options.json.write_text(json.dumps({"device": device.name, "python": platform.python_version(), "rows": rows}, indent=1) + "\n")


if __name__ == "__main__":
    main()
