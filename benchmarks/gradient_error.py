"""How exact gradients are: fp32 on the device against the float64 reference of the same graph, and HardSoftRas' silhouette gradient
against the derivative of true coverage.

    python benchmarks/gradient_error.py                # all parts, writes benchmarks/results/gradient_error.json, prints the tables
    python benchmarks/gradient_error.py --part coverage

Part fp32: the corpus of tests/corpus.py x distance and K x r, random weights on every pixel that is further than 1/64 of a pixel from
another discrete choice. Relative L2 error |g - g64| / |g64| and cosine, of the gradient by clip coordinates and by vertex colours.
Part half: the same with storage half.
Part coverage: geodesic spheres of radius 20 pixels at eight places within a pixel; the loss is the silhouette times a smooth image.
The true derivative by scale and by translation is the integral over the outline of the projected mesh, which is convex.
Part fields: closed meshes that hide parts of themselves (a ring, the pear, Spot where DIR/meshes/spot/spot.obj is, by default DIR is
`shared` next to the checkout), in two poses; the loss is the same. The derivative of covered area along each of 43 smooth displacement
fields (two translations, scale, 40 waves) is a central difference of 0.25 pixels over rows 1/32 of a pixel apart, exact along a row.
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
import brute_force_outline  # noqa: E402
from corpus import project, rotation, scenes  # noqa: E402
from test_hardsoftras import MARGIN, renderer, torus  # noqa: E402

from dressi_edge import runtime  # noqa: E402
from dressi_edge.compiler import compile_program  # noqa: E402
from dressi_edge.compiler.graph.reference import evaluate  # noqa: E402
from dressi_edge.compiler.io.meshes import load_mesh, normalize  # noqa: E402
from dressi_edge.compiler.io.shapes import pear, sphere  # noqa: E402
from dressi_edge.compiler.render.raster import Softness  # noqa: E402
from dressi_edge.compiler.render.topology import Topology  # noqa: E402
from dressi_edge.runtime.device import Device  # noqa: E402

GRADIENTS = ("by_clip", "by_attributes")


def fp32(array):
    return np.asarray(array, np.float32).astype(np.float64)


class Bundles:
    """Sessions by what they are compiled from; scenes of the same faces, size and near share one."""

    def __init__(self, device, folder):
        self.device, self.folder, self.count = device, folder, 0

    def open(self, program, storage="float"):
        self.count += 1
        path = Path(self.folder) / f"{self.count}.dressi"
        compile_program(program, "lavapipe", path, storage=storage)
        return runtime.load(path, self.device)


def part_fp32(bundles, layers, radii, storage="float"):
    groups, rows = {}, []
    for name, s in scenes().items():
        groups.setdefault((s.faces.tobytes(), len(s.clip), s.size, s.near), []).append(name)
    for how in [{"distance": "outline"}, *({"distance": "face", "layers": k} for k in layers)]:
        for r in radii:
            for names in groups.values():
                rows += _group(bundles, names, Softness(float(r), **how), storage)
            print(f"fp32: {how}, r = {r}", file=sys.stderr, flush=True)
    return rows


def _margins(s, softness):
    clip = fp32(s.clip)
    if softness.distance == "outline":
        return brute_force_outline.select(clip, s.faces, s.size, softness.r, near=s.near).margins
    return brute_force.select(clip, s.faces, s.size, softness.r, layers=softness.layers, near=s.near).margins


def _group(bundles, names, softness, storage):
    corpus, rows = scenes(), []
    first = corpus[names[0]]
    program = renderer(Topology(first.faces, len(first.clip)), first.size, softness, first.near)
    roots = {name: node for plan in program.plans for name, node in plan.outputs.items() if name in GRADIENTS}
    rng = np.random.default_rng(0)
    with bundles.open(program, storage) as session:
        for name in names:
            s = corpus[name]
            margins = _margins(s, softness)
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
                row = {"scene": name, "distance": softness.distance, "K": softness.layers, "r": softness.r, "of": key}
                if size < 1e-9:
                    rows.append(row | {"error": None, "absolute": float(np.abs(got).max())})
                    continue
                rows.append(row | {"smooth": float(sure.mean()), "error": float(np.linalg.norm(got - want) / size),
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


def crossings(screen, topology, size, step):
    """Where the rows `step` apart cross an edge between a face towards the camera and one away from it, by row, then by x: row, x,
    and +1 where one more layer begins, -1 where one ends. Closed meshes of one winding."""
    a, b, c = (screen[topology.faces[:, k]] for k in range(3))
    front = (b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0] > 0
    sides = topology.faces[front][:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
    keys, first, count = np.unique(np.sort(sides, 1), axis=0, return_index=True, return_counts=True)
    a, b = (screen[sides[first[count == 1], k]] for k in (0, 1))
    up = b[:, 1] < a[:, 1]  # rows grow downwards: a front face lies to the right of a side that goes up
    low, high = (np.clip(np.ceil(f(a[:, 1], b[:, 1]) / step - 0.5), 0, size / step).astype(int) for f in (np.minimum, np.maximum))
    edge = np.repeat(np.arange(len(a)), high - low)
    row = np.arange(len(edge)) - np.repeat(np.cumsum(high - low) - (high - low), high - low) + low[edge]
    y = (row + 0.5) * step
    x = a[edge, 0] + (y - a[edge, 1]) * ((b - a)[edge, 0] / (b - a)[edge, 1])
    order = np.lexsort((x, row))
    return row[order], x[order], np.where(up, 1, -1)[edge][order]


def covered(screen, topology, size, step=1 / 32):
    """The integral of `weight` over what the mesh covers on screen."""
    row, x, sign = crossings(screen, topology, size, step)
    y = (row + 0.5) * step
    primitive = x - 0.5 / 0.09 * np.cos(0.09 * x + 0.4) * np.cos(0.07 * y)
    inside = np.cumsum(sign)[:-1] > 0  # every row ends at 0
    return float(np.diff(primitive)[inside].sum() * step)


def softnesses(cases):
    return [(case, Softness(case["r"], sigma=case["sigma"], delta=case["delta"], layers=case["K"], distance=case["distance"]))
            for case in cases]


ESTIMATORS = ({"distance": "outline", "K": 1}, {"distance": "face", "K": 1}, {"distance": "face", "K": 3})


def placed(positions, size, focal, distance, centre):
    """Clip coordinates and pixels of positions seen from `distance`, their mean moved to `centre`."""
    clip = project(positions - (0, 0, distance), (size, size), focal=focal)
    screen = (clip[:, :2] / clip[:, 3:] + 1) * size / 2
    screen += centre - screen.mean(0)
    clip[:, :2] = (screen * 2 / size - 1) * clip[:, 3:]
    return clip, screen


class Estimate:
    """The silhouette's weighted sum and its gradient by positions on screen."""

    def __init__(self, session, vertices, size):
        self.session, self.size = session, size
        ys, xs = np.mgrid[:size, :size] + 0.5
        self.weight = weight(xs, ys)
        session.set("attributes", np.zeros((vertices, 3)))
        session.set("by_color", np.zeros((1, size, size, 3)))
        session.set("by_alpha", self.weight[None])

    def __call__(self, clip):
        self.session.set("clip", clip)
        g = self.session.get("by_clip")[:, :2].astype(np.float64) * clip[:, 3:] * 2 / self.size
        return float((self.session.get("alpha")[0] * self.weight).sum()), g


def part_coverage(bundles):
    base = {"vertices": 642, "r": 2.0, "K": 1, "sigma": None, "delta": None, "distance": "outline"}
    cases = [base | {"vertices": v} | e for v in (162, 642, 2562) for e in ESTIMATORS]
    cases += [base | {"r": r} | e for r in (1.0, 4.0, 8.0) for e in ESTIMATORS]
    cases += [base | {"sigma": x} | e for x in (0.1, 0.6, 1.0) for e in ESTIMATORS[:2]]
    cases += [base | ESTIMATORS[1] | {"delta": x} for x in (1.0, 4.0)]
    rows = []
    for case, softness in softnesses(cases):
        ball = sphere(case["vertices"])
        topology = Topology(ball.faces, len(ball.positions))
        found, true, area = [], [], []
        with bundles.open(renderer(topology, (SIZE, SIZE), softness, 0.1)) as session:
            estimate = Estimate(session, topology.vertex_count, SIZE)
            for shift in np.random.default_rng(1).uniform(-0.5, 0.5, (8, 2)):
                centre = SIZE / 2 + shift
                clip, screen = placed(ball.positions, SIZE, RADIUS * DISTANCE / SIZE, DISTANCE, centre)
                value, g = estimate(clip)
                found.append([(g * (screen - centre)).sum(), *g.sum(0)])
                true.append(coverage_derivative(screen, centre))
                area.append(value / covered(screen, topology, SIZE))
        found, true = np.array(found), np.array(true)
        edge = np.sqrt(4 * np.pi * RADIUS ** 2 / len(ball.faces) * 4 / np.sqrt(3))
        move = (found[:, 1:] * true[:, 1:]).sum(1) / np.linalg.norm(found[:, 1:], axis=1) / np.linalg.norm(true[:, 1:], axis=1)
        scale = found[:, 0] / true[:, 0]
        delta = None if softness.distance == "outline" else softness.r if case["delta"] is None else case["delta"]
        rows.append(case | {"sigma": softness.width, "delta": delta, "edge_px": float(edge), "area_ratio": float(np.mean(area)),
                            "scale_ratio": float(scale.mean()), "scale_spread": float(scale.std()),
                            "move_ratio": float(np.linalg.norm(found[:, 1:], axis=1).mean() / np.linalg.norm(true[:, 1:], axis=1).mean()),
                            "move_cosine": float(move.mean()), "move_worst": float(move.min())})
        print("coverage:", rows[-1], file=sys.stderr, flush=True)
    return rows


def solids(folder):
    """name: (positions, faces), in the unit ball."""
    found = {"ring": torus(64, 28), "pear": (pear(8).positions, pear(8).faces)}
    path = folder / "meshes" / "spot" / "spot.obj"
    if path.exists():
        spot = normalize(load_mesh(path))
        found["spot"] = spot.positions, spot.faces
    else:
        print(f"fields: no {path}, so without Spot", file=sys.stderr)
    return found


def fields(positions, screen, count=40):
    """(2 + 1 + count, V, 2): translations, scale and waves, the longest step a pixel."""
    rng = np.random.default_rng(0)
    out = [np.tile(axis, (len(screen), 1)) for axis in np.eye(2)] + [screen - screen.mean(0)]
    for k in range(count):
        wave = np.sin(positions @ rng.normal(size=3) * 4 + rng.uniform(0, 2 * np.pi))
        out.append(wave[:, None] * (np.cos(k), np.sin(k)))
    return np.array([f / np.abs(f).max() for f in out])


def part_fields(bundles, folder):
    base = {"size": 128, "r": 2.0, "K": 1, "sigma": None, "delta": None, "distance": "outline"}
    sizes = [base | {"size": x} | e for x in (64, 128, 256) for e in ESTIMATORS]
    settings = [base | {"r": r} | e for r in (1.0, 4.0, 8.0) for e in ESTIMATORS[::2]] + [base | {"sigma": x} for x in (0.1, 0.6, 1.0)]
    rows, step = [], 0.25
    for name, (positions, faces) in solids(folder).items():
        topology, views = Topology(faces, len(positions)), {}
        for size in (64, 128, 256):
            for pose in (5, 12):
                turned = positions @ rotation(pose).T
                clip, screen = placed(turned, size, 1.2, 3.4, np.full(2, size / 2))
                moves = fields(turned, screen)
                ends = [[covered(screen + x * f, topology, size) for x in (step, -step)] for f in moves]
                views.setdefault(size, []).append((clip, moves, np.array(ends) @ (1, -1) / (2 * step), covered(screen, topology, size)))
        for case, softness in softnesses(sizes + settings if name == "ring" else sizes):
            found, area = [], []
            with bundles.open(renderer(topology, (case["size"],) * 2, softness, 0.1)) as session:
                estimate = Estimate(session, topology.vertex_count, case["size"])
                for clip, moves, _, whole in views[case["size"]]:
                    value, g = estimate(clip)
                    found.append((moves * g).sum((1, 2)))
                    area.append(value / whole)
            true = np.array([v[2] for v in views[case["size"]]])
            v, t = np.ravel(found), true.ravel()
            rows.append({"mesh": name} | case | {
                "sigma": softness.width, "area_ratio": float(np.mean(area)), "slope": float(v @ t / (t @ t)),
                "cosine": float(v @ t / np.linalg.norm(v) / np.linalg.norm(t)),
                "scale_ratio": float(np.mean(np.array(found)[:, 2] / true[:, 2]))})
            print("fields:", rows[-1], file=sys.stderr, flush=True)
    return rows


def table(columns, rows):
    return [f"| {' | '.join(columns)} |", "|" + "---|" * len(columns), *(f"| {' | '.join(row)} |" for row in rows), ""]


def tables(result):
    lines = []
    for part in ("fp32", "half"):
        rows, cells = [x for x in result.get(part, ()) if x["error"] is not None], []
        for kind in sorted({(x["distance"], x["K"], x["r"]) for x in rows}, key=lambda k: (k[0] != "outline", *k[1:])):
            own = [x for x in rows if (x["distance"], x["K"], x["r"]) == kind]
            worst = max(own, key=lambda x: x["error"])
            cells.append([kind[0], f"{kind[1]}", f"{kind[2]:g}", f"{np.median([x['error'] for x in own]):.1e}", f"{worst['error']:.1e}",
                          f"{max(x['worst'] for x in own):.1e}", f"{min(x['cosine'] for x in own):.9f}",
                          f"{worst['scene']} {worst['of']}"])
        if cells:
            columns = ["distance", "K", "r", "median error", "worst error", "worst component", "least cosine", "worst scene"]
            lines += [f"{part}:", "", *table(columns, cells)]
    if result.get("coverage"):
        lines += table(["edge, px", "distance", "K", "r", "sigma", "delta", "area", "scale: ratio", "spread", "move: ratio", "cosine",
                        "least cosine"],
                       [[f"{x['edge_px']:.1f}", *_setting(x), "" if x["delta"] is None else f"{x['delta']:g}", f"{x['area_ratio']:.3f}",
                         f"{x['scale_ratio']:.3f}", f"{x['scale_spread']:.3f}", f"{x['move_ratio']:.3f}", f"{x['move_cosine']:.3f}",
                         f"{x['move_worst']:.3f}"] for x in result["coverage"]])
    if result.get("fields"):
        lines += table(["mesh", "size", "distance", "K", "r", "sigma", "area", "slope", "cosine", "scale: ratio"],
                       [[x["mesh"], f"{x['size']}", *_setting(x), f"{x['area_ratio']:.3f}", f"{x['slope']:.3f}", f"{x['cosine']:.4f}",
                         f"{x['scale_ratio']:.3f}"] for x in result["fields"]])
    return "\n".join(lines)


def _setting(x):
    return [x["distance"], f"{x['K']}", f"{x['r']:g}", f"{x['sigma']:.2f}"]


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--part", choices=("fp32", "half", "coverage", "fields"),
                        help="one part only; the others stay as they are in the file")
    parser.add_argument("--layers", type=int, nargs="+", default=[1, 3, 5])
    parser.add_argument("--radii", type=float, nargs="+", default=[1, 4, 16])
    parser.add_argument("--data", type=Path, default=ROOT.parent / "shared", help="where Spot is")
    parser.add_argument("--device", default="llvmpipe")
    parser.add_argument("--out", type=Path, default=ROOT / "benchmarks" / "results" / "gradient_error.json")
    options = parser.parse_args()
    result = json.loads(options.out.read_text()) if options.out.exists() else {}
    device = Device.open(options.device)
    result["device"] = {"name": device.name, "driver": device.driver_info, "numpy": np.__version__, "python": platform.python_version()}
    with tempfile.TemporaryDirectory() as folder:
        bundles = Bundles(device, folder)
        for part, run in (("coverage", lambda: part_coverage(bundles)), ("fields", lambda: part_fields(bundles, options.data)),
                          ("fp32", lambda: part_fp32(bundles, options.layers, options.radii)),
                          ("half", lambda: part_fp32(bundles, options.layers, options.radii, "half"))):
            if options.part in (None, part):
                result[part] = run()
                options.out.write_text(json.dumps(result, indent=1) + "\n")
    device.close()
    print(tables(result))


if __name__ == "__main__":
    main()
