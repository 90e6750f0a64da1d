"""rasterize, render, interpolate and edge_grad_estimator for PyTorch, with the arguments and shapes of DRTK's functions of these names.

    import dressi_edge.primitives.drtk as drtk     # instead of: import drtk

Places are in pixels, the upper left corner of a picture at (-0.5, -0.5), and z is the distance along the camera's axis; pictures have their
channels before rows. All of it is `primitives.torch` in other words: docs/primitives.md says what differs from DRTK. The device is that of
the last `primitives.torch.Context`. Raises InputError for what cannot be, DeviceError where there is no device.
"""
from __future__ import annotations

import torch as _torch

from ..cache.errors import InputError
from . import torch as _dr

__all__ = ["edge_grad_estimator", "interpolate", "rasterize", "render"]

Tensor = _torch.Tensor
NEAREST = 0.5  # where the near plane is, of the least distance there is
LEAST = 1e-6  # distances that are no more are behind the camera


def _clip(v: Tensor, height: int, width: int) -> Tensor:
    """[minibatch vertices 4] in clip coordinates with the far plane at infinity."""
    v = _dr._needed("v", v, "minibatch vertices 3", 3)
    z = v[..., 2]
    ahead = z.detach()[z.detach() > LEAST]
    near = NEAREST * float(ahead.min()) if len(ahead) else LEAST
    x, y = ((2.0 * v[..., k] + 1.0) / size - 1.0 for k, size in ((0, width), (1, height)))
    return _torch.stack([x * z, y * z, z - 2.0 * near, z], -1)


def _rast(v: Tensor, vi: Tensor, height: int, width: int) -> Tensor:
    context = _dr._last or _dr.Context(output_db=False)
    return _dr.rasterize(context, _clip(v, height, width), vi, [height, width], grad_db=False)[0]


def _indexed(index_img: Tensor, v: Tensor) -> tuple[int, int]:
    """Height and width."""
    tensor = isinstance(index_img, _torch.Tensor)
    if not tensor or index_img.dim() != 3 or index_img.is_floating_point() or len(index_img) != len(v):
        found = f"of shape {tuple(index_img.shape)} and {index_img.dtype}" if tensor else type(index_img).__name__
        raise InputError(f"index_img is {found}; whole numbers [{len(v)} height width] are needed, as rasterize gives them")
    return index_img.shape[1], index_img.shape[2]


def rasterize(v: Tensor, vi: Tensor, height: int, width: int, wireframe: bool = False) -> Tensor:
    """v [minibatch vertices 3], vi [triangles 3] -> index_img [minibatch height width], int32: the triangle in front, -1 where there is
    none. It has no gradient."""
    if wireframe:
        raise InputError("wireframe is not there; leave it out")
    with _torch.no_grad():
        return (_rast(v, vi, int(height), int(width))[..., 3] - 1.0).to(_torch.int32)


def render(v: Tensor, vi: Tensor, index_img: Tensor) -> tuple[Tensor, Tensor]:
    """depth_img [minibatch height width] and bary_img [minibatch 3 height width], in perspective, 0 where there is nothing; both have
    gradients by v. index_img: that of `rasterize` for these v and vi, which is drawn again and must be the same."""
    height, width = _indexed(index_img, v)
    rast = _rast(v, vi, height, width)
    if not _torch.equal((rast[..., 3] - 1.0).to(index_img.dtype), index_img.to(rast.device)):
        raise InputError("index_img is not that of rasterize for these v and vi; render draws what is in front, and nothing else")
    hit = (rast[..., 3] > 0).to(rast.dtype)
    bary = _torch.stack([rast[..., 0], rast[..., 1], hit - rast[..., 0] - rast[..., 1]], 1)
    depth = _dr.interpolate(v[..., 2:].contiguous(), rast, vi)[0][..., 0]
    return depth, bary


def interpolate(vert_attributes: Tensor, vi: Tensor, index_img: Tensor, bary_img: Tensor) -> Tensor:
    """vert_attributes [minibatch vertices channels] -> [minibatch channels height width]. Gradients by the attributes and bary_img, of
    which the third is 1 without the others."""
    _indexed(index_img, bary_img)
    bary = _dr._needed("bary_img", bary_img, "minibatch 3 height width")
    if bary.shape[1] != 3:
        raise InputError(f"bary_img has shape {tuple(bary.shape)}; floating [minibatch 3 height width] is needed")
    number = index_img.to(bary.dtype) + 1.0
    rast = _torch.stack([bary[:, 0], bary[:, 1], _torch.zeros_like(number), number], -1)
    return _dr.interpolate(vert_attributes, rast, vi)[0].permute(0, 3, 1, 2)


def edge_grad_estimator(v_pix: Tensor, vi: Tensor, bary_img: Tensor, img: Tensor, index_img: Tensor, v_pix_img_hook=None) -> Tensor:
    """img [minibatch channels height width] as it is, which here gets a gradient by v_pix at its silhouettes: that of `antialias`.
    bary_img is not needed."""
    if v_pix_img_hook is not None:
        raise InputError("v_pix_img_hook is not there: gradients are summed by vertex at once; leave it out")
    height, width = _indexed(index_img, v_pix)
    rast = _rast(v_pix.detach(), vi, height, width)
    soft = _dr.antialias(img.detach().permute(0, 2, 3, 1).contiguous(), rast, _clip(v_pix, height, width), vi).permute(0, 3, 1, 2)
    return img + (soft - soft.detach())
