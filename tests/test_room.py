"""Memory that nobody asked for: what the profile's heap leaves says how many pictures lie on the device, how many views are kept, and
whether all views can be drawn at once; the bits are those of an order that was named."""

from dataclasses import replace

import numpy as np
import pytest
from test_views import write_views

from dressi_edge import runtime
from dressi_edge.cache import bundle as bundles
from dressi_edge.cache.errors import ProfileError
from dressi_edge.cache.profile import Profile, merge, profile_names
from dressi_edge.cache.profile_file import to_json
from dressi_edge.cli import main
from dressi_edge.commands import profiles
from dressi_edge.compiler.io.cameras import orbit
from dressi_edge.compiler.scene import targets
from dressi_edge.compiler.scene.job import load_job
from dressi_edge.compiler.scene.targets import BATCH_BYTES, Carried

pytest_plugins = ["gpu"]

N, SIZE = 6, (40, 30)
NAMES = {"mesh": ("vertices", "texture"), "part": ("ball.vertices", "ball.colors")}
PIXELS = N * SIZE[0] * SIZE[1]


@pytest.fixture(autouse=True)
def few(monkeypatch):
    """Six views of 40x30 count as many."""
    monkeypatch.setattr(targets, "SMALL", 1000)


@pytest.fixture(scope="module")
def photos(tmp_path_factory):
    rng = np.random.default_rng(5)
    y, x = np.mgrid[:SIZE[1], :SIZE[0]] + 0.5
    images = []
    for k in range(N):
        alpha = np.clip(6.0 - np.hypot(x - 20 - np.cos(k), y - 15 + np.sin(k)) / 1.5, 0.0, 1.0)
        images.append(np.concatenate([rng.random((*alpha.shape, 3)), alpha[..., None]], -1))
    return write_views(tmp_path_factory.mktemp("photos"), images, orbit(N, [20.0, -15.0], 2.6, 50.0, SIZE))


def profile_with(gpu, heap, folder):
    """The file of lavapipe's profile with a heap of so many bytes."""
    path = folder / f"heap{heap}.json"
    path.write_text(to_json(replace(gpu.at_hand("lavapipe"), heap_bytes=heap)))
    return path


def job_of(photos, path, order, kind="mesh"):
    start = {"mesh": "[mesh]\nsphere = {vertices = 42, radius = 0.7}\n",
             "part": '[[part]]\nname = "ball"\nsphere = {vertices = 42, radius = 0.7}\n'}[kind]
    moved, painted = NAMES[kind]
    path.write_text(f"""{start}
[views]
transforms = "{photos}"
{f'order = "{order}"' if order else ""}
{"[render]" + chr(10) + "texture_size = [24, 16]" if kind == "mesh" else ""}
[[phase]]
name = "shape"
steps = 3
optimize."{moved}" = {{rate = 0.02}}
[[phase.loss]]
kind = "silhouette"
[[phase]]
name = "paint"
steps = 3
optimize."{painted}" = {{rate = 0.02}}
[[phase.loss]]
kind = "color"
""")
    return path


def solved(gpu, path, kind="mesh"):
    with runtime.load(path, gpu.device) as session:
        for phase, steps in session.bundle.description["meta"]["phases"]:
            session.step(steps, phase)
        kept = session.report()["views_kept"]
        return [session.get(name).tobytes() for name in NAMES[kind]], kept, session.report()["image_bytes"]


@pytest.mark.parametrize("kind", ["mesh", "part"])
def test_a_round_takes_the_place_of_all_views_at_once_where_these_do_not_fit(gpu, photos, tmp_path, capsys, kind):
    enough, small = (profile_with(gpu, heap, tmp_path) for heap in (2 * PIXELS * BATCH_BYTES, 2 * PIXELS * BATCH_BYTES - 2))
    job, bundle, found = tmp_path / "x.toml", tmp_path / "x.dressi", {}
    for name, profile, order in (("fits", enough, None), ("chosen", small, None), ("asked", small, "accumulate")):
        assert main(["compile", str(job_of(photos, job, order, kind)), "-p", str(profile), "-o", str(bundle), "--embed"]) == 0
        told = capsys.readouterr().out
        assert ("all views at once would not fit into 0 MB: a step draws one" in told) == (name == "chosen")
        assert bundles.read(bundle).description["meta"].get("chosen") == (
            {"order": "accumulate", "room": PIXELS * BATCH_BYTES - 1} if name == "chosen" else None)
        found[name] = solved(gpu, bundle, kind)[0]
    assert found["chosen"] == found["asked"] != found["fits"]
    a, b = (np.frombuffer(found[name][0], np.float32) for name in ("chosen", "fits"))
    assert np.allclose(a, b, atol=2e-3), "the gradients differ in the order of their sums alone, which Adam's signs make more of"
    gpu.silent()


def test_a_window_and_what_is_kept_stay_within_half_of_the_heap(gpu, photos, tmp_path, capsys):
    job, found = job_of(photos, tmp_path / "x.toml", "shuffle"), {}
    picture = SIZE[0] * SIZE[1] * 4
    heaps = {"whole": None, "one": 2 * targets.SHARE * picture, "tight": None, "roomy": 1 << 31}
    for name, heap in heaps.items():
        bundle = tmp_path / f"{name}.dressi"
        if name == "tight":  # room for two views and a half
            _, three, size, alone = found["whole"]
            heap = 2 * (alone + 5 * ((size - alone) // three) // 2)
        assert main(["compile", str(job), "-p", str(profile_with(gpu, heap, tmp_path)), "-o", str(bundle), "--embed"]) == 0
        told = capsys.readouterr().out
        d = bundles.read(bundle).description
        slots = next(x["count"] for x in d["values"] if x["name"] == "targets")
        assert d["meta"]["pictures"]["room"] == (None if heap is None else heap // 2)
        assert f"{N} pictures, {'all' if slots == N else f'{slots} at a time'} on the device: images of" in told
        with runtime.load(bundle, gpu.device) as session:
            alone = session.report()["image_bytes"]
        bits, kept, size = solved(gpu, bundle)
        found[name] = bits, kept["paint"], size, alone
        if heap is not None:
            assert size <= max(alone, heap // 2)
        assert slots == (1 if name == "one" else N)
    assert len({tuple(x[0]) for x in found.values()}) == 1, "the bits are the same"
    assert [found[name][1] for name in heaps] == [3, 0, 2, 3], "three steps see three views"
    gpu.silent()


def test_what_was_asked_for_is_not_chosen(gpu, photos, tmp_path):
    small = Profile.load(profile_with(gpu, 1 << 20, tmp_path))
    job = job_of(photos, tmp_path / "x.toml", "batch")
    assert load_job(job, [small], carried=Carried(False, 1 << 30)).order == "batch", "memory was said"
    assert load_job(job, [small], carried=Carried(whole=True)).order == "batch", "a reference has all of them"
    assert load_job(job, [], carried=Carried(False)).order == "batch", "of no profile a heap is known"
    assert load_job(job, [small, gpu.at_hand("lavapipe")], carried=Carried(False)).order == "batch", "768 kB"
    assert load_job(job, [small, replace(small, name="x", heap_bytes=500_000)], carried=Carried(False)).order == "accumulate", "the least"
    assert Carried().on([gpu.at_hand("lavapipe")]).room == 1 << 30, "half of 2 GiB"


def test_a_heap_is_in_profiles_but_not_in_what_is_packed_for(gpu):
    own = Profile.load("lavapipe")
    assert own.heap_bytes == 1 << 31 and own.digest == replace(own, heap_bytes=None).digest
    assert Profile.loads(to_json(own)) == own and '"heap_bytes": 2' not in to_json(replace(own, heap_bytes=None))
    assert merge([own, Profile.load("mali_g76"), Profile.load("vulkan_min")], "m").heap_bytes == 1 << 31
    for bad in ("0", "-1", '"much"', "1.5"):
        with pytest.raises(ProfileError, match="heap_bytes"):
            Profile.loads(to_json(own).replace('"heap_bytes": 2147483648', f'"heap_bytes": {bad}'))
    assert profiles.heap(gpu.device) == max(size for size, flags in gpu.device.heaps if flags & 1)
    known = [p for p in map(Profile.load, profile_names()) if p.heap_bytes is not None]
    assert len(known) > 10 and all("heap_bytes" in p.sources and p.heap_bytes >= 1 << 30 for p in known)
