"""A phase that keeps moments of a mip-mapped texture once a block gives the bits of one that keeps them once a texel, whatever is done in
between."""

import numpy as np
import pytest
from test_sparse import SCREEN, Fit, Pair, anything, given, picture, told

from dressi_edge import compiler
from dressi_edge.cache.profile import Profile
from dressi_edge.compiler.graph.functions import constant, dot, mean
from dressi_edge.compiler.graph.ir import topological
from dressi_edge.compiler.graph.ops.mip_blocks import STEP, _level_of_ref, _occupied_ref
from dressi_edge.compiler.graph.ops.mip_lists import numbered
from dressi_edge.compiler.graph.ops.mip_pyramid import Pyramid
from dressi_edge.compiler.graph.reference_session import ReferenceSession
from dressi_edge.compiler.passes.blocks import TOLD
from dressi_edge.compiler.render.optimizer import Adam, AdamUniform, AdamW, Clipped, Scaled, Sgd
from dressi_edge.compiler.render.texture import sample_texture
from dressi_edge.compiler.scene import HardSoftRas, Scene, Texture, Unlit, l2, look_at, sphere

pytest_plugins = ["gpu"]


class Mips(Fit):
    """`Fit` whose samples have a level of detail."""

    def __init__(self, *args, **how):
        self.lod = None
        super().__init__(*args, **how)

    def loss(self, step=None):
        if self.lod is None:
            self.lod = self.program.input("lod", picture("float", SCREEN))
        found = [sample_texture(t, uv, self.wrap, covered=self.covered, lod=self.lod) for t in self.textures.values() for uv in self.uvs]
        error = sum(found[1:], found[0]) - self.wanted
        return mean(dot(error, error))


def value(rng, name, shape):
    return rng.uniform(-1.0, 6.0, shape) if name == "lod" else anything(rng, name, shape)


def opened(gpu, fit, seed=0, **dense):
    pair = Pair(gpu, fit, **dense)
    pair.set("lod", value(np.random.default_rng(seed), "lod", pair.listed.shape("lod")))
    return pair


@pytest.mark.parametrize("size, dense", [((32, 32), {"sparse_texels": None}), ((20, 11), {"cache": False}),
                                         ((333, 217), {"sparse_texels": None})], ids=str)
def test_any_sequence_gives_the_bits_of_moments_of_every_texel(gpu, tmp_path, dense, size):
    """Two phases and one that updates all; values of every kind set in between; checkpoints."""
    fit = Mips(size=size).phase("other", Sgd(3.0, 0.5), lambda loss: loss * 2.0)
    fit.program.plan("fade", {"texture": fit.textures["texture"] * 0.75})
    rng = np.random.default_rng(size[0])
    with opened(gpu, fit, **dense) as pair:
        pair.call(rng, 40, ["texture", "texture.adam_m", "texture.adam_v", "fit.step", "fit.loss", "other.loss"],
                  ["texture", "texture.adam_m", "texture.momentum", "uv", "lod", "covered", "wanted", "fit.step"], value, tmp_path)
        pair.states()
        assert pair.runs("fit.enter") and pair.runs("fit.leave") and pair.runs("other.enter")


@pytest.mark.parametrize("optimizer", [Adam(0.03), AdamW(0.03), Sgd(2.0, 0.9, nesterov=True), Clipped(Adam(0.03), value=1e-3),
                                       AdamUniform(0.03, shared="vector"), Scaled(Adam(0.03), 0.5)], ids=lambda x: type(x).__name__)
def test_optimizers_whose_moments_follow_from_the_gradient_keep_them_by_blocks(gpu, optimizer):
    fit = Mips(optimizer)
    assert told(fit)["fit"]["texture"] == TOLD
    with opened(gpu, fit) as pair:
        pair.step(4)
        pair.states()
        assert pair.runs("fit.enter") == 1


def test_what_tells_texels_apart_keeps_moments_of_every_texel(gpu):
    """A mask of texels, a norm of the whole gradient, one moment for all, a texture that is sampled twice, a penalty on texels."""
    mask = constant(np.random.default_rng(0).random((11, 20, 1)))
    seen = {}

    class Masked:
        def update(self, program, name, parameter, gradient, step, **how):
            return Adam(0.03).update(program, name, parameter, gradient, step, **how, mask=mask)

    for key, fit in {"mask": Mips(Masked()), "norm": Mips(Clipped(Adam(0.03), norm=0.1)), "shared": Mips(AdamUniform(0.03)),
                     "twice": Mips(samples=2)}.items():
        seen[key] = told(fit).get("fit", {}).get("texture", "")
        with opened(gpu, fit) as pair:
            pair.step(3)
            pair.states()
    assert not any(TOLD in x for x in seen.values()), seen
    more = Mips()
    more.phase("other", Adam(0.01), lambda loss: loss + mean(dot(more.textures["texture"], more.textures["texture"])))
    assert told(more)["fit"]["texture"] == TOLD and TOLD not in told(more)["other"]["texture"]
    assert TOLD not in str(told(Mips(), sparse_texels=None))


def test_two_textures_have_lists_of_their_own(gpu):
    fit = Mips(textures=("texture", "other"))
    assert told(fit)["fit"] == {"texture": TOLD, "other": TOLD}
    with opened(gpu, fit) as pair:
        pair.step(5)
        pair.states()


@pytest.mark.parametrize("rows", [300, 100])
def test_lists_of_several_columns_give_the_same_bits(gpu, monkeypatch, rows):
    """Of 4 columns, which comparisons tell apart, and of 12."""
    monkeypatch.setattr(compiler, "rows_of", lambda profile: rows)
    with opened(gpu, Mips(size=(333, 217))) as pair:
        pair.step(3)
        pair.states()
        assert pair.runs("fit.enter") == 1


def test_what_pixels_read_is_listed_once(gpu):
    """For the samples and for their gradient, whatever passes made of the coordinates in between."""
    scene = Scene([look_at([0, 0, 3], [0, 0, 0], [0, 1, 0], 40, 200, 150)])
    texture = scene.parameter("texture", np.full((64, 64, 3), 0.5), kind="image")
    scene.add(sphere(162), material=Unlit(Texture(texture, mips=True)))
    seen = scene.frame(HardSoftRas(r=2.0, delta=0.0))
    scene.phase("fit", 10, {"texture": Adam(0.01)}, color=l2(seen.color, scene.input("photo", np.full((1, 150, 200, 3), 0.4))))
    plans = {plan.graph.name: [n.op.name for n in topological(plan.graph.roots)]
             for plan in compiler.build(scene.program, Profile.load("lavapipe")).plans}
    assert plans["fit.prepare"].count("mip_touched") == 1 and plans["fit"].count("mip_sums_00") == 1


def test_the_reference_has_the_same_numbers(gpu):
    fit = Mips(size=(37, 21))
    with gpu.open(fit.program, sparse_texels=1) as session, ReferenceSession(fit.program) as exact:
        rng = np.random.default_rng(3)
        for name, array in {**given(fit), "lod": rng.uniform(-1, 5, session.shape("lod"))}.items():
            for s in (session, exact):
                s.set(name, array)
        for s in (session, exact):
            s.step(6, "fit")
        np.testing.assert_allclose(session.get("texture"), exact.get("texture"), atol=2e-5)


@pytest.mark.parametrize("size", [(16, 16), (37, 21), (4, 1)], ids=str)
def test_blocks_are_the_largest_squares_in_which_nothing_finer_is_read(size):
    """Against the definition: of each texel, going up while no finer texel over or beside it, in what is next, is read."""
    p, rng = Pyramid(*size), np.random.default_rng(1)
    for share in (0.0, 0.02, 0.3):
        e = numbered(p)
        flags = (rng.random((e.height, e.width, 1)) < share).astype(int)
        occupied = flags
        for above in range(0, p.last, STEP):
            occupied = _occupied_ref(occupied, p.width, p.height, above)
        found = _level_of_ref(occupied, p.width, p.height)[..., 0]
        for y in range(p.height):
            for x in range(p.width):
                level = 0
                while level < p.last and not any(
                        p.texels(flags.reshape(-1, 1), k)[y >> level + 1 << level + 1 - k:(y >> level + 1) + 1 << level + 1 - k,
                                                          x >> level + 1 << level + 1 - k:(x >> level + 1) + 1 << level + 1 - k].any()
                        for k in range(level + 1)):
                    level += 1
                assert found[y, x] == level
