"""The page of a run: what is in it is what the run left, nothing is fetched, and a real browser draws it and turns it with the mouse.

Each claim about the browser has a twin that reads the file, for machines without Chromium.
"""

import base64
import io
import json
import re
from html.parser import HTMLParser

import numpy as np
import pytest
from browser import Browser, chromium
from jobs import TINY, command, write_job
from PIL import Image

from dressi_edge import runtime
from dressi_edge.cache import bundle as bundles
from dressi_edge.cache.errors import InputError
from dressi_edge.cache.summary import summary
from dressi_edge.compiler import Program
from dressi_edge.compiler.io.meshes import load_mesh
from dressi_edge.page.facts import bundle_facts
from dressi_edge.page.html import page, script_json

pytest_plugins = ["gpu"]

with_browser = pytest.mark.skipif(chromium() is None, reason="no Chromium: pages are read but not seen (Debian: apt-get install chromium)")


class Reader(HTMLParser):
    """Elements with their attributes, and the text of each script by its id."""

    def __init__(self, text):
        super().__init__()
        self.elements, self.scripts, self._id = [], {}, None
        self.feed(text)

    def handle_starttag(self, tag, attributes):
        self.elements.append((tag, dict(attributes)))
        self._id = dict(attributes).get("id", "") if tag == "script" else None

    def handle_endtag(self, tag):
        self._id = None

    def handle_data(self, data):
        if self._id is not None:
            self.scripts[self._id] = self.scripts.get(self._id, "") + data


def read(path):
    """(data, model) of a page."""
    reader = Reader(path.read_text(encoding="utf-8"))
    return json.loads(reader.scripts["data"]), base64.b64decode(reader.scripts.get("model", ""))


def picture(address):
    return np.asarray(Image.open(io.BytesIO(base64.b64decode(address.partition(",")[2]))))


@pytest.fixture(scope="module")
def ran(tmp_path_factory):
    """A folder with x.dressi and what `run --report report -o out.glb --checkpoint c` left."""
    folder = tmp_path_factory.mktemp("page")
    text = TINY.replace("steps = 3", "steps = 60").replace("steps = 2\n", "steps = 40\n")
    job = write_job(folder, text.replace('{optimizer = "sgd", rate = 0.1, momentum = 0.5}', "{rate = 0.05}"))
    made = command("compile", job, "-p", "lavapipe", "-o", folder / "x.dressi")
    assert made.returncode == 0, made.stderr
    done = command("run", "x.dressi", "--report", "report", "-o", "out.glb", "--checkpoint", "c", cwd=folder)
    assert done.returncode == 0 and "in report: index.html" in done.stdout, done.stderr
    return folder


def test_the_page_has_what_the_run_left(ran):
    data, model = read(ran / "report" / "index.html")
    metrics = json.loads((ran / "out_metrics.json").read_text())
    assert model == (ran / "out.glb").read_bytes()
    assert {p["name"]: (p["steps"], p["of"]) for p in data["phases"]} == {"shape": (60, 60), "paint": (40, 40)}
    assert data["views"] == metrics["views"]
    assert {c["phase"]: c["loss"] for c in data["curves"]} == metrics["losses"]
    terms = next(c["terms"] for c in data["curves"] if c["phase"] == "shape")
    assert set(terms) == {"silhouette", "laplacian"} and len(terms["laplacian"]) == len(metrics["losses"]["shape"])
    for (_, loss), (_, a), (_, b) in zip(metrics["losses"]["shape"], terms["silhouette"], terms["laplacian"]):
        assert loss == pytest.approx(a + 0.05 * b, rel=1e-4)
    assert [row["label"] for row in data["pictures"]] == ["start", "now", "target"]
    target = picture(data["pictures"][2]["images"][0])
    assert np.array_equal(target, np.asarray(Image.open(ran / "photos" / "0.png")))
    assert [c["name"] for c in data["cameras"]] == ["0", "1"]
    assert {p["name"]: p["phases"] for p in data["parameters"]} == {"vertices": ["shape"], "colors": ["paint"]}
    assert data["versions"]["device"] == metrics["device"] and data["bundle"]["digest"] == bundles.read(ran / "x.dressi").digest


def test_what_the_page_says_of_stages_is_the_bundle(ran):
    data, _ = read(ran / "report" / "index.html")
    d = bundles.read(ran / "x.dressi").description
    counted = summary(d)
    plans = {p["name"]: p for p in data["bundle"]["plans"]}
    assert list(plans) == [p["name"] for p in d["plans"]] and plans["shape"]["kind"] == "phase" and plans["render"]["kind"] == "output"
    assert any(p["kind"] == "prepare" for p in plans.values())
    for name, p in plans.items():
        assert sum(len(stage["substages"]) for stage in p["stages"]) == counted[name]["substages"]
        assert sum(stage["bytes"] for stage in p["stages"]) == counted[name]["bytes_per_step"] and p["ms"] > 0
        held = sum(n for stage in p["stages"] for sub in stage["substages"] for _, n in sub["holds"])
        assert held >= p["functions"] > 0, "a function may be computed in two substages"
        cached = {r["plan"] for stage in p["stages"] for sub in stage["substages"] for r in sub["reads"] if "plan" in r}
        assert cached <= set(p["needs"]) | {x for n in p["needs"] for x in plans[n]["needs"]}
        for k, stage in enumerate(p["stages"]):
            assert all(r["stage"] < k for sub in stage["substages"] for r in sub["reads"] if "stage" in r)
            assert len(stage["attachments"]) >= sum(len(sub["writes"]) for sub in stage["substages"]) > 0
    assert plans["shape"]["updates"][0] == "vertices" and plans["shape.loss"]["outputs"] == ["shape.loss"]
    limits = {x["name"]: x for x in data["bundle"]["limits"]}
    assert all(x["needed"] <= min(x["profile"], x["device"]) for x in limits.values()) and "maxColorAttachments" in limits


def test_nothing_is_fetched(ran):
    text = (ran / "report" / "index.html").read_text()
    reader = Reader(text)
    policy = next(a["content"] for tag, a in reader.elements if a.get("http-equiv") == "Content-Security-Policy")
    assert policy.startswith("default-src 'none';") and "connect-src" not in policy
    for tag, attributes in reader.elements:
        for key in ("src", "href", "srcset", "action", "data"):
            assert attributes.get(key, "data:").startswith("data:"), (tag, attributes)
    programs = "".join(reader.scripts.values()) + "".join(re.findall(r"<style>(.*?)</style>", text, re.S))
    assert set(re.findall(r"https?://[^\"'\s]+", programs)) == {"http://www.w3.org/2000/svg"} and "@import" not in programs


def test_timing_leaves_the_session_as_it_was(ran):
    from dressi_edge.page.result import stage_times
    with runtime.load(ran / "x.dressi") as session:
        session.step(5, "shape")
        before = {name: session.get(name).tobytes() for name, v in session.values.items() if v["role"] == "state"}
        times = stage_times(session, 1)
        assert set(times) == set(session.plans) and all(len(ms) == len(session.plans[n]["stages"]) for n, ms in times.items())
        assert {name: session.get(name).tobytes() for name in before} == before and session.phase == "shape"


def test_a_bundle_alone_has_a_page_and_a_checkpoint_has_its_curves(ran, tmp_path):
    done = command("report", ran / "x.dressi", "-o", tmp_path / "a.html", "--no-times")
    assert done.returncode == 0, done.stderr
    data, model = read(tmp_path / "a.html")
    (tmp_path / "a.glb").write_bytes(model)
    assert len(load_mesh(tmp_path / "a.glb").faces) == 80 and data["phases"] == [] and data["bundle"]["plans"][0]["ms"] is None
    done = command("report", ran / "x.dressi", "-o", tmp_path / "b.html", "--checkpoint", ran / "c")
    assert done.returncode == 0, done.stderr
    data, model = read(tmp_path / "b.html")
    assert model == (ran / "out.glb").read_bytes() and [c["phase"] for c in data["curves"]] == ["shape", "paint"]
    assert data["bundle"]["plans"][0]["ms"] > 0


def test_without_a_device_the_page_has_the_bundle(ran, tmp_path):
    none = str(tmp_path / "none.json")
    done = command("report", ran / "x.dressi", "-o", tmp_path / "a.html", VK_DRIVER_FILES=none, VK_ICD_FILENAMES=none)
    data, model = read(tmp_path / "a.html")
    assert done.returncode == 0 and model == b"" and len(data["bundle"]["plans"]) > 4 and "without a device" in data["subtitle"]


@pytest.mark.parametrize("suffix", [".glb", ".obj", ".ply"])
def test_a_mesh_file_becomes_a_page(ran, tmp_path, suffix):
    with runtime.load(ran / "x.dressi") as session:
        from dressi_edge.compiler.scene.results import save_result
        save_result(session, tmp_path / f"m{suffix}")
    done = command("view", tmp_path / f"m{suffix}", "-o", tmp_path / "m.html")
    assert done.returncode == 0, done.stderr
    (tmp_path / "again.glb").write_bytes(read(tmp_path / "m.html")[1])
    np.testing.assert_allclose(load_mesh(tmp_path / "again.glb").positions, load_mesh(tmp_path / f"m{suffix}").positions, atol=1e-6)


@pytest.mark.parametrize("args, expected", [
    (["view", "none.glb", "-o", "a.html"], "none.glb does not exist"), (["view", "out.glb", "-o", "a.pdf"], "name it .html"),
    (["report", "x.dressi", "-o", "none/a.html"], "does not exist; create it first"), (["report", "out.glb"], "not a bundle"),
    (["report", "x.dressi", "--checkpoint", "none"], "there is no such file"),
    (["run", "x.dressi", "--report", "c"], "cannot be made a folder")])
def test_what_has_no_page_says_why(ran, args, expected):
    before = sorted(p.name for p in ran.iterdir())
    done = command(*args, cwd=ran)
    assert done.returncode == 3 and expected in done.stderr and sorted(p.name for p in ran.iterdir()) == before, done.stderr


BAD = "</script><script>document.title='taken'</script><!--"


def test_names_of_a_bundle_stay_text():
    assert "<" not in script_json({BAD: [BAD]}) and json.loads(script_json({BAD: [BAD]})) == {BAD: [BAD]}
    reader = Reader(page({"title": BAD, "parameters": []}).decode())
    assert [tag for tag, _ in reader.elements].count("script") == 4 and json.loads(reader.scripts["data"])["title"] == BAD


def test_a_model_too_large_for_a_page_is_refused(monkeypatch):
    monkeypatch.setattr("dressi_edge.page.html.MAX_MODEL", 10)
    with pytest.raises(InputError, match="take a smaller texture or fewer faces"):
        page({}, bytes(11))


def test_a_bundle_of_an_earlier_compiler_has_stages_all_the_same(gpu):
    from dressi_edge.cache.layout import Layout
    p = Program()
    x = p.state("x", Layout("unit", "float"), 1.0)
    p.plan("go", {"x": x * 0.5}, steps=2)
    found = bundles.read(gpu.compile(p))
    del found.description["meta"]["holds"], found.description["meta"]["functions"]
    plan, = bundle_facts(found)["plans"]
    assert plan["functions"] is None and plan["stages"][0]["substages"][0]["holds"] == []


def test_dispatches_of_compute_are_stages_too(ran, tmp_path):
    made = command("compile", ran / "job.toml", "-p", "lavapipe", "-o", tmp_path / "c.dressi", "--compute", "all")
    assert made.returncode == 0, made.stderr
    found = bundles.read(tmp_path / "c.dressi")
    facts = {p["name"]: p for p in bundle_facts(found)["plans"]}
    for plan in found.description["plans"]:
        for stage, told in zip(plan["stages"], facts[plan["name"]]["stages"]):
            assert ("groups" in told) == ("compute" in stage) and sum(n for _, n in told["substages"][0]["holds"]) > 0
    assert any("groups" in stage for stage in facts["shape"]["stages"])


# ---- in a browser

def box(browser, selector):
    """(x, y, width, height) of an element in the window."""
    return browser.run(f"(() => {{ const r = document.querySelector({json.dumps(selector)}).getBoundingClientRect();"
                       " return [r.x, r.y, r.width, r.height]; })()")


def canvas(browser):
    """The pixels of the 3D view as they are on the screen."""
    x, y, w, h = (round(v) for v in box(browser, "canvas"))
    return np.asarray(Image.open(io.BytesIO(browser.picture())).convert("RGB")).astype(int)[y:y + h, x:x + w]


@with_browser
def test_a_browser_draws_the_model_and_turns_it_with_the_mouse(ran):
    with Browser() as browser:
        browser.open((ran / "report" / "index.html").as_uri())
        browser.until("window.dressi && dressi.viewer.drawn")
        first = canvas(browser)
        h, w = first.shape[:2]
        middle = first[h // 2 - 20:h // 2 + 20, w // 2 - 20:w // 2 + 20].reshape(-1, 3)
        assert (middle[:, 0] - middle[:, 2]).mean() > 60, "the disc in the photographs is red, and so is the ball"
        corner = first[20:30, 20:30].reshape(-1, 3)
        assert np.ptp(corner, axis=0).max() < 10 and np.abs(corner.mean(0) - middle.mean(0)).max() > 60, "there is nothing beside it"
        yaw = browser.run("dressi.viewer.yaw")
        x, y, *_ = box(browser, "canvas")
        browser.run("document.querySelector('[data-mode=\"2\"]').click()")
        browser.run("new Promise(requestAnimationFrame)")
        still = canvas(browser)
        browser.drag((x + w * 0.4, y + h * 0.5), (x + w * 0.6, y + h * 0.4))
        browser.run("new Promise(requestAnimationFrame)")
        assert abs(browser.run("dressi.viewer.yaw") - yaw) > 0.3 and np.abs(canvas(browser) - still).max() > 40
        distance = browser.run("dressi.viewer.distance")
        browser.mouse("mouseWheel", x + w / 2, y + h / 2, deltaX=0, deltaY=-100)
        browser.until(f"dressi.viewer.distance < {distance}")
        browser.run("document.querySelector('[data-toggle=\"showCameras\"]').click()")
        browser.run("dressi.viewer.reset()")
        browser.run("new Promise(requestAnimationFrame)")
        assert browser.run("dressi.viewer.yaw") == pytest.approx(yaw) and browser.errors == []
        assert all(r.startswith(("file:", "data:", "blob:")) for r in browser.requests)


@with_browser
def test_a_browser_lights_what_would_show_an_outline_alone(ran, tmp_path):
    path = tmp_path / "grey.html"
    with runtime.load(ran / "x.dressi") as session:
        from dataclasses import replace

        from dressi_edge.compiler.io.write_gltf import encode_gltf
        from dressi_edge.compiler.scene.results import parts_now
        part, = parts_now(session)
        path.write_bytes(page({}, encode_gltf([replace(part, mesh=replace(part.mesh, colors=None, color_faces=None))], binary=True)))
    with Browser() as browser:
        browser.open(path.as_uri())
        browser.until("window.dressi && dressi.viewer.drawn && dressi.viewer.mode === 1")
        assert browser.run("document.querySelector('[aria-pressed=true]').textContent") == "clay"
        texture = np.full((8, 8, 3), 0.5)
        flat = {"colors": None, "color_faces": None, "uvs": np.zeros((1, 2)), "uv_faces": np.zeros_like(part.mesh.faces)}
        for end, mode in ((0.5, 1), (0.9, 0)):
            texture[0] = end
            mesh = replace(part.mesh, **flat, texture=texture.copy())
            (tmp_path / "t.html").write_bytes(page({}, encode_gltf([replace(part, mesh=mesh)], binary=True)))
            browser.open((tmp_path / "t.html").as_uri())
            browser.until(f"window.dressi && dressi.viewer.drawn && dressi.viewer.mode === {mode} && dressi.viewer.counts")
        browser.open(path.as_uri())
        browser.until("window.dressi && dressi.viewer.drawn && dressi.viewer.mode === 1")
        browser.run("new Promise(requestAnimationFrame)")
        picture = canvas(browser)
        h, w = picture.shape[:2]
        assert np.ptp(picture[h // 4:3 * h // 4, w // 2].sum(1)) > 60, "it is shaded"


@with_browser
def test_a_browser_shows_curves_stages_and_both_themes(ran):
    with Browser() as browser:
        browser.dark(False)
        browser.open((ran / "report" / "index.html").as_uri())
        browser.until("window.dressi && dressi.viewer.drawn")
        assert browser.run("[...document.querySelectorAll('section')].map(e => e.id).join(' ')") == \
            "views loss parameters time stages limits versions"
        assert browser.run("document.querySelectorAll('#loss polyline').length") == 4  # shape: loss and two terms; paint: loss
        assert browser.run("document.querySelectorAll('#sheet img').length") == 6
        assert browser.run("[...document.querySelectorAll('#sheet img')].every(i => i.complete && i.naturalWidth === 24)")
        stages = next(p["stages"] for p in bundles.read(ran / "x.dressi").description["plans"] if p["name"] == "shape")
        assert browser.run("document.querySelectorAll('details[open] .row:not(.head)').length") == len(stages)
        browser.until("document.querySelectorAll('.rows path').length > 3")
        assert browser.run("document.documentElement.scrollWidth <= innerWidth"), "the page is no wider than the window"
        light = browser.run("getComputedStyle(document.body).backgroundColor")
        browser.dark(True)
        assert browser.run("getComputedStyle(document.body).backgroundColor") != light and browser.errors == []
        browser.send("Emulation.setDeviceMetricsOverride", width=390, height=800, deviceScaleFactor=1, mobile=False)
        browser.run("new Promise(requestAnimationFrame)")
        assert browser.run("document.documentElement.scrollWidth <= innerWidth"), "nor than a phone's"


@with_browser
def test_a_browser_runs_nothing_that_a_name_holds(tmp_path):
    path = tmp_path / "bad.html"
    path.write_bytes(page({"title": BAD, "versions": {BAD: "<img src=x onerror=\"document.title='taken'\">"}, "curves": [
        {"phase": BAD, "steps": 2, "loss": [[0, 1.0], [1, None], [2, 0.5]], "terms": {}}]}))
    with Browser() as browser:
        browser.open(path.as_uri())
        browser.until("document.querySelector('#versions')")
        assert browser.run("document.title") == BAD and browser.run("document.querySelectorAll('main img').length") == 0
        assert browser.errors == []
