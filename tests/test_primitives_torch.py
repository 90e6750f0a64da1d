"""rasterize, interpolate, texture and antialias for PyTorch, where it is installed; tests/test_primitives.py tests what they are made of
everywhere. Then the two programs in docs/examples/torch/."""
import importlib
import re
import sys
from pathlib import Path

import numpy as np
import primitives_reference as published
import pytest
from test_primitives import TRI, clip
from undertest import DEVICE

from dressi_edge.cache.errors import InputError

torch = pytest.importorskip("torch", reason="the extra torch is not installed, so the four functions were not run; their parts were")

import dressi_edge.primitives.torch as dr  # noqa: E402

FACES = torch.from_numpy(TRI)


@pytest.fixture(scope="module")
def context(tmp_path_factory):
    patch = pytest.MonkeyPatch()
    patch.setenv("DRESSI_CACHE", str(tmp_path_factory.mktemp("cache")))
    made = dr.Context(DEVICE)
    yield made
    made.close()
    patch.undo()


def numbers(*shape, seed=0, grad=True):
    return torch.tensor(np.random.default_rng(seed).uniform(size=shape), dtype=torch.float32).requires_grad_(grad)


def drawn(context, pos, colors, **how):
    """A whole chain: a textured picture with smooth silhouettes."""
    rast, db = dr.rasterize(context, pos, FACES, [32, 40], **how)
    uv, da = dr.interpolate(numbers(1, 45, 2, seed=1, grad=False), rast, FACES, rast_db=db, diff_attrs="all")
    picture = dr.texture(colors, uv, da) * (rast[..., 3:] > 0)
    return dr.antialias(picture, rast, pos, FACES)


def test_a_chain_is_what_is_published(context):
    pos = torch.from_numpy(clip().astype(np.float32))
    attr = numbers(1, 45, 2, seed=1, grad=False)
    rast, db = dr.rasterize(context, pos, FACES, [32, 40])
    uv, da = dr.interpolate(attr, rast, FACES, rast_db=db, diff_attrs=[1])
    tex = numbers(1, 6, 5, 3, seed=2, grad=False)
    color = dr.texture(tex, uv, boundary_mode="clamp") * (rast[..., 3:] > 0)
    out = dr.antialias(color, rast, pos, FACES)
    wanted, change = published.interpolate(attr.double().numpy(), rast.double().numpy(), TRI, db.double().numpy())
    assert np.abs(uv.numpy() - wanted).max() < 1e-5 and da.shape == (2, 32, 40, 2)
    assert np.abs(da.numpy() - change[..., 2:]).max() < 1e-4
    sampled = published.texture(tex.double().numpy(), uv.double().numpy(), "linear", "clamp") * (rast[..., 3:] > 0).numpy()
    assert np.abs(color.numpy() - sampled).max() < 1e-5
    far = np.abs(out.numpy() - published.antialias(color.double().numpy(), rast.double().numpy(), pos.double().numpy(), TRI)).max(-1)
    assert np.count_nonzero(far > 1e-5) < 5 and (out != color).any()


def test_gradients_run_through_the_chain_and_are_those_of_its_links(context):
    pos = torch.from_numpy(clip().astype(np.float32)).requires_grad_()
    colors = numbers(1, 6, 5, 3)
    weights = numbers(2, 32, 40, 3, seed=5, grad=False) - 0.5
    (drawn(context, pos, colors) * weights).sum().backward()
    assert pos.grad.abs().sum() > 0 and colors.grad.abs().sum() > 0 and torch.isfinite(pos.grad).all() and not pos.grad[..., 2].any()
    found, h = [], 1e-2
    direction = numbers(1, 6, 5, 3, seed=6, grad=False) - 0.5
    for sign in (1, -1):
        with torch.no_grad():
            found.append(float((drawn(context, pos, colors + sign * h * direction) * weights).sum()))
    assert float((colors.grad * direction).sum()) == pytest.approx((found[0] - found[1]) / (2 * h), rel=1e-3, abs=1e-3)  # linear in colours
    only = pos.detach().clone().requires_grad_()
    assert not dr.rasterize(context, only, FACES, [32, 40], grad_db=False)[1].requires_grad


def test_batches_shared_values_types_and_boosts(context):
    pos = torch.from_numpy(clip().astype(np.float32))
    rast, _ = dr.rasterize(context, pos, FACES, [32, 40])
    one, _ = dr.rasterize(context, pos[1:], FACES, [32, 40])
    torch.testing.assert_close(one[0], rast[1], rtol=0, atol=1e-6)
    attr = numbers(45, 9)
    shared, none = dr.interpolate(attr, rast, FACES)
    each, _ = dr.interpolate(attr.detach()[None].expand(2, -1, -1), rast, FACES)
    torch.testing.assert_close(shared, each, rtol=0, atol=0)
    assert none.shape == (2, 32, 40, 0)
    shared.sum().backward()
    torch.testing.assert_close(attr.grad.sum(0), torch.full((9,), float((rast[..., 3] > 0).sum())), rtol=1e-4, atol=1e-2)
    uv, tex = numbers(2, 8, 9, 2, seed=1), numbers(2, 5, 6, 3, seed=2)
    both = dr.texture(tex, uv)
    torch.testing.assert_close(both[1:], dr.texture(tex[1:], uv[1:]), rtol=0, atol=0)
    both.sum().backward()
    assert tex.grad.shape == tex.shape and uv.grad.abs().sum() > 0
    double = numbers(1, 5, 6, 3).detach().double().requires_grad_()
    dr.texture(double, uv.detach()[:1]).sum().backward()
    assert double.grad.dtype == torch.float64
    slopes = []
    for boost in (1.0, 3.0):
        p = pos.clone().requires_grad_()
        dr.antialias((rast[..., 3:] > 0).float(), rast, p, FACES, pos_gradient_boost=boost).square().sum().backward()
        slopes.append(p.grad)
    torch.testing.assert_close(slopes[1], 3 * slopes[0])
    assert dr.antialias_construct_topology_hash(FACES) is None


def test_beyond_the_texture_is_zero_if_that_is_asked_for(context):
    tex, uv = numbers(1, 5, 6, 3), torch.rand(1, 7, 8, 2, generator=torch.Generator().manual_seed(0)) * 2 - 0.5
    found = dr.texture(tex, uv, boundary_mode="zero")
    wanted = published.texture(tex.detach().double().numpy(), uv.double().numpy(), "linear", "zero")
    assert np.abs(found.detach().numpy() - wanted).max() < 1e-5
    found.sum().backward()
    assert tex.grad.shape == tex.shape


def test_an_unused_result_and_no_gradient_at_all_cost_nothing(context):
    pos = torch.from_numpy(clip().astype(np.float32))
    assert not dr.rasterize(context, pos, FACES, [32, 40])[0].requires_grad
    p = pos.clone().requires_grad_()
    rast, db = dr.rasterize(context, p, FACES, [32, 40])
    rast[..., :2].sum().backward()
    assert p.grad.abs().sum() > 0


@pytest.mark.parametrize("call, words", [
    (lambda c, p, r: dr.rasterize(None, p, FACES, [8, 8]), "glctx is NoneType; a Context"),
    (lambda c, p, r: dr.rasterize(c, p[0], FACES, [8, 8]), "range mode"),
    (lambda c, p, r: dr.rasterize(c, p[..., :3], FACES, [8, 8]), r"pos has shape \(2, 45, 3\)"),
    (lambda c, p, r: dr.rasterize(c, p, FACES.float(), [8, 8]), "whole numbers"),
    (lambda c, p, r: dr.rasterize(c, p, FACES + 1, [8, 8]), "tri names vertex 45; there are 0 to 44"),
    (lambda c, p, r: dr.rasterize(c, p, FACES, [0, 8]), r"resolution is \[0, 8\]"),
    (lambda c, p, r: dr.interpolate(p[:1].repeat(3, 1, 1), r, FACES), "1 or 2 in front are needed"),
    (lambda c, p, r: dr.interpolate(p, r, FACES, diff_attrs="all"), "diff_attrs without rast_db"),
    (lambda c, p, r: dr.interpolate(p, r, FACES[:1]), "rast names triangle"),
    (lambda c, p, r: dr.texture(r, r[..., :2], filter_mode="cubic"), "filter_mode is 'cubic'; auto nearest linear"),
    (lambda c, p, r: dr.texture(r, r[..., :2], boundary_mode="cube"), "boundary_mode is 'cube'; wrap clamp zero"),
    (lambda c, p, r: dr.texture(r, r[..., :2], filter_mode="linear-mipmap-linear"), "needs uv_da"),
    (lambda c, p, r: dr.antialias(r[:1], r, p, FACES), "as rast has"),
    (lambda c, p, r: dr.antialias(r, r, p[:1], FACES), "2 in front are needed"),
])
def test_what_cannot_be_is_said(context, call, words):
    pos = torch.from_numpy(clip().astype(np.float32))
    rast, _ = dr.rasterize(context, pos, FACES, [32, 40])
    with pytest.raises(InputError, match=words):
        call(context, pos, rast)


@pytest.mark.parametrize("name, how, right", [
    ("cube", {"size": 16, "steps": 80, "batch": 4}, lambda r: r["start"]["corners"] > 0.2 and r["end"]["corners"] < 0.1),
    ("earth", {"size": 40, "height": 16, "steps": 25, "batch": 1}, lambda r: r["start"] < 20 and r["end"] > r["start"] + 8),
])
def test_a_program_recovers_what_it_says(name, how, right, tmp_path, monkeypatch):
    from PIL import Image
    monkeypatch.setenv("DRESSI_CACHE", str(tmp_path / "cache"))
    monkeypatch.setenv("DRESSI_DEVICE", DEVICE)
    monkeypatch.syspath_prepend(str(Path(__file__).resolve().parents[1] / "docs" / "examples" / "torch"))
    for module in ("cube", "earth"):
        sys.modules.pop(module, None)
    found = importlib.import_module(name).main(str(tmp_path), **how)
    assert right(found), found
    assert np.asarray(Image.open(tmp_path / f"{name}.png")).std() > 5


def test_the_code_of_the_page_runs(tmp_path, monkeypatch, capsys):
    monkeypatch.setenv("DRESSI_CACHE", str(tmp_path / "cache"))
    page = (Path(__file__).resolve().parents[1] / "docs" / "primitives.md").read_text(encoding="utf-8")
    names = {}
    for block in re.findall(r"```python\n(.*?)```", page, re.S):
        exec(compile(block, "primitives.md", "exec"), names)
    names["context"].close()
    assert "tensor" in capsys.readouterr().out
