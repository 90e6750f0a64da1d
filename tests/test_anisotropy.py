"""Anisotropy: samples along the longer axis of what a pixel sees of a texture."""

import numpy as np
import pytest
from test_mips import check_gradient, fine, fp32, picture, scene_with, tilted

from dressi_edge import runtime
from dressi_edge.cache.errors import InputError
from dressi_edge.compiler import Program
from dressi_edge.compiler.graph.functions import constant
from dressi_edge.compiler.graph.ir import image
from dressi_edge.compiler.graph.reference import evaluate
from dressi_edge.compiler.render.texture import probes
from dressi_edge.compiler.scene import HardSoftRas, Scene, Texture, Unlit

pytest_plugins = ["gpu"]


def test_probes_share_the_longer_axis_of_the_ellipse(gpu):
    """Against the singular values of the derivatives, in float64; circles, lines and what lies far away among them."""
    rng, (w, h), count = np.random.default_rng(0), (64, 32), 4
    a, b = fp32(rng.normal(size=(19, 23, 2)) * 10.0 ** rng.uniform(-6, 6, (19, 23, 1))), fp32(rng.normal(size=(19, 23, 2)))
    b[:5] = a[:5, :, ::-1] * (-w / h, h / w)  # at right angles and as long: circles
    b[5:8] = a[5:8] * 0.5
    a[8, :3], b[8, :3] = 0.0, 0.0
    p = Program()
    apart, lod = probes(p.input("a", picture("vec2")), p.input("b", picture("vec2")), image(w, h), count)
    p.plan("p", {}, {"apart": (apart, picture("vec2")), "lod": (lod, picture("float"))})
    _, s, v = np.linalg.svd(np.stack([a * (w, h), b * (w, h)], -2))
    longest, other = s[..., 0], s[..., 1]
    expected = np.log2(np.maximum(np.sqrt((other ** 2 + (longest / count) ** 2) / 2), 1e-30))
    exact, device = evaluate([apart, lod], {"a": a, "b": b}), gpu.run(p, {"a": a, "b": b})
    for apart, lod, tolerance in ((*exact, 1e-6), (device["apart"], device["lod"], 2e-3)):
        lod = lod.reshape(19, 23)
        seen = np.ones((19, 23), bool)
        seen[8, :3] = False  # nothing moves: any level below 0
        np.testing.assert_allclose(lod[seen], expected[seen], atol=tolerance)
        assert (lod[8, :3] < -20).all()
        texels = apart * (w, h) * count
        np.testing.assert_allclose(np.linalg.norm(texels, axis=-1), longest, rtol=tolerance, atol=1e-12)
        clear = longest > 1.2 * other
        along = abs((texels * v[..., 0, :]).sum(-1)) / np.maximum(longest, 1e-30)
        np.testing.assert_allclose(along[clear & seen], 1.0, atol=tolerance)


def test_a_plane_at_a_slant_is_neither_blurred_nor_does_it_alias(gpu, tmp_path):
    """Root mean square difference from 64 samples a pixel: 4 probes have less than 0.6 of that of one."""
    by = 8

    def draw(size, **how):
        mesh, cameras = tilted(size)
        scene = Scene(cameras)
        scene.add(mesh, material=Unlit(Texture(constant(fine(256)), **how)))
        seen = scene.frame(HardSoftRas(r=1.0, delta=0.0))
        scene.output("o", color=seen.color, mask=seen.mask)
        scene.compile("lavapipe", tmp_path / "a.dressi")
        with runtime.load(tmp_path / "a.dressi", gpu.device) as session:
            return session.get("o.color")[0].astype(float), session.get("o.mask")[0]

    big, hit = draw((80 * by, 60 * by))
    truth, inside = big.reshape(60, by, 80, by, 3).mean((1, 3)), hit.reshape(60, by, 80, by).min((1, 3)) > 0
    one, four = (np.sqrt(((draw((80, 60), mips=True, anisotropy=n)[0] - truth)[inside] ** 2).mean()) for n in (1, 4))
    assert four < 0.6 * one, (four, one)
    gpu.silent()


def test_the_gradient_through_probes_is_exact(gpu, tmp_path):
    """Device against float64, and float64 against central differences along a direction."""
    how = {"wrap": ("repeat", "clamp"), "transform": ((2.0, 0.1, 0.2), (0.0, 1.5, 0.0))}
    scene = scene_with(lambda t: Texture(t, mips=True, anisotropy=3, **how), cameras=1)
    check_gradient(gpu, scene, tmp_path, 2e-4)


def test_what_anisotropy_cannot_be_is_named():
    t = constant(np.zeros((8, 8, 3)))
    for wrong in (0, 17, 2.0, True, None, "4"):
        with pytest.raises(InputError, match="a whole number from 1 to 16 is needed"):
            Texture(t, mips=True, anisotropy=wrong)
    with pytest.raises(InputError, match="has no mips; give it mips=True, or 1"):
        Texture(t, anisotropy=2)
