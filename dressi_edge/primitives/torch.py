"""rasterize, interpolate, texture and antialias for PyTorch, with the arguments of nvdiffrast's functions of these names.

    import dressi_edge.primitives.torch as dr     # instead of: import nvdiffrast.torch as dr

In: tensors of any floating type on any device. Out: float32 on the device of what was given, drawn by Vulkan. Each function is compiled for
its triangles and sizes when it is first called with them (seconds), kept in memory and on disk. docs/primitives.md says what differs.
Raises InputError for what cannot be, DeviceError where there is no device.
"""
from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import torch as _torch
from torch.autograd.function import once_differentiable as _once_differentiable

from ..cache.errors import InputError
from ..cache.profile import Profile
from ..torch import _host
from .boxes import boxes as _boxes
from .store import Primitive, Store

__all__ = ["Context", "RasterizeCudaContext", "RasterizeGLContext", "antialias", "antialias_construct_topology_hash", "interpolate",
           "rasterize", "texture"]

Tensor = _torch.Tensor
BOUNDARIES, MIPMAPS = ("wrap", "clamp", "zero"), ("linear-mipmap-nearest", "linear-mipmap-linear")
FILTERS = ("auto", "nearest", "linear", *MIPMAPS)


class Context:
    """The Vulkan device that draws, and what was compiled for it. device: a part of its name (default $DRESSI_DEVICE or the best there is);
    profile: what to compile for, by default what the device reports; output_db: whether rasterize gives rast_db, which costs time. The
    last one made is that of the functions that take none."""

    def __init__(self, device: str | None = None, profile: Profile | str | None = None, output_db: bool = True):
        global _last
        self.store, self.output_db = Store(device, profile), output_db
        _last = self

    def close(self) -> None:
        """Give everything back."""
        global _last
        self.store.close()
        _last = None if _last is self else _last


_last: Context | None = None


def RasterizeGLContext(output_db: bool = True, mode: str = "automatic", device=None) -> Context:  # noqa: N802  (their name)
    """A `Context`; mode and device are OpenGL's, and say nothing here."""
    return Context(output_db=output_db)


def RasterizeCudaContext(device=None) -> Context:  # noqa: N802
    """A `Context`; the argument is a device of CUDA, and says nothing here."""
    return Context()


def _store() -> Store:
    return (_last or Context()).store


class _Call(_torch.autograd.Function):
    """One function on one set of arrays. extra: arrays that are no tensors; still: names of what may well be as it was last time."""

    @staticmethod
    def forward(ctx, primitive: Primitive, names: Sequence[str], extra: Mapping[str, np.ndarray], still: Sequence[str], *tensors):
        ctx.set_materialize_grads(False)
        found, call = primitive.forward({**dict(zip(names, map(_host, tensors))), **extra}, still)
        if any(ctx.needs_input_grad):
            ctx.primitive, ctx.names, ctx.outputs, ctx.call = primitive, names, list(found), call
            ctx.save_for_backward(*tensors)
        return tuple(_torch.from_numpy(x).to(tensors[0].device) for x in found.values())

    @staticmethod
    @_once_differentiable
    def backward(ctx, *gradients):
        tensors = ctx.saved_tensors
        wanted = [name for name, needed in zip(ctx.names, ctx.needs_input_grad[4:]) if needed]
        found = ctx.primitive.backward(ctx.call, {k: _host(g) for k, g in zip(ctx.outputs, gradients) if g is not None}, wanted)
        return None, None, None, None, *(
            _torch.from_numpy(np.ascontiguousarray(found[name]).reshape(x.shape)).to(x.device, x.dtype) if name in found else None
            for name, x in zip(ctx.names, tensors))


def _wanted(**tensors: Tensor) -> list[str]:
    """Of what there will be gradients."""
    return [name for name, x in tensors.items() if x.requires_grad] if _torch.is_grad_enabled() else []


def _run(primitive: Primitive, extra: Mapping[str, np.ndarray] | None = None, held: Sequence[str] = (), /, **tensors: Tensor):
    """The outputs. held: of which there is no gradient."""
    still = [name for name, x in tensors.items() if not x.requires_grad]
    given = [x.detach() if name in held else x for name, x in tensors.items()]
    return _Call.apply(primitive, tuple(tensors), extra or {}, still, *given)


def _needed(name: str, x, axes: str, last: int | None = None) -> Tensor:
    if not isinstance(x, _torch.Tensor):
        raise InputError(f"{name} is {type(x).__name__}; a tensor is needed")
    count = len(axes.split())
    if x.dim() != count or last is not None and x.shape[-1] != last or 0 in x.shape or not x.is_floating_point():
        raise InputError(f"{name} has shape {tuple(x.shape)} and type {x.dtype}; floating [{axes}] is needed")
    return x


def _triangles(tri, vertices: int) -> np.ndarray:
    if not isinstance(tri, _torch.Tensor) or tri.dim() != 2 or tri.shape[1] != 3 or tri.is_floating_point() or not len(tri):
        found = f"of shape {tuple(tri.shape)} and {tri.dtype}" if isinstance(tri, _torch.Tensor) else type(tri).__name__
        raise InputError(f"tri is {found}; whole numbers [triangles 3] are needed, at least one row")
    faces = tri.detach().cpu().numpy().astype(np.int32)
    if faces.min() < 0 or faces.max() >= vertices:
        raise InputError(f"tri names vertex {faces.max() if faces.min() >= 0 else faces.min()}; there are 0 to {vertices - 1}")
    return faces


def _pictures(name: str, x: Tensor, like: Tensor) -> None:
    if x.shape[:3] != like.shape[:3]:
        raise InputError(f"{name} has shape {tuple(x.shape)}; {list(like.shape[:3])} and channels are needed, as rast has")


def _named(primitive: Primitive, rast: Tensor, count: int, beside: int = 0) -> np.ndarray:
    return _boxes(_host(rast), count, primitive.columns, beside)


def rasterize(glctx: Context, pos: Tensor, tri: Tensor, resolution: Sequence[int], ranges=None, grad_db: bool = True):
    """pos [minibatch vertices 4] in clip coordinates, tri [triangles 3], resolution [height, width] -> rast [minibatch height width 4]: u,
    v, z / w, triangle + 1, zero where there is nothing; and rast_db: du/dX, du/dY, dv/dX, dv/dY. The gradient by pos is that of u and v
    and, unless grad_db is false, of rast_db."""
    if not isinstance(glctx, Context):
        raise InputError(f"glctx is {type(glctx).__name__}; a Context of this module is needed")
    if ranges is not None or isinstance(pos, _torch.Tensor) and pos.dim() == 2:
        raise InputError("pos of two axes and ranges (nvdiffrast's range mode) are not there; give pos [minibatch vertices 4], and a tri "
                         "for each call")
    pos = _needed("pos", pos, "minibatch vertices 4", 4)
    height, width = (int(x) for x in resolution)
    if min(height, width) < 1:
        raise InputError(f"resolution is {[height, width]}; [height, width], 1 or more, is needed")
    n, vertices, _ = pos.shape
    primitive = glctx.store.find("rasterize", _triangles(tri, vertices), (vertices, n, (width, height), glctx.output_db), {},
                                   _wanted(pos=pos))
    rast, *db = _run(primitive, pos=pos.reshape(-1, 4))
    if not db:
        return rast, rast.new_zeros((n, height, width, 0))
    return rast, db[0] if grad_db else db[0].detach()


def interpolate(attr: Tensor, rast: Tensor, tri: Tensor, rast_db: Tensor | None = None, diff_attrs=None):
    """attr [minibatch or 1 vertices channels] (or without the first axis) over rast -> out [minibatch height width channels], and out_da:
    of the channels of diff_attrs ("all" or their numbers) how each changes, [... 2 per channel]: d/dX, d/dY; none without rast_db."""
    rast = _needed("rast", rast, "minibatch height width 4", 4)
    if isinstance(attr, _torch.Tensor) and attr.dim() == 2:
        attr = attr[None]
    attr = _needed("attr", attr, "minibatch vertices channels")
    n, height, width, _ = rast.shape
    if attr.shape[0] not in (1, n):
        raise InputError(f"attr has shape {tuple(attr.shape)} and rast {tuple(rast.shape)}; 1 or {n} in front are needed")
    faces, store = _triangles(tri, attr.shape[1]), _store()

    def made(name: str, channels: int, outputs: Sequence[str], wanted: Sequence[str]) -> Primitive:
        sizes = (attr.shape[1], n, (width, height), channels, attr.shape[0] > 1)
        return store.find(name, faces, sizes, {key: channels for key in ("attr", *outputs)}, wanted)

    primitive = made("interpolate", attr.shape[2], ["out"], _wanted(attr=attr, rast=rast))
    named = {"boxes": _named(primitive, rast, len(faces))}
    out, = _run(primitive, named, attr=attr.reshape(-1, attr.shape[2]), rast=rast)
    if diff_attrs is None or rast_db is None and not len(diff_attrs):
        return out, out.new_zeros((n, height, width, 0))
    if rast_db is None:
        raise InputError("diff_attrs without rast_db: how attributes change is made of how u and v do; give rasterize's second result")
    _pictures("rast_db", _needed("rast_db", rast_db, "minibatch height width 4", 4), rast)
    chosen = attr if isinstance(diff_attrs, str) and diff_attrs == "all" else attr[..., list(diff_attrs)]
    primitive = made("slopes", chosen.shape[2], ["x", "y"], _wanted(attr=chosen, db=rast_db))
    x, y = _run(primitive, named, ("rast",), attr=chosen.reshape(-1, chosen.shape[2]), rast=rast, db=rast_db)
    return out, _torch.stack([x, y], -1).reshape(n, height, width, -1)


def texture(tex: Tensor, uv: Tensor, uv_da: Tensor | None = None, mip_level_bias: Tensor | None = None, mip=None,
            filter_mode: str = "auto", boundary_mode: str = "wrap", max_mip_level: int | None = None) -> Tensor:
    """tex [minibatch or 1 height width channels] at uv [minibatch height width 2], 0 to 1 over the texture, v from row 0 on -> [minibatch
    height width channels]. uv_da: du/dX, du/dY, dv/dX, dv/dY, for mipmaps. filter_mode: "auto" (linear, with uv_da linear-mipmap-linear),
    "nearest", "linear", "linear-mipmap-nearest", "linear-mipmap-linear"; boundary_mode: "wrap", "clamp", "zero"."""
    tex, uv = _needed("tex", tex, "minibatch height width channels"), _needed("uv", uv, "minibatch height width 2", 2)
    for what, word, known in (("filter_mode", filter_mode, FILTERS), ("boundary_mode", boundary_mode, BOUNDARIES)):
        if word not in known:
            raise InputError(f"{what} is {word!r:.40}; {' '.join(known)} are there")
    if mip is not None:
        raise InputError("mip: mip levels are made of the texture where they are used; leave it out")
    n, height, width, _ = uv.shape
    if tex.shape[0] not in (1, n):
        raise InputError(f"tex has shape {tuple(tex.shape)} and uv {tuple(uv.shape)}; 1 or {n} in front are needed")
    if filter_mode == "auto":
        filter_mode = "linear" if uv_da is None else "linear-mipmap-linear"
    more = {}
    if filter_mode in MIPMAPS:
        if uv_da is None:
            raise InputError(f"filter_mode {filter_mode} needs uv_da, the second result of interpolate")
        if boundary_mode == "zero":
            raise InputError("boundary_mode zero has no mipmaps here; pad the texture and use clamp")
        more["da"] = _needed("uv_da", uv_da, "minibatch height width 4", 4)
        _pictures("uv_da", uv_da, uv)
        if mip_level_bias is not None:
            more["bias"] = _needed("mip_level_bias", mip_level_bias, "minibatch height width")
            _pictures("mip_level_bias", mip_level_bias, uv)
    if tex.shape[0] > 1:
        def one(k: int) -> Tensor:
            da, bias = (more[key][k:k + 1] if key in more else None for key in ("da", "bias"))
            return texture(tex[k:k + 1], uv[k:k + 1], da, bias, None, filter_mode, boundary_mode, max_mip_level)

        return _torch.cat([one(k) for k in range(n)])
    if boundary_mode == "zero":  # a rim of zeros, which then is what lies beyond
        size = _torch.tensor([tex.shape[2], tex.shape[1]], dtype=uv.dtype, device=uv.device)
        tex, uv, boundary_mode = _torch.nn.functional.pad(tex, (0, 0, 1, 1, 1, 1)), (uv * size + 1) / (size + 2), "clamp"
    _, rows, columns, channels = tex.shape
    top = int(max_mip_level) if max_mip_level is not None and filter_mode in MIPMAPS else None
    sizes = (n, (width, height), (columns, rows), channels, filter_mode, boundary_mode, top, "bias" in more)
    primitive = _store().find("texture", None, sizes, {"tex": channels, "out": channels},
                              _wanted(tex=tex, **{} if filter_mode == "nearest" else {"uv": uv}))
    return _run(primitive, {}, ("da", "bias", *(["uv"] if filter_mode == "nearest" else [])), uv=uv, tex=tex[0], **more)[0]


def antialias(color: Tensor, rast: Tensor, pos: Tensor, tri: Tensor, topology_hash=None, pos_gradient_boost: float = 1.0) -> Tensor:
    """color [minibatch height width channels], rast and pos as of rasterize -> color, blended between pixels where a silhouette runs
    between them. Gradients by color and pos. topology_hash is not needed, and not looked at."""
    color, rast = _needed("color", color, "minibatch height width channels"), _needed("rast", rast, "minibatch height width 4", 4)
    pos = _needed("pos", pos, "minibatch vertices 4", 4)
    _pictures("color", color, rast)
    n, height, width, channels = color.shape
    if pos.shape[0] != n:
        raise InputError(f"pos has shape {tuple(pos.shape)} and rast {tuple(rast.shape)}; {n} in front are needed")
    if pos_gradient_boost != 1.0:
        pos = pos.detach() + (pos - pos.detach()) * pos_gradient_boost
    faces = _triangles(tri, pos.shape[1])
    primitive = _store().find("antialias", faces, (pos.shape[1], n, (width, height), channels), {"color": channels, "out": channels},
                              _wanted(color=color, pos=pos))
    named = {"boxes": _named(primitive, rast, len(faces), 1)}
    return _run(primitive, named, ("rast",), color=color, pos=pos.reshape(-1, 4), rast=rast)[0]


def antialias_construct_topology_hash(tri: Tensor) -> None:
    """Nothing: who touches whom is found when a function is compiled."""
