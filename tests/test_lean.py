"""Small enough to embed: what loading imports, what is installed, and that closing gives everything back."""

import os
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from graphs import ROOT, python
from test_session import walk
from undertest import DEVICE

from dressi_edge import runtime
from dressi_edge.cache.layout import Layout
from dressi_edge.compiler import Program
from dressi_edge.compiler.graph.functions import apply, mean
from dressi_edge.runtime import vk
from dressi_edge.runtime.device import Device

pytest_plugins = ["gpu"]

INSTALLED_BYTES = 480_000  # of Python, the generated binding and the reader of shaders included
IMPORTS = 100  # modules beyond those of numpy and msgpack
SPANS = 5  # in the second half of the cycles, after each of which the process is weighed
RSS_GROWTH = 4 << 20  # over the second half of the cycles: noise


@pytest.fixture(scope="module")
def bundle(gpu):
    return gpu.compile(walk())


CYCLES = """
import ctypes, gc, os, sys
from dressi_edge import runtime
from dressi_edge.runtime.device import Device
trim = getattr(ctypes.CDLL(None), "malloc_trim", bool)  # what the allocator keeps is nobody's leak
def rss():
    trim(0)
    with open("/proc/self/statm") as f:
        return int(f.read().split()[1]) * os.sysconf("SC_PAGE_SIZE")
with Device.open(validation=sys.argv[3] == "synchronization") as device:
    def cycles(count):
        for _ in range(count):
            with runtime.load(sys.argv[1], device) as s:
                s.step(3)
                s.get("picture")
        gc.collect()
    count, spans = int(sys.argv[2]) // 2, int(sys.argv[4])
    cycles(count)
    print(rss())
    for _ in range(spans):
        cycles(count // spans)
        print(rss())
sys.exit("\\n".join(device.messages) or None)
"""

PROC = pytest.mark.skipif(not Path("/proc/self/statm").exists(), reason="no /proc here to read the memory of a process from")
LAYER = {"VK_INSTANCE_LAYERS": "VK_LAYER_KHRONOS_validation"}  # without a messenger it writes to stdout, where a number is expected


def kept(bundle, sessions, checks, code=CYCLES, **environment):
    """Bytes by which the process grows over the second half of the sessions if each span adds as much as the one that adds least: what
    leaks is in all of them, what the allocator does not give back in some."""
    return min(np.diff([int(line) for line in python(code, bundle, sessions, checks, SPANS, **environment).split()])) * SPANS


@PROC
def test_sessions_one_after_another_leave_nothing(bundle):
    assert kept(bundle, 200, "alone") < RSS_GROWTH


def test_over_60_sessions_the_layer_is_silent(bundle):
    python(CYCLES, bundle, 60, "synchronization", SPANS)


@PROC
@pytest.mark.full
@pytest.mark.parametrize("checks, environment, growth", [("alone", {}, RSS_GROWTH), ("objects", LAYER, RSS_GROWTH),
                                                         ("synchronization", {}, 20 << 20)])
def test_1000_sessions_one_after_another_leave_nothing(bundle, checks, environment, growth):
    """Over the last 500. Under synchronization validation the layer itself keeps 20 kB a session: docs/embedding.md."""
    assert kept(bundle, 1000, checks, **environment) < growth


@pytest.mark.full
@PROC
def test_a_session_is_no_garbage_that_stays(bundle):
    traced = CYCLES.replace("print(rss())", "import tracemalloc; tracemalloc.start(); cycles(1); tracemalloc.clear_traces()", 1)
    assert kept(bundle, 100, "alone", traced.replace("print(rss())", "print(tracemalloc.get_traced_memory()[0])")) < 25_000


def counted(table, kind, real, many):
    """A Vulkan command that counts the objects it makes or destroys."""
    def call(*args, **options):
        result = real(*args, **options)
        table[kind] = table.get(kind, 0) + many(args, result)
        return result

    return call


@pytest.mark.parametrize("sessions", [1, pytest.param(1000, marks=pytest.mark.full)])
def test_every_object_made_is_destroyed_once(bundle, monkeypatch, sessions):
    made, gone = {}, {}
    for name in dir(vk):
        for prefix, table in (("Create", made), ("Allocate", made), ("Destroy", gone), ("Free", gone)):
            kind = name.removeprefix(prefix).replace("GraphicsPipelines", "Pipeline")
            if name.startswith(prefix) and kind != "DescriptorSets":  # those go with their pool
                def many(args, result, table=table, kind=kind):
                    return len(args[2]) if table is gone and kind == "CommandBuffers" else \
                        len(result) if isinstance(result, list) else 1
                monkeypatch.setattr(vk, name, counted(table, kind, getattr(vk, name), many))
    with Device.open(DEVICE) as device:
        for _ in range(sessions):
            with runtime.load(bundle, device) as s:
                s.step(3)
                s.get("picture")
                s.set("rate", 0.5)
                s.profile_stages("walk", 1)
    made["CommandBuffers"] -= sessions  # those of the transfers go with their pools
    assert made == gone and len(made) > 12


def test_a_device_left_with_objects_says_so(bundle):
    """The layer does see what is not given back: the test above would fail."""
    device = Device.open(DEVICE, validation=True)
    vk.CreateFence(device.device, vk.VkFenceCreateInfo())
    device.close()
    assert any("VkFence" in line for line in device.messages)


IMPORT = """
import sys
import msgpack, numpy
before = set(sys.modules)
from dressi_edge import runtime
with runtime.load(sys.argv[1]) as s:
    s.step(2)
    s.get("picture")
    s.checkpoint(sys.argv[2])
    s.restore(sys.argv[2])
print(*sorted(set(sys.modules) - before))
"""


def test_running_a_bundle_imports_little_and_no_compiler(bundle, tmp_path):
    loaded = python(IMPORT, bundle, tmp_path / "c").split()
    foreign = ("dressi_edge.compiler", "dressi_edge.commands", "PIL", "scipy")
    assert [m for m in loaded if m.startswith(foreign)] == []
    assert len(loaded) < IMPORTS, loaded
    ours = {m.split(".")[0] for m in loaded}
    assert ours - {"dressi_edge"} <= set(sys.stdlib_module_names)


def test_what_is_installed_is_small():
    files = [p for part in ("runtime", "cache") for p in (ROOT / "dressi_edge" / part).glob("*.py")]
    assert sum(p.stat().st_size for p in files) < INSTALLED_BYTES


# docs/embedding.md


BLOCKS = re.findall(r"```python\n(.*?)```", (ROOT / "docs" / "embedding.md").read_text(encoding="utf-8"), re.S)


def test_the_app_of_the_guide_runs_and_goes_on_where_it_was_stopped(gpu, tmp_path):
    p = Program()
    targets = p.input("targets", Layout("table", "vec3", count=5))
    vertices = p.state("vertices", Layout("table", "vec3", count=5), 0.0)
    error = targets - vertices
    p.plan("fit", {"vertices": vertices + error * 0.125}, {"fit.loss": (mean(apply("dot", error, error)), Layout("unit", "float"))})
    path, wanted = gpu.compile(p), np.arange(15.0).reshape(5, 3)
    np.save(tmp_path / "targets.npy", wanted)
    assert len(BLOCKS[0].strip().splitlines()) <= 20

    def run(code=BLOCKS[0]):
        environment = {**os.environ, "PYTHONPATH": str(ROOT), "DRESSI_DEVICE": DEVICE}
        done = subprocess.run([sys.executable, "-c", code, path, "targets.npy", "saved"], cwd=tmp_path, env=environment,
                              capture_output=True, text=True)
        assert done.returncode == 0, done.stderr
        return [line.split()[0] for line in done.stdout.splitlines()]

    counts = run(BLOCKS[0].replace("< 500", "< 150"))
    assert counts[-1] == "200"
    assert run()[-1] == "500"
    np.testing.assert_allclose(np.load(tmp_path / "vertices.npy"), wanted, atol=1e-5)
    assert run() == []
