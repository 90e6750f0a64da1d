"""Ours against programs that others wrote: who covers a pixel, what is interpolated there, how it is shaded, how covered area
changes, and what sparse matrices say of sums and their transposes.

    pip install '.[compiler,bench,peers]'
    python benchmarks/peers.py [--quick] [--part PART ...] [--data DIR] [--device NAME] [--json FILE]

rays      rays through pixel centres: which pixels are hit, which face, attributes, depth and texture coordinates there; covered area
          by 16 x 16 rays a pixel. Peers: Embree, Mitsuba 3 (which casts by Embree too), and always a float64 caster here, each ray
          against all triangles by solving for the hit (Moeller and Trumbore 1997), which shares nothing with edge functions
shading   Spot or the pear with a pattern as its texture under three lights, as Mitsuba's diffuse surface without visibility tests; sRGB
gradient  of the weighted silhouette by vertex positions, along 24 smooth displacement fields: ours, Mitsuba's projective sampling of
          boundaries (Zhang et al. 2023), and the derivative of exactly covered area. Without Mitsuba ours and the latter
pbr       metallic-roughness under a panorama and a lamp: peers_pbr.py
algebra   SciPy: gather_sum, texture sampling, Laplacians, vertex normals and their transposes as sparse matrices; rotation vectors

Everything of ours is fp32 on the device. A peer that is not installed is named and left out. Of the pixels that show another face than
the peer hits, those whose centre is within 1/256 of a pixel of an edge (to which rasterizers round vertices) are counted apart. Errors are
absolute for attributes, depth and colours (0 to 1 or so, in the unit ball), relative to the largest value elsewhere. ms: what the peer
took; this is no race.
"""

from __future__ import annotations

import argparse
import importlib.metadata
import importlib.util
import math
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
from error_vs_time import Run, markdown
from gradient_error import covered, weight
from peers_algebra import area_normals, part_algebra, row
from peers_pbr import part_pbr
from peers_pbr import table as pbr_table
from step import HARD, options_of, rounded, write
from texture import pattern

from dressi_edge.cache.layout import Layout
from dressi_edge.compiler.graph.autodiff import gradients
from dressi_edge.compiler.graph.functions import total
from dressi_edge.compiler.graph.program import Program
from dressi_edge.compiler.io.cameras import Camera, orbit
from dressi_edge.compiler.io.images import linear_to_srgb
from dressi_edge.compiler.io.meshes import Mesh
from dressi_edge.compiler.render.atlas import Atlas
from dressi_edge.compiler.render.camera import fixed_views, to_clip
from dressi_edge.compiler.render.light import Light
from dressi_edge.compiler.render.raster import Softness, rasterized
from dressi_edge.compiler.render.topology import Topology
from dressi_edge.compiler.scene.problem import Problem

PARTS = ("rays", "shading", "pbr", "gradient", "algebra")
EDGE = 1 / 256  # pixels
INSTALLED = {name: importlib.util.find_spec(module) is not None for name, module in (("embree", "embreex"), ("mitsuba", "mitsuba"))}
LIGHTS = (Light("directional", (2.0, 1.5, 1.0), (-0.4, -1.0, -0.3)), Light("point", (3.0, 4.0, 5.0), (1.0, 1.5, 2.0)),
          Light("ambient", (0.2, 0.3, 0.25)))


def mitsuba():
    import mitsuba as mi
    if mi.variant() is None:
        mi.set_variant("llvm_ad_rgb")
        mi.set_log_level(mi.LogLevel.Error)
    return mi


# ---- rays: (origins, directions, corners (F, 3, 3)) -> hit face or -1, barycentrics of corners 1 and 2, multiples of the direction

def cast_here(origins, directions, corners):
    a, ab, ac = corners[:, 0], corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    face, uv, depth = np.full(len(origins), -1), np.zeros((len(origins), 2)), np.full(len(origins), np.inf)
    chunk = max(1, 2_000_000 // len(corners))
    for k in range(0, len(origins), chunk):
        o, d = origins[k:k + chunk, None], directions[k:k + chunk, None]
        across = np.cross(d, ac)
        size = (across * ab).sum(-1)
        inverse, away = 1 / np.where(size == 0, np.inf, size), o - a
        u, turned = (away * across).sum(-1) * inverse, np.cross(away, ab)
        v, t = (d * turned).sum(-1) * inverse, (ac * turned).sum(-1) * inverse
        t = np.where((u >= 0) & (v >= 0) & (u + v <= 1) & (t > 0) & (size != 0), t, np.inf)
        best = t.argmin(1)
        at = np.arange(len(best)), best
        hit = np.isfinite(t[at])
        face[k:k + chunk], depth[k:k + chunk] = np.where(hit, best, -1), t[at]
        uv[k:k + chunk] = np.where(hit[:, None], np.stack([u[at], v[at]], 1), 0)
    return face, uv, depth


def cast_embree(origins, directions, corners):
    from embreex.mesh_construction import TriangleMesh
    from embreex.rtcore_scene import EmbreeScene
    scene = EmbreeScene()
    TriangleMesh(scene, corners.astype(np.float32))
    found = scene.run(origins.astype(np.float32), directions.astype(np.float32), output=1)
    return found["primID"], np.stack([found["u"], found["v"]], 1).astype(np.float64), found["tfar"].astype(np.float64)


def mitsuba_mesh(corners, normals=None, uvs=None, **properties):
    """Corners (F, 3, 3), each a vertex of its own, with normals and texture coordinates of the same order."""
    mi, settings = mitsuba(), mitsuba().Properties()
    for name, value in properties.items():
        settings[name] = value
    mesh = mi.Mesh("mesh", 3 * len(corners), len(corners), settings, normals is not None, uvs is not None)
    values = mi.traverse(mesh)
    values["vertex_positions"], values["faces"] = np.ravel(corners).astype(np.float32), np.arange(3 * len(corners), dtype=np.uint32)
    values.update()  # which makes normals of its own where there are to be some
    for name, value in (("vertex_normals", normals), ("vertex_texcoords", uvs)):
        if value is not None:
            values[name] = np.ravel(value).astype(np.float32)
    values.update()
    return mesh


def mitsuba_rays(origins, directions):
    mi = mitsuba()
    return mi.Ray3f(mi.Point3f(*origins.T.astype(np.float32)), mi.Vector3f(*directions.T.astype(np.float32)))


def cast_mitsuba(origins, directions, corners):
    scene = mitsuba().load_dict({"type": "scene", "mesh": mitsuba_mesh(corners)})
    found = scene.ray_intersect_preliminary(mitsuba_rays(origins, directions))
    hit = np.array(found.is_valid())
    uv = np.array(found.prim_uv).astype(np.float64).T
    return np.where(hit, np.array(found.prim_index).astype(np.int64), -1), uv, np.array(found.t).astype(np.float64)


CASTERS = {"float64": cast_here, "embree": cast_embree, "mitsuba": cast_mitsuba}


def casters() -> dict[str, Callable]:
    return {name: cast for name, cast in CASTERS.items() if INSTALLED.get(name, True)}


def pixel_rays(camera: Camera, across: int = 1) -> tuple[np.ndarray, np.ndarray]:
    """Through across x across points of each pixel, row by row; a direction's length is 1 along the axis of view."""
    ys, xs = (np.mgrid[:camera.height * across, :camera.width * across] + 0.5) / across
    local = np.stack([(xs - camera.cx) / camera.fx, (camera.cy - ys) / camera.fy, -np.ones_like(xs)], -1).reshape(-1, 3)
    return np.tile(camera.position, (len(local), 1)), local @ camera.camera_to_world[:3, :3].T


def on_screen(positions: np.ndarray, camera: Camera) -> np.ndarray:
    clip = np.c_[positions, np.ones(len(positions))] @ camera.clip_rows().T
    return (clip[:, :2] / clip[:, 3:] + 1) / 2 * (camera.width, camera.height)


def edge_distance(camera: Camera, positions: np.ndarray, edges: np.ndarray, pixels: np.ndarray) -> np.ndarray:
    """Of flat pixel numbers (n,): pixels from the centre to the nearest edge of the mesh."""
    screen = on_screen(positions, camera)
    a, b = screen[edges[:, 0]], screen[edges[:, 1]]
    d, out = b - a, np.full(len(pixels), np.inf)
    for k, pixel in enumerate(pixels):
        o = np.array([pixel % camera.width, pixel // camera.width]) + 0.5 - a
        t = np.clip((o * d).sum(1) / np.maximum((d * d).sum(1), 1e-300), 0, 1)
        out[k] = np.linalg.norm(o - t[:, None] * d, axis=1).min()
    return out


def probe(mesh: Mesh, camera: Camera, softness: Softness, attributes: np.ndarray) -> Program:
    """Outputs over one view's pixels: face, and at its point position, attributes and texture coordinates."""
    program, table = Program(), Layout("table", "vec3", count=len(mesh.positions))
    positions, values = (program.input(name, table, array) for name, array in (("positions", mesh.positions), ("values", attributes)))
    view = fixed_views([camera])
    shape = rasterized(to_clip(positions, view), Topology(mesh.faces, len(mesh.positions)), Atlas(camera.width, camera.height, 1, 1),
                       softness, view.near)
    layer = shape.layers[0]
    weights = shape.barycentrics(layer)
    outputs = {"face": layer.face, "hard": layer.hard, "position": shape.interpolate(layer, positions, weights),
               "attributes": shape.interpolate(layer, values, weights),
               "uv": shape.interpolate_constant(layer, mesh.uvs[mesh.uv_faces], weights)}
    program.plan("probe", {}, {name: (node, Layout("image", node.vtype, camera.width, camera.height)) for name, node in outputs.items()})
    return program


def part_rays(run: Run) -> Iterator[dict]:
    quick = run.options.quick
    size, rng = 40 if quick else 128, np.random.default_rng(3)
    camera = orbit(6, (20.0, -20.0), 2.5, 50.0, (size, size))[1]
    for file in ("spot/spot.obj",) if quick else ("spot/spot.obj", "pear"):
        name, mesh = run.mesh(file)
        attributes = rng.uniform(size=(len(mesh.positions), 3))
        topology, corners = Topology(mesh.faces, len(mesh.positions)), mesh.positions[mesh.faces]
        ours = {}
        for distance, softness in (("outline", Softness(2.0)), ("face", HARD)):
            with run.open(probe(mesh, camera, softness, attributes)) as session:
                ours[distance] = {key: session.get(key).reshape(size * size, -1).astype(np.float64)
                                  for key in ("face", "hard", "position", "attributes", "uv")}
        rays = pixel_rays(camera)
        for peer, cast in casters().items():
            start = time.perf_counter()
            face, uv, depth = cast(*rays, corners)
            for distance, found in ours.items():
                mine = np.where(found["hard"][:, 0] > 0, found["face"][:, 0], -1).astype(int)
                differ = np.flatnonzero(mine != face)
                away = edge_distance(camera, mesh.positions, topology.edges, differ)
                yield {"case": f"{name} {size}x{size}: front face, {distance}, {peer}", "part": "rays", "peer": peer, "count": size * size,
                       "hit": int((face >= 0).sum()), "differ": int((away > EDGE).sum()), "at_edges": int((away <= EDGE).sum()),
                       "furthest": rounded(float(away.max(initial=0))), "ms": rounded((time.perf_counter() - start) * 1e3)}
            same = np.flatnonzero((mine == face) & (face >= 0))
            b = np.c_[1 - uv.sum(1), uv][same]
            theirs = {"attributes": np.einsum("ni,nia->na", b, attributes[mesh.faces[face[same]]]),
                      "uv": np.einsum("ni,nia->na", b, mesh.uvs[mesh.uv_faces[face[same]]])}
            local = found["position"][same] @ camera.world_to_camera[2, :3] + camera.world_to_camera[2, 3]
            yield row("rays", f"{name}: depth", peer, -local - depth[same], 1, start)
            for key, value in theirs.items():
                yield row("rays", f"{name}: {key}", peer, found[key][same] - value, 1, start)
        if INSTALLED["embree"]:
            start, samples = time.perf_counter(), 4 if quick else 16
            seen = (cast_embree(*pixel_rays(camera, samples), corners)[0] >= 0).reshape(size * samples, -1)
            ys, xs = (np.mgrid[:size * samples, :size * samples] + 0.5) / samples
            exact = covered(on_screen(mesh.positions, camera), topology, size)
            yield row("rays", f"{name}: covered area, {samples * samples} rays a pixel", "embree",
                      (seen * weight(xs, ys)).sum() / samples ** 2 - exact, exact, start)


# ---- shading

def part_shading(run: Run) -> Iterator[dict]:
    size = 40 if run.options.quick else 128
    name, mesh = run.mesh("spot/spot.obj")
    mesh = replace(mesh, texture=pattern(256))
    camera = orbit(6, (20.0, -20.0), 2.5, 50.0, (size, size))[1]
    drawn = {}
    for key, settings in (("texture", {}), ("lambert", {"shading": "lambert", "lights": LIGHTS}),
                          ("srgb", {"shading": "lambert", "lights": LIGHTS, "srgb": True})):
        stored = replace(mesh, texture=linear_to_srgb(mesh.texture)) if key == "srgb" else mesh  # which decodes it
        problem = Problem(stored, [camera], **settings)
        problem.render(softness=HARD)
        with run.open(problem) as session:
            drawn[key] = session.get("render.color").reshape(-1, 4).astype(np.float64)
    start = time.perf_counter()
    yield row("shading", f"{name}: sRGB", "float64", drawn["srgb"][:, :3] - linear_to_srgb(drawn["lambert"][:, :3].clip(0, 1)), 1, start)
    if not INSTALLED["mitsuba"]:
        return
    mi, normals = mitsuba(), area_normals(mesh.positions, mesh.faces)
    bitmap = {"type": "bitmap", "bitmap": mi.Bitmap(mesh.texture.astype(np.float32)), "raw": True, "format": "variant"}
    surface = mi.load_dict({"type": "diffuse", "reflectance": bitmap})
    shape = mitsuba_mesh(mesh.positions[mesh.faces], normals[mesh.faces], mesh.uvs[mesh.uv_faces], bsdf=surface)
    sun, lamp, sky = LIGHTS
    scene = mi.load_dict({
        "type": "scene", "mesh": shape,
        "sun": {"type": "directional", "direction": list(sun.vector), "irradiance": {"type": "rgb", "value": list(sun.power)}},
        "lamp": {"type": "point", "position": list(lamp.vector), "intensity": {"type": "rgb", "value": list(lamp.power)}}})
    start, context = time.perf_counter(), mi.BSDFContext()
    si = scene.ray_intersect(mitsuba_rays(*pixel_rays(camera)))
    albedo = np.array(surface.eval_diffuse_reflectance(si)).T.astype(np.float64)
    light = albedo * sky.power
    for emitter in scene.emitters():
        towards, power = emitter.sample_direction(si, mi.Point2f(0.5, 0.5))
        light += np.array(surface.eval(context, si, si.to_local(towards.d)) * power).T
    facing = np.array(si.is_valid()) & (drawn["lambert"][:, 3] > 0)
    yield row("shading", f"{name}: texture", "mitsuba", (drawn["texture"][:, :3] - albedo)[facing], 1, start)
    facing &= np.array(si.wi.z) > 0.01  # Mitsuba has no light where the smooth normal looks away
    yield row("shading", f"{name}: Lambert, three lights", "mitsuba", (drawn["lambert"][:, :3] - light)[facing], float(light[facing].max()),
              start)


def pbr(run: Run) -> Iterator[dict]:
    return part_pbr(run, mitsuba if INSTALLED["mitsuba"] else None, mitsuba_mesh, pixel_rays)


# ---- gradient

def silhouette_gradient(mesh: Mesh, camera: Camera) -> Program:
    program, table = Program(), Layout("table", "vec3", count=len(mesh.positions))
    positions = program.input("positions", table, mesh.positions)
    by = program.input("by_alpha", Layout("image", "float", camera.width, camera.height))
    view = fixed_views([camera])
    shape = rasterized(to_clip(positions, view), Topology(mesh.faces, len(mesh.positions)), Atlas(camera.width, camera.height, 1, 1),
                       Softness(2.0), view.near)
    g, = gradients(total(shape.silhouette() * by), [positions])
    program.plan("gradient", {}, {"by_positions": (g, table)})
    return program


def mitsuba_gradient(mesh: Mesh, camera: Camera, image: np.ndarray, samples: int, colors: np.ndarray | None = None) -> np.ndarray:
    """Of the image of a mesh that glows with radiance 1, times `image` (h, w), by vertex positions; with colours (V, 3) of vertices it
    glows in these, `image` is (h, w, 3), and what moves inside outlines is sampled, too."""
    import drjit as dr
    mi = mitsuba()
    settings = mi.Properties()
    radiance = {"type": "rgb", "value": 1.0} if colors is None else {"type": "mesh_attribute", "name": "vertex_color"}
    settings["emitter"] = mi.load_dict({"type": "area", "radiance": radiance})
    shape = mi.Mesh("mesh", len(mesh.positions), len(mesh.faces), settings)
    if colors is not None:
        shape.add_attribute("vertex_color", 3, np.ravel(colors).astype(np.float32))
    values = mi.traverse(shape)
    values["vertex_positions"], values["faces"] = np.ravel(mesh.positions).astype(np.float32), np.ravel(mesh.faces).astype(np.uint32)
    values.update()
    film = {"type": "hdrfilm", "width": camera.width, "height": camera.height, "rfilter": {"type": "box"},
            "pixel_format": "luminance" if colors is None else "rgb"}
    inside = 0 if colors is None else 64
    scene = mi.load_dict({
        "type": "scene", "mesh": shape, "integrator": {"type": "direct_projective", "sppc": inside, "sppp": samples, "sppi": 0},
        "sensor": {"type": "perspective", "fov": 2 * math.degrees(math.atan(camera.width / 2 / camera.fx)), "film": film,
                   "to_world": mi.ScalarTransform4f(camera.camera_to_world * (-1, 1, -1, 1))}})  # looks along +z, x to the left
    values = mi.traverse(scene)
    key = next(key for key in values.keys() if key.endswith("vertex_positions"))
    dr.enable_grad(values[key])
    values.update()
    dr.backward(dr.sum(mi.render(scene, values, spp=16).array * mi.Float(image.ravel().astype(np.float32))))
    return np.array(dr.grad(values[key]), np.float64).reshape(-1, 3)


def part_gradient(run: Run) -> Iterator[dict]:
    quick, rng, step = run.options.quick, np.random.default_rng(0), 0.002
    size = 40 if quick else 128
    camera = orbit(6, (20.0, -20.0), 2.5, 50.0, (size, size))[1]
    ys, xs = np.mgrid[:size, :size] + 0.5
    for file in ("spot/spot.obj",) if quick else ("spot/spot.obj", "pear"):
        name, mesh = run.mesh(file)
        p, topology = mesh.positions, Topology(mesh.faces, len(mesh.positions))
        waves = [np.sin(p @ rng.normal(size=3) * 4 + rng.uniform(0, 2 * np.pi))[:, None] * rng.normal(size=3) for _ in range(20)]
        moves = np.array([*(np.tile(axis, (len(p), 1)) for axis in np.eye(3)), p, *waves])
        start = time.perf_counter()
        true = np.array([covered(on_screen(p + step * f, camera), topology, size) - covered(on_screen(p - step * f, camera), topology, size)
                         for f in moves]) / (2 * step)
        with run.open(silhouette_gradient(mesh, camera)) as session:
            session.set("by_alpha", weight(xs, ys))
            ours = (moves * session.get("by_positions").astype(np.float64)).sum((1, 2))
        pairs = [("ours to exact area", "float64", ours, true, start)]
        if INSTALLED["mitsuba"]:
            start = time.perf_counter()
            theirs = (moves * mitsuba_gradient(mesh, camera, weight(xs, ys), 16 if quick else 256)).sum((1, 2))
            pairs += [("ours to Mitsuba's", "mitsuba", ours, theirs, start), ("Mitsuba's to exact area", "mitsuba", theirs, true, start)]
        for case, peer, v, t, start in pairs:
            yield row("gradient", f"{name} {size}x{size}: {case}", peer, v - t, float(np.abs(t).max()), start,
                      slope=rounded(v @ t / (t @ t)), cosine=float(f"{v @ t / np.linalg.norm(v) / np.linalg.norm(t):.6f}"))


def tables(results: list[dict]) -> str:
    out = []
    for part in PARTS:
        rows = [x for x in results if x["part"] == part]
        if part == "pbr" and rows:
            out.append(pbr_table(rows))
            continue
        more = [key for key in ("hit", "differ", "at_edges", "furthest", "slope", "cosine") if any(key in x for x in rows)]
        out.append(markdown([part, "numbers", "median error", "worst", *more], [
            [x["case"], f"{x['count']}", *(("", "") if "differ" in x else (f"{x['median']:.1e}", f"{x['worst']:.1e}")),
             *(f"{x.get(key, '')}" for key in more)] for x in rows]))
    return "\n".join(out)


def main(arguments: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--part", choices=PARTS, nargs="+", default=PARTS, help="default: all")
    options = options_of(parser, arguments)
    for name, there in INSTALLED.items():
        if not there:
            print(f"{name} is not installed and left out: pip install '.[peers]'")
    peers = {name: importlib.metadata.version(name) for name, there in (("scipy", True), ("embreex", INSTALLED["embree"]),
                                                                        ("mitsuba", INSTALLED["mitsuba"])) if there}
    parts = {"rays": part_rays, "shading": part_shading, "pbr": pbr, "gradient": part_gradient, "algebra": part_algebra}
    with tempfile.TemporaryDirectory(prefix="dressi-peers-") as folder:
        run = Run(Path(folder), options)
        results = [row for part in options.part for row in parts[part](run)]
    write(options.json, run.about, results, peers=peers)
    print(f"{run.about['device']}; {', '.join(f'{k} {v}' for k, v in peers.items())}\n\n{tables(results)}")


if __name__ == "__main__":
    main()
