"""What sparse matrices and rotations of SciPy say of our linear parts: gather_sum, texture sampling, Laplacians, vertex normals, clip
coordinates, and the transposes of all. Part "algebra" of peers.py; `row` is how both count errors.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator

import numpy as np
from error_vs_time import Run
from scipy.sparse import coo_array, csr_array, diags_array
from scipy.spatial.transform import Rotation
from step import rounded

from dressi_edge.cache.layout import Layout
from dressi_edge.compiler.graph.autodiff import gradients
from dressi_edge.compiler.graph.functions import constant_table, dot, gather_sum, lookup, total
from dressi_edge.compiler.graph.program import Program
from dressi_edge.compiler.io.cameras import orbit
from dressi_edge.compiler.io.shapes import icosphere
from dressi_edge.compiler.render.camera import fixed_views, posed_views, to_clip
from dressi_edge.compiler.render.loss import COTANGENTS, cotangent_laplacian, uniform_laplacian
from dressi_edge.compiler.render.normals import incidence, vertex_normals
from dressi_edge.compiler.render.texture import sample_texture
from dressi_edge.compiler.render.topology import Topology


def row(part: str, case: str, peer: str, error: np.ndarray, scale: float, start: float, **more) -> dict:
    """error: of each number compared; scale: what a relative one is relative to."""
    error = np.abs(np.asarray(error, np.float64)).ravel() / scale
    return {"case": f"{case}, {peer}", "part": part, "peer": peer, "count": error.size, "median": rounded(float(np.median(error))),
            "worst": rounded(float(error.max())), "ms": rounded((time.perf_counter() - start) * 1e3), **more}


def relative(part: str, case: str, peer: str, ours: np.ndarray, theirs: np.ndarray, start: float) -> dict:
    """Errors relative to the largest value."""
    return row(part, case, peer, np.asarray(ours, np.float64) - theirs, float(np.abs(theirs).max()), start)


def evaluated(run: Run, inputs: dict[str, tuple[Layout, np.ndarray]], build: Callable) -> dict[str, np.ndarray]:
    """What `build(nodes)`, name -> (node, layout), is on the device."""
    program = Program()
    nodes = {name: program.input(name, layout, array) for name, (layout, array) in inputs.items()}
    outputs = build(nodes)
    program.plan("algebra", {}, outputs)
    with run.open(program) as session:
        return {name: session.get(name).astype(np.float64) for name in outputs}


def table_of(array: np.ndarray) -> Layout:
    return Layout("table", {1: "float", 2: "vec2", 3: "vec3", 4: "vec4"}[array.shape[1]], count=len(array))


def algebra_gathers(run: Run, rng) -> Iterator[dict]:
    values, index = rng.normal(size=(500, 3)), np.concatenate([rng.integers(0, 500, 3000), np.full(200, 7)])
    by, back = rng.normal(size=(3200, 3)), rng.normal(size=(500, 3))
    rows, columns = incidence(index, 500)

    def build(x):
        seen = lookup(x["values"], index)
        summed = gather_sum(x["by"], rows, columns)
        g, = gradients(total(dot(seen, x["by"])), [x["values"]])
        h, = gradients(total(dot(summed, x["back"])), [x["by"]])
        many, few = table_of(by), table_of(values)
        return {"seen": (seen, many), "seen_t": (g, few), "sum": (summed, few), "sum_t": (h, many)}

    found = evaluated(run, {"values": (table_of(values), values), "by": (table_of(by), by), "back": (table_of(back), back)}, build)
    start = time.perf_counter()
    take = csr_array((np.ones(3200), index, np.arange(3201)), (3200, 500))
    for case, ours, theirs in (("lookup", "seen", take @ values), ("transpose of lookup", "seen_t", take.T @ by),
                               ("gather_sum", "sum", take.T @ by), ("transpose of gather_sum", "sum_t", take @ back)):
        yield relative("algebra", case, "scipy", found[ours], theirs, start)


def bilinear(uv: np.ndarray, width: int, height: int, wrap: str) -> csr_array:
    """(pixels, texels): a row has the four weights of a sample."""
    place = uv * (width, height) - 0.5
    low = np.floor(place)
    f, rows, columns, weights = place - low, [], [], []
    for dx in (0, 1):
        for dy in (0, 1):
            x, y = (low + (dx, dy)).astype(int).T
            x, y = (x % width, y % height) if wrap == "repeat" else (x.clip(0, width - 1), y.clip(0, height - 1))
            rows.append(np.arange(len(uv)))
            columns.append(y * width + x)
            weights.append(np.where(dx, f[:, 0], 1 - f[:, 0]) * np.where(dy, f[:, 1], 1 - f[:, 1]))
    return coo_array((np.concatenate(weights), (np.concatenate(rows), np.concatenate(columns))), (len(uv), width * height)).tocsr()


def algebra_textures(run: Run, rng) -> Iterator[dict]:
    width, height, w, h = 24, 17, 40, 32
    ys, xs = np.mgrid[:h, :w]
    uv = np.stack([xs / w * 1.7 - 0.2 + 0.1 * np.sin(ys), ys / h * 1.5 - 0.3], -1).astype(np.float32).astype(np.float64)
    texture, by = rng.uniform(size=(height, width, 3)), rng.normal(size=(h, w, 3))
    kinds = {"texture": (Layout("image", "vec3", width, height), texture), "uv": (Layout("image", "vec2", w, h), uv),
             "by": (Layout("image", "vec3", w, h), by)}
    for wrap in ("repeat", "clamp"):
        def build(x, wrap=wrap):
            seen = sample_texture(x["texture"], x["uv"], wrap)
            g, = gradients(total(dot(seen, x["by"])), [x["texture"]])
            return {"seen": (seen, kinds["by"][0]), "seen_t": (g, kinds["texture"][0])}
        found = evaluated(run, kinds, build)
        start = time.perf_counter()
        matrix = bilinear(uv.reshape(-1, 2), width, height, wrap)
        yield relative("algebra", f"texture, {wrap}", "scipy", found["seen"].reshape(-1, 3), matrix @ texture.reshape(-1, 3), start)
        yield relative("algebra", f"transpose of texture, {wrap}", "scipy", found["seen_t"].reshape(-1, 3), matrix.T @ by.reshape(-1, 3),
                       start)


def cotangents(p: np.ndarray, faces: np.ndarray) -> coo_array:
    """Symmetric weights: of an edge the sum of the cotangents opposite, limited as ours are."""
    rows, columns, weights = [], [], []
    for k in range(3):
        i, j, o = faces[:, (k + 1) % 3], faces[:, (k + 2) % 3], faces[:, k]
        a, b = p[i] - p[o], p[j] - p[o]
        cot = np.clip((a * b).sum(1) / np.linalg.norm(np.cross(a, b), axis=1), *COTANGENTS)
        rows += [i, j]
        columns += [j, i]
        weights += [cot, cot]
    return coo_array((np.concatenate(weights), (np.concatenate(rows), np.concatenate(columns))), (len(p), len(p)))


def area_normals(positions: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Vertex normals weighted by area: a sparse sum over the faces around each vertex."""
    around = coo_array((np.ones(faces.size), (faces.ravel(), np.repeat(np.arange(len(faces)), 3))), (len(positions), len(faces)))
    a, b, c = (positions[faces[:, k]] for k in range(3))
    n = around.tocsr() @ np.cross(b - a, c - a)
    return n / np.linalg.norm(n, axis=1)[:, None]


def algebra_meshes(run: Run, rng) -> Iterator[dict]:
    mesh = run.mesh("spot/spot.obj")[1] if not run.options.quick else icosphere(2)
    p, topology = mesh.positions + 0.01 * rng.normal(size=mesh.positions.shape), Topology(mesh.faces, len(mesh.positions))
    p, unit = p.astype(np.float32).astype(np.float64), Layout("unit", "float")
    kinds = {"uniform": uniform_laplacian, "cotangent": cotangent_laplacian}

    def build(x):
        out = {"normals": (vertex_normals(x["p"], topology), table_of(p))}
        for name, laplacian in kinds.items():
            for power in (1, 2):
                loss = laplacian(x["p"], topology, power)
                out |= {f"{name}{power}": (loss, unit), f"{name}{power}_g": (gradients(loss, [x["p"]])[0], table_of(p))}
        return out

    found = evaluated(run, {"p": (table_of(p), p)}, build)
    start, n = time.perf_counter(), len(p)
    e = topology.edges
    adjacency = coo_array((np.ones(2 * len(e)), (np.r_[e[:, 0], e[:, 1]], np.r_[e[:, 1], e[:, 0]])), (n, n))
    for name, near in (("uniform", adjacency.tocsr()), ("cotangent", cotangents(p, mesh.faces).tocsr())):
        matrix = diags_array(np.ones(n)) - diags_array(1 / near.sum(1)) @ near
        d = matrix @ p
        length = np.linalg.norm(d, axis=1)
        for power, value, slope in ((1, length.mean(), matrix.T @ (d / length[:, None]) / n),
                                    (2, (length ** 2).mean(), 2 * matrix.T @ d / n)):
            kind = f"{name} Laplacian, {'lengths' if power == 1 else 'squares'}"
            yield relative("algebra", kind, "scipy", found[f"{name}{power}"], value, start)
            yield relative("algebra", f"{kind}: gradient", "scipy", found[f"{name}{power}_g"], slope, start)
    yield relative("algebra", "vertex normals", "scipy", found["normals"], area_normals(p, mesh.faces), start)


def algebra_cameras(run: Run, rng) -> Iterator[dict]:
    """Clip coordinates of turned views; the gradient by positions is the transpose of the same matrix."""
    cameras = orbit(3, (20.0, -20.0), 2.5, 50.0, (48, 40))
    points, turn, move = rng.normal(size=(60, 3)), rng.normal(size=(3, 3)), 0.1 * rng.normal(size=(3, 3))
    turn[0] *= 1e-3
    by = rng.normal(size=(180, 4))

    def build(x):
        clip = to_clip(x["points"], posed_views(fixed_views(cameras), x["turn"], x["move"]))
        g, = gradients(total(dot(clip, constant_table(by))), [x["points"]])
        return {"clip": (clip, table_of(by)), "clip_t": (g, table_of(points))}

    found = evaluated(run, {"points": (table_of(points), points), "turn": (table_of(turn), turn), "move": (table_of(move), move)}, build)
    start, clips, back = time.perf_counter(), [], 0.0
    for k, camera in enumerate(cameras):
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = Rotation.from_rotvec(turn[k]).as_matrix(), move[k]
        matrix = camera.projection_rows() @ pose @ camera.world_to_camera
        clips.append(np.c_[points, np.ones(60)] @ matrix.T)
        back = back + (by.reshape(3, 60, 4)[k] @ matrix)[:, :3]
    yield relative("algebra", "clip coordinates of turned views", "scipy", found["clip"], np.concatenate(clips), start)
    yield relative("algebra", "their transpose by points", "scipy", found["clip_t"], back, start)


def part_algebra(run: Run) -> Iterator[dict]:
    for k, part in enumerate((algebra_gathers, algebra_textures, algebra_meshes, algebra_cameras)):
        yield from part(run, np.random.default_rng(k))
