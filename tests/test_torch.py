"""The bridge to PyTorch, where it is installed (the extra `torch`, which is not in CI); tests/test_bridges.py tests what it is made of
everywhere."""
import copy
import threading

import numpy as np
import pytest
from bridge_scenes import SHAPES, arrays, ball_scene, run_page

from dressi_edge import runtime
from dressi_edge.cache.errors import DeviceError, InputError
from dressi_edge.cache.layout import Layout
from dressi_edge.compiler.graph.reference_session import ReferenceSession

torch = pytest.importorskip("torch", reason="the extra torch is not installed, so the bridge to PyTorch was not run; its parts were")

import dressi_edge.torch as bridge  # noqa: E402

pytest_plugins = ["gpu"]


@pytest.fixture(scope="module")
def path(gpu):
    return gpu.compile(ball_scene().program)


@pytest.fixture
def session(gpu, path):
    with runtime.load(path, gpu.device) as s:
        yield s
    gpu.silent()


def tensors(seed, grad=True):
    given, gradients = arrays(seed)
    return ({k: torch.from_numpy(x).requires_grad_(grad) for k, x in given.items()},
            {k: torch.from_numpy(x) for k, x in gradients.items()})


def wanted(session, seed):
    """Pictures and gradients, by the session alone."""
    given, gradients = arrays(seed)
    for k, x in given.items():
        session.set(k, x)
    return session.forward("render"), session.backward("render", **gradients)


def slopes(pictures, gradients):
    sum((pictures[k] * g).sum() for k, g in gradients.items()).backward()


def test_gradcheck_in_float64_through_the_reference():
    f = bridge.Function(ReferenceSession(ball_scene(0, (8, 6)).program))
    rng = np.random.default_rng(0)
    x = torch.tensor(np.random.default_rng(1).normal(size=(12, 3)) * 0.02 + f.pure.session.get("vertices")).requires_grad_()
    colors = torch.tensor(rng.uniform(size=(12, 3))).requires_grad_()
    assert f(vertices=x)["color"].dtype == torch.float64
    assert torch.autograd.gradcheck(lambda v, c: tuple(f(vertices=v, colors=c).values()), (x, colors), eps=1e-6, atol=1e-5, fast_mode=True)


def test_pictures_and_gradients_are_those_of_the_session(session):
    pictures, gradients = wanted(session, 1)
    given, weights = tensors(1)
    found = bridge.Function(session)(**given)
    slopes(found, weights)
    for key, x in pictures.items():
        assert found[key].requires_grad and np.array_equal(found[key].detach().numpy(), x)
    for key, x in gradients.items():
        np.testing.assert_array_equal(given[key].grad.numpy(), x)


def test_numbers_of_other_types_strides_and_devices_are_taken_and_gradients_are_of_their_type(session):
    pictures, gradients = wanted(session, 1)
    f, (given, weights) = bridge.Function(session), tensors(1, grad=False)
    for kind, far in ((torch.float64, 1e-6), (torch.float16, 2e-2), (torch.bfloat16, 2e-1)):
        x = given["colors"].to(kind).requires_grad_()
        found = f(vertices=given["vertices"], colors=x)
        assert found["color"].dtype == torch.float32
        slopes(found, weights)
        assert x.grad.dtype == kind and np.abs(x.grad.float().numpy() - gradients["colors"]).max() < far * np.abs(gradients["colors"]).max()
    turned = given["colors"].T.contiguous().T.requires_grad_()
    assert not turned.is_contiguous()
    one = torch.tensor([1.0]).expand(3)  # strides of zero
    found = f(vertices=given["vertices"], colors=turned, shade=one)
    np.testing.assert_array_equal(found["color"].detach().numpy(), pictures["color"])
    (found["color"].permute(3, 0, 1, 2) * weights["color"].permute(3, 0, 1, 2)).sum().backward()
    assert turned.grad.shape == (42, 3)
    if torch.cuda.is_available():
        x = given["colors"].cuda().requires_grad_()
        found = f(colors=x)
        found["color"].sum().backward()
        assert found["color"].is_cuda and x.grad.is_cuda


class Exported:
    """What is known by the protocol alone."""

    def __init__(self, of):
        self.of = of

    def __dlpack__(self, **asked):
        return self.of.__dlpack__(**asked)

    def __dlpack_device__(self):
        return self.of.__dlpack_device__()


def test_what_dlpack_exports_is_read_where_it_lies_and_results_are_exported_without_a_copy(session, monkeypatch):
    """One pass from a tensor's memory to that which the device copies from, and one back; then a tensor shares the array's memory."""
    passes, fill = [], Layout.fill

    def counted(layout, pixels, array):
        passes.append((pixels, array))
        fill(layout, pixels, array)

    monkeypatch.setattr(Layout, "fill", counted)
    x = torch.rand(42, 3)
    for given in (x, Exported(x), x.numpy()):
        session.set("vertices", given)
    assert len(passes) == 3
    for pixels, array in passes:
        assert np.shares_memory(array, x.numpy()) and np.shares_memory(pixels, session._staging.view)
    found = session.get("vertices")
    tensor = torch.from_dlpack(found)
    assert tensor.data_ptr() == found.__array_interface__["data"][0] and torch.equal(tensor, x)
    tensor.zero_()
    assert not found.any() and session.get("vertices").any(), "the array is the caller's own"


def test_a_session_says_why_it_cannot_take_a_tensor(session):
    with pytest.raises(InputError, match=r"vertices is a torch.Tensor, which NumPy does not take: .*requires grad.*detach"):
        session.set("vertices", torch.rand(42, 3, requires_grad=True))
    with pytest.raises(InputError, match="vertices is a test_torch.Exported, which NumPy does not take"):
        session.set("vertices", Exported(torch.empty(42, 3, dtype=torch.bfloat16)))
    with pytest.raises(InputError, match="vertices is a builtins.list, which NumPy does not take: .*inhomogeneous"):
        session.set("vertices", [[1.0, 2.0, 3.0], [1.0]])


def test_gradients_are_computed_for_what_requires_them_and_of_what_is_used(session):
    f, (given, weights) = bridge.Function(session), tensors(2)
    x, colors = given["vertices"], given["colors"].detach()
    (f(vertices=x, colors=colors)["alpha"] * weights["alpha"]).sum().backward()
    pure = f.pure
    np.testing.assert_array_equal(x.grad.numpy(), pure.backward(pure.at({k: v.detach().numpy() for k, v in given.items()}),
                                                                {"alpha": weights["alpha"].numpy()})["vertices"])
    with torch.no_grad():
        assert not f(vertices=x)["color"].requires_grad
    assert not f(colors=colors)["color"].requires_grad and not f()["alpha"].requires_grad
    color, = torch.autograd.grad(f(**given)["color"].sum(), [given["colors"]])
    assert color.abs().sum() > 0


def test_several_calls_before_backward_and_backward_twice(session):
    f, found = bridge.Function(session), []
    for order in ((0, 1), (1, 0)):
        cases = [tensors(seed) for seed in (3, 4)]
        pictures = [f(**given) for given, _ in cases]
        for k in order:
            sum((pictures[k][key] * g).sum() for key, g in cases[k][1].items()).backward(retain_graph=True)
        found.append([given["vertices"].grad.clone() for given, _ in cases])
        slopes(pictures[0], cases[0][1])
        torch.testing.assert_close(cases[0][0]["vertices"].grad, 2 * found[-1][0])
    assert all(torch.equal(a, b) for a, b in zip(*found)) and not torch.equal(*found[0])


def test_a_batch_is_its_members_and_what_they_share_gets_the_sum(session):
    f, cases = bridge.Function(session), [tensors(seed) for seed in (5, 6, 7)]
    colors = cases[0][0]["colors"]
    for given, weights in cases:
        slopes(f(vertices=given["vertices"], colors=colors), weights)
    x = torch.stack([given["vertices"].detach() for given, _ in cases]).requires_grad_()
    shared = colors.detach().clone().requires_grad_()
    found = f(vertices=x, colors=shared)
    assert found["color"].shape == (3, *SHAPES["color"])
    slopes(found, {key: torch.stack([weights[key] for _, weights in cases]) for key in found})
    torch.testing.assert_close(x.grad, torch.stack([given["vertices"].grad for given, _ in cases]), rtol=0, atol=0)
    torch.testing.assert_close(shared.grad, colors.grad, rtol=1e-5, atol=1e-5)
    with pytest.raises(InputError, match=r"batches of {'vertices': 3, 'colors': 2}; one size"):
        f(vertices=x, colors=torch.zeros(2, 42, 3))


@pytest.mark.parametrize("given, words", [
    ({"paint": torch.zeros(3)}, "no parameter or input 'paint'; there are: vertices colors shade"),
    ({"colors": [1.0]}, "colors is list; a tensor is needed"),
    ({"colors": torch.zeros(41, 3)}, r"colors has shape \(41, 3\); \(42, 3\) is needed, or that with an axis of a batch in front"),
    ({"colors": torch.zeros(42, 3).to_sparse()}, "dense one of real numbers"),
    ({"colors": torch.zeros(42, 3, dtype=torch.complex64)}, "dense one of real numbers"),
    ({"colors": torch.full((42, 3), torch.nan)}, "NaN or Inf"),
    ({"shade": torch.ones(3, requires_grad=True)}, "shade requires a gradient, which render does not give"),
    ({"colors": torch.zeros(42, 3), "vertices": torch.zeros(42, 3, device="meta")}, "tensors on cpu and meta"),
])
def test_what_cannot_be_given_is_said(session, given, words):
    with pytest.raises(InputError, match=words):
        bridge.Function(session)(**given)


def test_what_pytorch_forbids_is_still_forbidden(session):
    f, (given, weights) = bridge.Function(session), tensors(8)
    found = f(**given)
    with torch.no_grad():
        given["vertices"] += 0.1
    with pytest.raises(RuntimeError, match="modified by an inplace operation"):
        slopes(found, weights)
    given, weights = tensors(8)
    slope, = torch.autograd.grad(f(**given)["alpha"].square().sum(), [given["vertices"]], create_graph=True)
    with pytest.raises(RuntimeError, match="once_differentiable|second time|does not require grad"):
        slope.sum().backward()
    given, weights = tensors(8)
    with pytest.raises(InputError, match="NaN or Inf"):
        slopes(f(**given), {key: g * torch.nan for key, g in weights.items()})


def test_a_module_learns_what_it_holds(session):
    target = {k: torch.from_numpy(x) for k, x in wanted(session, 9)[0].items()}
    for k, x in arrays(10)[0].items():
        session.set(k, x)
    render = bridge.Render(session)
    assert {k: tuple(p.shape) for k, p in render.named_parameters()} == {k: SHAPES[k] for k in ("vertices", "colors")}
    optimizer, losses = torch.optim.Adam(render.parameters(), 0.01), []
    for _ in range(30):
        optimizer.zero_grad()
        loss = sum((x - target[k]).square().mean() for k, x in render().items())
        loss.backward()
        optimizer.step()
        losses.append(float(loss.detach()))
    assert losses[-1] < losses[0] / 4
    twin = copy.deepcopy(render)
    assert twin.function.pure is render.function.pure
    with torch.no_grad():
        render.colors.zero_()
    assert not torch.equal(twin()["color"], render()["color"])
    twin.load_state_dict(render.state_dict())
    assert torch.equal(twin()["color"], render()["color"])
    still = bridge.Render(session, learn=["colors"])
    assert [k for k, _ in still.named_parameters()] == ["colors"] and "vertices colors shade" in repr(still)
    with pytest.raises(InputError, match="gives no gradients of 'shade'"):
        bridge.Render(session, learn=["shade"])


def test_losses_of_the_scene_accumulate_as_backward_does(gpu):
    s = ball_scene()
    from dressi_edge.compiler.scene import F
    seen = s._frames[0]
    s.vjp("losses", ["vertices", "colors"], bright=F.mean(F.dot(seen.color, seen.color)), covered=F.mean(seen.alpha), alpha=seen.alpha)
    with gpu.open(s.program) as session:
        one, two = bridge.Render(session, "losses"), bridge.Render(session, "losses")
        for _ in range(2):
            found = one()
            (3.0 * found["bright"] - 0.5 * found["covered"]).backward()
            two.accumulate(bright=3.0, covered=-0.5)
        for a, b in zip(one.parameters(), two.parameters()):
            assert a.grad.abs().sum() > 0
            torch.testing.assert_close(a.grad, b.grad, rtol=1e-6, atol=0)
        with pytest.raises(InputError, match="no output 'alpha' of one number; there are: bright covered"):
            two.accumulate(alpha=1.0)
    gpu.silent()


def test_threads_share_a_session(session):
    f, found = bridge.Function(session), {}
    cases = {seed: wanted(session, seed)[1]["vertices"] for seed in range(3)}

    def work(seed):
        for _ in range(4):
            given, weights = tensors(seed)
            slopes(f(**given), weights)
            found.setdefault(seed, []).append(np.array_equal(given["vertices"].grad.numpy(), cases[seed]))

    threads = [threading.Thread(target=work, args=(seed,)) for seed in cases]
    for t in threads:
        t.start()
    for t in threads:
        t.join(120)
    assert found == {seed: [True] * 4 for seed in cases}


class Photos(torch.utils.data.Dataset):
    """Read in other processes; `render`: something that must not be called there."""

    def __init__(self, render=None):
        self.render = render

    def __len__(self):
        return 4

    def __getitem__(self, k):
        if self.render is not None:
            self.render()
        return torch.full(SHAPES["color"], k / 4.0)


def test_pictures_come_from_a_loader_with_processes_of_its_own(session):
    render = bridge.Render(session)
    loader = torch.utils.data.DataLoader(Photos(), batch_size=1, num_workers=2, multiprocessing_context="fork")
    for photo in loader:
        (render()["color"] - photo[0]).square().mean().backward()
    assert torch.isfinite(render.colors.grad).all() and render.colors.grad.abs().sum() > 0
    loader = torch.utils.data.DataLoader(Photos(render), num_workers=1, multiprocessing_context="fork")
    with pytest.raises(DeviceError, match="of which this one is a fork"):
        next(iter(loader))


def test_the_code_of_the_page_runs(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert run_page("torch") == 4
