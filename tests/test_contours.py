"""Occluding contours: the gradient of a colour picture where one surface hides another, against pictures of 256 samples a pixel."""
import numpy as np
import pytest

from dressi_edge import runtime
from dressi_edge.cache.errors import InputError
from dressi_edge.compiler.graph.functions import compose, constant_table
from dressi_edge.compiler.graph.reference_session import ReferenceSession
from dressi_edge.compiler.render.raster.contours import ContourFragments
from dressi_edge.compiler.render.raster.fragments import Fragments
from dressi_edge.compiler.scene import Binned, HardSoftRas, Mesh, Outline, Scene, Unlit, Vertex, icosphere, look_at, orbit, rigid

pytest_plugins = ["gpu"]
SAMPLES = 16  # a pixel's side


def supersampled(parts, camera, background=0.0):
    """Mean colour of each pixel: parts are (positions, faces, colour), drawn sharply at SAMPLES^2 times the pixels, in float64. A colour
    of None is the depth."""
    n, k = camera.width, SAMPLES
    depth, color = np.full((n * k, n * k), np.inf), np.full((n * k, n * k, 3), background)
    for positions, faces, paint in parts:
        h = (camera.world_to_camera @ np.column_stack([positions, np.ones(len(positions))]).T).T
        x, y, near = (camera.cx - camera.fx * h[:, 0] / h[:, 2]) * k, (camera.cy + camera.fy * h[:, 1] / h[:, 2]) * k, -1 / h[:, 2]
        for f in faces:
            (x0, x1, x2), (y0, y1, y2), w = x[f], y[f], near[f]
            area = (x1 - x0) * (y2 - y0) - (x2 - x0) * (y1 - y0)
            low, high = np.floor([min(y[f]), min(x[f])]).astype(int), np.ceil([max(y[f]), max(x[f])]).astype(int)
            if area >= 0 or (high <= low).any():
                continue
            at = slice(max(low[0], 0), high[0]), slice(max(low[1], 0), high[1])
            py, px = np.mgrid[at] + 0.5
            b0 = ((x1 - px) * (y2 - py) - (x2 - px) * (y1 - py)) / area
            b1 = ((x2 - px) * (y0 - py) - (x0 - px) * (y2 - py)) / area
            away = 1 / (b0 * w[0] + b1 * w[1] + (1 - b0 - b1) * w[2])
            nearer = (np.minimum(b0, b1) >= 0) & (b0 + b1 <= 1) & (away < depth[at])
            depth[at][nearer], color[at][nearer] = away[nearer], away[nearer, None] if paint is None else paint
    return color.reshape(n, k, n, k, 3).mean((1, 3))


def balls(size, renderer, shift=(0.05, 0.02, 1.3), radius=0.3):
    """A red ball, which moves, before a white one; a picture and its transpose."""
    red, white = icosphere(3, radius), icosphere(3, 0.9)
    s = Scene([look_at((0, 0, 4), (0, 0, 0), (0, 1, 0), 40, size, size)])
    place = s.parameter("place", np.zeros(3))
    s.add(red, rigid(red.positions + shift, np.zeros(3), place), Unlit((1.0, 0.0, 0.0)))
    s.add(white, material=Unlit(1.0))
    f = s.frame(renderer)
    s.vjp("v", ["place"], color=f.color, alpha=f.alpha, depth=f.soft(lambda x: compose(x.depth, x.depth, x.depth), 5.0))
    return s, [(red.positions + shift, red.faces, (1, 0, 0)), (white.positions, white.faces, (1, 1, 1))]


def fields(size):
    """Smooth gradients of a loss by a picture."""
    y, x = np.mgrid[:size, :size] / size
    return [np.stack([np.sin(3 * x + 1 + k) + y, np.cos(4 * y + k) + x, np.sin(6 * x * y + k)], -1) for k in range(4)]


def truth(parts, camera, size, h=0.02):
    """The derivative of the supersampled picture by a shift of the first part, against each field: (fields, 3)."""
    slopes = []
    for axis in np.eye(3):
        moved = [supersampled([(parts[0][0] + s * h * axis, *parts[0][1:]), *parts[1:]], camera) for s in (1, -1)]
        slopes.append((moved[0] - moved[1]) / (2 * h))
    return np.array([[(slope * field).sum() for slope in slopes] for field in fields(size)])


@pytest.mark.parametrize("case, size, before, after", [((0.05, 0.02, 1.3), 64, 0.99, 0.02), pytest.param(
    (0.15, 0.05, 1.3), 96, 0.95, 0.2, marks=pytest.mark.full)], ids=["inside the other", "contours that cross"])
def test_a_ball_before_another_moves_as_its_picture_does(gpu, case, size, before, after):
    """Translation in all directions, relative L2 over four fields; without contours what lies inside the silhouette has none."""
    radius = 0.3 if size == 64 else 0.5
    errors = []
    for renderer in (Outline(), Outline(contours=True)):
        scene, parts = balls(size, renderer, case, radius)
        if not errors:
            exact = truth(parts, scene.cameras[0], size)
        with runtime.load(gpu.compile(scene.program), gpu.device) as s:
            found = np.array([s.backward("v", color=field[None])["place"] for field in fields(size)])
        errors.append(np.linalg.norm(found - exact) / np.linalg.norm(exact))
        gpu.silent()
    assert errors[0] > before and errors[1] < after, errors


def test_soft_depth_has_the_gradient_of_contours(gpu):
    """Against the depth of the pixels' samples, moved across and towards the eye."""
    size, errors, h = 64, [], 0.02
    for renderer in (Outline(), Outline(contours=True)):
        scene, parts = balls(size, renderer)
        with runtime.load(gpu.compile(scene.program), gpu.device) as s:
            found = np.array([s.backward("v", depth=field[None])["place"] for field in fields(size)])
        exact = []
        for axis in np.eye(3):
            moved = [supersampled([(parts[0][0] + s * h * axis, parts[0][1], None), (*parts[1][:2], None)], scene.cameras[0], 5.0)
                     for s in (1, -1)]
            exact.append((moved[0] - moved[1]) / (2 * h))
        exact = np.array([[(slope * field).sum() for slope in exact] for field in fields(size)])
        errors.append(np.linalg.norm(found - exact) / np.linalg.norm(exact))
    gpu.silent()
    assert errors[0] > 0.3 and errors[1] < 0.06, errors


def test_the_picture_is_nearer_to_the_supersampled_one(gpu):
    """Composed of both sides at contours as at outlines, and the silhouette is the same to the bit."""
    found = {}
    for contours in (False, True):
        scene, parts = balls(64, Outline(r=1.0, contours=contours))
        with runtime.load(gpu.compile(scene.program), gpu.device) as s:
            found[contours] = s.forward("v")
    gpu.silent()
    exact = supersampled(parts, scene.cameras[0])
    np.testing.assert_array_equal(found[True]["alpha"], found[False]["alpha"])
    inside = found[True]["alpha"][0] == 1  # away from the outline, which both draw alike
    error = [float(np.square(found[c]["color"][0] - exact)[inside].mean()) for c in (False, True)]
    assert error[1] < error[0] / 3


def test_a_convex_thing_is_drawn_as_without(gpu):
    """Nothing hides anything: the same picture, whatever the slope of the surface at its limb."""
    ball, found = icosphere(3, 0.8), []
    for contours in (False, True):
        s = Scene(orbit(2, [15, -10], 3.0, 40, (90, 66)))
        s.add(ball, material=Unlit(Vertex(constant_table(0.5 + 0.4 * np.sin(5 * ball.positions)))))
        s.output("look", color=s.frame(Outline(contours=contours)).color)
        with runtime.load(gpu.compile(s.program), gpu.device) as session:
            found.append(session.get("look.color"))
    gpu.silent()
    np.testing.assert_allclose(found[1], found[0], atol=1e-6)


def test_the_device_gives_the_gradients_of_the_reference(gpu):
    """By places and by colours of both, in two views."""
    front, back = icosphere(1, 0.35), icosphere(2, 0.8)
    s = Scene(orbit(2, [10, -5], 3.5, 36, (40, 32)), (0.2, 0.1, 0.0))
    place = s.parameter("place", np.array([0.1, 0.05, 1.0]))
    colors = [s.parameter(f"colors{k}", 0.5 + 0.4 * np.sin(5 * m.positions + k)) for k, m in enumerate((front, back))]
    s.add(front, constant_table(front.positions) + place, Unlit(Vertex(colors[0])))
    s.add(back, material=Unlit(Vertex(colors[1])))
    s.vjp("v", list(s.parameters), color=s.frame(Outline(contours=True)).color)
    given = np.random.default_rng(2).normal(size=(2, 32, 40, 3))
    with ReferenceSession(s.program) as exact, runtime.load(gpu.compile(s.program, "vulkan_min"), gpu.device) as session:
        np.testing.assert_allclose(session.forward("v")["color"], exact.forward("v")["color"], atol=2e-5)
        one, two = exact.backward("v", color=given), session.backward("v", color=given)
        for name in s.parameters:
            np.testing.assert_allclose(two[name], one[name], atol=1e-3 * np.abs(one[name]).max())
    gpu.silent()


def slope_across(gpu, positions, faces, colors, renderer, columns):
    """Derivative of the red of some columns, per row, by a shift of a mesh by a pixel to the right, before a white wall; 64 x 48 pixels,
    and the mesh's x is a pixel too."""
    s = Scene([look_at((0, 0, 1000), (0, 0, 0), (0, 1, 0), np.degrees(2 * np.arctan(24 / 1000)), 64, 48, near=500, far=2000)])
    shift = s.parameter("shift", np.zeros(3))
    mesh = Mesh(np.asarray(positions, float), np.array(faces))
    s.add(mesh, rigid(mesh.positions, np.zeros(3), shift), Unlit(Vertex(constant_table(np.array(colors, float)))))
    wall = np.array([(-99, -99, -100.0), (99, -99, -100), (99, 99, -100), (-99, 99, -100)])
    s.add(Mesh(wall, np.array([(0, 1, 2), (0, 2, 3)])), material=Unlit(1.0))
    s.vjp("v", ["shift"], color=s.frame(renderer).color)
    weight = np.zeros((1, 48, 64, 3))
    weight[:, :, columns, 0] = 1
    with runtime.load(gpu.compile(s.program), gpu.device) as session:
        slope = session.backward("v", color=weight)["shift"][0] / 48
    gpu.silent()
    return slope


@pytest.mark.parametrize("phase", [0.0, 0.25, 0.45, 0.9])
def test_an_upright_edge_has_its_gradient_wherever_pixels_lie_to_it(gpu, phase):
    """A black stripe moves to the right over the white wall: each row of its right edge loses one pixel of white. At r = 1
    sigmoid(d / sigma) itself, taken at the pixels' centres, would give 0.4 to 1.75 of it."""
    x = 8.0 + phase
    stripe = [(-20, -99, 0), (x, -99, 0), (x, 99, 0), (-20, 99, 0)]
    slope = slope_across(gpu, stripe, [(0, 1, 2), (0, 2, 3)], np.zeros((4, 3)), Outline(1.0, contours=True), slice(32, 64))
    assert abs(slope + 1) < 0.04


@pytest.mark.parametrize("width, known", [(0.5, 2.0), (0.02, 8.0)], ids=["half a pixel", "a fiftieth"])
def test_a_thin_face_has_a_gradient_of_bounded_size(gpu, width, known):
    """White turns black over a face of that width which holds a column's centres: there colours change by 1 / width a pixel, of which the
    gradient knows at most 8."""
    x = np.array([-20, 0.5 - width / 2, 0.5 + width / 2, 20])
    positions = [(k, y, 0) for k in x for y in (-99, 99)]
    faces = [f for k in (0, 2, 4) for f in ((k, k + 2, k + 3), (k, k + 3, k + 1))]
    colors = np.repeat([1.0, 1.0, 0.0, 0.0], 2)[:, None] * np.ones(3)
    found = [slope_across(gpu, positions, faces, colors, Outline(contours=c), [32]) for c in (False, True)]
    np.testing.assert_allclose(found, (1 / width, known), rtol=0.01)


def lit(normals):
    """A part that reads its colours, places and normals before one that does not: gradients by how it is turned, where it is, its paint."""
    front, back = icosphere(1, 0.35), icosphere(2, 0.9)
    s = Scene(orbit(2, [10, -5], 3.5, 36, (48, 40)), (0.2, 0.1, 0.0))
    turn, place = (s.parameter(name, np.array(start)) for name, start in (("turn", [0.1, -0.2, 0.3]), ("place", [0.1, 0.05, 1.0])))
    paint = s.parameter("paint", 0.5 + 0.4 * np.sin(5 * front.positions))
    s.add(front, rigid(front.positions, turn, place), lambda x: x.vertex(paint) * 0.7 + x.normal * 0.3 + x.position * 0.1, normals=normals)
    s.add(back, material=Unlit((0.1, 0.9, 0.4)))
    s.vjp("v", list(s.parameters), color=s.frame(Outline(contours=True)).color)
    return s, np.random.default_rng(3).normal(size=(2, 40, 48, 3))


def test_gradients_are_differences_of_the_picture(gpu):
    """Of the reference in float64; all choices stay what they are as far as these steps go."""
    s, given = lit("smooth")
    with runtime.load(gpu.compile(s.program), gpu.device) as session:
        found = session.backward("v", color=given)
    gpu.silent()
    with ReferenceSession(s.program) as exact:
        for name, step in (("turn", 2.0 ** -18), ("place", 2.0 ** -18), ("paint", 2.0 ** -7)):
            start, slopes = np.asarray(exact.get(name)), {}
            for k in range(0, start.size, 1 if start.size == 3 else 31):
                losses = []
                for sign in (1, -1):
                    moved = start.copy()
                    moved.reshape(-1)[k] += sign * step
                    exact.set(name, moved)
                    losses.append((exact.forward("v")["color"] * given).sum())
                slopes[k] = (losses[0] - losses[1]) / (2 * step)
            exact.set(name, start)
            got = np.asarray(found[name]).reshape(-1)[list(slopes)]
            np.testing.assert_allclose(got, list(slopes.values()), atol=5e-3 * np.abs(found[name]).max(), err_msg=name)


def test_sums_beside_edges_are_those_over_all_pixels_of_faces(monkeypatch):
    """What the far side of a contour adds up edge by edge, summed face by face instead; flat normals, two parts, in the reference."""
    found = []
    for _ in range(2):
        s, given = lit("flat")
        with ReferenceSession(s.program) as exact:
            found.append(exact.backward("v", color=given))
        monkeypatch.setattr(ContourFragments, "_at_corners", Fragments._at_corners)
        monkeypatch.setattr(ContourFragments, "of_face", Fragments.of_face)
    for name in found[0]:
        assert np.abs(found[0][name]).max() > 1e-2
        np.testing.assert_allclose(found[1][name], found[0][name], atol=1e-6 * np.abs(found[0][name]).max())


@pytest.mark.full
def test_three_views_of_an_uncommon_size_give_the_reference_s_picture_and_gradients(gpu):
    near, far = icosphere(3, 0.35), icosphere(3, 0.7)
    s = Scene(orbit(3, [20, -15, 40], 3.0, 45, (333, 217)))
    x, y = s.parameter("near", near.positions + (0.1, 0.05, 0.75)), s.parameter("far", far.positions)
    paint = s.parameter("paint", 0.5 + 0.4 * np.sin(5 * near.positions))
    s.add(near, x, Unlit(Vertex(paint)))
    s.add(far, y, Unlit(Vertex(constant_table(0.5 + 0.4 * np.cos(4 * far.positions)))))
    s.vjp("v", ["near", "far", "paint"], color=s.frame(Outline(2.0, contours=True)).color)
    slope = np.stack([np.sin(np.mgrid[:217, :333][1] / 30 + k) for k in range(3)], -1)[None].repeat(3, 0)
    reference = ReferenceSession(s.program)
    reference.set("v.color.grad", slope)
    with gpu.open(s.program) as session:
        session.set("v.color.grad", slope)
        np.testing.assert_allclose(session.get("v.color"), reference.get("v.color"), atol=1e-4)
        for name, within in (("near", 5e-3), ("far", 5e-3), ("paint", 1e-5)):
            found, wanted = (np.asarray(each.get(f"v.{name}.grad"), float) for each in (session, reference))
            assert np.linalg.norm(found - wanted) < within * np.linalg.norm(wanted), name
    gpu.silent()


@pytest.mark.parametrize("gap", [0.0, -1.0, float("nan"), float("inf")])
def test_a_gap_is_a_positive_number(gap):
    with pytest.raises(InputError, match="gap is .*a positive fraction of the distance"):
        Outline(contours=True, gap=gap)


def test_layers_have_contours_of_coverage_alone():
    """What the paper's renderer has not is not offered."""
    with pytest.raises(TypeError):
        HardSoftRas(contours=True)


@pytest.mark.parametrize("renderer", [Outline(2.0, contours=True), HardSoftRas(2.0), HardSoftRas(2.0, layers=3, edges="all"),
                                      Binned(2.0, over=True)], ids=["contours", "one layer", "all edges", "every face"])
def test_one_colour_for_all_of_a_single_part_is_that_colour_at_each_vertex(gpu, renderer):
    """A picture of one texel, which every renderer must spread over its pixels; it did not beside contours."""
    ball, found = icosphere(1, 0.6), {}
    for name, color in (("one", (0.8, 0.3, 0.1)), ("each", Vertex(constant_table(np.tile((0.8, 0.3, 0.1), (42, 1)))))):
        s = Scene(orbit(2, [20, -15], 3.0, 40, (65, 49)), background=(0.1, 0.2, 0.3))
        s.add(ball, s.parameter("vertices", ball.positions), Unlit(color))
        s.vjp("v", ["vertices"], color=s.frame(renderer).color)
        with gpu.open(s.program) as session:
            session.forward("v")
            found[name] = session.get("v.color"), session.backward("v", color=np.ones((2, 49, 65, 3)))["vertices"]
    gpu.silent()
    assert np.abs(found["one"][1]).max() > 1
    for one, each in zip(found["one"], found["each"]):
        np.testing.assert_allclose(one, each, atol=1e-4 * np.abs(each).max())
