"""Every face near a pixel: pictures and gradients are those of the published formulas, whatever the lists do."""
import dataclasses

import brute_force_binned
import numpy as np
import pytest
from brute_force import central_differences, screen
from corpus import project, scenes
from graphs import python

from dressi_edge import runtime
from dressi_edge.cache.errors import InputError
from dressi_edge.cache.layout import Layout
from dressi_edge.compiler import Program
from dressi_edge.compiler.graph.autodiff import gradients
from dressi_edge.compiler.graph.functions import apply, compose, dot, lookup, total
from dressi_edge.compiler.graph.ir import table
from dressi_edge.compiler.graph.ops import soft, soft_parts, tile_lists
from dressi_edge.compiler.graph.ops.bins import Grid
from dressi_edge.compiler.graph.ops.tile_lists import bin_faces
from dressi_edge.compiler.graph.reference import evaluate
from dressi_edge.compiler.graph.reference_session import ReferenceSession
from dressi_edge.compiler.render.atlas import Atlas
from dressi_edge.compiler.render.optimizer import Sgd
from dressi_edge.compiler.render.topology import Topology
from dressi_edge.compiler.scene import (
    Adam,
    Binned,
    Lambert,
    Light,
    Mesh,
    Scene,
    Unlit,
    Vertex,
    icosphere,
    l2,
    look_along,
    look_at,
    orbit,
    pear,
)
from dressi_edge.compiler.scene.layouts import pictures_layout

pytest_plugins = ["gpu"]
# One size and one near plane: clip coordinates times any number above 0 are the same picture.
SCENES = {name: s._replace(size=(24, 24), near=0.1, clip=(s.clip * 0.1 / s.near).astype(np.float32).astype(float),
                           attributes=s.attributes.astype(np.float32).astype(float)) for name, s in scenes().items()}
RANGE = (0.5, 8.0)
BACK = (0.1, 0.25, 0.6)
PLAIN = Binned(2.5, 0.4, 0.02, depth=RANGE)
KINDS = {"plain": PLAIN, "squared": Binned(2.5, 0.8, 0.02, depth=RANGE, squared=True), "over": dataclasses.replace(PLAIN, over=True),
         "hard": dataclasses.replace(PLAIN, hard=True)}


def settings(kind: Binned) -> dict:
    return {"r": kind.r, "sigma": kind.width, "gamma": kind.gamma, "depth": kind.depth, "squared": kind.squared, "over": kind.over,
            "hard": kind.hard}


def drawn(program, scenes_, kind, weights=None):
    """Pictures of scenes, each a view of all their faces with those of the others behind the eye: {what: (node, layout)}; with weights of
    pixels also gradients by clip coordinates and colours."""
    (width, height), near, views = scenes_[0].size, scenes_[0].near, len(scenes_)
    first = [int(k) for k in np.cumsum([0, *(len(s.clip) for s in scenes_)])]
    topology = Topology(np.concatenate([s.faces + k for s, k in zip(scenes_, first)]), first[-1])
    every = np.tile(np.array([0.0, 0.0, -1.0, -1.0]), (views, first[-1], 1))
    for k, s in enumerate(scenes_):
        every[k, first[k]:first[k + 1]] = s.clip
    clip = program.input("clip", Layout("table", "vec4", count=views * first[-1]), every.reshape(-1, 4))
    colors = program.input("colors", Layout("table", "vec3", count=first[-1]), np.concatenate([s.attributes for s in scenes_]))
    atlas = Atlas.of(width, height, views)
    fragments = kind.draw(clip, topology, atlas, near, True)
    corner = [lookup(colors, np.tile(topology.sorted_faces[:, k], views)) for k in range(3)]
    color = fragments.color(corner, compose(*BACK))
    alpha = kind.draw(clip, topology, atlas, near, False).silhouette()
    three, one = (pictures_layout(atlas, kind) for kind in ("vec3", "float"))
    out = {"color": (color, three), "alpha": (alpha, one), "both": (fragments.silhouette(), one)}
    if weights is not None:
        wc, wa = (program.input(name, layout, w) for name, layout, w in zip(("wc", "wa"), (three, one), weights))
        loss = total(dot(color, wc)) + total(fragments.silhouette() * wa)
        by_clip, by_color = gradients(loss, [clip, colors])
        out |= {"by_clip": (by_clip, program.values["clip"].layout), "by_color": (by_color, program.values["colors"].layout),
                "by_alpha": (gradients(total(alpha * wa), [clip])[0], program.values["clip"].layout)}
    return out


def by_reference(program, out):
    """The outputs in float64."""
    feed = {n: v.layout.to_image(v.initial, n) for n, v in program.values.items() if v.initial is not None}
    return {name: layout.from_image(x) for (name, (_, layout)), x in zip(out.items(), evaluate([node for node, _ in out.values()], feed))}


def loss_weights(scene, kind, seed):
    """Weights of pixels, none where a jump is near."""
    sure = brute_force_binned.render(scene.clip, scene.faces, scene.size, scene.near, **settings(kind)).margin > 2e-3
    rng = np.random.default_rng(seed)
    w, h = scene.size
    found = [(rng.normal(size=(h, w, c)) * sure[..., None]).astype(np.float32).astype(float) for c in (3, 1)]
    return [found[0], found[1][..., 0]]


@pytest.fixture(scope="module")
def pictures(gpu):
    """{kind: ({scene: {what: (device, reference)}}, by_color)}: all scenes of a kind are views of one atlas."""
    found, first = {}, np.cumsum([0, *(len(s.clip) for s in SCENES.values())])
    for number, (kind, renderer) in enumerate(KINDS.items()):
        program = Program()
        weights = [np.stack(w) for w in zip(*(loss_weights(s, renderer, 100 * number + k) for k, s in enumerate(SCENES.values())))]
        out = drawn(program, list(SCENES.values()), renderer, weights)
        reference = by_reference(program, out)
        program.plan("all", {}, out)
        device = gpu.run(program, {})
        for k, name in enumerate(SCENES):
            def mine(what, x, k=k):
                x = x.reshape(len(SCENES), -1, 4)[k] if what in ("by_clip", "by_alpha") else x
                return x[first[k]:first[k + 1]] if what.startswith("by_") else x[k]
            found[name, kind] = {what: (mine(what, device[what]), mine(what, reference[what])) for what in out}
            found[name, kind]["weights"] = [w[k] for w in weights]
    return found


each_kind = pytest.mark.parametrize("kind", KINDS)
each_scene = pytest.mark.parametrize("name", SCENES)


@each_kind
@each_scene
def test_a_picture_is_that_of_the_formulas(name, kind, pictures):
    scene = SCENES[name]
    expected = brute_force_binned.render(scene.clip, scene.faces, scene.size, scene.near, colors=scene.attributes, background=BACK,
                                         **settings(KINDS[kind]))
    sure = expected.margin > 1e-4
    assert sure.mean() > 0.98
    for what, truth in (("color", expected.color), ("alpha", expected.alpha), ("both", expected.alpha)):
        device, reference = pictures[name, kind][what]
        np.testing.assert_allclose(reference[sure], truth[sure], rtol=1e-9, atol=1e-12, err_msg=what)
        np.testing.assert_allclose(device[sure], truth[sure], rtol=1e-5, atol=1e-5, err_msg=what)
    if name in ("acute", "overlapping", "icosphere", "near_cut", "one_behind", "two_behind", "larger_than_screen", "random"):
        assert 0.02 < (expected.alpha > 0.5).mean() and np.ptp(expected.color) > 0.1


@each_kind
@each_scene
def test_a_gradient_on_the_device_is_that_of_float64(name, kind, pictures):
    for what in ("by_clip", "by_color", "by_alpha"):
        device, reference = pictures[name, kind][what]
        if name in ("overlapping", "icosphere", "near_cut", "one_behind", "random"):  # with `hard` alpha has none, of shape
            assert np.abs(reference).max() > 1e-3 or kind == "hard" and what == "by_alpha"
        np.testing.assert_allclose(device, reference, rtol=1e-4, atol=3e-5 * max(np.abs(reference).max(), 1.0), err_msg=what)


@each_kind
@pytest.mark.parametrize("name", ["overlapping", "intersecting", "quad", "tetrahedron", "one_behind", "two_behind", "near_cut"])
def test_a_gradient_is_the_central_difference_of_the_formulas(name, kind, pictures):
    scene = SCENES[name]
    wc, wa = pictures[name, kind]["weights"]

    def loss(clip, colors):
        found = brute_force_binned.render(clip, scene.faces, scene.size, scene.near, colors=colors, background=BACK,
                                          **settings(KINDS[kind]))
        return (found.color * wc).sum() + (found.alpha * wa).sum()

    expected = central_differences(loss, scene.clip, scene.attributes)
    clip, color = pictures[name, kind]["by_clip"][1], pictures[name, kind]["by_color"][1]
    np.testing.assert_allclose(clip, expected.clip, rtol=1e-5, atol=1e-5 * np.abs(expected.clip).max())
    np.testing.assert_allclose(color, expected.attributes, rtol=1e-5, atol=1e-5 * np.abs(expected.attributes).max())
    assert np.abs(expected.clip).max() > 1e-2


# The published settings


@pytest.mark.parametrize("name", ["overlapping", "intersecting", "tetrahedron", "icosphere", "random"])
def test_pytorch3d_settings_are_its_blend(name):
    """On square pictures of faces before the camera; K is the number of faces."""
    scene = SCENES[name]
    w, h = scene.size
    z = scene.clip[:, 3]
    points = screen(scene.clip, True, scene.size)
    points = np.stack([w / 2 - points[:, 0], h / 2 - points[:, 1]], 1) / (min(w, h) / 2)
    for sigma, gamma, blur in ((1e-4, 1e-4, None), (3e-3, 1e-2, 0.02)):
        kind = Binned.pytorch3d(scene.size, sigma, gamma, blur)
        radius = np.log(1e4 - 1) * sigma if blur is None else blur
        expected = brute_force_binned.pytorch3d(points, z, scene.faces, scene.size, sigma, gamma, radius, scene.attributes,
                                                np.array(BACK), 1.0, 100.0, len(scene.faces))
        program = Program()
        found = by_reference(program, drawn(program, [scene], kind))
        np.testing.assert_allclose(found["color"][0], expected[..., :3], rtol=1e-6, atol=1e-8)
        np.testing.assert_allclose(found["alpha"][0], expected[..., 3], rtol=1e-6, atol=1e-8)
        assert (expected[..., 3] > 0.5).mean() > 0.02


def test_settings_that_mean_nothing_are_refused():
    for wrong, says in (({"r": 0.0}, "r is 0.0"), ({"sigma": -1.0}, "sigma is -1.0"), ({"gamma": 0}, "gamma is 0"),
                        ({"gamma": float("nan")}, "gamma is nan"), ({"depth": (3.0, 1.0)}, "depth is"), ({"depth": 3}, "depth is 3"),
                        ({"tile": (0, 8)}, "tile is"), ({"pairs": 0}, "pairs is 0"), ({"r": 1e-7, "squared": True}, "sigma is")):
        with pytest.raises(InputError, match=says):
            Binned(**wrong)
    faces = np.arange(93000).reshape(-1, 3)
    with pytest.raises(InputError, match="through 31000 faces; at most 30000"):
        dataclasses.replace(PLAIN, tile=None).draw(compose(0.0, 0.0, 0.5, 1.0), Topology(faces, 93000), Atlas(8, 8, 1, 1), 0.1, True)
    with pytest.raises(InputError, match="give depth="):
        drawn(Program(), [SCENES["acute"]], Binned())


# Lists


def lists_of(boxes, grid):
    """By brute force: for each tile the faces (over views) of its view whose boxes have a pixel of it."""
    out = []
    for v in range(grid.views):
        corner = np.array([v % grid.columns * grid.cell_w, v // grid.columns * grid.cell_h])
        for b in range(grid.tiles[1]):
            for a in range(grid.tiles[0]):
                lo = corner + np.array([a, b]) * grid.tile
                mine = boxes[v * grid.faces:(v + 1) * grid.faces]
                meets = (mine[:, :2] < lo + grid.tile).all(1) & (mine[:, 2:] > lo).all(1)
                out.append(v * grid.faces + np.flatnonzero(meets))
    return out


@pytest.mark.parametrize("first, second, spills", [(None, None, 0), (None, 200, 1), (120, 10, 1)], ids=["room", "tiles", "bins"])
def test_lists_hold_every_face_of_a_tile_in_order(gpu, monkeypatch, first, second, spills):
    """Where a list has no room, tiles have the faces of their bin or their view: more, never fewer."""
    grid = Grid(3, 100, 213, 97, 2, (8, 4))
    rng = np.random.default_rng(5)
    lo = rng.integers(0, (200, 90), (300, 2))
    hi = np.minimum(lo + rng.integers(1, 40, (300, 2)), (213, 97))
    corner = np.array([(v % 2 * 213, v // 2 * 97) for v in np.repeat(range(3), 100)])
    boxes = np.where(rng.random((300, 1)) < 0.1, 0, np.concatenate([lo + corner, hi + corner], 1))
    expected = lists_of(boxes, grid)
    if first is not None:
        monkeypatch.setattr(tile_lists, "capacities", lambda *_: (max(first, 300), 300))
    elif second is not None:
        monkeypatch.setattr(tile_lists, "capacities", lambda *_: (3000, 3000))
    program = Program()
    found = bin_faces(program.input("boxes", Layout("table", "ivec4", count=300), boxes), grid)
    count = found.faces.extent.count
    listed = lookup(found.faces, apply("texel_index", extent=table(count)))  # as tables lie
    program.plan("p", {}, {"ranges": (found.ranges, Layout("table", "ivec2", count=len(expected))),
                           "faces": (listed, Layout("table", "int", count=count)), "pairs": (found.pairs, Layout("unit", "int")),
                           "spilled": (found.spilled, Layout("unit", "int"))})
    device = gpu.run(program, {})
    feed = {"boxes": program.values["boxes"].layout.to_image(boxes, "boxes")}
    for name, node in zip(("ranges", "faces"), evaluate([found.ranges, found.faces], feed)):
        used = slice(None) if name == "ranges" else slice(device["ranges"].max())
        np.testing.assert_array_equal(device[name][used], program.values[name].layout.from_image(node)[used])
    assert device["spilled"] == spills
    if not spills:
        assert device["pairs"] == sum(map(len, expected))
    for (begin, end), wanted in zip(device["ranges"], expected):
        mine = device["faces"][begin:end]
        assert (np.diff(mine) > 0).all()
        if spills:
            assert np.isin(wanted, mine).all()
        else:
            np.testing.assert_array_equal(mine, wanted)


def painted(kind, size=(200, 150), views=3, mesh=None):
    mesh = mesh or icosphere(2, 0.7)
    s = Scene(orbit(views, [20, -15], 3.0, 36, size), BACK)
    at = s.parameter("vertices", mesh.positions)
    colors = s.parameter("colors", 0.5 + 0.4 * np.sin(5 * mesh.positions + [0, 1, 2]), low=0.0, high=1.0)
    s.add(mesh, at, Unlit(Vertex(colors)))
    return s, s.frame(kind)


def test_a_list_without_room_changes_no_bit(gpu, monkeypatch):
    found = []
    for room in (None, (2000, 2000)):
        if room:
            monkeypatch.setattr(tile_lists, "capacities", lambda *_: room)  # noqa: B023
        s, f = painted(Binned(3.0, gamma=1e-3))
        s.vjp("look", ["vertices", "colors"], color=f.color, alpha=f.alpha)
        s.output("lists", spilled=f.fragments.lists.spilled)
        with runtime.load(gpu.compile(s.program), gpu.device) as d:
            seen = d.forward("look")
            found.append([*seen.values(), *d.backward("look", color=np.sin(1e3 * seen["color"]), alpha=seen["alpha"]).values()])
            spilled = d.get("lists.spilled")
        gpu.silent()
    assert spilled
    for a, b in zip(*found):
        np.testing.assert_array_equal(a, b)


@pytest.mark.parametrize("tile", [(4, 4), (13, 7), None])
def test_the_size_of_tiles_changes_no_bit(gpu, tile):
    found = []
    for size in ((8, 8), tile):
        s, f = painted(Binned(3.0, gamma=1e-3, tile=size), (97, 75))
        s.output("look", color=f.color, alpha=f.alpha)
        with runtime.load(gpu.compile(s.program), gpu.device) as d:
            found.append([d.get("look.color"), d.get("look.alpha")])
        gpu.silent()
    for a, b in zip(*found):
        np.testing.assert_array_equal(a, b)


def test_a_list_in_parts_is_the_same_picture(gpu, monkeypatch):
    """Where a list is too long for one invocation several go through it; where it is too long for all there is no picture."""
    found = []
    for each in (1 << 20, 16, 2):
        monkeypatch.setattr(soft, "EACH", each)
        if each == 2:
            monkeypatch.setattr(soft_parts, "capacity", lambda *_: 800)
        s, f = painted(Binned(3.0, gamma=1e-2, depth=RANGE), (97, 75), 2)
        s.vjp("look", ["vertices", "colors"], color=f.color, alpha=f.alpha)
        with runtime.load(gpu.compile(s.program), gpu.device) as d:
            seen = d.forward("look")
            by = {} if each == 2 else d.backward("look", color=np.sin(1e3 * np.arange(seen["color"].size)).reshape(seen["color"].shape),
                                                 alpha=np.ones_like(seen["alpha"]))
        found.append({**seen, **by})
        gpu.silent()
    for name in found[0]:
        scale = np.abs(found[0][name]).max()
        assert scale > 0.1
        np.testing.assert_allclose(found[1][name], found[0][name], atol=2e-5 * scale, rtol=1e-4, err_msg=name)
    bad = ~np.isfinite(found[2]["alpha"])
    assert 0.05 < bad.mean() < 0.9 and not np.isfinite(found[2]["color"][bad]).any()
    np.testing.assert_allclose(found[2]["alpha"][~bad], found[0]["alpha"][~bad], atol=1e-5)


@pytest.mark.parametrize("balls, tile, size", [(720, (8, 8), (72, 56)), (200, None, (20, 15))], ids=["tiles", "none"])
def test_every_face_of_a_long_list_is_counted(gpu, balls, tile, size):
    """More than llvmpipe lets one invocation look at, 57,600 in one tile; and without tiles, 16,000: balls at one place, of which the first
    half is dark and the second is bright."""
    ball, n = icosphere(1, 0.7), balls
    mesh = Mesh(np.tile(ball.positions, (n, 1)), np.concatenate([ball.faces + k * len(ball.positions) for k in range(n)]))
    s = Scene(orbit(1, [0], 30.0 if tile else 4.0, 36, size), BACK)
    colors = s.parameter("colors", np.repeat([0.2, 0.8], len(mesh.positions) // 2)[:, None].repeat(3, 1))
    s.add(mesh, material=Unlit(Vertex(colors)))
    f = s.frame(Binned(2.0, gamma=1e-2, depth=(1.0, 50.0), tile=tile))
    s.output("look", color=f.color, alpha=f.alpha, longest=f.fragments.lists.pairs)
    with runtime.load(gpu.compile(s.program), gpu.device) as d:
        color, alpha, pairs = d.get("look.color")[0], d.get("look.alpha")[0], d.get("look.longest")
    gpu.silent()
    assert pairs >= len(mesh.faces) and (alpha > 0.999).sum() > 4
    np.testing.assert_allclose(color[alpha > 0.999], 0.5, atol=1e-3)


# Scenes


FIT = """
import sys, hashlib
sys.path.insert(0, "tests")
from test_binned import *
s, f = painted(Binned(4.0, gamma=1e-3, over=True), (97, 75))
photo = s.input("photo", shape=(3, 75, 97, 3))
s.phase("fit", 12, {"vertices": Adam(0.01), "colors": Adam(0.02)}, color=l2(f.color, photo), shape=total(f.alpha) * 1e-4)
s.compile("lavapipe", sys.argv[1])
with runtime.load(sys.argv[1]) as d:
    d.set("photo", np.random.default_rng(0).uniform(size=(3, 75, 97, 3)))
    d.step(12)
    print(hashlib.sha256(d.get("vertices").tobytes() + d.get("colors").tobytes()).hexdigest(), d.loss())
"""


def test_runs_are_equal_to_the_bit_whatever_the_threads(tmp_path):
    assert len({python(FIT, tmp_path / "a.dressi", LP_NUM_THREADS=n) for n in ("0", "1", "2")}) == 1


def test_a_face_of_more_pixels_than_a_loop_has_turns_keeps_its_gradient(gpu):
    """llvmpipe ends loops after 65535 turns; the face's box has 80,000 pixels."""
    square = Mesh(np.array([(-2.0, -2, 0), (2, -2, 0), (2, 2, 0), (-2, 2, 0)]), np.array([(0, 1, 2), (0, 2, 3)]))
    s = Scene(orbit(1, [0], 3.0, 36, (400, 200)), BACK)
    colors = s.parameter("colors", np.full((4, 3), 0.5))
    s.add(square, material=Unlit(Vertex(colors)))
    s.vjp("look", ["colors"], color=s.frame(Binned(1.0, hard=True)).color)
    with runtime.load(gpu.compile(s.program), gpu.device) as d:
        d.forward("look")
        found = d.backward("look", color=np.ones((1, 200, 400, 3)))["colors"]
    gpu.silent()
    np.testing.assert_allclose(found.sum(0), 80000, rtol=1e-4)  # all pixels are covered, and each pixel's weights add up to 1


def test_a_floor_that_runs_past_the_camera_keeps_its_gradient(gpu):
    """It crosses the near plane and covers most of two views, one from below: its loop over 38,000 pixels takes one turn a pixel,
    whether an edge is cut there or not. With loops inside it that cut edges, two corners lost all of their gradient."""
    floor = np.array([(-40.0, -0.6, 3.2), (40, -0.6, 3.2), (40, -0.6, -40), (-40, -0.6, -40)])
    s = Scene(orbit(2, [20, -20], 2.5, 50, (240, 160)), BACK)
    s.add(Mesh(floor, np.array([(0, 1, 2), (0, 2, 3)])), s.parameter("floor", floor), Unlit((0.7, 0.6, 0.3)))
    seen = s.frame(Binned(2.0, gamma=1e-2, over=True))
    s.phase("fit", 1, {"floor": Sgd(1.0)}, color=l2(seen.color, s.input("photo", np.full((2, 160, 240, 3), 0.3))))
    with runtime.load(gpu.compile(s.program), gpu.device) as d, ReferenceSession(s.program) as r:
        for session in (d, r):
            session.step(1, "fit")
        found, expected = (session.get("floor")[:, 1] - floor[:, 1] for session in (d, r))
    gpu.silent()
    assert np.abs(expected).min() > 5e-5
    np.testing.assert_allclose(found, expected, rtol=2e-3, atol=1e-7)


def test_a_fit_learns_shape_and_colour(gpu):
    truth, f = painted(Binned(2.0, gamma=1e-3, over=True), (97, 75))
    truth.output("look", color=f.color)
    with runtime.load(gpu.compile(truth.program), gpu.device) as d:
        target = d.get("look.color")
    mesh = icosphere(2, 0.55)
    s = Scene(orbit(3, [20, -15], 3.0, 36, (97, 75)), BACK)
    s.add(mesh, s.parameter("vertices", mesh.positions), Unlit(Vertex(s.parameter("colors", np.full((162, 3), 0.5)))))
    seen, photo = s.frame(Binned(3.0, gamma=1e-3, over=True)), s.input("photo", target)
    s.phase("fit", 100, {"vertices": Adam(0.004), "colors": Adam(0.03)}, color=l2(seen.color, photo))
    with runtime.load(gpu.compile(s.program), gpu.device) as d:
        start = d.loss()
        d.step(100)
        assert d.loss() < 0.1 * start
        assert abs(np.median(np.linalg.norm(d.get("vertices"), axis=1)) - 0.7) < 0.04  # not all of it is seen
    gpu.silent()


def test_a_hidden_face_has_a_gradient_where_the_softmax_is_soft():
    """The far one of two squares, wholly hidden, is to become nearer; with gamma 1e-4 it has no say."""
    found = {}
    clip = project([(x, y, z) for z in (-3.0, -4.0) for x, y in ((-1, -1), (1, -1), (1, 1), (-1, 1))], (24, 24))
    faces = np.array([(0, 1, 2), (0, 2, 3), (4, 5, 6), (4, 6, 7)])
    scene = SCENES["quad"]._replace(clip=clip, faces=faces, attributes=np.repeat([[1.0, 0, 0], [0, 1.0, 0]], 4, 0))
    for gamma in (0.1, 1e-4):
        program = Program()
        weights = np.full((1, 24, 24, 3), (-1.0, 1.0, 0.0)), np.zeros((1, 24, 24))
        found[gamma] = by_reference(program, drawn(program, [scene], dataclasses.replace(PLAIN, gamma=gamma), weights))["by_clip"]
    assert (found[0.1][4:, 3] < -1).all() and (np.abs(found[1e-4][4:]) < 1e-12).all()


def test_materials_are_shaded_at_corners(gpu):
    """Flat normals: one colour a face. The same corners' colours by hand are the same picture."""
    mesh, cams = icosphere(1, 0.8), orbit(2, [10], 3.0, 36, (97, 75))
    lights = [Light("directional", (3.0, 2.7, 2.4), (0.2, -0.4, -1.0)), Light("ambient", 0.2)]
    s = Scene(cams, BACK)
    s.add(mesh, material=Lambert((0.8, 0.6, 0.4), lights), normals="flat", name="lit")
    f = s.frame(Binned(2.0, gamma=1e-3))
    hard = s.frame()
    s.output("look", color=f.color, alpha=f.alpha, hard=hard.color, mask=f.mask, depth=f.depth, seen=hard.depth)
    with runtime.load(gpu.compile(s.program), gpu.device) as d:
        look = {key: d.get(f"look.{key}") for key in ("color", "alpha", "hard", "mask", "depth", "seen")}
    gpu.silent()
    inside = look["alpha"] > 0.999
    assert np.median(np.abs(look["color"] - look["hard"])[inside]) < 1e-3 and inside.mean() > 0.1
    np.testing.assert_array_equal(look["depth"], look["seen"])


def test_several_parts_and_an_orthographic_view_are_blended_together(gpu):
    """A part of its own colour each; of two squares the nearer one is seen, by both kinds of cameras."""
    square = np.array([(-0.5, -0.5, 0), (0.5, -0.5, 0), (0.5, 0.5, 0), (-0.5, 0.5, 0)], float)
    faces = np.array([(0, 1, 2), (0, 2, 3)])
    deep = look_at((0, 0, 3), (0, 0, 0), (0, 1, 0), 36, 60, 50)
    flat = look_along((0, 0, 3), (0, 0, 0), (0, 1, 0), 1.6, 60, 50)
    s = Scene([deep, flat], BACK)
    for z, color in ((0.0, (1.0, 0.0, 0.0)), (-0.5, (0.0, 1.0, 0.0))):
        s.add(Mesh(square + (z, 0, z), faces), material=Unlit(color))
    f = s.frame(Binned(1.5))
    s.output("look", color=f.color, alpha=f.alpha, part=f.part)
    with runtime.load(gpu.compile(s.program), gpu.device) as d:
        color, part = d.get("look.color"), d.get("look.part")
    gpu.silent()
    for view in range(2):
        assert {*np.unique(part[view])} == {-1, 0, 1}
        for k, expected in enumerate(((1, 0, 0), (0, 1, 0))):
            middle = np.median(color[view][part[view] == k], axis=0)
            np.testing.assert_allclose(middle, expected, atol=1e-3)


def test_pictures_in_the_place_of_corners_are_refused():
    s = Scene(orbit(1, [20], 3.0, 36, (64, 48)))
    s.add(pear(16))
    with pytest.raises(InputError, match="three vec3 tables"):
        s.frame(Binned()).composed([s.input("x", shape=(1, 48, 64, 3))])


# Stability


FACES = np.random.default_rng(3).integers(0, 40, (50, 3))


def wild(rng, kind):
    """Clip coordinates of 40 vertices: some behind the eye, some at one place, some at one depth, some huge."""
    p = rng.normal(size=(40, 3)) * 10.0 ** rng.uniform(-2, 1) + (0, 0, rng.uniform(-4, 0.5))
    if kind % 4 == 1:
        p[::2, 2] = -3.0
    if kind % 4 == 2:
        p[::3] = p[0]
    if kind % 4 == 3:
        p[:20] = p[20:]
    if kind % 7 == 0:
        p[5] *= 1e4
    return project(p, (48, 40)).astype(np.float32)


def check_wild(gpu, count, seed):
    kinds = {"a": Binned(2.0, 1e-6, 1e-5, depth=RANGE), "b": Binned(6.0, 1e-6, 1e-5, depth=RANGE, squared=True, over=True),
             "c": Binned(3.0, gamma=1e-4, depth=(0.1, 20.0)), "d": Binned(1.0, 10.0, 1.0, depth=RANGE, over=True),
             "e": Binned(1.0, gamma=1e-5, depth=RANGE, hard=True)}
    rng = np.random.default_rng(seed)
    kept = FACES[[len(set(f)) == 3 for f in FACES]]
    scene = SCENES["random"]._replace(clip=wild(rng, 0), faces=kept, size=(48, 40), attributes=rng.uniform(size=(40, 3)))
    seen = 0
    for kind in kinds.values():
        program, (h, w) = Program(), (40, 48)
        found = drawn(program, [scene], kind, [rng.normal(size=(1, h, w, 3)), rng.normal(size=(1, h, w))])
        program.plan("p", {}, found)
        with gpu.open(program) as d:
            for k in range(count):
                d.set("clip", wild(rng, k))
                for name in found:
                    value = d.get(name)
                    assert np.isfinite(value).all(), (kind, k, name)
                    if name in ("alpha", "both"):
                        assert value.min() >= 0 and value.max() <= 1
                        seen += value.max() > 0.5
        gpu.silent()
    assert seen > 2 * count


def test_nothing_is_ever_infinite(gpu):
    check_wild(gpu, 30, 1)


@pytest.mark.full
def test_nothing_is_ever_infinite_in_ten_thousand_scenes(gpu):
    check_wild(gpu, 2000, 2)
