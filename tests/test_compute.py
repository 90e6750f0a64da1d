"""Work that is dispatched to compute shaders instead of being drawn: the same bits, only where a profile has the limits, and refused by
name where a device has not."""

from dataclasses import replace

import jobs
import make_vectors
import numpy as np
import pytest
import test_profile_matrix as matrix
from test_binned import painted

from dressi_edge import runtime
from dressi_edge.cache import bundle
from dressi_edge.cache.errors import DeviceError, InputError
from dressi_edge.cache.layout import Layout
from dressi_edge.cache.profile import Profile
from dressi_edge.cache.verify import violations
from dressi_edge.cli import main
from dressi_edge.compiler import Options, Program, build, compile_program
from dressi_edge.compiler.graph.functions import apply
from dressi_edge.compiler.graph.ir import image
from dressi_edge.compiler.passes.compute import groups, hindrance, local_size
from dressi_edge.compiler.scene import Binned
from dressi_edge.runtime.emulate import EmulatedDevice
from dressi_edge.runtime.session import Session

pytest_plugins = ["gpu"]

LAVAPIPE = Profile.load("lavapipe")


def bits(arrays):
    return [None if x is None else (x.dtype, x.shape, x.tobytes()) for x in arrays]


def done(made, steps, gpu):
    """What the steps give on a session of what was built."""
    data = bundle.dumps(made.description, made.blobs, bundle.version_of([made.description]))
    with Session(bundle.loads(data), gpu.device) as session:
        return [make_vectors.perform(session, step) for step in steps]


def dispatched(made):
    """Plan -> how many of its stages are dispatches, and how many there are."""
    return {name: (sum(stage.compute for stage in stages), len(stages)) for name, stages in made.stages.items()}


@pytest.mark.parametrize("name", ["ops", "states", "lists", "copies", "half", "texture"])
def test_what_is_dispatched_has_the_bits_of_what_is_drawn(gpu, name):
    """Loops, prepared parts, draws between dispatches, tiles, lists, copies given back in place, 16 bits a channel, a filter."""
    program, steps = make_vectors.VECTORS[name]()
    options, profile = {"storage": "float"} | make_vectors.OPTIONS.get(name, {}), gpu.at_hand(LAVAPIPE)
    drawn = build(program, profile, Options(**options))
    wanted = bits(done(drawn, steps, gpu))
    assert "computes" not in drawn.description
    for kind in ("pixel", "all"):
        made = build(program, profile, Options(**options, compute=kind))
        assert sum(n for n, _ in dispatched(made).values()) > 0
        assert bits(done(made, steps, gpu)) == wanted, kind
    gpu.silent()


@pytest.mark.parametrize("scene, layers", [("colors", 1), *(pytest.param(scene, k, marks=pytest.mark.full) for scene in matrix.SCENES
                                                            for k in (1, 3) if (scene, k) != ("colors", 1))])
def test_a_fit_comes_to_the_same_bits(gpu, tmp_path, scene, layers):
    found = {}
    for kind in ("none", "all"):
        path = tmp_path / f"{kind}.dressi"
        d = compile_program(matrix.problem(scene, layers), gpu.at_hand(LAVAPIPE), path, compute=kind)
        with runtime.load(path, gpu.device) as session:
            losses, color = matrix.fitted(session)
            found[kind] = losses, color.tobytes()
    assert found["none"] == found["all"]
    stages = [stage for plan in d["plans"] for stage in plan["stages"]]
    assert sum("compute" in stage for stage in stages) > len(stages) / 2
    gpu.silent()


def test_every_face_near_a_pixel_is_found_with_kernels_too(gpu):
    """The lists by tile are made of running sums; pictures, gradients and lists have the same bits however these come about."""
    found = []
    for kind in ("none", "ops", "all"):
        s, f = painted(Binned(3.0, gamma=1e-3), (97, 75))
        s.vjp("look", ["vertices", "colors"], color=f.color, alpha=f.alpha)
        s.output("lists", spilled=f.fragments.lists.spilled)
        with runtime.load(gpu.compile(s.program, compute=kind), gpu.device) as d:
            seen = d.forward("look")
            found.append(bits([*seen.values(), *d.backward("look", color=np.sin(1e3 * seen["color"]), alpha=seen["alpha"]).values(),
                               d.get("lists.spilled")]))
            stages = [stage for plan in d.bundle.description["plans"] for stage in plan["stages"]]
        assert (kind == "none") == (not any("compute" in stage for stage in stages))
        gpu.silent()
    assert found[0] == found[1] == found[2]


def test_a_list_is_dispatched_as_far_as_it_goes(gpu):
    """A stage of one texel says how many workgroups that are; where those of all entries are too many along one axis, it is dispatched over
    the whole image, by the same bits."""
    found = {}
    for room in (65535, 100):
        profile = replace(LAVAPIPE, name="less", limits={**LAVAPIPE.limits, "maxComputeWorkGroupCount": (room, 65535, 65535)})
        s, f = painted(Binned(3.0, gamma=1e-3), (97, 75))
        s.output("look", color=f.color, alpha=f.alpha, pairs=f.fragments.lists.pairs)
        made = build(s.program, profile, Options(compute="all"))
        color, alpha, pairs = done(made, [("get", f"look.{name}") for name in ("color", "alpha", "pairs")], gpu)
        d, stages = made.description, [stage for plan in made.description["plans"] for stage in plan["stages"]]
        counted = [stage for stage in stages if stage.get("count", -1) >= 0 and "compute" in stage]
        found[room] = len(counted), bits([color, alpha])
        whole = [stage["groups"] for stage in counted]
        assert all(y == z == 1 and x <= room for x, y, z in whole)
        if room == 65535:
            assert max(x for x, _, _ in whole) > max(100, 2 * -(-int(pairs) // 64))  # far less is run than there is room for
            assert not violations(d, profile, bundle.loads(bundle.dumps(d, made.blobs, bundle.version_of([d]))).interfaces)
        gpu.silent()
    assert found[65535][0] > 2 and found[100][0] > 2 and found[65535][1] == found[100][1]


@pytest.mark.parametrize("width, height", [(1, 1), (2, 1), (4, 1), (4, 333), (7, 9), (8, 8), (9, 1), (200, 150), (333, 217)])
def test_every_texel_is_written_once_whatever_the_size(gpu, width, height):
    p, layout = Program(), Layout("image", "int", width, height)
    x = p.state("x", layout, np.arange(width * height).reshape(height, width) - 5)
    p.plan("walk", {"x": apply("add", x * 3, 1)}, {})
    p.plan("look", {}, {"guarded": (apply("select", x > 100, x * x, 7), layout)})
    made = build(p, LAVAPIPE, Options(compute="pixel"))
    assert all(n == of for n, of in dispatched(made).values())
    start = np.arange(width * height).reshape(height, width).astype(np.int32) - 5
    got = done(made, [("step", "walk", 2), ("get", "x"), ("get", "guarded")], gpu)
    assert np.array_equal(got[1], start * 9 + 4) and np.array_equal(got[2], np.where(got[1] > 100, got[1] ** 2, 7))
    gpu.silent()


def test_workgroups_cover_an_image():
    for extent in (image(1, 1), image(4, 1000), image(8, 8), image(333, 217)):
        (w, h), (x, y) = local_size(extent), groups(extent)
        assert w * h == 64
        covered = (w * x, 1) if extent.width < 8 else (w * x, h * y)
        assert covered[0] >= (extent.width * extent.height if extent.width < 8 else extent.width)
        assert extent.width < 8 or covered[1] >= extent.height


def two(vtype="float"):
    """A plan of two outputs over an image, and one of a pair."""
    p, layout = Program(), Layout("image", vtype, 20, 12)
    x = p.input("x", layout, np.ones(240).reshape(12, 20))
    p.plan("map", {}, {"y": (x * 2, layout), "z": (x * 3, layout)})
    return p


def test_a_profile_is_asked_what_it_prefers():
    assert not dispatched(build(two(), LAVAPIPE))["map"][0]
    assert dispatched(build(two(), replace(LAVAPIPE, compute="pixel")))["map"] == (1, 1)
    assert not dispatched(build(two(), replace(LAVAPIPE, compute="pixel"), Options(compute="none")))["map"][0]
    with pytest.raises(InputError, match="compute is 'gpu'; allowed: none ops pixel all"):
        build(two(), LAVAPIPE, Options(compute="gpu"))


SMALL = {"maxPerStageDescriptorStorageImages": 1, "maxDescriptorSetStorageImages": 1,
         "maxComputeWorkGroupInvocations": 32, "maxComputeWorkGroupSize": (4, 128, 64), "maxComputeWorkGroupCount": (2, 65535, 65535)}


@pytest.mark.parametrize("limit", SMALL)
def test_what_breaks_a_limit_is_drawn_and_a_bundle_that_breaks_it_is_named(gpu, tmp_path, limit):
    """The limits count in the compiler, in the verifier, and for the device that a session emulates."""
    wanted = two()
    small = replace(LAVAPIPE, name="small", limits={**LAVAPIPE.limits, limit: SMALL[limit]})
    made = build(wanted, LAVAPIPE, Options(compute="pixel"))
    stage, = build(wanted, small, Options(compute="pixel")).stages["map"][:1]
    assert not stage.compute and limit in hindrance(stage, small)
    path = tmp_path / "two.dressi"
    bundle.write(path, made.description, made.blobs)
    lines = violations(made.description, small, bundle.read(path).interfaces)
    assert lines and all(limit in line and line.startswith("map.stages[0]") for line in lines)
    with pytest.raises(DeviceError, match=rf"does not fit small: map\.stages\[0\].*\({limit}\)"):
        runtime.load(path, EmulatedDevice(gpu.device, small))


def test_formats_that_no_shader_may_write_are_drawn(gpu, tmp_path):
    p, layout = Program(), Layout("image", "vec2", 20, 12)
    p.plan("map", {}, {"y": (p.input("x", layout, 1.0) * 2, layout)})
    stage, = build(p, LAVAPIPE, Options(compute="pixel")).stages["map"]
    assert not stage.compute and hindrance(stage, LAVAPIPE) == "R32G32_SFLOAT takes a feature to be written"
    without = replace(LAVAPIPE, name="without", formats={**LAVAPIPE.formats, "R32_SFLOAT": frozenset({"sampled", "color"})})
    made = build(two(), LAVAPIPE, Options(compute="pixel"))
    stage, = build(two(), without, Options(compute="pixel")).stages["map"]
    assert not stage.compute and hindrance(stage, without) == "R32_SFLOAT is no storage image"
    path = tmp_path / "two.dressi"
    bundle.write(path, made.description, made.blobs)
    with pytest.raises(DeviceError, match=r"does not fit without: images\[\d\] needs R32_SFLOAT with storage; profile without has color"):
        runtime.load(path, EmulatedDevice(gpu.device, without))


def test_variants_with_and_without_compute_share_a_file(gpu, tmp_path):
    path = tmp_path / "both.dressi"
    d = compile_program(two(), [replace(LAVAPIPE, name="best", compute="all"), Profile.load("vulkan_min")], path)
    assert [len(one["computes"]) for one in d["variants"]] == [1, 0]
    found = []
    for name in ("best", "vulkan_min"):
        with runtime.load(path, gpu.device, profile=name) as session:
            found.append(session.get("z").tobytes())
    assert found[0] == found[1] and path.read_bytes()[8] == 4
    gpu.silent()


def test_what_draws_alone_is_written_as_before(tmp_path):
    path = tmp_path / "drawn.dressi"
    compile_program(two(), LAVAPIPE, path)
    assert path.read_bytes()[8] == 1


def test_a_job_is_compiled_so_from_the_command_line(tmp_path):
    job, path = jobs.write_job(tmp_path), tmp_path / "job.dressi"
    assert not main(["compile", str(job), "-p", "lavapipe", "-o", str(path), "--compute", "pixel"])
    assert bundle.read(path).description["computes"] and path.read_bytes()[8] == 4


def test_a_dispatch_is_told_by_inspect_and_bench(gpu, tmp_path, capsys):
    path = tmp_path / "two.dressi"
    compile_program(two(), LAVAPIPE, path, compute="all")
    assert not main(["inspect", str(path)])
    assert "1 substages, compute, 3 x 2 x 1 workgroups" in capsys.readouterr().out
    assert not main(["bench", str(path), "--runs", "1", "--device", gpu.device.name])
    assert "compute" in capsys.readouterr().out
