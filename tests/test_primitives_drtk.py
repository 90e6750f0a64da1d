"""rasterize, render, interpolate and edge_grad_estimator in DRTK's shapes, against its published formulas in float64."""
import numpy as np
import pytest

from dressi_edge.cache.errors import InputError

torch = pytest.importorskip("torch", reason="the extra torch is not installed, so DRTK's functions were not run")

from test_primitives_torch import context  # noqa: E402, F401  (a fixture)

import dressi_edge.primitives.drtk as drtk  # noqa: E402

pytestmark = pytest.mark.usefixtures("context")

HEIGHT, WIDTH = 36, 48
FACES = np.array([[0, 1, 2], [0, 2, 3], [4, 5, 6]])
PLACES = np.array([[[5.2, 4.1, 2.0], [40.3, 7.7, 3.0], [37.9, 30.2, 2.5], [8.4, 27.6, 4.0], [20.1, -3.0, 1.5],
                    [44.2, 17.3, 1.8], [15.7, 33.1, 6.0]],
                   [[9.1, 2.2, 5.0], [30.3, 5.7, 5.0], [31.9, 20.2, 5.5], [6.4, 21.6, 5.0], [20.1, 3.0, 9.5],
                    [44.2, 17.3, 7.8], [15.7, 33.1, 8.0]]])


def published(v):
    """Of each triangle at each pixel (n, faces, h, w): barycentrics in perspective (.., 3), distance, and how far the pixel is inside."""
    y, x = np.mgrid[:HEIGHT, :WIDTH].astype(float)
    found = []
    for places in v:
        rows = []
        for a, b, c in places[FACES]:
            area = (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
            flat = [((q[0] - p[0]) * (y - p[1]) - (q[1] - p[1]) * (x - p[0])) / area for p, q in ((b, c), (c, a), (a, b))]
            over = np.stack([m / p[2] for m, p in zip(flat, (a, b, c))], -1)
            rows.append((over / over.sum(-1, keepdims=True), 1.0 / over.sum(-1), np.min(flat, 0)))
        found.append([np.stack(k) for k in zip(*rows)])
    return [np.stack(k) for k in zip(*found)]


def tensors(grad=False):
    return torch.tensor(PLACES, dtype=torch.float32, requires_grad=grad), torch.tensor(FACES, dtype=torch.int32)


def test_index_depth_barycentrics_and_attributes_are_what_is_published():
    v, vi = tensors()
    index = drtk.rasterize(v, vi, HEIGHT, WIDTH)
    depth, bary = drtk.render(v, vi, index)
    color = torch.rand(2, 7, 4)
    image = drtk.interpolate(color, vi, index, bary)
    assert index.dtype == torch.int32 and index.shape == (2, HEIGHT, WIDTH) and image.shape == (2, 4, HEIGHT, WIDTH)
    assert bary.shape == (2, 3, HEIGHT, WIDTH) and depth.shape == (2, HEIGHT, WIDTH) and set(index.unique().tolist()) == {-1, 0, 1, 2}
    shares, distance, inside = published(PLACES)
    front = np.where(inside >= 0, distance, np.inf).argmin(1)
    expected = np.where((inside >= 0).any(1), front, -1)
    sure = (np.abs(inside) > 1e-3).all(1)
    np.testing.assert_array_equal(index.numpy()[sure], expected[sure])
    hit = sure & (expected >= 0)
    pick = np.nonzero(hit)[0], expected[hit], *np.nonzero(hit)[1:]
    np.testing.assert_allclose(bary.permute(0, 2, 3, 1).numpy()[hit], shares[pick], atol=2e-5)
    np.testing.assert_allclose(depth.numpy()[hit], distance[pick], rtol=1e-5)
    corners = color.double().numpy()[pick[0][:, None], FACES[expected[hit]]]
    np.testing.assert_allclose(image.permute(0, 2, 3, 1).numpy()[hit], (corners * shares[pick][..., None]).sum(1), atol=2e-5)
    empty = index.numpy() < 0
    assert not depth.numpy()[empty].any() and not bary.permute(0, 2, 3, 1).numpy()[empty].any()


def test_gradients_by_places_and_attributes_are_those_of_differences():
    v, vi = tensors(True)
    color = torch.rand(2, 7, 3, requires_grad=True)
    index = drtk.rasterize(v, vi, HEIGHT, WIDTH)
    weights = torch.rand(2, 3, HEIGHT, WIDTH)
    depth, bary = drtk.render(v, vi, index)
    ((drtk.interpolate(color, vi, index, bary) * weights).sum() + depth.sum()).backward()
    hit, expected, w = index.numpy() >= 0, index.numpy(), weights.permute(0, 2, 3, 1).double().numpy()
    pick = np.nonzero(hit)[0], expected[hit], *np.nonzero(hit)[1:]

    def loss(places):
        shares, distance, _ = published(places)
        corners = color.detach().double().numpy()[pick[0][:, None], FACES[expected[hit]]]
        return ((corners * shares[pick][..., None]).sum(1) * w[hit]).sum() + distance[pick].sum()

    slope = np.zeros_like(PLACES)
    for at in np.ndindex(*PLACES.shape):
        step = np.zeros_like(PLACES)
        step[at] = 1e-5
        slope[at] = (loss(PLACES + step) - loss(PLACES - step)) / 2e-5
    np.testing.assert_allclose(v.grad.numpy(), slope, rtol=1e-3, atol=1e-3 * np.abs(slope).max())
    assert color.grad.abs().sum() > 1


def test_an_edge_estimate_leaves_the_picture_and_gives_the_gradient_of_its_area():
    """A square moved and stretched: how its area, and where its middle is, change by its corners."""
    places = torch.tensor([[[8.3, 9.4, 2.0], [36.6, 9.4, 2.0], [36.6, 27.8, 2.0], [8.3, 27.8, 2.0]]], requires_grad=True)
    vi = torch.tensor([[0, 1, 2], [0, 2, 3]], dtype=torch.int32)
    index = drtk.rasterize(places, vi, HEIGHT, WIDTH)
    _, bary = drtk.render(places, vi, index)
    white = (index >= 0).float()[:, None].repeat(1, 3, 1, 1).requires_grad_()
    out = drtk.edge_grad_estimator(places, vi, bary.detach(), white, index)
    assert torch.equal(out, white)
    out.sum().backward()
    assert torch.equal(white.grad, torch.ones_like(white))
    wide, high = 36.6 - 8.3, 27.8 - 9.4
    np.testing.assert_allclose(places.grad[0, [1, 2], 0].sum(), 3 * high, rtol=0.1)
    np.testing.assert_allclose(places.grad[0, [0, 3], 0].sum(), -3 * high, rtol=0.1)
    np.testing.assert_allclose(places.grad[0, [2, 3], 1].sum(), 3 * wide, rtol=0.1)


@pytest.mark.parametrize("call, says", [
    (lambda v, vi, i, b: drtk.rasterize(v, vi, 8, 8, wireframe=True), "wireframe is not there"),
    (lambda v, vi, i, b: drtk.rasterize(v[..., :2], vi, 8, 8), r"v has shape \(2, 7, 2\)"),
    (lambda v, vi, i, b: drtk.render(v + 3.0, vi, i), "index_img is not that of rasterize for these v and vi"),
    (lambda v, vi, i, b: drtk.render(v, vi, i.float()), r"index_img is of shape \(2, 36, 48\) and torch.float32; whole numbers"),
    (lambda v, vi, i, b: drtk.interpolate(torch.rand(2, 7, 3), vi, i, b[:, :2]), r"bary_img has shape \(2, 2, 36, 48\)"),
    (lambda v, vi, i, b: drtk.edge_grad_estimator(v, vi, b, b, i, lambda x: x), "v_pix_img_hook is not there")])
def test_what_is_not_there_is_said(call, says):
    v, vi = tensors()
    index = drtk.rasterize(v, vi, HEIGHT, WIDTH)
    _, bary = drtk.render(v, vi, index)
    with pytest.raises(InputError, match=says):
        call(v, vi, index, bary)
