"""Scenes that users write: parts, pictures on request, terms, gradients out. Most of it needs no truth but itself: a position must lie
where its pixel looks, two parts must be what each is alone, one mesh in two pieces must be the mesh."""
import numpy as np
import pytest

from dressi_edge import runtime
from dressi_edge.cache.errors import GraphError, InputError
from dressi_edge.compiler.graph.functions import compose, constant_table, dot, maximum, mean, total
from dressi_edge.compiler.graph.reference_session import ReferenceSession
from dressi_edge.compiler.scene import (
    Adam,
    HardSoftRas,
    Lambert,
    Light,
    Mesh,
    Outline,
    Scene,
    Sgd,
    Texture,
    Unlit,
    Vertex,
    icosphere,
    l2,
    orbit,
    pear,
)

pytest_plugins = ["gpu"]
BALL, OTHER = icosphere(2, 0.6), icosphere(2, 0.5)
SHIFT = np.array([0.35, 0.15, 0.2])  # they cut each other
IDS = {Outline(): "outline", HardSoftRas(2.0, 2): "K2"}


def cameras(n=2, size=(97, 75)):
    return orbit(n, [20, -15], 3.0, 36, size)


def paint(mesh):
    return 0.5 + 0.4 * np.sin(5 * mesh.positions + [0, 1, 2])


def draw(gpu, scene, name="look", **options):
    """The outputs of a plan, by short name."""
    with runtime.load(gpu.compile(scene.program, **options), gpu.device) as s:
        found = {k[len(name) + 1:]: s.get(k) for k in s.values if k.startswith(name + ".")}
    gpu.silent()
    return found


def painted(parts, cams, renderer, wanted=("color", "alpha", "depth", "part", "mask")):
    """A scene of vertex-coloured parts, each a mesh and a shift; what is wanted as outputs of `look`."""
    s = Scene(cams, (0.1, 0.2, 0.3))
    for mesh, shift in parts:
        s.add(mesh, constant_table(mesh.positions + shift), Unlit(Vertex(constant_table(paint(mesh)))))
    f = s.frame(renderer)
    s.output("look", **{key: getattr(f, key) for key in wanted})
    return s


@pytest.mark.parametrize("renderer", IDS, ids=IDS.get)
def test_what_is_in_front_is_what_is_nearest_of_each_part_alone(gpu, renderer):
    parts = [(BALL, 0.0), (OTHER, SHIFT)]
    both = draw(gpu, painted(parts, cameras(), renderer))
    alone = [draw(gpu, painted([part], cameras(), renderer)) for part in parts]
    far = np.stack([np.where(x["mask"] > 0, x["depth"], np.inf) for x in alone])
    front = np.where(np.isfinite(far.min(0)), far.argmin(0), -1)
    with np.errstate(invalid="ignore"):
        clear = ~(np.abs(far[0] - far[1]) < 1e-4)  # where they cut each other fp32 depth decides
    np.testing.assert_array_equal(both["part"][clear], front[clear])
    assert {*np.unique(both["part"])} == {-1, 0, 1} and (clear | (front < 0)).mean() > 0.99
    inside = (both["alpha"] == 1) & clear & (front >= 0)
    color = np.where((front == 0)[..., None], alone[0]["color"], alone[1]["color"])
    same = inside & np.where(front == 0, alone[0]["alpha"] == 1, alone[1]["alpha"] == 1)
    np.testing.assert_allclose(both["color"][same], color[same], atol=2e-6)
    assert same.sum() > 2000


def halves(mesh, front):
    """The mesh in two pieces, each with the vertices that it needs."""
    pieces = []
    for faces in (mesh.faces[front], mesh.faces[~front]):
        used, index = np.unique(faces, return_inverse=True)
        pieces.append((Mesh(mesh.positions[used], index.reshape(-1, 3)), 0.0))
    return pieces


@pytest.mark.parametrize("renderer", IDS, ids=IDS.get)
def test_a_mesh_in_two_pieces_is_the_mesh(gpu, renderer):
    one = draw(gpu, painted([(BALL, 0.0)], cameras(), renderer))
    pieces = halves(BALL, BALL.positions[BALL.faces].mean(1)[:, 0] > 0.1)
    two = draw(gpu, painted(pieces, cameras(), renderer))
    for key in ("mask", "depth"):
        np.testing.assert_allclose(two[key], one[key], atol=1e-6)
    for key in ("alpha", "color"):  # where the cut's own boundary meets the outline, it is outline, too
        other = np.abs(two[key] - one[key]) > 1e-5
        assert other.mean() < 0.004 and not (other.any() and renderer != Outline())


def test_every_picture_agrees_with_the_cameras_and_the_mesh(gpu):
    mesh, cams = pear(32), cameras(2, (200, 150))
    s = Scene(cams)
    s.add(OTHER, constant_table(OTHER.positions + [1.2, 0.5, 0.0]), name="ball")
    s.add(mesh, material=Unlit(Texture(s.parameter("texture", mesh.texture))), name="pear")
    f = s.frame()
    keys = ("mask", "position", "depth", "distance", "normal", "geometric_normal", "camera_normal", "barycentric", "face", "part")
    s.output("look", **{key: getattr(f, key) for key in keys}, uv=f.of(lambda x: x.uv))
    found = draw(gpu, s)
    inside = found["mask"] > 0
    assert (found["depth"][~inside] == 0).all() and (found["part"][~inside] == -1).all() and (found["face"][~inside] == -1).all()
    pieces = [(OTHER, OTHER.positions + [1.2, 0.5, 0.0]), (mesh, mesh.positions)]
    for v, camera in enumerate(cams):
        y, x = np.nonzero(inside[v])
        at = {key: found[key][v, y, x].astype(float) for key in (*keys, "uv")}
        eye = (camera.world_to_camera @ np.column_stack([at["position"], np.ones(len(x))]).T).T[:, :3]
        seen = np.column_stack([camera.cx + camera.fx * eye[:, 0] / -eye[:, 2], camera.cy - camera.fy * eye[:, 1] / -eye[:, 2]])
        np.testing.assert_allclose(seen, np.column_stack([x, y]) + 0.5, atol=1e-2)  # seen edge on at worst
        np.testing.assert_allclose(at["depth"], -eye[:, 2], atol=2e-6)
        np.testing.assert_allclose(at["distance"], np.linalg.norm(at["position"] - camera.position, axis=1), atol=2e-6)
        np.testing.assert_allclose(at["camera_normal"], at["normal"] @ camera.world_to_camera[:3, :3].T, atol=2e-6)
        np.testing.assert_allclose(np.linalg.norm(at["normal"], axis=1), 1, atol=1e-5)
        assert (((camera.position - at["position"]) * at["geometric_normal"]).sum(1) > -1e-3).mean() > 0.998  # the pear's stem cuts it
        for k, (piece, positions) in enumerate(pieces):
            mine = at["part"] == k
            corners = positions[np.sort(piece.faces[at["face"][mine].astype(int)], axis=1)]
            np.testing.assert_allclose((corners * at["barycentric"][mine][..., None]).sum(1), at["position"][mine], atol=1e-5)
            flat = np.cross(*(positions[piece.faces[at["face"][mine].astype(int)]][:, j] -
                              positions[piece.faces[at["face"][mine].astype(int)]][:, 0] for j in (1, 2)))
            np.testing.assert_allclose(flat / np.linalg.norm(flat, axis=1, keepdims=True), at["geometric_normal"][mine], atol=1e-4)
            order = np.argsort(piece.faces[at["face"][mine].astype(int)], axis=1)
            uv = np.take_along_axis(piece.uvs[piece.uv_faces[at["face"][mine].astype(int)]], order[..., None], 1)
            np.testing.assert_allclose((uv * at["barycentric"][mine][..., None]).sum(1), at["uv"][mine], atol=1e-5)


def moving(renderer=None, shading=False):
    """Two parts that overlap, each with a place and colours of its own; gradients of the picture by all four."""
    s = Scene(orbit(2, [20, -15], 3.0, 40, (28, 24)), (0.2, 0.2, 0.2))
    for k, (mesh, shift) in enumerate(((icosphere(1, 0.6), [0, 0, 0]), (icosphere(1, 0.5), SHIFT))):
        place = s.parameter(f"place{k}", np.array(shift, float))
        color = Vertex(s.parameter(f"colors{k}", paint(mesh), low=0.0, high=1.0))
        material = Lambert(color, [Light("point", (9.0, 8.0, 7.0), (2.0, 2.0, 2.0)), Light("ambient", 0.2)]) if shading else Unlit(color)
        s.add(mesh, constant_table(mesh.positions) + place, material)
    f = s.frame(renderer)
    s.vjp("back", list(s.parameters), color=f.color, alpha=f.alpha, depth=f.depth)
    return s


@pytest.mark.parametrize("shading", [False, True], ids=["unlit", "lambert"])
def test_gradients_reach_every_part(shading):
    """Of what each pixel shows, in float64: by colours, and by places along the shading, against central differences."""
    scene, rng = moving(shading=shading), np.random.default_rng(3)
    with ReferenceSession(scene.program) as s:
        shapes = {key: s.shape(f"back.{key}.grad") for key in ("color", "depth")}
        given = {key: rng.normal(size=shape) for key, shape in shapes.items()}
        inner = s.forward("back")["alpha"] == 1  # a contour's own gradient is another matter
        given = {key: g * (inner if g.ndim == 3 else inner[..., None]) for key, g in given.items()}
        found = s.backward("back", **given)
        for name in scene.parameters:
            start, direction = s.get(name), rng.normal(size=s.shape(name))
            if name.startswith("place"):
                direction = np.asarray(scene.cameras[0].position) / 3  # towards the eye of one view: hardly any pixel changes face
            h, values = 1e-5, []
            for sign in (1, -1):
                s.set(name, start + sign * h * direction)
                after = s.forward("back")
                values.append(sum((after[key] * g).sum() for key, g in given.items()))
            s.set(name, start)
            slope = (values[0] - values[1]) / (2 * h)
            assert abs(slope) > 1e-2 and slope == pytest.approx((found[name] * direction).sum(), rel=2e-3 if "colors" in name else 5e-2)


def test_the_device_gives_the_gradients_of_the_reference(gpu):
    for renderer in IDS:
        scene, rng = moving(renderer, shading=renderer == Outline()), np.random.default_rng(4)
        with ReferenceSession(scene.program) as exact, runtime.load(gpu.compile(scene.program), gpu.device) as s:
            given = {key: rng.normal(size=s.shape(f"back.{key}.grad")) for key in ("color", "alpha")}
            one, two = exact.backward("back", **given), s.backward("back", **given)
            for name in scene.parameters:
                np.testing.assert_allclose(two[name], one[name], atol=3e-4 * np.abs(one[name]).max())
        gpu.silent()


def test_what_was_drawn_forward_is_not_drawn_again(gpu):
    with runtime.load(gpu.compile(moving().program), gpu.device) as s:
        s.forward("back")
        before = s.report()["runs"]
        s.backward("back", color=np.ones(s.shape("back.color.grad")))
        s.backward("back", alpha=np.ones(s.shape("back.alpha.grad")))
        ran = {name for name, n in s.report()["runs"].items() if n != before[name]}
        assert ran == {"back.vjp"}
        drawn = [name for name in before if name.startswith("back.prepare")]
        assert drawn and sum(len(s.plans[name]["stages"]) for name in drawn) > len(s.plans["back"]["stages"])
        with pytest.raises(InputError, match="vjp back has no output 'colour'; there are: color alpha depth"):
            s.backward("back", colour=1)
        with pytest.raises(InputError, match="the gradient by alpha has shape"):
            s.backward("back", alpha=np.ones(3))
        with pytest.raises(InputError, match="'fit' is no vjp of this bundle; there are: back"):
            s.forward("fit")


def test_two_objects_are_found_one_hidden_by_the_other(gpu):
    """Places and colours of both come back from pictures; terms are told apart."""
    want = draw(gpu, moving(), "back")
    scene = moving()
    f = scene._frames[0]
    photo, mask = scene.input("photo", want["color"]), scene.input("mask", want["alpha"])
    scene.phase("fit", 120, {"place0": Adam(0.02), "place1": Adam(0.02)}, color=l2(f.color, photo), shape=(0.5, l2(f.alpha, mask)))
    with runtime.load(gpu.compile(scene.program), gpu.device) as s:
        s.set("place0", [0.1, -0.1, 0.05])
        s.set("place1", SHIFT + [0.05, 0.1, -0.1])
        first = s.loss()
        assert first == pytest.approx(float(s.get("fit.color")) + 0.5 * float(s.get("fit.shape")), rel=1e-5)
        s.step(120)
        assert s.loss() < first / 100
        np.testing.assert_allclose(s.get("place0"), 0, atol=0.02)
        np.testing.assert_allclose(s.get("place1"), SHIFT, atol=0.02)
    gpu.silent()


def test_one_view_a_step_sees_its_own_pictures(gpu):
    """Cycling through the views gives each view's own loss, and the background of that view."""
    cams, rng = cameras(3, (40, 30)), np.random.default_rng(1)
    pictures = rng.uniform(size=(3, 30, 40, 3))
    behind = rng.uniform(size=(3, 30, 40, 3))

    def scene(order):
        s = Scene(cams, behind)
        s.add(BALL, material=Unlit(s.parameter("tint", [0.2, 0.5, 0.7])))
        photo = s.input("photo", pictures)
        f = s.frame(phase="fit", order=order)
        s.phase("fit", 3, {"tint": Sgd(1e-9)}, color=l2(f.color, f.at(photo)))
        if order == "batch":
            s.output("look", color=f.color)
        return s

    shown = draw(gpu, scene("batch"))["color"]
    each = ((shown.astype(float) - pictures) ** 2).mean((1, 2, 3))
    with runtime.load(gpu.compile(scene("cycle").program), gpu.device) as s:
        for view in range(3):
            assert s.loss() == pytest.approx(each[view], rel=1e-5)
            s.step(1)


def test_entries_that_are_not_free_stay(gpu):
    s = Scene(cameras(1, (40, 30)))
    free = (BALL.positions[:, 0] > 0).astype(float)
    x = s.parameter("vertices", BALL.positions, free=free)
    s.add(BALL, x)
    f = s.frame()
    s.phase("fit", 5, {"vertices": Adam(0.01)}, area=mean(f.alpha))
    with runtime.load(gpu.compile(s.program), gpu.device) as session:
        session.step(5)
        moved = np.abs(session.get("vertices") - BALL.positions.astype(np.float32)).max(1)
    assert (moved[free == 0] == 0).all() and (moved[free == 1] > 1e-3).any()


def test_silhouettes_alone_are_drawn_as_before_colours_were_asked_for(gpu):
    """A frame of which only alpha is read draws half of a closed surface; where colours are read, one drawing gives both."""
    def stages(*wanted):
        with runtime.load(gpu.compile(painted([(BALL, 0.0)], cameras(), Outline(), wanted).program), gpu.device) as s:
            return sum(len(plan["stages"]) for plan in s.plans.values())
    assert stages("alpha") < stages("color") and stages("alpha", "color") == stages("color", "alpha") <= stages("color") + 1


# What is wrong is said before any work, with the user's own names and lines

def ball_scene(material=None, positions=None):
    s = Scene(cameras(1, (16, 12)))
    s.add(BALL, positions, material, "ball")
    return s


def broken_type(s):
    return s.depth


def broken_attribute(s):
    return s.velocity


def broken_extent(s):
    return constant_table(np.ones((7, 3)))


@pytest.mark.parametrize("make, what", [
    (lambda: ball_scene(broken_type).frame().color, r"ball: its material broken_type at test_open_renderer.py:\d+ gives .*float.*vec3"),
    (lambda: ball_scene(broken_attribute).frame().color, r"broken_attribute at test_open_renderer.py:\d+ reads .*'velocity'"),
    (lambda: ball_scene(broken_extent).frame().color, r"broken_extent at .* over .*is needed"),
    (lambda: ball_scene(Texture(constant_table(np.ones(3)))).frame().color, "Texture gives|texture"),
    (lambda: ball_scene(0.5), "its material is 0.5; a function surface -> vec3 is needed"),
    (lambda: ball_scene(None, constant_table(np.ones((5, 3)))), "positions are .* of 5 entries; a vec3 table of the mesh's 162 vertices"),
    (lambda: ball_scene().add(BALL, name="ball"), "part 'ball': the name is taken"),
    (lambda: Scene([]).frame(), "no cameras"),
    (lambda: Scene(cameras(1)).frame(), "the scene has no parts"),
    (lambda: Scene(cameras(1), background=(1, 2)), "background has shape"),
    (lambda: ball_scene().parameter("x", np.ones((3, 5, 5, 5, 5))), "parameter x has shape"),
    (lambda: ball_scene().parameter("x", [np.nan]), "parameter x has NaN or Inf"),
    (lambda: ball_scene().parameter("x", "red"), "parameter x is 'red'; numbers are needed"),
    (lambda: ball_scene().parameter("x", 1.0, low=2.0, high=1.0), "its limits are 2.0 to 1.0"),
    (lambda: ball_scene().parameter("x", np.ones((5, 2)), free=np.ones(4)), "free has shape"),
    (lambda: ball_scene().frame(order="shuffle"), "name the phase"),
    (lambda: ball_scene().frame(phase="fit", order="random"), "order is 'random'; allowed: batch cycle shuffle"),
    (lambda: ball_scene().output("look"), "output look: nothing is given out"),
    (lambda: ball_scene().output("look", x=3.0), "output look: x is 3.0; a value of the graph is needed"),
    (lambda: ball_scene().compile("lavapipe", "x"), "no phase and gives nothing out"),
    (lambda: ball_scene().vjp("back", ["x"], a=mean(constant_table(np.ones(9)))), "vjp back: no parameter 'x'"),
], ids=lambda x: x if isinstance(x, str) else "")
def test_mistakes_are_named(make, what):
    with pytest.raises((InputError, GraphError), match=what):
        make()


def test_an_output_of_a_vjp_is_not_called_as_a_parameter_is():
    s = ball_scene()
    tint, free = s.parameter("color", [1.0, 2.0, 3.0]), s.parameter("free", 1.0)
    before = dict(s.program.values), list(s.program.plans)
    with pytest.raises(InputError, match="vjp back: an output and a parameter are both called color, and so would their gradients be, "
                                         r"back\.color\.grad; call the output something else"):
        s.vjp("back", ["free", "color"], color=tint * free)
    assert (dict(s.program.values), list(s.program.plans)) == before
    s.vjp("back", ["free"], color=tint * free)  # a parameter that no gradient is asked by
    s.vjp("other", ["free", "color"], image=tint * free)
    with ReferenceSession(s.program) as session:
        session.set("back.color.grad", [1.0, 10.0, 100.0])
        session.set("other.image.grad", [1.0, 10.0, 100.0])
        assert session.get("back.free.grad") == session.get("other.free.grad") == 321.0
        np.testing.assert_allclose(session.get("other.color.grad"), [1.0, 10.0, 100.0])


def test_a_phase_that_fails_leaves_nothing_behind():
    s = ball_scene()
    x = s.parameter("x", [1.0, 2.0, 3.0])
    y = s.parameter("y", np.ones(9), kind="table")
    before = dict(s.program.values), list(s.program.plans), list(s.phases)
    for optimize, terms, what in (({"x": Adam()}, {"a": x}, r"term a \(test_open_renderer.py:\d+\) is .*float of extent 1x1"),
                                  ({"x": Adam()}, {"a": mean(y)}, r"optimizes x \(test_open_renderer.py:\d+\), but none of its terms"),
                                  ({"z": Adam()}, {"a": mean(y)}, "no parameter 'z'; there are: x y"),
                                  ({}, {"a": mean(y)}, "something to optimize"), ({"y": Adam()}, {}, "and a loss are needed"),
                                  ({"y": Adam()}, {"step": mean(y)}, "a term is called step"),
                                  ({"y": Adam()}, {"a": (-1 + 2j, mean(y))}, "weight of term a")):
        with pytest.raises((InputError, GraphError), match=what):
            s.phase("fit", 3, optimize, **terms)
        assert (dict(s.program.values), list(s.program.plans), list(s.phases)) == before
    s.phase("fit", 3, {"x": Adam()}, a=total(dot(x, x)))
    with pytest.raises(InputError, match=r"parameter y \(test_open_renderer.py:\d+\) is used by nothing"):
        s.check()
    with pytest.raises(InputError, match="phase 'fit': a new name"):
        s.phase("fit", 3, {"x": Adam()}, a=total(dot(x, x)))


def test_a_material_of_ones_own_is_a_function(gpu):
    """Three lines, differentiated: a fresnel-like rim, against its formula on the pictures of normal and eye."""
    def rim(s):
        facing = maximum(dot(s.normal, s.to_eye), 0.0)
        return compose(1.0 - facing, facing, facing * facing)
    s = Scene(cameras(1, (60, 44)))
    s.add(BALL, material=rim)
    f = s.frame()
    s.output("look", color=f.color, normal=f.normal, position=f.position, alpha=f.alpha)
    found = draw(gpu, s)
    to_eye = s.cameras[0].position - found["position"]
    facing = np.maximum((found["normal"] * to_eye).sum(-1) / np.linalg.norm(to_eye, axis=-1), 0)
    inside = found["alpha"] == 1
    wanted = np.stack([1 - facing, facing, facing ** 2], -1)
    np.testing.assert_allclose(found["color"][inside], wanted[inside], atol=1e-5)
