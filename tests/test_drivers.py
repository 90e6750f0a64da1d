"""Every vector and a set of whole problems on drivers that run without hardware: docs/drivers.md.

`make test-drivers` runs them all, `DRIVERS=` chooses; what cannot be fetched is left out with a word. Drivers that draw must come to
the stored results, within each file's tolerance; drivers of GPUs that are not there must compile, record and submit, and spill no
register where a bundle was made for their profile. None may make the validation layer say anything. Where all that draw are off after
a change to the compiler that changes numbers, `python -m tests.drivers.whole`.
"""

import os

import numpy as np
import pytest
from drivers import catalog, fetch, replay, session, whole
from make_vectors import FOLDER

from dressi_edge.cache.profile import Profile

pytestmark = pytest.mark.drivers
CHOSEN = catalog.chosen(os.environ.get("DRIVERS") or "all")


@pytest.fixture(scope="session")
def bundles(tmp_path_factory):
    """bundles(profile name): folders of the vectors and of the whole problems, compiled for it; profiles that allow the same share them."""
    made = {}

    def get(name):
        profile = Profile.load(name)
        if profile.digest not in made:
            made[profile.digest] = [tmp_path_factory.mktemp(f"{name}.{kind}") for kind in ("vectors", "whole")]
            whole.vectors(profile, made[profile.digest][0])
            for problem in whole.CASES:
                whole.write(problem, profile, made[profile.digest][1])
        return made[profile.digest]

    return get


@pytest.mark.parametrize("name", CHOSEN)
def test_every_bundle_on(name, bundles):
    try:
        packages = fetch.ready(name)
    except fetch.Missing as why:
        pytest.skip(f"{name} was left out: {why}")
    driver = catalog.DRIVERS[name]
    outcome = session.run(name, packages, bundles(driver.profile))
    spilling = [f"{r['name']}: {place} spills {told['spills']} registers (it has {told.get('registers', '?')})"
                for r in outcome.results for place, _, told, _ in r["statistics"]
                if told.get("spills", 0) > driver.spills.get(r["name"], 0)]
    assert [*outcome.faults, *spilling] == [], f"{name}: {outcome.device}"
    assert len(outcome.results) == len(list(FOLDER.glob("*.dressi"))) + len(whole.CASES)
    if driver.shim and driver.packages != "backports":
        assert all(r["statistics"] for r in outcome.results), f"{name} tells nothing of what it compiled"


def test_a_result_that_is_off_a_driver_that_dies_and_one_that_complains_are_faults(tmp_path, monkeypatch):
    """The check itself, on the system's own lavapipe: a wrong number, a file that is no bundle, an end before the end."""
    (tmp_path / "off.dressi").write_bytes((FOLDER / "reduction.dressi").read_bytes())
    text = (FOLDER / "reduction.json").read_text()
    (tmp_path / "off.json").write_text(text.replace('"do": "get", "name": "mean"', '"do": "get", "name": "sum"'))
    (tmp_path / "torn.dressi").write_bytes(b"no bundle")
    monkeypatch.setattr(catalog, "command", lambda driver, folder, *words: ([os.sys.executable, *words], dict(os.environ)))
    outcome = session.run("lavapipe25", tmp_path, [tmp_path])
    assert [line.split(":")[0] for line in outcome.faults] == ["off", "torn"]
    monkeypatch.setattr(catalog, "command", lambda driver, folder, *words: (["false"], {}))
    assert session.run("lavapipe25", tmp_path, [tmp_path]).faults == ("off: the process ended with exit code 1: ",)


def test_deviation_is_counted_in_tolerances():
    a = np.array([0.0, 4.0], np.float32)
    assert replay.deviation(np, a, a, 0) == 0
    assert replay.deviation(np, a, a + np.float32(1), 0.1) == pytest.approx(2)  # of the largest, 5
    assert replay.deviation(np, a * np.float32(np.nan), a, 0.1) == replay.deviation(np, a, a + 1, 0) == np.inf
    assert replay.deviation(np, a, a.astype(int), 1) == np.inf


def test_names_of_drivers_and_groups():
    assert set(catalog.chosen("quick")) < set(catalog.chosen("all")) < set(catalog.chosen("everything")) == set(catalog.DRIVERS)
    assert catalog.chosen("m1, navi21") == ["m1", "navi21"]
    with pytest.raises(ValueError, match="no driver 'voodoo'; there are the groups quick all everything, and swiftshader"):
        catalog.chosen("m1 voodoo")
    assert all(driver.packages in catalog.PACKAGES and driver.group in session.SECONDS for driver in catalog.DRIVERS.values())


@pytest.mark.parametrize("packages, told", [
    ("backports", "mesa-vulkan-drivers .* of bookworm-backports need that system's libraries; this is elsewhere"),
    ("unstable", "there is no apt-get here")])
def test_what_cannot_be_had_says_why(packages, told, tmp_path, monkeypatch):
    monkeypatch.setenv("DRESSI_DRIVERS", str(tmp_path / "new"))
    monkeypatch.setattr(fetch, "_release", lambda: "elsewhere")
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(fetch.Missing, match=told):
        fetch.make(packages)
    assert not [path for path in (tmp_path / "new").rglob("*") if path.is_file()]


def test_without_a_network_the_packages_are_left_out(tmp_path, monkeypatch):
    monkeypatch.setenv("DRESSI_DRIVERS", str(tmp_path))
    monkeypatch.setattr(fetch, "_mirrors", lambda: {"debian": "http://127.0.0.1:9/debian"})
    with pytest.raises(fetch.Missing, match="apt-get -q failed: E: "):
        fetch.make("unstable")
    assert list(tmp_path.iterdir()) == []
