"""How exact gradients are: fp32 on the device against the float64 reference of the same graph, and HardSoftRas' silhouette gradient
against the derivative of true coverage.

    python benchmarks/gradient_error.py                # both parts, writes benchmarks/results/gradient_error.json, prints the tables
    python benchmarks/gradient_error.py --part coverage

Part fp32: the corpus of tests/corpus.py x K x r, random weights on every pixel that is further than 1/64 of a pixel from another
discrete choice. Relative L2 error |g - g64| / |g64| and cosine, of the gradient by clip coordinates and by vertex colours.
Part coverage: geodesic spheres of radius 20 pixels at eight places within a pixel; the loss is the silhouette times a smooth image.
The true derivative by scale and by translation is the integral over the outline of the projected mesh, which is convex.
"""
from __future__ import annotations

import argparse
import json
import platform
import sys
import tempfile
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT), str(ROOT / "tests")]

import brute_force  # noqa: E402
from corpus import project, scenes  # noqa: E402
from test_hardsoftras import MARGIN, renderer  # noqa: E402

from dressi_edge import runtime  # noqa: E402
from dressi_edge.compiler import compile_program  # noqa: E402
from dressi_edge.compiler.reference import evaluate  # noqa: E402
from dressi_edge.compiler.render.hardsoftras import Softness  # noqa: E402
from dressi_edge.compiler.scene import sphere  # noqa: E402
from dressi_edge.compiler.topology import Topology  # noqa: E402
from dressi_edge.runtime.device import Device  # noqa: E402

GRADIENTS = ("by_clip", "by_attributes")


def fp32(array):
    return np.asarray(array, np.float32).astype(np.float64)


class Bundles:
    """Sessions by what they are compiled from; scenes of the same faces, size and near share one."""

    def __init__(self, device, folder):
        self.device, self.folder, self.count = device, folder, 0

    def open(self, program):
        self.count += 1
        path = Path(self.folder) / f"{self.count}.dressi"
        compile_program(program, "lavapipe", path)
        return runtime.load(path, self.device)


def part_fp32(bundles, layers, radii):
    groups, rows = {}, []
    for name, s in scenes().items():
        groups.setdefault((s.faces.tobytes(), len(s.clip), s.size, s.near), []).append(name)
    for k in layers:
        for r in radii:
            for names in groups.values():
                rows += _group(bundles, names, Softness(float(r), layers=k))
            print(f"fp32: K = {k}, r = {r}", file=sys.stderr, flush=True)
    return rows


def _group(bundles, names, softness):
    corpus, rows = scenes(), []
    first = corpus[names[0]]
    program = renderer(Topology(first.faces, len(first.clip)), first.size, softness, first.near)
    roots = {name: node for plan in program.plans for name, node in plan.outputs.items() if name in GRADIENTS}
    rng = np.random.default_rng(0)
    with bundles.open(program) as session:
        for name in names:
            s = corpus[name]
            margins = brute_force.select(fp32(s.clip), s.faces, s.size, softness.r, layers=softness.layers, near=s.near).margins
            sure = (margins.gradient > MARGIN) & (margins.color > MARGIN)
            given = {"clip": s.clip, "attributes": s.attributes, "by_alpha": (rng.normal(size=sure.shape) * sure)[None],
                     "by_color": (rng.normal(size=(*sure.shape, 3)) * sure[..., None])[None]}
            feed = {key: program.values[key].layout.to_image(fp32(x), key) for key, x in given.items()}
            for key, x in given.items():
                session.set(key, x)
            for key, value in zip(roots, evaluate(roots.values(), feed)):
                want = program.values[key].layout.from_image(value).ravel()
                got = session.get(key).astype(np.float64).ravel()
                size = np.linalg.norm(want)
                if size < 1e-9:
                    rows.append({"scene": name, "K": softness.layers, "r": softness.r, "of": key, "error": None,
                                 "absolute": float(np.abs(got).max())})
                    continue
                rows.append({"scene": name, "K": softness.layers, "r": softness.r, "of": key, "smooth": float(sure.mean()),
                             "error": float(np.linalg.norm(got - want) / size),
                             "worst": float(np.abs(got - want).max() / np.abs(want).max()),
                             "cosine": float(got @ want / size / np.linalg.norm(got))})
    return rows


SIZE, RADIUS, DISTANCE = 56, 20.0, 12.0  # within the far plane of `project`


def hull(points):
    """The convex hull of (n, 2), anticlockwise (Andrew's monotone chain)."""
    points = sorted(map(tuple, points))

    def half(ps):
        out = []
        for p in ps:
            while len(out) > 1 and ((out[-1][0] - out[-2][0]) * (p[1] - out[-2][1])
                                    <= (out[-1][1] - out[-2][1]) * (p[0] - out[-2][0])):
                out.pop()
            out.append(p)
        return out[:-1]

    return np.array(half(points) + half(points[::-1]))


def weight(x, y):
    return 1 + 0.5 * np.sin(0.09 * x + 0.4) * np.cos(0.07 * y)


def coverage_derivative(screen, centre):
    """Of the integral of `weight` over the outline of screen points: by scale about the centre, and by translation."""
    a = hull(screen)
    b = np.roll(a, -1, axis=0)
    normal = np.stack([(b - a)[:, 1], -(b - a)[:, 0]], 1)  # times the edge's length
    total = np.zeros(3)
    nodes, weights = np.polynomial.legendre.leggauss(6)
    for t, w in zip((nodes + 1) / 2, weights / 2):
        p = a + t * (b - a)
        value = weight(*p.T) * w
        total += [(value * ((p - centre) * normal).sum(1)).sum(), *(value[:, None] * normal).sum(0)]
    return total


def part_coverage(bundles):
    rows = []
    base = {"vertices": 642, "r": 2.0, "K": 1, "sigma": None, "delta": None}
    cases = [base | {"vertices": v, "K": k} for v in (162, 642, 2562) for k in (1, 3)]
    cases += [base | {"r": r, "K": k} for r in (1.0, 4.0, 8.0) for k in (1, 3)]
    cases += [base | {"sigma": x} for x in (0.1, 0.6, 1.0)] + [base | {"delta": x} for x in (1.0, 4.0)]
    for case in cases:
        ball = sphere(case["vertices"])
        topology = Topology(ball.faces, len(ball.positions))
        softness = Softness(case["r"], sigma=case["sigma"], delta=case["delta"], layers=case["K"])
        ys, xs = np.mgrid[:SIZE, :SIZE] + 0.5
        found, true = [], []
        with bundles.open(renderer(topology, (SIZE, SIZE), softness, 0.1)) as session:
            session.set("attributes", np.zeros((topology.vertex_count, 3)))
            session.set("by_color", np.zeros((1, SIZE, SIZE, 3)))
            session.set("by_alpha", weight(xs, ys)[None])
            for shift in np.random.default_rng(1).uniform(-0.5, 0.5, (8, 2)):
                centre = SIZE / 2 + shift
                clip = project(ball.positions + (0, 0, -DISTANCE), (SIZE, SIZE), focal=RADIUS * DISTANCE / SIZE)
                screen = (clip[:, :2] / clip[:, 3:] + 1) * SIZE / 2
                screen += centre - screen.mean(0)
                clip[:, :2] = (screen * 2 / SIZE - 1) * clip[:, 3:]
                session.set("clip", clip)
                g = session.get("by_clip")[:, :2].astype(np.float64) * clip[:, 3:] * 2 / SIZE  # by the position on screen
                found.append([(g * (screen - centre)).sum(), *g.sum(0)])
                true.append(coverage_derivative(screen, centre))
        found, true = np.array(found), np.array(true)
        edge = np.sqrt(4 * np.pi * RADIUS ** 2 / len(ball.faces) * 4 / np.sqrt(3))
        move = (found[:, 1:] * true[:, 1:]).sum(1) / np.linalg.norm(found[:, 1:], axis=1) / np.linalg.norm(true[:, 1:], axis=1)
        scale = found[:, 0] / true[:, 0]
        delta = softness.r if case["delta"] is None else case["delta"]
        rows.append(case | {"sigma": softness.width, "delta": delta, "edge_px": float(edge),
                            "scale_ratio": float(scale.mean()), "scale_spread": float(scale.std()),
                            "move_ratio": float(np.linalg.norm(found[:, 1:], axis=1).mean() / np.linalg.norm(true[:, 1:], axis=1).mean()),
                            "move_cosine": float(move.mean()), "move_worst": float(move.min())})
        print("coverage:", rows[-1], file=sys.stderr, flush=True)
    return rows


def tables(result):
    lines = []
    if result.get("fp32"):
        lines += ["| K | r | median error | worst error | worst component | least cosine | worst scene |", "|---|---|---|---|---|---|---|"]
        rows = [x for x in result["fp32"] if x["error"] is not None]
        for k, r in sorted({(x["K"], x["r"]) for x in rows}):
            own = [x for x in rows if (x["K"], x["r"]) == (k, r)]
            worst = max(own, key=lambda x: x["error"])
            lines.append(f"| {k} | {r:g} | {np.median([x['error'] for x in own]):.1e} | {worst['error']:.1e} | "
                         f"{max(x['worst'] for x in own):.1e} | {min(x['cosine'] for x in own):.9f} | {worst['scene']} {worst['of']} |")
        lines.append("")
    if result.get("coverage"):
        lines += ["| edge, px | r | K | sigma | delta | scale: ratio | spread | move: ratio | cosine | least cosine |",
                  "|---|---|---|---|---|---|---|---|---|---|"]
        for x in result["coverage"]:
            lines.append(f"| {x['edge_px']:.1f} | {x['r']:g} | {x['K']} | {x['sigma']:.2f} | {x['delta']:g} | {x['scale_ratio']:.3f} | "
                         f"{x['scale_spread']:.3f} | {x['move_ratio']:.3f} | {x['move_cosine']:.3f} | {x['move_worst']:.3f} |")
    return "\n".join(lines)


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--part", choices=("fp32", "coverage"), help="one part only; the other stays as it is in the file")
    parser.add_argument("--layers", type=int, nargs="+", default=[1, 3, 5])
    parser.add_argument("--radii", type=float, nargs="+", default=[1, 4, 16])
    parser.add_argument("--device", default="llvmpipe")
    parser.add_argument("--out", type=Path, default=ROOT / "benchmarks" / "results" / "gradient_error.json")
    options = parser.parse_args()
    result = json.loads(options.out.read_text()) if options.out.exists() else {}
    device = Device.open(options.device)
    result["device"] = {"name": device.name, "driver": device.driver_info, "numpy": np.__version__, "python": platform.python_version()}
    with tempfile.TemporaryDirectory() as folder:
        bundles = Bundles(device, folder)
        for part, run in (("coverage", lambda: part_coverage(bundles)),
                          ("fp32", lambda: part_fp32(bundles, options.layers, options.radii))):
            if options.part in (None, part):
                result[part] = run()
                options.out.write_text(json.dumps(result, indent=1) + "\n")
    device.close()
    print(tables(result))


if __name__ == "__main__":
    main()
