"""Losses of images, or of anything that lies like them: a value and a target of equal extent in, a float of extent 1x1 out.

Every mean is over all texels of the extent, empty cells of an atlas included, and over all channels; a mask weighs what is added up,
not what it is divided by.
"""
from __future__ import annotations

import math

import numpy as np

from ....cache.errors import GraphError
from ....cache.layout import beyond_fp32
from ...graph.functions import absolute, apply, convolve, dot, downsample, minimum, normalize, select, shift, sqrt, total
from ...graph.ir import Node, is_int
from ...graph.optable import as_node


def _difference(name: str, image: Node, target: Node) -> Node:
    """image - target. Raises GraphError."""
    if not isinstance(image, Node) or is_int(image.vtype):
        raise GraphError(f"{name}: the image is {image!r:.60}; a float or vec image is needed")
    target = as_node(target)
    if target.channels not in (1, image.channels):
        raise GraphError(f"{name}: {image!r} has {image.channels} channels, its target {target!r} has {target.channels}; equal numbers "
                         "are needed")
    return image - target


def _weights(mask: Node) -> Node:
    mask = as_node(mask)
    if mask.vtype != "float":
        raise GraphError(f"mask {mask!r} is not a float image")
    return mask


def _image_mean(term: Node, channels: int, mask: Node | None) -> Node:
    if mask is not None:
        term = term * _weights(mask)
    return total(term) * (1.0 / (term.extent.count * channels))


def _channel_sum(x: Node) -> Node:
    return apply("sum_channels", x) if x.channels > 1 else x


def _positive(name: str, what: str, x) -> float:
    if isinstance(x, bool) or not isinstance(x, int | float | np.floating) or not x > 0 or beyond_fp32(x) or np.float32(x) == 0:
        raise GraphError(f"{name}: {what} is {x!r:.40}; a number above 0, finite in fp32, is needed")
    return float(x)


def l1(image: Node, target: Node, mask: Node | None = None) -> Node:
    """Mean over texels and channels of |image - target|: float or vec images of equal extent (or 1x1).

    mask: a float image in [0, 1] that weighs each texel; the mean is still over all texels, so the loss shrinks with the mask.
    """
    d = absolute(_difference("l1", image, target))
    return _image_mean(_channel_sum(d), d.channels, mask)


def l2(image: Node, target: Node, mask: Node | None = None) -> Node:
    """Mean over texels and channels of (image - target)^2; see `l1` for shapes and the mask."""
    d = _difference("l2", image, target)
    return _image_mean(dot(d, d), d.channels, mask)


def _huber(d: Node, delta: float) -> Node:
    """Of each channel."""
    size = absolute(d)
    near = minimum(size, delta)
    return near * (size - near * 0.5)


def huber(image: Node, target: Node, delta: float = 1.0, mask: Node | None = None) -> Node:
    """Mean over texels and channels of d^2 / 2 where |d| <= delta, else delta (|d| - delta / 2), d = image - target (Huber 1964). delta
    is in units of the image. Shapes and mask as in `l1`. Raises GraphError."""
    delta = _positive("huber", "delta", delta)
    d = _difference("huber", image, target)
    return _image_mean(_channel_sum(_huber(d, delta)), d.channels, mask)


def charbonnier(image: Node, target: Node, epsilon: float = 1e-3, mask: Node | None = None) -> Node:
    """Mean over texels and channels of sqrt(d^2 + epsilon^2) - epsilon, d = image - target: `l1` with a round bottom (Charbonnier et al.
    1994). epsilon is in units of the image. Shapes and mask as in `l1`. Raises GraphError."""
    epsilon = _positive("charbonnier", "epsilon", epsilon)
    d = _difference("charbonnier", image, target)
    # (sqrt(d^2 + e^2) - e) without the difference of nearly equal numbers
    term = d * d / (sqrt(d * d + epsilon * epsilon) + epsilon)
    return _image_mean(_channel_sum(term), d.channels, mask)


def mean_square(x: Node) -> Node:
    """Mean over entries and channels of x^2, of a parameter or anything else: what keeps coefficients and offsets small."""
    if not isinstance(x, Node) or is_int(x.vtype):
        raise GraphError(f"mean_square: {x!r:.60}; a float or vec value is needed")
    return _image_mean(dot(x, x), x.channels, None)


def total_variation(image: Node, power: int = 1, cell: tuple[int, int] | None = None, mask: Node | None = None) -> Node:
    """Mean over texels and channels of |right - own|^power + |below - own|^power, 0 beyond the last column and row (Rudin, Osher and Fatemi
    1992, by axis): what keeps a texture even where no picture tells. power: 1, which leaves edges, or 2.

    cell: (width, height) of the views of an atlas, `frame.cell`; None: one image. mask: a float image in [0, 1] that weighs each texel's
    two differences. Texels that lie side by side in a texture need not do so on the surface. Raises GraphError."""
    if power not in (1, 2) or isinstance(power, bool):
        raise GraphError(f"total_variation: power is {power!r:.40}; 1 or 2 is allowed")
    if not isinstance(image, Node) or is_int(image.vtype):
        raise GraphError(f"total_variation: the image is {image!r:.60}; a float or vec image is needed")
    differences = [shift(image, dx, dy, cell=cell) - image for dx, dy in ((-1, 0), (0, -1))]
    each = [_channel_sum(absolute(d)) if power == 1 else dot(d, d) for d in differences]
    return _image_mean(each[0] + each[1], image.channels, mask)


def tint(image: Node, mask: Node | None = None) -> Node:
    """Mean over texels and channels of |c - mean of the texel's channels|: how far colours are from grey. Of an environment's map: light
    and colours of surfaces share what is seen, and of the two it is the light that is nearly white (Munkberg et al. 2022).

    image: a vec image. mask: a float image in [0, 1] that weighs each texel. Raises GraphError."""
    if not isinstance(image, Node) or is_int(image.vtype) or image.channels < 2:
        raise GraphError(f"tint: the image is {image!r:.60}; a vec image is needed")
    return _image_mean(_channel_sum(absolute(image - _channel_sum(image) * (1.0 / image.channels))), image.channels, mask)


def pyramid_l1(image: Node, target: Node, levels: int = 4, cell: tuple[int, int] | None = None, mask: Node | None = None) -> Node:
    """Mean over `levels` levels of the L1 of the difference halved 0, 1, 2, ... times (`downsample`): it sees how far away a misplaced
    thing is, up to 2^(levels - 1) texels.

    cell: (width, height) of the views of an atlas, `frame.cell`; None: one image. mask: a float image that weighs the difference before
    it is halved. Each level's mean is over its own texels and channels. Raises GraphError where an image is halved beyond one texel.
    """
    w, h = cell = cell or (image.extent.width, image.extent.height)
    if isinstance(levels, bool) or not isinstance(levels, int) or levels < 1 or 2 ** (levels - 1) >= 2 * max(w, h):
        raise GraphError(f"pyramid_l1: {levels!r:.40} levels of cells of {w} x {h}; 1 to {1 + math.ceil(math.log2(max(w, h)))} are allowed")
    d, loss = _difference("pyramid_l1", image, target), None
    if mask is not None:
        d = d * _weights(mask)
    for level in range(levels):
        if level:
            d, cell = downsample(d, cell), (-(-cell[0] // 2), -(-cell[1] // 2))
        term = _image_mean(_channel_sum(absolute(d)), d.channels, None)
        loss = term if loss is None else loss + term
    return loss * (1.0 / levels)


def _gauss(window: int, sigma: float) -> np.ndarray:
    x = np.arange(window) - window // 2
    w = np.exp(-0.5 * (x / sigma) ** 2)
    return w / w.sum()


def ssim(image: Node, target: Node, cell: tuple[int, int] | None = None, window: int = 11, sigma: float = 1.5, peak: float = 1.0) -> Node:
    """The structural similarity of each texel and channel, at most 1, of the type and extent of the image (Wang et al. 2004, equation 13,
    with their K1 = 0.01, K2 = 0.03).

    Means and variances are weighted by a Gauss of `sigma` texels, cut to `window` x `window` and at the borders of the cell, where the
    weights left are scaled to add up to 1. cell: (width, height) of the views of an atlas, `frame.cell`; None: one image. peak: what the
    images' values go up to. Raises GraphError.
    """
    sigma, peak = _positive("ssim", "sigma", sigma), _positive("ssim", "peak", peak)
    if isinstance(window, bool) or not isinstance(window, int) or window < 1 or window % 2 == 0 or window > 129:
        raise GraphError(f"ssim: the window is {window!r:.40} texels wide; an odd number up to 129 is needed")
    _difference("ssim", image, target)
    x, y = image, as_node(target)
    y = y if y.extent == x.extent else apply("broadcast", y, extent=x.extent)
    taps = _gauss(window, sigma)
    inverse = 1.0 / convolve(apply("broadcast", 1.0, extent=x.extent), taps, "zero", cell)

    def average(z: Node) -> Node:
        return convolve(z, taps, "zero", cell) * inverse

    c1, c2 = (0.01 * peak) ** 2, (0.03 * peak) ** 2
    mx, my = average(x), average(y)
    xx, yy, xy = average(x * x) - mx * mx, average(y * y) - my * my, average(x * y) - mx * my
    return (mx * my * 2.0 + c1) * (xy * 2.0 + c2) / ((mx * mx + my * my + c1) * (xx + yy + c2))


def ssim_loss(image: Node, target: Node, mask: Node | None = None, cell: tuple[int, int] | None = None, window: int = 11,
              sigma: float = 1.5, peak: float = 1.0) -> Node:
    """Mean over texels and channels of 1 - `ssim`. mask: a float image that weighs each texel; windows look beyond it, so multiply both
    images by it first where what is outside must not count."""
    similar = ssim(image, target, cell, window, sigma, peak)
    return _image_mean(_channel_sum(1.0 - similar), similar.channels, mask)


def depth_loss(depth: Node, target: Node, delta: float = 0.1, mask: Node | None = None) -> Node:
    """Mean over texels of the Huber loss (`huber`) of depth - target where both are above 0, which is where both see something (as
    `frame.depth` and `frame.distance` have it); else nothing. Float images in units of the scene, as delta is. mask as in `l1`."""
    delta = _positive("depth_loss", "delta", delta)
    d = _difference("depth_loss", depth, target)
    if d.channels != 1:
        raise GraphError(f"depth_loss: the depth is {depth!r}; a float image is needed")
    return _image_mean(_huber(select((depth > 0.0) & (as_node(target) > 0.0), d, 0.0), delta), 1, mask)


def normal_loss(normal: Node, target: Node, mask: Node | None = None) -> Node:
    """Mean over texels of 1 - cos of the angle between two directions, 0 to 2, where neither is zero; else nothing. vec3 images, such as
    `frame.normal` and what it should be, of any length but 0. mask as in `l1`."""
    if getattr(normal, "vtype", None) != "vec3" or getattr(target, "vtype", None) != "vec3":
        raise GraphError(f"normal_loss: {normal!r:.60} and {target!r:.60}; vec3 images are needed")
    a, b = normalize(normal), normalize(target)
    # 1 - cos = |a - b|^2 / 2 of unit vectors, which keeps its digits where they are nearly alike
    d = a - b
    defined = minimum(dot(a, a), dot(b, b)) > 0.5
    return _image_mean(select(defined, dot(d, d), 0.0), 1, mask) * 0.5
