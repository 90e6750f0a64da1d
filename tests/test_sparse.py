"""A phase that works on a list of the touched texels gives the bits of one that updates every texel, whatever is done in between."""

from dataclasses import replace

import numpy as np
import pytest

from dressi_edge.cache.errors import InputError
from dressi_edge.cache.layout import Layout
from dressi_edge.cache.profile import Profile
from dressi_edge.cache.vulkan import STAGE_VERTEX
from dressi_edge.compiler import Options, Program, build
from dressi_edge.compiler.graph.autodiff import gradients
from dressi_edge.compiler.graph.functions import apply, constant, dot, mean, total
from dressi_edge.compiler.graph.reference_session import ReferenceSession
from dressi_edge.compiler.passes.lists import MIN_TEXELS
from dressi_edge.compiler.render.optimizer import Adam, AdamUniform, AdamW, Clipped, Scaled, Sgd
from dressi_edge.compiler.render.texture import sample_texture

pytest_plugins = ["gpu"]

SIZE, SCREEN = (20, 11), (13, 9)
UNIT = Layout("unit", "float")
STATES = ("texture", "texture.adam_m", "texture.adam_v", "fit.step", "other.step")


def picture(vtype, size=SIZE):
    return Layout("image", vtype, *size)


class Fit:
    """A program that fits textures to what is wanted where they are sampled: a phase `fit`, its loss, whatever else is added."""

    def __init__(self, optimizer=None, wrap="repeat", samples=1, textures=("texture",), size=SIZE, kind="vec3"):
        self.program = p = Program()
        self.wrap, self.kind, self.size = wrap, kind, size
        self.textures = {name: p.state(name, picture(kind, size), 0.5) for name in textures}
        self.uvs = [p.input(f"uv{k}" if k else "uv", picture("vec2", SCREEN)) for k in range(samples)]
        self.covered = p.input("covered", picture("int", SCREEN), 1)
        self.wanted = p.input("wanted", picture(kind, SCREEN), 0.7)
        self.phase("fit", optimizer or Adam(0.03))

    def loss(self, step=None):
        found = [sample_texture(t, uv, self.wrap, covered=self.covered, step=step) for t in self.textures.values() for uv in self.uvs]
        error = sum(found[1:], found[0]) - self.wanted
        return mean(dot(error, error))

    def phase(self, name, optimizer, more=lambda loss: loss, limits=None):
        p = self.program
        step = p.state(f"{name}.step", Layout("unit", "int"))
        loss = more(self.loss(step))
        updates = {f"{name}.step": step + 1}
        for (key, texture), g in zip(self.textures.items(), gradients(loss, list(self.textures.values()))):
            updates |= optimizer.update(p, key, texture, g, step, **(limits or {"low": 0.0, "high": 1.0}))
        p.plan(name, updates, {}, dynamic=frozenset(updates), steps=3, group=name)
        p.plan(f"{name}.loss", {}, {f"{name}.loss": (loss, UNIT)}, dynamic=frozenset(updates), group=name)
        return self


def given(fit, seed=0):
    """Inputs; half of the texture is never sampled."""
    rng = np.random.default_rng(seed)
    return {name: (rng.uniform(-0.1, 0.55, fit.program.values[name].layout.shape) if name.startswith("uv")
                   else rng.integers(0, 4, fit.program.values[name].layout.shape) > 0 if name == "covered"
                   else rng.uniform(0, 1, fit.program.values[name].layout.shape))
            for name, role in fit.program.roles.items() if role == "input"}


def anything(rng, name, shape):
    """A new value: moments of a few texels, not only of those that are sampled; colours in range and out of it."""
    if name in ("covered", "fit.step"):
        return rng.integers(0, 3, shape)
    if name in ("uv", "wanted"):
        return rng.uniform(-0.4, 0.5, shape)
    return rng.uniform(-0.2, 1.2, shape) if name == "texture" else abs(rng.normal(size=shape)) * (rng.random((*shape[:2], 1)) < 0.1)


class Pair:
    """The same program with lists and without, side by side; `get` compares every bit."""

    def __init__(self, gpu, fit, profile="lavapipe", **dense):
        self.gpu, self.program = gpu, fit.program
        self.listed = gpu.open(fit.program, profile, sparse_texels=1)
        self.dense = gpu.open(fit.program, profile, **(dense or {"sparse_texels": None}))
        for name, array in given(fit).items():
            self.set(name, array)

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.listed.close()
        self.dense.close()
        self.gpu.silent()

    def set(self, name, array):
        for s in (self.listed, self.dense):
            s.set(name, array)

    def step(self, n=1, phase=None):
        for s in (self.listed, self.dense):
            s.step(n, phase)

    def call(self, rng, count, gets, sets, value, tmp_path):
        """So many calls in an order of chance: steps of three plans, values got and set, checkpoints."""
        saved = []
        for k in range(count):
            what = rng.choice(["step", "get", "set", "checkpoint", "restore"], p=[0.4, 0.25, 0.25, 0.05, 0.05])
            if what == "step":
                self.step(int(rng.integers(1, 4)), str(rng.choice(["fit", "fit", "fit", "other", "fade"])))
            elif what == "get":
                self.get(str(rng.choice(gets)))
            elif what == "set":
                name = str(rng.choice(sets))
                self.set(name, value(rng, name, self.listed.shape(name)))
            elif what == "checkpoint":
                saved = [tmp_path / f"{k}.{n}" for n in range(2)]
                for s, path in zip((self.listed, self.dense), saved):
                    s.checkpoint(path)
            elif saved:
                for s, path in zip((self.listed, self.dense), saved):
                    s.restore(path)

    def get(self, name):
        listed, dense = self.listed.get(name), self.dense.get(name)
        np.testing.assert_array_equal(listed, dense, err_msg=name)
        assert listed.tobytes() == dense.tobytes(), name
        return listed

    def states(self):
        for name, role in self.program.roles.items():
            if role == "state":
                self.get(name)

    def runs(self, name):
        return self.listed.report()["runs"][name]


def told(fit, **how):
    return build(fit.program, Profile.load("lavapipe"), Options(**{"sparse_texels": 1, **how})).description["meta"].get("texels", {})


# The same bits


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("dense", [{"sparse_texels": None}, {"cache": False}], ids=["every texel", "no cache"])
def test_any_sequence_gives_the_bits_of_updating_every_texel(gpu, tmp_path, dense, seed):
    """Two phases on lists of their own and one that updates all; values of every kind set in between; checkpoints."""
    fit = Fit().phase("other", Sgd(3.0, 0.5), lambda loss: loss * 2.0)
    fit.program.plan("fade", {"texture": fit.textures["texture"] * 0.75})
    fit.program.plan("look", {}, {"sum": (total(fit.textures["texture"]), Layout("unit", "vec3"))})
    rng = np.random.default_rng(seed)
    with Pair(gpu, fit, **dense) as pair:
        pair.call(rng, 60, [*STATES, "fit.loss", "other.loss", "sum"],
                  ["texture", "texture.adam_m", "texture.momentum", "uv", "covered", "wanted", "fit.step"], anything, tmp_path)
        pair.states()
        assert pair.runs("fit.enter") and pair.runs("fit.leave") and pair.runs("other.enter")


@pytest.mark.parametrize("optimizer", [AdamW(0.03, decay=0.5), Scaled(Adam(0.03), np.linspace(0, 1, 220).reshape(11, 20)),
                                       AdamUniform(0.03), AdamUniform(0.03, shared="vector"), Clipped(Adam(0.03), 1e-3, 1e-2)],
                         ids=["AdamW", "Scaled", "AdamUniform", "AdamUniform, vector", "Clipped"])
def test_every_optimizer_gives_the_bits_of_updating_every_texel(gpu, optimizer):
    with Pair(gpu, Fit(optimizer)) as pair:
        pair.step(3)
        pair.get("texture")
        pair.set("texture", np.random.default_rng(1).uniform(0, 1, pair.listed.shape("texture")))
        pair.step(2)
        pair.states()


@pytest.mark.parametrize("profile", ["lavapipe", "limit4", "mali_g76", "vulkan_min"])
def test_every_profile_has_lists(gpu, profile):
    fit = Fit(samples=2)
    with Pair(gpu, fit, profile) as pair:
        pair.step(3)
        pair.get("fit.loss")
        pair.step(2)
        pair.states()
        assert pair.runs("fit.leave") == 1


@pytest.mark.parametrize("how", [{"wrap": "clamp"}, {"samples": 3}, {"textures": ("a", "b")}, {"kind": "float"}, {"kind": "vec4"},
                                 {"optimizer": Sgd(2.0)}, {"optimizer": Sgd(2.0, 0.9, True)}, {"size": (16, 64)}], ids=str)
def test_every_way_to_sample_and_to_optimize_has_lists(gpu, how):
    fit = Fit(**how)
    assert set(told(fit)["fit"].values()) == {"listed"}
    with Pair(gpu, fit) as pair:
        pair.step(4)
        pair.states()
        pair.step(3)
        pair.get("fit.loss")
        pair.states()


def test_what_is_listed_is_what_an_update_would_change(gpu):
    """Texels out of range are limited though no pixel touches them, moments run out, and no bit of the others changes."""
    rng = np.random.default_rng(4)
    fit = Fit()
    with Pair(gpu, fit) as pair:
        texture = rng.uniform(0, 1, (*SIZE[::-1], 3))
        texture[::3, ::4] = -1.0, 2.0, -0.0
        texture[1::3, 1::4, 1] = -0.0
        pair.set("texture", texture)
        pair.step(1)
        pair.states()
        pair.set("texture.adam_m", np.where(rng.random((*SIZE[::-1], 1)) < 0.5, 1e-3, -0.0) * np.ones(3))
        pair.step(2)
        pair.states()
        pair.set("texture.adam_v", np.ones((*SIZE[::-1], 3)))  # now all are listed
        pair.step(2)
        pair.states()
        pair.set("covered", np.zeros(SCREEN[::-1], int))  # and now none is touched
        pair.set("texture.adam_m", np.zeros((*SIZE[::-1], 3)))
        pair.set("texture.adam_v", np.zeros((*SIZE[::-1], 3)))
        pair.step(2)
        pair.states()


@pytest.mark.parametrize("size, profile, width", [((600, 512), "vulkan_min", 128), ((1024, 512), "vulkan_min", 128),
                                                 ((600, 512), "lavapipe", 64)], ids=str)
def test_lists_of_one_and_several_columns(gpu, size, profile, width):
    """Two of 2400 and of 4096 rows where a profile has 4096, one of 4800 where it has more; filled to within the first, into the
    second, and to the end."""
    fit, rng = Fit(size=size), np.random.default_rng(6)
    with Pair(gpu, fit, profile) as pair:
        copy = next(v for v in pair.listed.bundle.description["values"] if v["name"] == "fit.list.texture")
        assert copy["width"] == width and copy["width"] * copy["height"] == size[0] * size[1]
        for share in (0.0, 0.7, 1.0):
            pair.set("texture.adam_m", np.where(rng.random((*size[::-1], 1)) < share, 0.01, 0.0) * np.ones(3))
            pair.step(2)
            pair.states()
            pair.get("fit.loss")


def test_the_reference_agrees(gpu):
    fit = Fit()
    with gpu.open(fit.program, sparse_texels=1) as session, ReferenceSession(fit.program) as reference:
        for s in (session, reference):
            for name, array in given(fit).items():
                s.set(name, array)
            s.step(3)
        for name in ("texture", "texture.adam_m", "fit.loss"):
            np.testing.assert_allclose(session.get(name), reference.get(name), atol=2e-5)
    gpu.silent()


# When lists are made and given back


def test_steps_and_losses_neither_make_nor_give_back_lists(gpu):
    with Pair(gpu, Fit()) as pair:
        for _ in range(5):
            pair.step(1)
            pair.listed.loss()
        assert (pair.runs("fit.enter"), pair.runs("fit.leave")) == (1, 0)
        for name in ("texture", "texture.adam_m", "texture"):
            pair.get(name)
        pair.step(1)
        assert (pair.runs("fit.enter"), pair.runs("fit.leave")) == (1, 1)
        pair.set("wanted", np.zeros((*SCREEN[::-1], 3)))  # what is not in the lists
        pair.step(1)
        assert (pair.runs("fit.enter"), pair.runs("fit.leave")) == (1, 1)
        pair.set("uv", np.zeros((*SCREEN[::-1], 2)))
        pair.step(1)
        assert (pair.runs("fit.enter"), pair.runs("fit.leave")) == (2, 2)
        pair.states()


def test_a_step_costs_what_the_list_holds_not_what_the_image_has():
    """All that the step draws over the image's size is drawn as far as there are entries; nothing of it touches the image itself."""
    fit = Fit(size=(64, 48))
    description = build(fit.program, Profile.load("lavapipe"), Options(sparse_texels=1)).description
    plan, states = next(p for p in description["plans"] if p["name"] == "fit"), {v["image"]: v["name"] for v in description["values"]}

    def by_entries(draw):
        kinds = description["pipelines"][draw["pipeline"]]["bindings"]
        return draw["vertices"] == 12 and sum(stages & STAGE_VERTEX for _, stages, _ in kinds) == STAGE_VERTEX

    assert sum(by_entries(draw) for stage in plan["stages"] for draws in stage["subpasses"] for draw in draws) == 1
    for stage in plan["stages"]:
        draws = [draw for draws in stage["subpasses"] for draw in draws]
        touched = {states.get(ref // 2) for ref in [*stage["attachments"], *(ref for draw in draws for ref in draw["images"])]}
        assert touched.isdisjoint(fit.textures) and "texture.adam_m" not in touched
        assert stage["width"] * stage["height"] < 64 * 48 or all(map(by_entries, draws))


def test_users_see_states_and_phases_alone(gpu):
    with Pair(gpu, Fit()) as pair:
        assert pair.listed.phases == ["fit"]
        with pytest.raises(InputError, match="no input or state or output"):
            pair.listed.get("fit.list.texture")
        with pytest.raises(InputError, match="no phase"):
            pair.listed.step(1, "fit.enter")
        assert pair.listed.report()["texels"] == {"fit": {"texture": "listed"}}
        for name in pair.listed.plans:
            pair.listed.profile_stages(name, 2)
        assert pair.listed.get("fit.step") == 2


# Where every texel is updated


def test_why_every_texel_is_updated_is_told(gpu):
    def regularized():
        fit = Fit()
        texture = fit.textures["texture"]
        return fit.phase("other", Adam(0.1), lambda loss: loss + mean(dot(texture, texture)))

    def watched():
        fit = Fit()
        p, texture = fit.program, fit.textures["texture"]
        step, level = p.state("other.step", Layout("unit", "int")), p.state("level", Layout("unit", "vec3"))
        g, = gradients(fit.loss(), [texture])
        p.plan("other", {**Adam().update(p, "texture", texture, g, step), "level": level + total(texture), "other.step": step + 1})
        return fit

    def moving():
        fit = Fit()
        p, texture = fit.program, fit.textures["texture"]
        step, shift = p.state("other.step", Layout("unit", "int")), p.state("shift", Layout("unit", "vec2"))
        y = sample_texture(texture, fit.uvs[0] + shift, step=step)
        g, h = gradients(mean(dot(y, y)), [texture, shift])
        p.plan("other", {**Adam().update(p, "texture", texture, g, step), "shift": shift - h, "other.step": step + 1})
        return fit

    def counted():
        """A phase that also counts, in integers, the texels' updates."""
        fit = Fit()
        p, texture = fit.program, fit.textures["texture"]
        step, count = p.state("other.step", Layout("unit", "int")), p.state("count", picture("int"))
        g, = gradients(fit.loss(step), [texture])
        changed = dot(g, g) > 0.0
        p.plan("other", {**Adam().update(p, "texture", texture, g, step), "count": count + changed, "other.step": step + 1})
        return fit

    assert told(Fit(), sparse_texels=MIN_TEXELS) == {"fit": {"texture": f"every texel is updated: it has 220; lists begin at {MIN_TEXELS}"}}
    assert told(Fit(size=(4096, 2048)))["fit"]["texture"].endswith("it has 8388608; lists end at 4194304, for they have room for all")
    assert told(Fit(), cache=False) == told(Fit(), naive=True) == told(Fit(), sparse_texels=None) == {}
    for made, why in ((regularized, "its update moves texels without gradient"), (watched, "more reads it than samples do"),
                      (moving, "where it is sampled changes while the phase runs"), (counted, "count of its size is an integer")):
        fit = made()
        assert told(fit) == {"fit": {"texture": "listed"}, "other": {"texture": f"every texel is updated: {why}"}}
        with Pair(gpu, fit) as pair:
            for phase in ("fit", "other", "fit"):
                pair.step(2, phase)
                pair.states()


def test_a_constant_mask_of_texels_is_listed_too(gpu):
    fit = Fit()
    p, texture = fit.program, fit.textures["texture"]
    step = p.state("other.step", Layout("unit", "int"))
    g, = gradients(fit.loss(), [texture])
    mask = constant((np.arange(SIZE[0] * SIZE[1]).reshape(*SIZE[::-1], 1) % 3 > 0) * 1.0)
    p.plan("other", {**Adam(0.1).update(p, "texture", texture, g, step, mask=mask), "other.step": step + 1})
    assert told(fit)["other"] == {"texture": "listed"}
    with Pair(gpu, fit) as pair:
        pair.step(3, "other")
        pair.states()
        assert (pair.get("texture")[0, 0] == 0.5).all()


def test_differs_sees_the_sign_of_zero(gpu):
    p = Program()
    a, b = p.input("a", picture("vec2")), p.input("b", picture("vec2"))
    p.plan("p", {}, {"y": (apply("differs", a, b), picture("int"))})
    rng = np.random.default_rng(0)
    feed = {name: rng.choice([0.0, -0.0, 1.0], (*SIZE[::-1], 2)) for name in "ab"}
    y = gpu.run(p, feed)["y"]
    expected = ((feed["a"] != feed["b"]) | (np.signbit(feed["a"]) != np.signbit(feed["b"]))).any(-1)
    np.testing.assert_array_equal(y, expected)


@pytest.mark.parametrize("rows", [4096, 7680, 16384])
def test_lists_of_a_million_texels_lie_where_rows_are_no_power_of_two(rows):
    """VideoCore 7 has 7680: its list has as many rows as one that an op lays, which may be laid again."""
    profile = Profile.load("lavapipe")
    build(Fit(size=(1024, 1024)).program,
          replace(profile, limits={**profile.limits, "maxImageDimension2D": rows, "maxFramebufferHeight": rows}))
