"""rasterize, interpolate, texture and antialias, without PyTorch: images against NumPy float64 (tests/primitives_reference.py), gradients
against the float64 reference of their graphs and central differences. tests/test_primitives_torch.py has the functions themselves."""
import numpy as np
import primitives_reference as published
import pytest
from undertest import DEVICE

from dressi_edge.cache.errors import InputError
from dressi_edge.compiler.graph.reference_session import ReferenceSession
from dressi_edge.compiler.scene import icosphere
from dressi_edge.primitives import store as stores
from dressi_edge.primitives.boxes import boxes
from dressi_edge.primitives.graphs import build, names_of, opposite
from dressi_edge.primitives.store import Store

BALL = icosphere(1, 0.7)
TRI = np.concatenate([np.asarray(BALL.faces), [[42, 43, 44]]]).astype(np.int32)  # and a triangle with free edges, partly behind it
LOOSE = [[-0.9, -0.8, -0.2], [0.9, -0.3, 0.3], [-0.2, 0.95, 0.5]]


def clip(seed=0, views=2, level=None):
    """(views, V, 4): the ball and the triangle in perspective, turned at random."""
    rng, out = np.random.default_rng(seed), []
    for _ in range(views):
        q, _ = np.linalg.qr(rng.normal(size=(3, 3)))
        x = np.concatenate([BALL.positions, LOOSE]) @ q.T + [0.05, -0.03, -3.0]
        near, far, f = 1.0, 10.0, 3.2
        z = -(far + near) / (far - near) * x[:, 2] - 2 * far * near / (far - near)
        out.append(np.stack([f * x[:, 0], f * x[:, 1], z, -x[:, 2]], 1))
    return np.array(out)


@pytest.fixture(scope="module")
def store(tmp_path_factory):
    patch = pytest.MonkeyPatch()
    patch.setenv("DRESSI_CACHE", str(tmp_path_factory.mktemp("cache")))
    made = Store(DEVICE)
    yield made
    made.close()
    patch.undo()


def near(a, b, worst=1e-5):
    assert a.shape == b.shape and np.abs(a - b).max() < worst, np.abs(a - b).max()


@pytest.fixture(scope="module")
def scene(store):
    """Clip coordinates as the device has them, what rasterize gives, and the published answer."""
    pos = clip().astype(np.float32)
    primitive = store.find("rasterize", TRI, (45, 2, (61, 47)), {})
    found, _ = primitive.forward({"pos": pos.reshape(-1, 4)})
    return pos, found, published.rasterize(pos.astype(float), TRI, 47, 61), primitive.columns


def test_rasterize_is_what_is_published(scene):
    pos, found, (rast, db, sure), _ = scene
    covered = (rast[..., 3] > 0) & sure
    assert sure.mean() > 0.8 and 0.3 < covered.mean() < 0.9 and len(np.unique(rast[..., 3][sure])) > 40
    np.testing.assert_array_equal(found["rast"][sure][:, 3], rast[sure][:, 3])
    near(found["rast"][sure], rast[sure])
    assert np.abs(found["db"] - db)[sure].max() < 1e-5 * max(1.0, np.abs(db[sure]).max())


def test_between_the_planes_alone(store):
    primitive = store.find("rasterize", np.array([[0, 1, 2]], np.int32), (3, 1, (16, 16)), {})
    for z, there in ((0.0, True), (-1.5, False), (1.5, False), (0.99, True), (-0.99, True)):
        pos = np.array([[-0.9, -0.9, z, 1], [0.9, -0.9, z, 1], [0, 0.9, z, 1]], np.float32)
        rast = primitive.forward({"pos": pos})[0]["rast"]
        assert (rast[0, 8, 8, 3] == 1) == there and (not there or abs(rast[0, 8, 8, 2] - z) < 1e-6)
        assert not there or (rast[0, 1, :, 3].any() and not rast[0, -1, :, 3].any())  # row 0 is where y is least


@pytest.mark.parametrize("each, channels", [(True, 3), (False, 6), (False, 1), (False, 5)])
def test_interpolate_is_what_is_published(store, scene, each, channels):
    _, found, _, columns = scene
    attr = np.random.default_rng(1).normal(size=(2 if each else 1, 45, channels)).astype(np.float32)
    given = {"attr": attr.reshape(-1, channels), "rast": found["rast"], "boxes": boxes(found["rast"], len(TRI), columns)}
    sizes = (45, 2, (61, 47), channels, each)
    out = store.find("interpolate", TRI, sizes, {"attr": channels, "out": channels}).forward(given)[0]["out"]
    wanted, da = published.interpolate(attr.astype(float), found["rast"].astype(float), TRI, found["db"].astype(float))
    near(out, wanted)
    slopes = store.find("slopes", TRI, sizes, {"attr": channels, "x": channels, "y": channels}).forward({**given, "db": found["db"]})[0]
    near(np.stack([slopes["x"], slopes["y"]], -1).reshape(da.shape), da, 1e-5 * max(1.0, np.abs(da).max()))


@pytest.mark.parametrize("filter_mode, boundary", [("linear", "wrap"), ("linear", "clamp"), ("nearest", "wrap"), ("nearest", "clamp")])
def test_texture_is_what_is_published(store, filter_mode, boundary):
    rng = np.random.default_rng(2)
    tex, uv = rng.uniform(size=(1, 9, 14, 3)).astype(np.float32), rng.uniform(-0.6, 1.6, (2, 12, 17, 2)).astype(np.float32)
    primitive = store.find("texture", None, (2, (17, 12), (14, 9), 3, filter_mode, boundary, None, False), {"tex": 3, "out": 3})
    wanted = published.texture(tex.astype(float), uv.astype(float), filter_mode, boundary)
    near(primitive.forward({"tex": tex[0], "uv": uv})[0]["out"], wanted)


def test_a_mipmap_is_the_texture_where_it_is_magnified_and_its_mean_far_away(store):
    rng = np.random.default_rng(3)
    tex, uv = rng.uniform(size=(16, 32, 3)).astype(np.float32), rng.uniform(0, 1, (1, 12, 17, 2)).astype(np.float32)

    def drawn(step, mode="linear-mipmap-linear", top=None, bias=None):
        da = np.zeros((1, 12, 17, 4), np.float32)
        da[..., 0], da[..., 3] = step / 32, step / 16
        sizes = (1, (17, 12), (32, 16), 3, mode, "wrap", top, bias is not None)
        more = {} if bias is None else {"bias": np.full((1, 12, 17), bias, np.float32)}
        return store.find("texture", None, sizes, {"tex": 3, "out": 3}).forward({"tex": tex, "uv": uv, "da": da, **more})[0]["out"]

    plain = published.texture(tex[None].astype(float), uv.astype(float), "linear", "wrap")
    near(drawn(0.7), plain)
    near(drawn(64.0), np.broadcast_to(tex.mean((0, 1)), plain.shape))
    near(drawn(64.0, top=0), plain)
    half = tex.reshape(8, 2, 16, 2, 3).mean((1, 3))
    one = published.texture(half[None].astype(float), uv.astype(float), "linear", "wrap")
    near(drawn(2.0), one)
    near(drawn(2.4, "linear-mipmap-nearest"), one)
    near(drawn(2.0 ** 0.25), 0.75 * plain + 0.25 * one)
    near(drawn(1.0, bias=1.0), one)


def test_antialias_is_what_is_published(store, scene):
    pos, found, _, columns = scene
    color = np.random.default_rng(4).uniform(size=(2, 47, 61, 6)).astype(np.float32)
    color *= (found["rast"][..., 3:] > 0)
    given = {"color": color, "pos": pos.reshape(-1, 4), "rast": found["rast"], "boxes": boxes(found["rast"], len(TRI), columns, 1)}
    out = store.find("antialias", TRI, (45, 2, (61, 47), 6), {"color": 6, "out": 6}).forward(given)[0]["out"]
    wanted = published.antialias(color.astype(float), found["rast"].astype(float), pos.astype(float), TRI)
    blended = np.abs(wanted - color).max(-1) > 0
    assert 150 < blended.sum() < 1500
    far = np.abs(out - wanted).max(-1)
    assert np.count_nonzero(far > 1e-5) <= 0.01 * blended.sum(), (far > 1e-5).sum()  # crossings within rounding of the ends of the way


# Gradients


def exact(name, *sizes):
    return ReferenceSession(build(name, *sizes).program)


def slope_error(session, given, outputs, by, seed, h=1e-5, step=None):
    """Of the float64 graph: the gradient along a direction less the central difference, and the gradient."""
    rng = np.random.default_rng(seed)
    session.set_all(given)
    weights = {key: rng.normal(size=session.shape(f"f.{key}")) for key in outputs}
    if "rast" in weights:
        weights["rast"][..., 2:] = 0.0  # depth and triangle have no gradient
    gradient = session.backward("f", **weights)[by]
    direction = rng.normal(size=gradient.shape) if step is None else step
    values = []
    for sign in (1, -1):
        session.set(by, given[by] + sign * h * direction)
        values.append(sum((session.forward("f")[key] * weights[key]).sum() for key in outputs))
    session.set(by, given[by])
    return (gradient * direction).sum() - (values[0] - values[1]) / (2 * h), gradient, weights


@pytest.fixture(scope="module")
def little():
    """A few triangles, in float64."""
    ball = icosphere(0, 0.7)
    x = ball.positions @ np.linalg.qr(np.random.default_rng(5).normal(size=(3, 3)))[0].T + [0.05, -0.03, -3.0]
    pos = np.stack([3.2 * x[:, 0], 3.2 * x[:, 1], -11 / 9 * x[:, 2] - 20 / 9, -x[:, 2]], 1)
    tri = np.asarray(ball.faces, np.int32)
    rast, db, _ = published.rasterize(pos[None], tri, 11, 14)
    return pos, tri, rast, db


def test_the_gradient_of_rasterize_is_that_of_its_weights_and_their_slopes(little, store):
    pos, tri, *_ = little
    for outputs in (["rast"], ["db"]):
        error, gradient, weights = slope_error(exact("rasterize", tri, 12, 1, (14, 11)), {"pos": pos}, outputs, "pos", 6,
                                               step=np.random.default_rng(7).normal(size=pos.shape) * [1, 1, 0, 1])
        assert abs(error) < 1e-5 * np.abs(gradient).max() and not gradient[:, 2].any()
        primitive = store.find("rasterize", tri, (12, 1, (14, 11)), {})
        ours = primitive.backward(primitive.forward({"pos": pos.astype(np.float32)})[1], weights, ["pos"])["pos"]
        assert np.abs(ours - gradient).max() < 2e-4 * np.abs(gradient).max()


@pytest.mark.parametrize("by", ["attr0", "rast"])
def test_the_gradient_of_interpolate(little, by):
    pos, tri, rast, _ = little
    given = {"attr0": np.random.default_rng(8).normal(size=(12, 3)), "rast": rast, "boxes": boxes(rast, len(tri), 1)}
    step = None if by == "attr0" else np.random.default_rng(9).normal(size=rast.shape) * [1, 1, 1, 0]
    error, gradient, _ = slope_error(exact("interpolate", tri, 12, 1, (14, 11), 3, False), given, ["out0"], by, 10, step=step)
    assert abs(error) < 1e-7 * np.abs(gradient).max() and (by == "attr0" or not gradient[..., 2:].any())


@pytest.mark.parametrize("by", ["attr0", "db"])
def test_the_gradient_of_slopes(little, by):
    pos, tri, rast, db = little
    given = {"attr0": np.random.default_rng(8).normal(size=(12, 2)), "rast": rast, "db": db, "boxes": boxes(rast, len(tri), 1)}
    error, gradient, _ = slope_error(exact("slopes", tri, 12, 1, (14, 11), 2, False), given, ["x0", "y0"], by, 10)
    assert abs(error) < 1e-7 * np.abs(gradient).max()


@pytest.mark.parametrize("by", ["tex0", "uv"])
def test_the_gradient_of_texture(by):
    rng = np.random.default_rng(11)
    given = {"tex0": rng.uniform(size=(5, 6, 3)), "uv": rng.uniform(-0.3, 1.3, (1, 7, 8, 2))}
    session = exact("texture", None, 1, (8, 7), (6, 5), 3, "linear", "wrap", None, False)
    error, gradient, _ = slope_error(session, given, ["out0"], by, 12, 1e-7)
    assert abs(error) < 1e-5 * np.abs(gradient).max()


@pytest.mark.parametrize("by", ["color0", "pos"])
def test_the_gradient_of_antialias(little, store, by):
    pos, tri, rast, _ = little
    color = np.random.default_rng(13).uniform(size=(1, 11, 14, 3)) * (rast[..., 3:] > 0)
    given = {"color0": color, "pos": pos, "rast": rast, "boxes": boxes(rast, len(tri), 1, 1)}
    error, gradient, weights = slope_error(exact("antialias", tri, 12, 1, (14, 11), 3), given, ["out0"], by, 14, 1e-6)
    assert abs(error) < 1e-6 * np.abs(gradient).max() and np.abs(gradient).max() > 0.1
    primitive = store.find("antialias", tri, (12, 1, (14, 11), 3), {"color": 3, "out": 3})
    arrays = {"color": color, "pos": pos, "rast": rast, "boxes": given["boxes"]}
    call = primitive.forward({k: x.astype(np.float32) if x.dtype == float else x for k, x in arrays.items()})[1]
    ours = primitive.backward(call, {"out": weights["out0"]}, [by.rstrip("0")])[by.rstrip("0")]
    assert np.abs(ours - gradient).max() < 1e-3 * np.abs(gradient).max()


# What is around them


def test_boxes_hold_every_pixel_that_names_a_triangle():
    rng = np.random.default_rng(15)
    rast = np.zeros((3, 7, 9, 4), np.float32)
    rast[..., 3] = rng.integers(0, 6, (3, 7, 9)) * (rng.uniform(size=(3, 7, 9)) < 0.3)
    for beside in (0, 1):
        found = boxes(rast, 6, 2, beside).reshape(3, 6, 4)
        for k in range(3):
            corner = np.array([k % 2 * 9, k // 2 * 7])
            for t in range(6):
                ys, xs = np.nonzero(rast[k, ..., 3] == t + 1)
                wanted = np.zeros(4) if not len(ys) else np.concatenate([
                    np.maximum([xs.min() - beside, ys.min() - beside], 0) + corner, np.array([xs.max() + 1, ys.max() + 1]) + corner])
                np.testing.assert_array_equal(found[k, t], wanted)
    with pytest.raises(InputError, match="rast names triangle 5; there are 0 to 4"):
        boxes(np.full((1, 2, 2, 4), 6.0), 5, 1)


def test_across_an_edge_is_the_other_triangles_corner():
    assert opposite(np.array([[0, 1, 2], [2, 1, 3]])).tolist() == [[3, 1, 2], [2, 1, 0]]
    assert opposite(np.array([[0, 1, 2]])).tolist() == [[0, 1, 2]]
    assert opposite(np.array([[0, 1, 2], [1, 0, 3], [0, 1, 4]]))[:, 2].tolist() == [3, 2, 2]
    assert names_of("x", 9) == ["x0", "x1", "x2"]


def test_a_function_is_compiled_once_kept_in_memory_and_on_disk_and_anew_where_that_is_damaged(tmp_path, monkeypatch):
    monkeypatch.setenv("DRESSI_CACHE", str(tmp_path))
    built = []
    monkeypatch.setattr(stores, "build", lambda *a, **how: built.append(a[0]) or build(*a, **how))
    sizes = (1, (8, 8), (4, 4), 3, "linear", "wrap", None, False)
    wide = {"tex": 3, "out": 3}

    def drawn(**how):
        s = Store(DEVICE, **how)
        try:
            first = s.find("texture", None, sizes, wide)
            assert s.find("texture", None, sizes, wide) is first
            return first.forward({"tex": np.ones((4, 4, 3)), "uv": np.zeros((1, 8, 8, 2))})[0]["out"]
        finally:
            s.close()

    assert (drawn() == 1).all() and built == ["texture"]
    assert (drawn() == 1).all() and built == ["texture"]
    file, = (tmp_path / "functions").glob("*.dressi")
    file.write_bytes(file.read_bytes()[:-100])
    assert (drawn() == 1).all() and built == ["texture"] * 2
    assert (drawn(profile="vulkan_min") == 1).all() and built == ["texture"] * 3
    monkeypatch.setenv("DRESSI_CACHE", "off")
    assert (drawn() == 1).all() and built == ["texture"] * 4


def test_only_wanted_gradients_are_compiled_and_who_wants_none_takes_what_is_open(store):
    sizes, wide = (1, (8, 8), (5, 4), 3, "linear", "wrap", None, False), {"tex": 3, "out": 3}
    one = store.find("texture", None, sizes, wide, ["tex"])
    assert list(one.pure.parameters) == ["tex0"] and store.find("texture", None, sizes, wide, []) is one
    both = store.find("texture", None, sizes, wide, ["uv", "tex"])
    assert sorted(both.pure.parameters) == ["tex0", "uv"] and both is store.find("texture", None, sizes, wide, ["tex", "uv"])
    arrays = {"tex": np.random.default_rng(0).uniform(size=(4, 5, 3)), "uv": np.random.default_rng(1).uniform(size=(1, 8, 8, 2))}
    weights = {"out": np.random.default_rng(2).normal(size=(1, 8, 8, 3))}
    found = [f.backward(f.forward(arrays)[1], weights, ["tex"])["tex"] for f in (one, both)]
    np.testing.assert_array_equal(*found)


def test_those_not_used_for_longest_are_closed(monkeypatch, tmp_path):
    monkeypatch.setenv("DRESSI_CACHE", str(tmp_path))
    monkeypatch.setattr(stores, "MOST", 1)
    s = Store(DEVICE)
    try:
        found = [s.find("texture", None, (1, (8, k), (4, 4), 1, "linear", "wrap", None, False), {}) for k in (8, 9)]
        assert found[0].pure.session._closed and not found[1].pure.session._closed
    finally:
        s.close()
