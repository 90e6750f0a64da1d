"""What drivers tell of their shaders: names of six vendors become one, and a driver that tells nothing says so."""

import pytest
from make_vectors import FOLDER

from dressi_edge import runtime
from dressi_edge.cache import bundle
from dressi_edge.cli import main
from dressi_edge.commands.statistics import NAMES, Compiled, Place, compiled, image_memory, places
from dressi_edge.runtime.device import Device

pytest_plugins = ["gpu"]

AMD = Compiled(None, 1.0, (("vertex", 1, {"VGPRs": 24, "Spilled VGPRs": 1, "Spilled SGPRs": 2, "Subgroups per SIMD": 8, "Hash": 7}),
                           ("fragment", 16, {"VGPRs": 12, "Spilled VGPRs": 0, "Spilled SGPRs": 0, "Subgroups per SIMD": 16})))


@pytest.mark.parametrize("what, expected", [("registers", 24), ("spills", 3), ("waves", 8), ("cycles", None)])
def test_of_a_vertex_and_a_fragment_shader_the_worse_counts(what, expected):
    assert AMD.told(what) == expected


def test_a_record_has_ours_and_the_drivers_own_numbers():
    record = Compiled(Place("fit", 1, 0, 8, 4, 3, 32), 2.5, AMD.executables).record()
    assert record["place"] == {"plan": "fit", "stage": 1, "substage": 0, "width": 8, "height": 4, "vertices": 3, "pixels": 32}
    assert record["spills"] == 3 and record["executables"][0]["told"]["Hash"] == 7 and set(NAMES) <= set(record)


@pytest.mark.parametrize("name", ["silhouette", "copies", "subpasses", "dispatched", "shared"])
def test_every_pipeline_is_compiled_and_placed(gpu, name):
    taken = bundle.read(FOLDER / f"{name}.dressi").variants[0]
    made = compiled(gpu.device, taken)
    assert len(made) == len(taken.description["pipelines"]) + len(taken.description.get("computes", ())) and all(one.ms > 0 for one in made)
    assert [one.place for one in made] == [places(taken.description).get(k) for k in range(len(made))]
    assert {one.place.plan for one in made} <= {plan["name"] for plan in taken.description["plans"]}
    gpu.silent()


@pytest.mark.parametrize("name", ["copies", "dispatched"])
def test_of_one_plan_its_own_pipelines_are_compiled_and_no_others(gpu, name):
    taken = bundle.read(FOLDER / f"{name}.dressi").variants[0]
    found, names = places(taken.description), [plan["name"] for plan in taken.description["plans"]]
    made = {name: compiled(gpu.device, taken, name) for name in names}
    assert len([one for some in made.values() for one in some]) == len(found) and len([some for some in made.values() if some]) > 2
    assert all(one.place.plan == name and one.ms > 0 for name, some in made.items() for one in some)
    assert compiled(gpu.device, taken, "no such plan") == []
    gpu.silent()


VIDEOCORE = Compiled(None, 1.0, (("fragment", 16, {"Instruction Count": 566, "Thread Count": 2, "TMU Spills": 7, "TMU Fills": 9}),))


def test_what_videocore_spills_is_read():
    assert {what: VIDEOCORE.told(what) for what in ("spills", "waves", "instructions")} == {"spills": 7, "waves": 2, "instructions": 566}


@pytest.mark.parametrize("name", ["silhouette", "copies"])
def test_images_take_at_least_their_texels_and_what_a_session_takes(gpu, name):
    raw, taken = image_memory(gpu.device, bundle.read(FOLDER / f"{name}.dressi").variants[0])
    with runtime.load(FOLDER / f"{name}.dressi", gpu.device) as session:
        occupied = session.report()["image_bytes"]
    assert 0 < raw <= taken <= occupied < taken + 65536  # images are aligned in one allocation
    gpu.silent()


def test_statistics_of_a_driver_that_tells_nothing_are_an_error(capsys):
    with Device.open("llvmpipe", statistics=True) as device:
        if device.statistics:
            pytest.skip(f"{device.driver} tells what it compiles")
    assert main(["inspect", str(FOLDER / "ops.dressi"), "--statistics", "llvmpipe"]) == 4
    assert "does not tell what it compiles: it has no VK_KHR_pipeline_executable_properties" in capsys.readouterr().err
    assert main(["inspect", str(FOLDER / "ops.dressi"), "--statistics", "0", "--dot"]) == 3
    assert "--statistics is no graph" in capsys.readouterr().err
