"""One file for several devices: the first variant that fits is taken, the session says why, and nobody sees which it was."""

import dataclasses
import json

import numpy as np
import pytest
from make_vectors import FOLDER, same_compiler, variants

from dressi_edge import runtime
from dressi_edge.cache import bundle
from dressi_edge.cache.errors import BundleError, DeviceError, InputError, ProfileError
from dressi_edge.cache.layout import Layout
from dressi_edge.cache.profile import Profile
from dressi_edge.cli import main
from dressi_edge.compiler import Program, compile_program
from dressi_edge.compiler.backend.needs import shadowed
from dressi_edge.compiler.io.cameras import orbit
from dressi_edge.compiler.io.shapes import sphere
from dressi_edge.compiler.passes.lists import rows_of
from dressi_edge.compiler.render.optimizer import Adam
from dressi_edge.compiler.render.raster import Softness
from dressi_edge.compiler.scene.problem import Loss, Problem

pytest_plugins = ["gpu"]

ORDER = ("limit8", "vulkan_min")
X = np.linspace(-1, 2, 30, dtype=np.float32).reshape(5, 6)


@pytest.fixture(scope="module")
def several(tmp_path_factory):
    """The path of a bundle for both profiles of ORDER."""
    path = tmp_path_factory.mktemp("several") / "x.dressi"
    compile_program(variants()[0], ORDER, path)
    return path


def states(session):
    session.set("x", X)
    session.step(3)
    return [session.get(name) for name in ("s", "y0", "y4")]


# ---- the choice


@pytest.mark.parametrize("emulate, taken", [(None, "limit8"), ("limit8", "limit8"), ("limit4", "vulkan_min")])
def test_the_first_that_fits_is_taken_and_the_report_says_why(gpu, several, emulate, taken):
    with runtime.load(several, gpu.device, emulate=emulate) as session:
        report = session.report()
        assert session.bundle.profile == report["profile"] == taken
        assert list(report["variants"]) == list(ORDER) and report["variants"][taken] == "taken: the first that fits"
        other, = set(ORDER) - {taken}
        if emulate == "limit4":
            assert report["variants"][other].startswith("does not fit limit4: map.stages[0].subpasses[0]")
            assert report["variants"][other].endswith("profile limit4 allows 4 (maxColorAttachments)")
        else:
            assert report["variants"][other] == "not taken: limit8 comes before it and fits"
    gpu.silent()


def test_variants_agree_in_lists_of_texels_however_many_rows_each_profile_has(gpu, tmp_path):
    """A texture whose list is one column on one of them, and more on the other."""
    tall, path = gpu.at_hand("lavapipe"), tmp_path / "x.dressi"
    assert (rows_of(tall), rows_of(Profile.load("vulkan_min"))) == (16384, 4096)
    problem = Problem(sphere(42, 0.5), orbit(2, [20.0], 2.5, 50.0, (32, 32)), albedo="texture", texture_size=(1024, 512))
    problem.phase("paint", 3, {"texture": Adam(0.05)}, [Loss("color")], Softness(1.0, delta=0.0))
    found = []
    for profiles in (["lavapipe", "vulkan_min"], ["lavapipe"], ["vulkan_min"]):
        problem.compile(profiles, path)
        for name in profiles:
            with runtime.load(path, gpu.device, profile=name if len(profiles) > 1 else None) as session:
                assert session.report()["texels"] == {"paint": {"texture": "listed"}}
                session.set("targets", np.linspace(0.0, 1.0, 2 * 32 * 32 * 4, dtype=np.float32).reshape(2, 32, 32, 4))
                session.step(3)
                found.append(session.get("texture").tobytes())
    assert len(set(found)) == 1
    gpu.silent()


def test_all_variants_come_to_the_same_bits_on_one_device_here(gpu, several):
    found = []
    for name in ORDER:
        with runtime.load(several, gpu.device, profile=name) as session:
            assert session.report()["variants"][name] == "taken: asked for"
            found.append(states(session))
    for a, b in zip(*found):
        np.testing.assert_array_equal(a, b)
    gpu.silent()


def test_the_variant_that_is_asked_for_is_taken_though_another_comes_first(gpu, several):
    with runtime.load(several, gpu.device, profile="vulkan_min") as session:
        assert session.report()["variants"] == {"limit8": "not taken: vulkan_min was asked for", "vulkan_min": "taken: asked for"}
    with pytest.raises(InputError, match="profile 'limit4' is none of this bundle's; there are: limit8 vulkan_min"):
        runtime.load(several, gpu.device, profile="limit4")
    with pytest.raises(DeviceError, match="made for profile limit8, does not fit limit4: .*maxColorAttachments"):
        runtime.load(several, gpu.device, profile="limit8", emulate="limit4")


def test_where_nothing_fits_each_variant_says_what_does_not(gpu, several):
    limit4 = Profile.load("limit4")
    tiny = dataclasses.replace(limit4, name="tiny", limits={**limit4.limits, "maxColorAttachments": 2})
    with pytest.raises(DeviceError) as error:
        runtime.load(several, gpu.device, emulate=tiny)
    told = str(error.value)
    assert "\n" not in told and told.startswith("no variant of the bundle fits: limit8: map.stages[0]")
    assert "needs 5 colour attachments; profile tiny allows 2" in told
    assert "; vulkan_min: map.stages[0]" in told and "needs 4 colour attachments; profile tiny allows 2" in told


def test_a_bundle_for_one_profile_says_so_too(gpu, tmp_path):
    compile_program(variants()[0], ["limit4"], tmp_path / "a.dressi")
    compile_program(variants()[0], "limit4", tmp_path / "b.dressi")
    assert (tmp_path / "a.dressi").read_bytes() == (tmp_path / "b.dressi").read_bytes()
    with runtime.load(tmp_path / "a.dressi", gpu.device, profile="limit4") as session:
        assert session.report()["variants"] == {"limit4": "taken: asked for"}
    with pytest.raises(InputError, match="is none of this bundle's; there are: limit4"):
        runtime.load(tmp_path / "a.dressi", gpu.device, profile="limit8")


def test_a_checkpoint_of_one_variant_restores_on_another(gpu, several, tmp_path):
    with runtime.load(several, gpu.device, profile="limit8") as session:
        session.set("x", X)
        session.step(3)
        session.checkpoint(tmp_path / "saved")
        session.step(2)
        expected = session.get("s"), session.get("y4")
    with runtime.load(several, gpu.device, profile="vulkan_min") as session:
        session.restore(tmp_path / "saved")
        assert session.report()["runs"]["grow"] == 3
        session.step(2)
        np.testing.assert_array_equal(session.get("s"), expected[0])
        np.testing.assert_array_equal(session.get("y4"), expected[1])
    gpu.silent()


# ---- the file


def test_what_variants_share_is_in_the_file_once_and_the_file_is_always_the_same(several, tmp_path):
    compile_program(variants()[0], [Profile.load(name) for name in ORDER], tmp_path / "again.dressi")
    assert (tmp_path / "again.dressi").read_bytes() == several.read_bytes()
    assert several.read_bytes() == (FOLDER / "variants.dressi").read_bytes() or not same_compiler()
    found = bundle.read(several).variants
    assert tuple(b.profile for b in found) == ORDER and len({b.digest for b in found}) == 1
    blobs = found[0].description["blobs"]
    assert len({digest for _, _, digest in blobs}) == len(blobs)
    shaders = [set(b.description["shaders"]) for b in found]
    assert shaders[0] & shaders[1] and shaders[0] != shaders[1]
    for name, b in zip(ORDER, found):  # what one has alone is what a bundle for it alone has
        compile_program(variants()[0], name, tmp_path / "one.dressi")
        one = bundle.read(tmp_path / "one.dressi")
        assert [bytes(b.blob(k)) for k in b.description["shaders"]] == [bytes(one.blob(k)) for k in one.description["shaders"]]
        same = ("meta", "profile", "needs", "depth_formats", "samplers", "passes", "pipelines", "plans")
        assert {key: b.description[key] for key in same} == {key: one.description[key] for key in same}


@pytest.mark.parametrize("profiles, told", [
    ([], "0 profiles; a bundle is compiled for 1 to 16"), (["limit4"] * 17, "17 profiles; a bundle"),
    (["limit8", "limit4", "limit8"], "profile limit8 is given twice"), (["limit8", "limit9"], "limit9")])
def test_wrong_lists_of_profiles_are_named_before_any_work(tmp_path, profiles, told):
    with pytest.raises(ProfileError, match=told):
        compile_program(Program(), profiles, tmp_path / "x.dressi")
    assert not list(tmp_path.iterdir())


def test_variants_of_different_problems_are_refused():
    made = []
    for name, size in (("limit8", 3), ("limit4", 4)):
        p, layout = Program(), Layout("image", "float", size, 2)
        p.plan("p", {}, {"y": (p.input("x", layout) * 2.0, layout)})
        from dressi_edge.compiler import build
        built = build(p, Profile.load(name))
        made.append((built.description, built.blobs))
    with pytest.raises(BundleError, match=r"variants\[1\].values\[0\].width is 4; that of variants\[0\] is 3"):
        bundle.loads(bundle.dumps(*bundle.combine(made)))


# ---- the command line


def test_a_variant_that_one_before_it_stands_in_for_is_named(several, tmp_path):
    assert shadowed([b.description for b in every(several)]) == {}
    three = tmp_path / "y.dressi"
    compile_program(variants()[0], ("limit8", "vulkan_min", "limit4"), three)
    assert shadowed([b.description for b in every(three)]) == {"limit4": "vulkan_min"}


def every(path):
    first = bundle.read(path)
    return [first, *first.after]


def test_the_command_line_lists_checks_and_chooses(several, tmp_path, capsys):
    def here(*args):
        code = main([str(a) for a in args])
        return code, *capsys.readouterr()

    code, out, _ = here("inspect", several, "--json")
    assert code == 0 and list(json.loads(out)) == sorted(ORDER) and json.loads(out)["limit8"]["map"]["substages"] == 1
    code, out, _ = here("inspect", several)
    assert [line.split(":")[0] for line in out.splitlines() if line.startswith("profile ")] == [f"profile {n}" for n in ORDER]
    code, out, _ = here("inspect", several, "--dot")
    assert out.count("digraph bundle {") == 2
    code, out, _ = here("verify", several)
    assert code == 0 and "profile limit8 vulkan_min, 5 plans" in out
    code, out, _ = here("verify", several, "-p", "raspberry_pi_4")
    assert code == 0 and "(vulkan_min fits raspberry_pi_4)" in out
    assert here("verify", FOLDER / "silhouette.dressi", "-p", "limit4")[0] == 0
