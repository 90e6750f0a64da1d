"""Counts and running sums: np.bincount and np.cumsum, with kernels whose workgroups share memory and without, the same bits."""

from dataclasses import replace

import numpy as np
import pytest

from dressi_edge import runtime
from dressi_edge.cache import bundle
from dressi_edge.cache.errors import DeviceError, GraphError
from dressi_edge.cache.layout import Layout
from dressi_edge.cache.profile import Profile
from dressi_edge.cache.verify import violations
from dressi_edge.compiler import Options, Program, build
from dressi_edge.compiler.graph.functions import bincount, constant_table, exclusive_scan
from dressi_edge.compiler.graph.reference_session import ReferenceSession
from dressi_edge.compiler.passes.compute import room, spread
from dressi_edge.runtime.emulate import EmulatedDevice
from dressi_edge.runtime.session import Session

pytest_plugins = ["gpu"]

LAVAPIPE = Profile.load("lavapipe")
KINDS = ("none", "ops", "all")


def table(n):
    return Layout("table", "int", count=n)


def counting(n, bins):
    """Entries to counts to where each bin begins, and running sums of the entries."""
    p = Program()
    index = p.input("index", table(n))
    counts = bincount(index, bins)
    p.plan("count", {}, {"counts": (counts, table(bins)), "begins": (exclusive_scan(counts), table(bins)),
                         "running": (exclusive_scan(index), table(n))})
    return p


def entries(n, bins):
    """Many in few bins, some in none."""
    rng = np.random.default_rng(n)
    return np.where(rng.random(n) < 0.5, rng.integers(-3, bins + 4, n), rng.integers(0, 1 + bins // 7, n)).astype(np.int32)


def wanted(index, bins):
    counts = np.bincount(index[(index >= 0) & (index < bins)], minlength=bins)
    return counts, np.cumsum(counts) - counts, np.cumsum(index, dtype=np.int32) - index


def run(program, kind, device, index, profile=LAVAPIPE):
    made = build(program, profile, Options(compute=kind))
    data = bundle.dumps(made.description, made.blobs, bundle.version_of([made.description]))
    with Session(bundle.loads(data), device) as session:
        session.set("index", index)
        return made, [session.get(name) for name in ("counts", "begins", "running")]


@pytest.mark.parametrize("n, bins", [(1, 1), (64, 3), (1024, 1024), (1025, 2048), (4097, 2049), (70_001, 4096), (333 * 217, 130_000)])
def test_counts_and_sums_are_those_of_numpy(gpu, n, bins):
    """Around the sizes of chunks, workgroups and the bins that a workgroup holds; where bins lie in a workgroup's memory and where not."""
    index, program = entries(n, bins), counting(n, bins)
    reference = wanted(index, bins)
    with ReferenceSession(program) as session:
        session.set("index", index)
        for found, right in zip((session.get(name) for name in ("counts", "begins", "running")), reference, strict=True):
            assert np.array_equal(found, right)
    for kind in KINDS:
        made, found = run(program, kind, gpu.device, index)
        assert all(np.array_equal(a, b) for a, b in zip(found, reference, strict=True)), kind
        kernels = [s for stage in made.stages["count"] for s in stage.substages if s.kernel]
        assert bool(kernels) == (kind != "none") and all(s.compute for s in kernels)
    gpu.silent()


def test_fewer_stages_are_run_with_kernels():
    stages = {kind: len(build(counting(70_000, 4096), LAVAPIPE, Options(compute=kind)).stages["count"]) for kind in KINDS}
    assert stages["ops"] <= 7 < 20 < stages["none"]


def test_sums_wrap_around_alike(gpu):
    index = np.full(3000, 2 ** 30, np.int32)
    right = (np.arange(3000) * 2 ** 30 + 2 ** 31) % 2 ** 32 - 2 ** 31
    for kind in ("none", "ops"):
        assert np.array_equal(run(counting(3000, 5), kind, gpu.device, index)[1][2], right)
    gpu.silent()


def test_the_first_entries_alone(gpu):
    """Of an image, too: row by row, and nothing of the rest."""
    p, layout = Program(), Layout("image", "int", 50, 40)
    index = p.input("index", layout)
    p.plan("count", {}, {"counts": (bincount(index, 9, count=1234), table(9)), "begins": (exclusive_scan(index, count=1234), layout),
                         "running": (exclusive_scan(index), layout)})
    data = np.random.default_rng(2).integers(0, 9, (40, 50)).astype(np.int32)
    flat = data.ravel()
    sums = np.cumsum(flat) - flat
    for kind in KINDS:
        counts, begins, running = run(p, kind, gpu.device, data)[1]
        assert np.array_equal(counts, np.bincount(flat[:1234], minlength=9))
        assert np.array_equal(begins.ravel(), np.where(np.arange(2000) < 1234, sums, 0)) and np.array_equal(running.ravel(), sums)
    gpu.silent()


def test_runs_agree_bit_for_bit(gpu):
    index, program = entries(20_000, 300), counting(20_000, 300)
    first = run(program, "ops", gpu.device, index)[1]
    assert all(a.tobytes() == b.tobytes() for _ in range(3) for a, b in zip(first, run(program, "ops", gpu.device, index)[1]))


def test_what_has_no_place_for_kernels_does_without(gpu):
    """Too few invocations, no storage images, or less shared memory than the bins take."""
    index, program = entries(5000, 1500), counting(5000, 1500)
    right = wanted(index, 1500)
    for limits, kernels in (({"maxComputeWorkGroupInvocations": 32}, 0), ({"maxPerStageDescriptorStorageImages": 0}, 0),
                            ({"maxComputeSharedMemorySize": 1024}, 7), ({"maxComputeSharedMemorySize": 100}, 1)):
        profile = replace(LAVAPIPE, name="less", limits={**LAVAPIPE.limits, **limits})
        made, found = run(program, "ops", EmulatedDevice(gpu.device, profile), index, profile)
        assert all(np.array_equal(a, b) for a, b in zip(found, right, strict=True))
        assert sum(s.kernel for stage in made.stages["count"] for s in stage.substages) == kernels, limits
        shared = [shader.shared_bytes for shader in bundle.loads(bundle.dumps(made.description, made.blobs, bundle.version_of(
            [made.description]))).interfaces]
        assert max(shared) <= profile.limit("maxComputeSharedMemorySize")
    gpu.silent()


@pytest.mark.parametrize("limit, value", [("maxComputeSharedMemorySize", 4096), ("maxComputeWorkGroupInvocations", 63),
                                          ("maxComputeWorkGroupSize", (63, 128, 64)), ("maxPerStageDescriptorStorageImages", 0)])
def test_a_device_with_less_refuses_it_by_name(gpu, tmp_path, limit, value):
    made = build(counting(5000, 1500), LAVAPIPE, Options(compute="ops"))
    path = tmp_path / "count.dressi"
    bundle.write(path, made.description, made.blobs)
    assert made.description["needs"]["limits"]["maxComputeSharedMemorySize"] == 6000
    less = replace(LAVAPIPE, name="less", limits={**LAVAPIPE.limits, limit: value})
    lines = violations(made.description, less, bundle.read(path).interfaces)
    assert lines and limit in lines[0] and lines[0].startswith("count.stages[")
    with pytest.raises(DeviceError, match=rf"does not fit less: count\.stages\[\d\].*profile less allows .*{limit}"):
        runtime.load(path, EmulatedDevice(gpu.device, less))


def test_workgroups_are_spread_over_two_axes():
    assert spread(5) == (5, 1) and spread(1 << 15) == (1 << 15, 1) and spread((1 << 15) + 1) == (1 << 15, 2)
    assert room("none", LAVAPIPE) is None and room("ops", LAVAPIPE) == LAVAPIPE.limit("maxComputeSharedMemorySize")


@pytest.mark.parametrize("call, told", [
    (lambda: bincount(constant_table(np.zeros(4)), 3), "bincount: an int table or image is needed"),
    (lambda: bincount(constant_table(np.zeros(4, int)), 0), "bincount: 0 bins of 4 entries"),
    (lambda: bincount(constant_table(np.zeros(4, int)), 3, count=5), "bincount: 3 bins of 5 entries"),
    (lambda: exclusive_scan(constant_table(np.zeros(4))), "exclusive_scan: an int table or image"),
    (lambda: exclusive_scan(constant_table(np.zeros(4, int)), count=0), "exclusive_scan: count is 0")])
def test_what_cannot_be_counted_is_named(call, told):
    with pytest.raises(GraphError, match=told):
        call()
