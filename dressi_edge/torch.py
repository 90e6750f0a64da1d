"""PyTorch: a `Scene.vjp` of a session as a differentiable function of tensors, and as a module. docs/bridges.md.

    render = dressi_edge.torch.Render(runtime.load("render.dressi"))     # holds the parameters
    optimizer = torch.optim.Adam(render.parameters(), 0.01)
    loss = (render()["color"] - photo).square().mean()
    loss.backward()
    optimizer.step()

In: tensors of any floating type, strides and device. Out: tensors of the session's type (float32; float64 of a `ReferenceSession`) on the
device of what was given. Between a tensor on the CPU and the memory that the Vulkan device copies from or to there is one copy each way.
PyTorch is needed (`pip install 'dressi_edge[torch]'`); the runtime does not import this module.
"""
from __future__ import annotations

from collections.abc import Iterable

import numpy as np
import torch
from torch.autograd.function import once_differentiable

from .bridges.pure import Pure
from .cache.errors import InputError

__all__ = ["Function", "Render"]


class Function:
    """A vjp as a function: `f(vertices=x)` gives pictures by name, with gradients by every tensor of a parameter that requires one. What is
    not given is as the session has it. A tensor may have one axis more in front: then so many pictures are drawn one after another, tensors
    without it are the same for all, and each is drawn once more for its gradients. Several calls may come before `backward`. session:
    an open one, or a `Pure`; name: of the vjp, where there are several. Calls of several threads run one after another. Raises InputError
    for what cannot be, DeviceError in a forked process."""

    def __init__(self, session, name: str | None = None):
        self.pure = session if isinstance(session, Pure) else Pure(session, name)

    def __repr__(self) -> str:
        p = self.pure
        return f"{type(self).__name__}({p.name}: {' '.join(p.given)} -> {' '.join(p.outputs)})"

    def __call__(self, **tensors: torch.Tensor) -> dict[str, torch.Tensor]:
        pure, names = self.pure, tuple(tensors)
        pure.check(names)
        for name, tensor in tensors.items():
            _check(name, tensor, pure)
        batched = tuple(tensors[name].dim() > len(pure.given[name]) for name in names)
        counts = {name: len(tensors[name]) for name, more in zip(names, batched) if more}
        if len(set(counts.values())) > 1 or 0 in counts.values():
            raise InputError(f"{pure.name} is given batches of {counts}; one size above 0 is needed")
        devices = {tensor.device for tensor in tensors.values()}
        if len(devices) > 1:
            raise InputError(f"{pure.name} is given tensors on {' and '.join(sorted(map(str, devices)))}; they must be on one device")
        count = next(iter(counts.values()), None)
        return dict(zip(pure.outputs, _Vjp.apply(pure, names, batched, count, *tensors.values())))


def _check(name: str, tensor, pure: Pure) -> None:
    if not isinstance(tensor, torch.Tensor):
        raise InputError(f"{name} is {type(tensor).__name__}; a tensor is needed")
    shape = pure.given[name]
    if tuple(tensor.shape) != shape and tuple(tensor.shape[1:]) != shape:
        raise InputError(f"{name} has shape {tuple(tensor.shape)}; {shape} is needed, or that with an axis of a batch in front")
    if tensor.layout != torch.strided or tensor.is_complex() or tensor.is_quantized:
        raise InputError(f"{name} is a tensor of {tensor.layout} and {tensor.dtype}; a dense one of real numbers is needed")
    if tensor.requires_grad and name not in pure.parameters:
        raise InputError(f"{name} requires a gradient, which {pure.name} does not give; it gives those of {' '.join(pure.parameters)}. "
                         "Name it in Scene.vjp(), or detach it")


def _host(tensor: torch.Tensor) -> np.ndarray:
    """Its numbers, shared where they are in the memory of the CPU and of a type that NumPy has."""
    tensor = tensor.detach()
    return (tensor.float() if tensor.dtype == torch.bfloat16 else tensor).cpu().numpy()


class _Vjp(torch.autograd.Function):
    """The function's node in PyTorch's graph."""

    @staticmethod
    def forward(ctx, pure: Pure, names, batched, count, *tensors):
        ctx.set_materialize_grads(False)  # outputs without gradient give None
        hosts = dict(zip(names, map(_host, tensors)))
        steady = [name for name, tensor in zip(names, tensors) if not tensor.requires_grad]  # what is optimized changes every time
        real = torch.from_numpy(np.zeros(0, pure.real)).dtype
        made = [torch.empty(shape if count is None else (count, *shape), dtype=real) for shape in pure.outputs.values()]
        wide = {name for name, more in zip(names, batched) if more}
        calls = []
        for k in range(count or 1):
            arrays = {name: host[k] if name in wide else host for name, host in hosts.items()}
            into = {key: (out if count is None else out[k]).numpy() for key, out in zip(pure.outputs, made)}
            calls.append(pure.forward(arrays, steady, into)[1])
        if any(ctx.needs_input_grad):
            ctx.pure, ctx.names, ctx.batched, ctx.calls, ctx.single = pure, names, batched, calls, count is None
            ctx.save_for_backward(*tensors)  # PyTorch then says so if one was changed in place before backward
        device = tensors[0].device if tensors else torch.device("cpu")
        return tuple(out.to(device) for out in made)

    @staticmethod
    @once_differentiable
    def backward(ctx, *gradients):
        tensors, pure = ctx.saved_tensors, ctx.pure
        wanted = [name for name, needed in zip(ctx.names, ctx.needs_input_grad[4:]) if needed]
        hosts = {key: _host(g) for key, g in zip(pure.outputs, gradients) if g is not None}
        found = []
        for k in reversed(range(len(ctx.calls))):  # of the last the session may still have all
            found.insert(0, pure.backward(ctx.calls[k], {key: g if ctx.single else g[k] for key, g in hosts.items()}, wanted))
        given = []
        for name, more, tensor in zip(ctx.names, ctx.batched, tensors):
            if name not in wanted:
                given.append(None)
                continue
            each = [arrays[name] for arrays in found]
            whole = np.stack(each) if more else each[0] if len(each) == 1 else np.sum(each, 0)
            given.append(torch.from_numpy(whole).to(tensor.device, tensor.dtype))
        return None, None, None, None, *given


class Render(torch.nn.Module):
    """A vjp as a module that holds parameters: those of `learn` (default: all of which the vjp gives gradients), as the session has them
    now. A dot in a name becomes a line: `light0.power` is `render.light0_power`. Called, it gives pictures by name; tensors that are given
    to a call stand in for the module's own. session, name: as of `Function`. A copy of the module uses the same session."""

    def __init__(self, session, name: str | None = None, learn: Iterable[str] | None = None):
        super().__init__()
        self.function = Function(session, name)
        pure = self.function.pure
        self.learn = {key: key.replace(".", "_") for key in (pure.parameters if learn is None else learn)}
        for key, held in self.learn.items():
            if key not in pure.parameters:
                raise InputError(f"{pure.name} gives no gradients of {key!r:.60}; it gives those of {' '.join(pure.parameters)}")
            if hasattr(self, held):
                raise InputError(f"the module cannot hold {key}: it has a {held} of its own; leave it out of learn, and give it to calls")
            self.register_parameter(held, torch.nn.Parameter(torch.from_numpy(np.array(pure.session.get(key)))))

    def forward(self, **tensors: torch.Tensor) -> dict[str, torch.Tensor]:
        own = {key: getattr(self, held) for key, held in self.learn.items() if key not in tensors}
        return self.function(**own, **tensors)

    def accumulate(self, **weights: float) -> None:
        """Add to the `.grad` of the module's parameters the gradient of the sum of these outputs of one number each, times these weights.
        The same as `backward()` of that sum, but the numbers themselves are not computed: for losses that are written in the scene."""
        pure = self.function.pure
        for key in weights:
            if pure.outputs.get(key) != ():
                known = " ".join(name for name, shape in pure.outputs.items() if shape == ())
                raise InputError(f"{pure.name} has no output {key!r:.60} of one number; there are: {known or 'none'}")
        held = {key: getattr(self, name) for key, name in self.learn.items()}
        wanted = [key for key, parameter in held.items() if parameter.requires_grad]
        with pure.session.alone():
            call = pure.at({key: _host(parameter) for key, parameter in held.items()})
            found = pure.backward(call, {key: np.asarray(weight, pure.real) for key, weight in weights.items()}, wanted)
        for key in wanted:
            gradient = torch.from_numpy(found[key]).to(held[key].device, held[key].dtype)
            held[key].grad = gradient if held[key].grad is None else held[key].grad.add_(gradient)

    def extra_repr(self) -> str:
        return repr(self.function)
