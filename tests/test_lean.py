"""Small enough to embed: what loading imports, what is installed, and that closing gives everything back."""

import gc
import os
import sys
from pathlib import Path

import pytest
from graphs import ROOT, python
from test_session import walk

from dressi_edge import runtime
from dressi_edge.runtime import vk

pytest_plugins = ["gpu"]

INSTALLED_BYTES = 400_000  # of Python, the generated binding included
IMPORTS = 100  # modules beyond those of numpy and msgpack
RSS_GROWTH = 16 << 20  # over all cycles: what allocators keep, not what a session holds


@pytest.fixture(scope="module")
def bundle(gpu):
    return gpu.compile(walk())


def rss() -> int:
    with open("/proc/self/statm") as f:
        return int(f.read().split()[1]) * os.sysconf("SC_PAGE_SIZE")


def cycles(gpu, bundle, count):
    """Load, use, close on one device under the validation layer: RSS stays, and every object made is destroyed."""
    def cycle():
        with runtime.load(bundle, gpu.device) as s:
            s.step(3)
            s.get("picture")

    for _ in range(20):
        cycle()
    gc.collect()
    before = rss()
    for _ in range(count):
        cycle()
    gc.collect()
    gpu.silent()
    return rss() - before


@pytest.mark.skipif(not Path("/proc/self/statm").exists(), reason="this system has no /proc to read the memory of a process from")
def test_200_sessions_one_after_another_leave_nothing(gpu, bundle):
    assert cycles(gpu, bundle, 200) < RSS_GROWTH


@pytest.mark.full
@pytest.mark.skipif(not Path("/proc/self/statm").exists(), reason="this system has no /proc to read the memory of a process from")
def test_1000_sessions_one_after_another_leave_nothing(gpu, bundle):
    assert cycles(gpu, bundle, 1000) < RSS_GROWTH


def counted(table, kind, real, many):
    """A Vulkan command that counts the objects it makes or destroys."""
    def call(*args, **options):
        result = real(*args, **options)
        table[kind] = table.get(kind, 0) + many(args, result)
        return result

    return call


def test_every_object_made_is_destroyed_once(bundle, monkeypatch):
    made, gone = {}, {}
    for name in dir(vk):
        for prefix, table in (("Create", made), ("Allocate", made), ("Destroy", gone), ("Free", gone)):
            kind = name.removeprefix(prefix).replace("GraphicsPipelines", "Pipeline")
            if name.startswith(prefix) and kind != "DescriptorSets":  # those go with their pool
                def many(args, result, table=table, kind=kind):
                    return len(args[2]) if table is gone and kind == "CommandBuffers" else \
                        len(result) if isinstance(result, list) else 1
                monkeypatch.setattr(vk, name, counted(table, kind, getattr(vk, name), many))
    with runtime.load(bundle, "llvmpipe") as s:
        s.step(3)
        s.get("picture")
        s.set("rate", 0.5)
        s.profile_stages("walk", 1)
    made["CommandBuffers"] -= 1  # that of the transfers goes with its pool
    assert made == gone and len(made) > 12


def test_a_device_left_with_objects_says_so(bundle):
    """The layer does see what is not given back: the test above would fail."""
    from dressi_edge.runtime.device import Device
    device = Device.open("llvmpipe", validation=True)
    vk.CreateFence(device.device, vk.VkFenceCreateInfo())
    device.close()
    assert any("VkFence" in line for line in device.messages)


IMPORT = """
import sys
import msgpack, numpy
before = set(sys.modules)
from dressi_edge import runtime
with runtime.load(sys.argv[1], "llvmpipe") as s:
    s.step(2)
    s.get("picture")
    s.checkpoint(sys.argv[2])
    s.restore(sys.argv[2])
print(*sorted(set(sys.modules) - before))
"""


def test_running_a_bundle_imports_little_and_no_compiler(bundle, tmp_path):
    loaded = python(IMPORT, bundle, tmp_path / "c").split()
    foreign = ("dressi_edge.compiler", "dressi_edge.commands", "trimesh", "PIL", "scipy")
    assert [m for m in loaded if m.startswith(foreign)] == []
    assert len(loaded) < IMPORTS, loaded
    ours = {m.split(".")[0] for m in loaded}
    assert ours - {"dressi_edge"} <= set(sys.stdlib_module_names)


def test_what_is_installed_is_small():
    files = [p for part in ("runtime", "cache") for p in (ROOT / "dressi_edge" / part).glob("*.py")]
    assert sum(p.stat().st_size for p in files) < INSTALLED_BYTES
