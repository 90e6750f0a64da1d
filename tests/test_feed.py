"""Pictures that are brought to the device view by view: the same bits as with all of them there, whatever the window, the order and where
they come from; what is missing or wrong is named."""

import inspect
import shutil
import zlib

import msgpack
import numpy as np
import pytest
from PIL import Image
from test_views import write_views

from dressi_edge import runtime
from dressi_edge.cache import bundle as bundles
from dressi_edge.cache import kept as kept_parts
from dressi_edge.cache.errors import BundleError, InputError
from dressi_edge.cache.feed import Feed, differences, summed
from dressi_edge.cache.layout import Layout
from dressi_edge.cache.vulkan import FORMATS
from dressi_edge.cli import main
from dressi_edge.compiler.graph.ops import texture_gradient
from dressi_edge.compiler.graph.ops.packed import unorm8
from dressi_edge.compiler.graph.program import Program
from dressi_edge.compiler.graph.reference_session import ReferenceSession
from dressi_edge.compiler.io.again import reader, recorded
from dressi_edge.compiler.io.cameras import orbit
from dressi_edge.compiler.io.decode import Masks, Photograph
from dressi_edge.compiler.io.lens import Lens
from dressi_edge.compiler.io.pictures import Pictures
from dressi_edge.compiler.io.shapes import sphere
from dressi_edge.compiler.io.views import Views, load_views
from dressi_edge.compiler.render.loss import ssim_loss
from dressi_edge.compiler.render.optimizer import Adam, Sgd
from dressi_edge.compiler.render.raster import Softness
from dressi_edge.compiler.render.schedule import Schedule
from dressi_edge.compiler.scene import targets
from dressi_edge.compiler.scene.problem import Loss, Problem
from dressi_edge.compiler.scene.results import measure
from dressi_edge.runtime import kept, vk
from dressi_edge.runtime.work import Work

pytest_plugins = ["gpu"]

N, SIZE = 7, (40, 30)
NAMES = ("vertices", "vertices.adam_m", "texture", "texture.adam_v", "shape.step", "paint.step")


@pytest.fixture(autouse=True)
def few(monkeypatch):
    """Seven views of 40x30 count as many, and three of them make a window."""
    monkeypatch.setattr(targets, "SMALL", 1000)
    monkeypatch.setattr(targets, "SLOTS", 3)


def blobs():
    """Pictures of a blob that no two views show alike, soft at its rim, and their cameras."""
    rng = np.random.default_rng(3)
    y, x = np.mgrid[:SIZE[1], :SIZE[0]] + 0.5
    images = []
    for k in range(N):
        r = np.hypot(x - 20 - np.cos(k), y - 15 + np.sin(k)) / (9 + k % 3)
        alpha = np.clip((1.0 - r) * 8.0, 0.0, 1.0)
        images.append(np.concatenate([rng.random((*r.shape, 3)), alpha[..., None]], -1))
    return images, orbit(N, [20.0, -15.0], 2.6, 50.0, SIZE)


@pytest.fixture(scope="module")
def photos(tmp_path_factory):
    """A folder of views of a blob."""
    return write_views(tmp_path_factory.mktemp("photos"), *blobs())


def fit(views, order="shuffle", **how):
    problem = Problem(sphere(42, 0.7), views, order=order, seed=4, albedo="texture", texture_size=(24, 16), **how)
    problem.phase("shape", 9, {"vertices": Adam(0.02)}, [Loss("silhouette"), Loss("laplacian", 0.1)], Softness(2.0))
    problem.phase("paint", 6, {"texture": Adam(0.05)}, [Loss("color", masked=True)], Softness(1.0, delta=0.0))
    problem.render("render", Softness(1.0, delta=0.0))
    return problem


def made(gpu, problem, path):
    problem.compile(gpu.at_hand("lavapipe"), path)
    return path


def solved(session, chunks=(1, 4, 2, 1, 9), paint=(6, 2)):
    losses = []
    for n in chunks:
        session.step(n, "shape")
        losses.append(session.loss())
    for n in paint:
        session.step(n, "paint")
        losses.append(session.loss())
    return losses, {name: session.get(name).tobytes() for name in NAMES}, session.get("render.color").tobytes()


@pytest.fixture(scope="module")
def whole(gpu, photos, tmp_path_factory):
    """Of each order, with all views on the device as floats."""
    found = {}
    for order in ("shuffle", "cycle", "batch", "accumulate"):
        path = made(gpu, fit(load_views(photos), order, whole=True), tmp_path_factory.mktemp("whole") / "x.dressi")
        with runtime.load(path, gpu.device) as session:
            assert "pictures" not in session.bundle.description["meta"]
            found[order] = solved(session)
    return found


# ---- the same bits


@pytest.mark.parametrize("order", ["shuffle", "cycle", "batch", "accumulate"])
@pytest.mark.parametrize("embed", [True, False], ids=["embedded", "outside"])
def test_a_window_gives_the_bits_of_all_views(gpu, photos, whole, tmp_path, order, embed):
    path = made(gpu, fit(load_views(photos), order, embed=embed), tmp_path / "x.dressi")
    with runtime.load(path, gpu.device) as session:
        value = session.values["targets"]
        assert (value["count"], value["type"]) == (N if order == "batch" else 3, "int") and session.shape("targets") == (N, 30, 40, 4)
        if not embed:
            session.pictures(reader(photos, session.bundle.description["meta"]["pictures"], False))
        assert solved(session) == whole[order]
    gpu.silent()


@pytest.mark.parametrize("slots", [1, 2, 5, 7, 20])
def test_how_many_views_a_window_has_makes_no_difference(gpu, photos, whole, tmp_path, monkeypatch, slots):
    monkeypatch.setattr(targets, "SLOTS", slots)
    path = made(gpu, fit(load_views(photos)), tmp_path / "x.dressi")
    with runtime.load(path, gpu.device) as session:
        assert session.values["targets"]["count"] == min(slots, N)
        assert solved(session, (9, 8), (8,))[1:] == whole["shuffle"][1:]
    gpu.silent()


@pytest.mark.parametrize("how", ["averaged", "linear", "arrays", "float arrays"])
def test_pictures_of_other_kinds_give_the_bits_of_all_views(gpu, photos, tmp_path, how):
    views = load_views(photos, (20, 15) if how == "averaged" else None)
    if how == "linear":
        views = views.linear()
    if "arrays" in how:
        images = np.asarray(views.images)
        views = Views(images * np.float32(0.999) if how == "float arrays" else images, views.cameras, views.names)
    found = []
    for k, more in enumerate(({"whole": True}, {}, {"embed": False})):
        path = made(gpu, fit(views, **more), tmp_path / f"{k}.dressi")
        with runtime.load(path, gpu.device) as session:
            if k:
                assert session.values["targets"]["type"] == ("vec4" if how in ("averaged", "float arrays") else "int")
            if k == 2:
                meta = session.bundle.description["meta"]["pictures"]
                session.pictures(views.images.__getitem__ if "arrays" in how else reader(photos, meta, how == "linear"))
            found.append((solved(session), session.get("targets").tobytes()))
    assert found[1] == found[0] and found[2] == found[0]
    gpu.silent()


def test_every_byte_is_what_numpy_makes_of_it(gpu):
    """k / 255 to the last bit, on the device and in the reference to fp32; and a table's."""
    p, table = Program(), np.linspace(1.0, -3.0, 256).astype(np.float32) ** 3
    rng = np.random.default_rng(0)
    rows = np.stack([rng.permutation(256) for _ in range(4)], -1).astype(np.uint8).reshape(16, 16, 4)
    packed = p.input("packed", Layout("image", "int", 16, 16), rows.view("<i4")[..., 0])
    p.plan("out", outputs={"plain": (unorm8(packed), Layout("image", "vec4", 16, 16)),
                           "table": (unorm8(packed, table), Layout("image", "vec4", 16, 16))})
    found, wanted = gpu.run(p, {}), rows.astype(np.float32) / np.float32(255.0)
    assert np.array_equal(found["plain"], wanted)
    assert np.array_equal(found["table"], np.concatenate([table[rows[..., :3]], wanted[..., 3:]], -1))
    with ReferenceSession(p) as session:
        assert np.array_equal(session.get("plain").astype(np.float32), wanted)


# ---- the gradient of all views, one at a time


def fit_all(views, order, optimizer, **how):
    problem = Problem(sphere(42, 0.7), views, order=order, albedo="texture", texture_size=(24, 16), **how)
    problem.phase("shape", 3, {"vertices": optimizer(0.02)}, [Loss("silhouette"), Loss("laplacian", Schedule(0.1, 0.01, 3, "linear"))])
    problem.phase("paint", 4, {"texture": optimizer(0.05)}, [Loss("color", masked=True)], Softness(1.0, delta=0.0))
    return problem


@pytest.fixture(scope="module")
def six(photos):
    """As many views as fill an atlas."""
    views = load_views(photos)
    return Views(np.asarray(views.images)[:6], views.cameras[:6], views.names[:6])


@pytest.mark.parametrize("optimizer", [Adam, lambda rate: Sgd(rate, 0.9)], ids=["adam", "momentum"])
def test_the_gradients_of_a_round_are_those_of_all_views_at_once(six, optimizer):
    """In float64: parameters and moments after as many rounds as there were steps, and in between as they were."""
    found = []
    for order in ("batch", "accumulate"):
        with ReferenceSession(fit_all(six, order, optimizer, whole=True).program) as session:
            for phase, name in (("shape", "vertices"), ("paint", "texture")):
                for _ in range(2):
                    before = session.get(name)
                    if order == "accumulate":
                        session.step(5, phase)
                        assert np.array_equal(session.get(name), before)
                    session.step(1, phase)
                    assert not np.array_equal(session.get(name), before)
                    found.append({k: session.get(k) for k in session.values if k.startswith(("vertices", "texture"))})
    assert all(x.keys() == y.keys() for x, y in zip(found[:4], found[4:]))
    for x, y in zip(found[:4], found[4:]):
        for name in x:
            assert np.allclose(x[name], y[name], rtol=1e-9, atol=1e-12), name


def test_rounds_on_a_device_give_what_all_views_at_once_give(gpu, six, tmp_path):
    found = []
    for order in ("batch", "accumulate"):
        path = made(gpu, fit_all(six, order, Adam), tmp_path / f"{order}.dressi")
        with runtime.load(path, gpu.device) as session:
            assert [session.plans[phase]["steps"] for phase in session.phases] == ([3, 4] if order == "batch" else [18, 24])
            for phase in session.phases:
                session.step(session.plans[phase]["steps"], phase)
            found.append((session.get("vertices"), session.get("texture")))
            if order == "accumulate":
                assert session.values["targets"]["count"] == 3 and session.report()["views_kept"] == {"paint": 6}
    for x, y in zip(*found):
        assert np.abs(x - y).max() < 2e-4 and np.abs(x - y).mean() < 1e-6
    gpu.silent()


# ---- what is kept of each view


def painted(session, chunks=(1, 2, 9, 1, 8)):
    """Losses and states after steps of the texture on a shape at rest."""
    losses = []
    for n in chunks:
        session.step(n, "paint")
        losses.append(session.loss())
    return losses, {name: session.get(name).tobytes() for name in NAMES}


@pytest.fixture(scope="module")
def unkept(gpu, photos, tmp_path_factory):
    """The same steps, each of which works everything out."""
    path = made(gpu, fit(load_views(photos), whole=True), tmp_path_factory.mktemp("unkept") / "x.dressi")
    with runtime.load(path, gpu.device) as session:
        assert "kept" not in session.bundle.description["meta"]
        found = painted(session)
        session.set("vertices", session.get("vertices") * np.float32(1.125))
        return found, painted(session)


@pytest.fixture(scope="module")
def keeping(gpu, photos, tmp_path_factory):
    """A bundle of which views are kept, all pixels of them, and what one of them takes."""
    return kept_of(gpu, photos, tmp_path_factory)


@pytest.fixture(scope="module")
def listing(gpu, photos, tmp_path_factory):
    """The same, where lists are kept of the pixels that sample the texture, as of views that have many."""
    return kept_of(gpu, photos, tmp_path_factory, 100)


def kept_of(gpu, photos, tmp_path_factory, many=texture_gradient.MANY):
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(targets, "SMALL", 1000)
        patch.setattr(targets, "SLOTS", 3)
        patch.setattr(texture_gradient, "MANY", many)
        path = made(gpu, fit(load_views(photos)), tmp_path_factory.mktemp("keeping") / "x.dressi")
    with runtime.load(path, gpu.device) as session:
        assert [x["input"] for x in session.bundle.description["meta"]["kept"]] == ["paint.view"], "vertices move in the other phase"
        session.step(1, "paint")
        assert session.report()["views_kept"] == {"paint": 1}
        return path, session._kept.bytes


@pytest.mark.parametrize("room", [0, 1, 3, 100])
@pytest.mark.parametrize("kind", ["keeping", "listing"])
def test_how_many_views_are_kept_makes_no_difference(gpu, request, kind, unkept, monkeypatch, room):
    path, size = request.getfixturevalue(kind)
    assert bool(bundles.read(path).description["meta"]["kept"][0]["lists"]) == (kind == "listing")
    monkeypatch.setattr(kept, "USUAL_BYTES", room * size)
    with runtime.load(path, gpu.device) as session:
        before = session.report()["image_bytes"]
        assert painted(session) == unkept[0]
        report = session.report()
        if kind == "keeping":
            assert report["views_kept"] == {"paint": min(room, N)} and report["image_bytes"] == before + min(room, N) * size
        assert report["image_bytes"] <= before + room * size
        made_once = report["runs"]["paint.prepare"]
        assert made_once == N if room > N else made_once > N
        session.set("vertices", session.get("vertices") * np.float32(1.125))
        assert painted(session) == unkept[1], "what was kept of another shape is made again"
        assert session.report()["image_bytes"] <= before + room * size
    gpu.silent()


def test_of_lists_as_much_is_kept_as_there_are_entries(gpu, listing):
    with runtime.load(listing[0], gpu.device) as session:
        d = session.bundle.description
        session.step(1, "paint")
        few, = session._kept._copies["paint.view"].values()
        turn = session._kept.turns["paint"]
        rows = {image: r["height"] for image, r in zip(turn.images, few.own.records)}
        formats = sorted(d["images"][image]["format"] for image in turn.lists)
        assert formats == sorted(FORMATS[x] for x in ("R32_SINT", "R32_SINT", "R32_SFLOAT", "R32G32_SFLOAT")), (
            "a pixel's number, from which its place is had, which layer it takes its colour from, its coverage and uv; not that it samples")
        covered = np.count_nonzero(session.get("render.color", view=int(turn.order[0]))[..., 3])
        for image, (_, column) in turn.lists.items():
            record = d["images"][image]
            assert column == record["width"] and rows[image] == -(-covered // column) < record["height"]
        near = session.get("vertices")
        session.set("vertices", near * np.float32(1.5))
        session.set("paint.step", 0)
        session.step(1)
        more, = session._kept._copies["paint.view"].values()
        assert more is not few and all(a["height"] >= b["height"] for a, b in zip(more.own.records, few.own.records))
        session.set("vertices", near)
        session.set("paint.step", 0)
        session.step(1)
        assert list(session._kept._copies["paint.view"].values()) == [more], "there is room enough"
    gpu.silent()


@pytest.mark.parametrize(("width", "height", "column"), [(4, 10, 4), (64, 100, 64), (256, 30, 64), (128, 7, 64)])
def test_the_part_of_an_image_that_is_kept_holds_all_entries(width, height, column):
    for count in (0, 1, column, column + 1, column * height - 1, column * height, column * height + 1, width * height):
        count = min(count, width * height)
        w, h = kept_parts.part((width, height), column, count)
        k = np.arange(count)
        x, y = k // (column * height) * column + k % column, k // column % height
        assert 0 < w <= width and 0 < h <= height and (x < w).all() and (y < h).all()
        assert w * h - count < column * (height if w > column else 1) + (count == 0)


def test_a_loss_of_pixels_and_their_neighbours_is_kept_pixel_by_pixel(gpu, photos, tmp_path, monkeypatch):
    monkeypatch.setattr(texture_gradient, "MANY", 100)
    found = []
    for whole in (True, False):
        problem = Problem(sphere(42, 0.7), load_views(photos), order="shuffle", albedo="texture", texture_size=(24, 16), whole=whole)
        problem.phase("paint", 6, {"texture": Adam(0.05)},
                      [lambda frame, target: ssim_loss(frame.color, target.xyz, cell=frame.cell)], Softness(1.0))
        path = made(gpu, problem, tmp_path / f"{whole}.dressi")
        with runtime.load(path, gpu.device) as session:
            session.step(9, "paint")
            found.append((session.loss(), session.get("texture").tobytes()))
            if not whole:
                assert session.report()["views_kept"] == {"paint": N}
                assert not session._kept.turns["paint"].lists
    assert found[0] == found[1]


def test_steps_of_views_that_are_kept_are_one_submission(gpu, keeping, monkeypatch):
    submitted, submit = [], Work.submit
    monkeypatch.setattr(Work, "submit", lambda self, commands, *more: submitted.append(len(commands)) or submit(self, commands, *more))
    monkeypatch.setattr(targets, "SLOTS", 3)
    with runtime.load(keeping[0], gpu.device) as session:
        session.step(2 * N, "paint")
        submitted.clear()
        session.step(9)
        assert [n for n in submitted if n > 1] == [3, 3, 3], "the window has three pictures"


def test_a_step_that_was_interrupted_is_gone_on_from(gpu, keeping, unkept, monkeypatch):
    """Before the submission, in it, and after it, wherever views are made, kept and read."""
    real, left = vk.WaitForFences, [0]

    def wait(*arguments):
        left[0] -= 1
        if left[0] == 0:
            raise KeyboardInterrupt
        return real(*arguments)

    with runtime.load(keeping[0], gpu.device) as session:
        monkeypatch.setattr(vk, "WaitForFences", wait)
        done, k = 0, 0
        while done < 21:
            k += 1
            left[0] = k
            try:
                session.step(min(3, 21 - done), "paint")
            except KeyboardInterrupt:
                pass
            left[0] = 0
            done = int(session.get("paint.step"))
        assert {name: session.get(name).tobytes() for name in NAMES} == unkept[0][1] and k > 10


def test_what_is_kept_is_no_business_of_checkpoints(gpu, keeping, unkept, tmp_path):
    with runtime.load(keeping[0], gpu.device) as session:
        session.step(12, "paint")
        session.checkpoint(tmp_path / "a")
        session.step(1)
        session.set("paint.step", 3)
        assert session.loss() == session.loss()
        session.restore(tmp_path / "a")
        session.checkpoint(tmp_path / "b")
        assert (tmp_path / "a").read_bytes() == (tmp_path / "b").read_bytes()
        session.step(9)
        assert {name: session.get(name).tobytes() for name in NAMES} == unkept[0][1]
        session.set("paint.view", 6)  # it is the session's
        session.profile_stages("paint", 1)
    with runtime.load(keeping[0], gpu.device) as session:
        session.restore(tmp_path / "a")
        session.step(9, "paint")
        assert {name: session.get(name).tobytes() for name in NAMES} == unkept[0][1]
    gpu.silent()


def test_a_budget_holds_for_what_is_kept_too(gpu, photos, unkept, keeping, tmp_path):
    with runtime.load(keeping[0], gpu.device) as session:
        alone = session.report()["image_bytes"]
    path = made(gpu, fit(load_views(photos), memory=alone + 5 * keeping[1] // 2), tmp_path / "x.dressi")
    with runtime.load(path, gpu.device) as session:
        assert painted(session) == unkept[0]
        assert session.report()["views_kept"] == {"paint": 2} and session.report()["image_bytes"] <= alone + 5 * keeping[1] // 2


def test_a_device_without_memory_keeps_nothing(gpu, keeping, unkept, monkeypatch):
    real = vk.AllocateMemory

    def allocate(device, info):
        if sum(1 for frame in inspect.stack() if frame.function == "_room"):
            raise vk.VulkanError("vkAllocateMemory", vk.VK_ERROR_OUT_OF_DEVICE_MEMORY)
        return real(device, info)

    with runtime.load(keeping[0], gpu.device) as session:
        monkeypatch.setattr(vk, "AllocateMemory", allocate)
        assert painted(session) == unkept[0] and session.report()["views_kept"] == {"paint": 0}


def test_a_reader_that_does_not_know_of_it_is_asked_for_the_view(gpu, photos):
    with ReferenceSession(fit(load_views(photos)).program) as session:
        session.set("targets", np.zeros((3, 30, 40), int))
        with pytest.raises(InputError, match="paint.view"):
            session.step(1, "paint")


@pytest.mark.parametrize(("key", "value"), [
    ("input", "vertices"), ("input", "lost"), ("counter", "texture"), ("counter", "paint.view"), ("order", b""), ("order", b"123"),
    ("order", np.full(2, -1, "<i4").tobytes()), ("order", 3), ("memory", "x"), ("memory", -1), ("lists", 3), ("lists", "last"),
    ("lists", "format"), ("lists", "column")])
def test_a_bundle_that_misleads_about_what_is_kept_is_refused(gpu, listing, tmp_path, key, value):
    path = tmp_path / "x.dressi"
    if key == "lists" and value != 3:  # a total that is not kept; one that is no number
        (image, total, column), (other, *_) = bundles.read(listing[0]).description["meta"]["kept"][0]["lists"][:2]
        value = [{"last": [image, 0, column], "format": [image, other, column], "column": [image, total, column - 1]}[value]]
    misled(listing[0], path, lambda meta: {**meta, "kept": [{**meta["kept"][0], key: value}]})
    with pytest.raises(BundleError, match="meta.kept is malformed"):
        runtime.load(path, gpu.device)


# ---- what a user sees


def test_one_picture_is_set_and_got_alone(gpu, photos, whole, tmp_path):
    views = load_views(photos)
    new = np.random.default_rng(1).integers(0, 256, (30, 40, 4), np.uint8)
    floats = new.astype(np.float32) / np.float32(255.0)
    found = []
    for k, more in enumerate(({"whole": True}, {}, {})):
        path = made(gpu, fit(views, **more), tmp_path / f"{k}.dressi")
        with runtime.load(path, gpu.device) as session:
            session.step(3, "shape")
            before, runs = session.loss(), session.report()["runs"]
            for view in range(2, 5):  # one of them in the window, if there is one
                session.set("targets", floats if k < 2 else new, view=view)
            assert session.report()["runs"] == runs
            assert np.array_equal(session.get("targets", view=3), floats)
            assert np.array_equal(session.get("targets", view=1), views.images[1])
            all_ = session.get("targets")
            assert np.array_equal(all_[2:5], [floats] * 3) and np.array_equal(all_[5:], np.asarray(views.images)[5:])
            losses, *rest = solved(session)
            one = session.get("render.color", view=5)
            assert np.array_equal(one, session.get("render.color")[5]) and one.shape == (30, 40, 4)
            found.append((before, losses, rest))
    assert found[0] == found[1] == found[2] and found[0][2][0] != whole["shuffle"][1]
    gpu.silent()


def test_all_pictures_are_set_at_once(gpu, photos, tmp_path):
    path = made(gpu, fit(load_views(photos), embed=False), tmp_path / "x.dressi")
    images = np.asarray(load_views(photos).images)
    found = []
    with runtime.load(path, gpu.device) as session:
        session.set("targets", images[::-1].copy())
        session.step(5)
        found.append(session.get("vertices").tobytes())
        assert np.array_equal(session.get("targets"), images[::-1])
    with runtime.load(path, gpu.device) as session:
        session.pictures(lambda k: images[N - 1 - k])
        session.step(5)
        found.append(session.get("vertices").tobytes())
    assert found[0] == found[1]


def test_a_counter_that_is_set_takes_the_pictures_of_its_steps(gpu, photos, tmp_path):
    found = []
    for k, more in enumerate(({"whole": True}, {})):
        path = made(gpu, fit(load_views(photos), **more), tmp_path / f"{k}.dressi")
        with runtime.load(path, gpu.device) as session:
            session.step(2)
            session.set("shape.step", 5)
            losses = [session.loss()]
            session.step(4)
            assert session.get("shape.step") == 9
            found.append((losses, session.get("vertices").tobytes()))
            session.profile_stages("shape", 2)
            session.step(1)
            found[-1] += (session.get("vertices").tobytes(),)
    assert found[0] == found[1]


@pytest.mark.parametrize("embed", [True, False])
def test_a_run_that_was_killed_goes_on_with_the_same_bits(gpu, photos, whole, tmp_path, embed):
    path = made(gpu, fit(load_views(photos), embed=embed), tmp_path / "x.dressi")

    def opened():
        session = runtime.load(path, gpu.device)
        if not embed:
            session.pictures(reader(photos, session.bundle.description["meta"]["pictures"], False))
        return session

    with opened() as session:
        session.step(10, "shape")
        session.checkpoint(tmp_path / "c")
    assert (tmp_path / "c").stat().st_size < 42 * 16 * 3 * 4 + 24 * 16 * 16 * 3 + 4000, "no picture is in it"
    with opened() as session:
        session.step(3, "paint")  # what it did before does not matter
        session.restore(tmp_path / "c")
        session.step(7)
        session.step(8, "paint")
        assert {name: session.get(name).tobytes() for name in NAMES} == whole["shuffle"][1]
    gpu.silent()


def test_what_lies_on_the_device_does_not_grow_with_views(gpu, photos, tmp_path):
    views = load_views(photos)
    sizes = []
    for count in (4, 7, 14):
        which = [k % N for k in range(count)]
        cams = orbit(count, [20.0, -15.0], 2.6, 50.0, SIZE)
        some = Views(np.asarray(views.images)[which], cams, tuple(map(str, range(count))))
        with runtime.load(made(gpu, fit(some), tmp_path / f"{count}.dressi"), gpu.device) as session:
            sizes.append(sum(x["width"] * x["height"] * x["slots"] for x in session.bundle.description["images"]))
    assert sizes[2] - sizes[0] < 10 * 300, "tables of cameras and of the order, and no pixel"


# ---- what is wrong


def test_pictures_that_nobody_gave_are_asked_for(gpu, photos, tmp_path):
    path = made(gpu, fit(load_views(photos), embed=False), tmp_path / "x.dressi")
    with runtime.load(path, gpu.device) as session:
        for call in (session.ready, session.step, session.loss, lambda: session.get("targets", view=2)):
            with pytest.raises(InputError, match="targets has no value yet: the bundle was compiled without its 7 pictures of 40x30; give"):
                call()
        session.get("render.color")
        for array, view, message in (
                (np.zeros((6, 30, 40, 4)), None, r"targets has shape \(6, 30, 40, 4\); \(7, 30, 40, 4\) is needed"),
                (np.zeros((30, 40, 3)), 2, r"targets, view 2 has shape \(30, 40, 3\)"),
                (np.zeros((30, 40, 4)), 7, "view 7; 0 to 6 are there"),
                (np.full((30, 40, 4), 1.5), 1, "values from 1.5 to 1.5; pictures of 8 bits have 0 to 1"),
                (np.full((30, 40, 4), np.nan), 1, "has 4800 values that are NaN or Inf"),
                (np.full((30, 40, 4), "x"), 1, "numbers are needed")):
            with pytest.raises(InputError, match=message):
                session.set("targets", array, view=view)
        session.pictures(lambda k: np.zeros((3, 3, 4)))
        with pytest.raises(InputError, match=r"targets, view \d has shape \(3, 3, 4\)"):
            session.step()
        with pytest.raises(InputError, match="vertices has no views"):
            session.get("vertices", view=0)
        with pytest.raises(InputError, match="vertices has no views"):
            session.set("vertices", np.zeros((42, 3)), view=0)
    with runtime.load(made(gpu, fit(load_views(photos), whole=True), tmp_path / "y.dressi"), gpu.device) as session:
        with pytest.raises(InputError, match="the bundle has its pictures"):
            session.pictures(lambda k: None)


def misled(path, out, change):
    """A bundle with another meta."""
    b = bundles.read(path)
    d = {k: x for k, x in b.description.items() if k != "blobs"}
    blobs = [bytes(b.blob(k)) for k in range(len(b.description["blobs"]))]
    bundles.write(out, {**d, "meta": change(d["meta"])}, blobs)


def broken(folder, k, how):
    path = folder / f"00{k}.png"
    if how == "missing":
        path.unlink()
    elif how == "truncated":
        path.write_bytes(path.read_bytes()[:-40])
    else:
        Image.new("RGBA", SIZE, (1, 2, 3, 255)).save(path)


@pytest.mark.parametrize(("how", "message"), [
    ("missing", "^picture .*003.png is not in .*; give the folder that the pictures are in"),
    ("truncated", "003.png is not the one that the bundle was compiled with"), ("replaced", "003.png is not the one that the bundle")])
def test_pictures_that_are_no_longer_there_are_one_line(gpu, photos, tmp_path, capsys, how, message):
    folder = shutil.copytree(photos, tmp_path / "photos")
    path = made(gpu, fit(load_views(folder), embed=False), tmp_path / "x.dressi")
    moved = shutil.move(folder, tmp_path / "moved")
    with runtime.load(path, gpu.device) as session:
        meta = session.bundle.description["meta"]["pictures"]
        assert reader(moved, meta, False)(2).shape == (30, 40, 4) and reader(moved / "transforms.json", meta, False)(2).any()
        broken(moved, 3, how)
        with pytest.raises(InputError, match=message):
            reader(moved, meta, False)
    for given, told in ((moved, message), (tmp_path / "lost", "lost is no folder")):
        assert main(["run", str(path), "--views", str(given), "--device", gpu.device.name]) == 3
        lines = capsys.readouterr().err.strip().splitlines()
        assert len(lines) == 1 and lines[0].startswith("dressi-edge: ") and "malformed" not in lines[0]
        with pytest.raises(InputError, match=told):
            raise InputError(lines[0].removeprefix("dressi-edge: "))


@pytest.mark.parametrize(("key", "value"), [
    ("value", "vertices"), ("value", 3), ("views", 0), ("views", 8), ("views", "7"), ("bits", 16), ("bits", 32), ("table", b"123"),
    ("order", b""),
    ("order", np.full(4, 7, "<i4").tobytes()), ("order", None), ("steps", {"shape": "lost"}), ("steps", []), ("shown", {"render.color": 3}),
    ("names", ["a"]), ("files", "x"), ("blobs", [10 ** 6] * 7), ("blobs", [0]), ("digests", [b""])])
def test_a_bundle_that_misleads_about_its_pictures_is_refused(gpu, photos, tmp_path, key, value):
    path = made(gpu, fit(load_views(photos)), tmp_path / "x.dressi")
    misled(path, path, lambda meta: {**meta, "pictures": {**meta["pictures"], key: value}})
    with pytest.raises(BundleError, match="meta.pictures is malformed"):
        runtime.load(path, gpu.device)


@pytest.mark.parametrize("damage", [lambda x: x[:-9], lambda x: b"no zlib", lambda x: zlib.compress(bytes(1000)),
                                    lambda x: zlib.compress(bytes(30 * 40 * 4 + 1))])
def test_an_embedded_picture_that_is_damaged_is_named(gpu, photos, tmp_path, damage):
    path = made(gpu, fit(load_views(photos)), tmp_path / "x.dressi")
    b = bundles.read(path)
    d = {k: x for k, x in b.description.items() if k != "blobs"}
    blobs = [bytes(b.blob(k)) for k in range(len(b.description["blobs"]))]
    at = d["meta"]["pictures"]["blobs"][4]
    blobs[at] = damage(blobs[at])
    bundles.write(path, d, blobs)
    with runtime.load(path, gpu.device) as session:
        with pytest.raises(BundleError, match="picture 4 of the bundle"):
            session.step(7)
        assert session.get("targets", view=3).any(), "the others are there"


# ---- parts


def test_a_window_fits_its_budget_and_every_device():
    assert targets.slots_for(100, 40, 30, 4, None) == 3, "as said above"
    assert targets.slots_for(100, 800, 800, 4, 15_400_000) == 1 and targets.slots_for(100, 800, 800, 4, 30_800_000) == 3
    assert targets.slots_for(2, 40, 30, 4, None) == 2 and targets.slots_for(100, 9000, 9000, 4, None) == 1


def test_differences_are_summed_again():
    rng = np.random.default_rng(0)
    for rows in (rng.integers(0, 256, (5, 7, 4), np.uint8), rng.random((5, 7, 4), np.float32)):
        data = differences(rows)
        assert len(data) == rows.nbytes and np.array_equal(summed(data, rows.shape, rows.dtype), rows)


def test_pictures_are_read_again_as_they_were(tmp_path):
    """Masks in files of their own, a backdrop, different sizes, a lens that bends; files told apart by as much of their path as is needed;
    from the folder above them."""
    rng = np.random.default_rng(0)
    for cam, size in (("a", (40, 30)), ("b", (24, 30))):
        for kind, mode in (("rgb", "RGB"), ("masks", "L")):
            (tmp_path / cam / kind).mkdir(parents=True)
            shape = (size[1], size[0], 3)[:3 if mode == "RGB" else 2]
            Image.fromarray(rng.integers(0, 256, shape, np.uint8)).save(tmp_path / cam / kind / "1.png")
    masks = Masks(backdrop=(0.2, 0.4, 0.1), within=0.9)
    lens = Lens(30.0, 31.0, 20.0, 15.0, k=(0.1, -0.02), p=(1e-3, 0.0))
    readings = [Photograph(tmp_path / cam / "rgb" / "1.png", size, masks, tmp_path / cam / "masks" / "1.png", True, lens)
                for cam, size in (("a", (40, 30)), ("b", (24, 30)))]
    for sizes in (None, [(20, 15), (12, 15)]):
        pictures = Pictures(readings, sizes)
        meta = msgpack.unpackb(msgpack.packb({"bits": pictures.bits, **recorded(pictures)}))
        assert meta["files"][1] == "b/rgb/1.png\nb/masks/1.png"
        again = reader(tmp_path, meta, False)
        assert all(np.array_equal(again(k), pictures.rows(k)) for k in (0, 1))
        assert np.array_equal(reader(tmp_path / "a", meta, False)(1), pictures.rows(1)), "beside the folder"
    meta["readings"][0].pop("lens")
    with pytest.raises(BundleError, match="meta.pictures is malformed"):
        reader(tmp_path, meta, False)
    for name in ("../a/rgb/1.png", "/etc/passwd"):
        with pytest.raises(InputError, match="is not in"):
            reader(tmp_path, meta | {"files": [name, name]}, False)


def test_metrics_take_one_picture_at_a_time():
    rng = np.random.default_rng(0)
    a, b = rng.random((4, 5, 6, 4)), rng.random((4, 5, 6, 4))
    assert measure(iter(a), iter(b)) == measure(a, b)


def test_the_feed_wants_what_is_not_there():
    values = {"t": {"name": "t", "role": "input", "layout": "atlas", "type": "int", "width": 2, "height": 3, "count": 4, "columns": 2},
              "s": {}}
    meta = {"value": "t", "views": 9, "bits": 8, "table": None, "order": np.array([5, 1, 8, 0, 2, 3], "<i4").tobytes(),
            "steps": {"p": "s"}, "shown": {}, "names": list("abcdefghi"), "files": [], "blobs": []}
    feed = Feed(meta, values, lambda k: b"", 0)
    assert feed.wanted("p", 0, 4) == {0: 5, 1: 1, 2: 8, 3: 0} and feed.wanted("p", 5, 2) == {1: 3, 2: 5}
    feed.held |= {0: 2, 1: 1}
    assert feed.wanted("p", 4, 3) == {1: 3, 2: 5} and feed.cell(3) == (2, 3) and feed.shape == (9, 3, 2, 4)


# ---- the command line


def test_a_job_of_many_views_from_compiling_to_metrics(photos, tmp_path, capsys, gpu, monkeypatch):
    monkeypatch.setenv("DRESSI_DEVICE", gpu.device.name)
    job = tmp_path / "x.toml"
    job.write_text(f"""
[mesh]
sphere = {{vertices = 42, radius = 0.7}}
[views]
transforms = "{photos}"
order = "shuffle"
[render]
texture_size = [24, 16]
[[phase]]
name = "shape"
steps = 4
optimize.vertices = {{rate = 0.02}}
[[phase.loss]]
kind = "silhouette"
[[phase]]
name = "paint"
steps = 4
optimize.texture = {{rate = 0.02}}
[[phase.loss]]
kind = "color"
""")
    outside, inside = tmp_path / "outside.dressi", tmp_path / "inside.dressi"
    assert main(["compile", str(job), "-p", "lavapipe", "-o", str(outside)]) == 0
    assert "its 7 pictures are not in it: run it with --views DIR, or compile it with --embed" in capsys.readouterr().out
    assert main(["compile", str(job), "-p", "lavapipe", "-o", str(inside), "--embed", "--memory", "2MB"]) == 0
    assert "--views" not in capsys.readouterr().out
    assert main(["run", str(outside), "-o", str(tmp_path / "o.glb")]) == 3
    assert "compiled without its 7 pictures" in capsys.readouterr().err
    assert main(["run", str(outside), "-o", str(tmp_path / "o.glb"), "--views", str(photos)]) == 0
    assert main(["run", str(inside), "-o", str(tmp_path / "i.glb")]) == 0
    metrics = [__import__("json").loads((tmp_path / f"{name}_metrics.json").read_text()) for name in "oi"]
    assert metrics[0]["views"] == metrics[1]["views"] and metrics[0]["losses"] == metrics[1]["losses"]
    assert (tmp_path / "o.glb").read_bytes() == (tmp_path / "i.glb").read_bytes()
    monkeypatch.setattr(targets, "SMALL", 1 << 20)
    few, reference = tmp_path / "few.dressi", tmp_path / "r.glb"
    assert main(["compile", str(job), "-p", "lavapipe", "-o", str(few)]) == 0
    assert main(["run", str(few), "-o", str(tmp_path / "f.glb")]) == 0
    assert (tmp_path / "f.glb").read_bytes() == (tmp_path / "i.glb").read_bytes(), "few views are in the bundle as ever"
    assert main(["run", str(few), "-o", str(tmp_path / "f.glb"), "--views", str(photos)]) == 3
    assert "names no picture files" in capsys.readouterr().err
    monkeypatch.setattr(targets, "SMALL", 1000)
    assert main(["run", str(job), "--device", "reference", "--steps", "1", "-o", str(reference)]) == 0
    capsys.readouterr()
    assert main(["compile", str(job), "-p", "lavapipe", "-o", str(inside), "--memory", "100kB"]) == 3
    assert "MB for profile lavapipe; memory allows 0.1 MB; use smaller views" in capsys.readouterr().err
    with pytest.raises(SystemExit):
        main(["compile", str(job), "-p", "lavapipe", "-o", str(inside), "--memory", "much"])
