"""Tables in rows as wide as a profile asks for: the same bits whatever the width, drawn or dispatched; less memory where rows are padded.

What is compared is everything a user can get: pictures, gradients, states after steps, losses; on lavapipe, under the layer.
"""

from dataclasses import replace

import numpy as np
import pytest
from drivers import whole

from dressi_edge import runtime
from dressi_edge.cache import bundle
from dressi_edge.cache.errors import ProfileError
from dressi_edge.cache.layout import Layout
from dressi_edge.cache.profile import TABLE_WIDTHS, Profile, canonical, merge
from dressi_edge.cache.profile_file import to_json
from dressi_edge.cache.summary import padded_bytes
from dressi_edge.cli import main
from dressi_edge.commands import profiles
from dressi_edge.compiler import Program, build
from dressi_edge.compiler.graph.functions import apply, constant_table, gather_sum, lookup, total
from dressi_edge.compiler.render.light import Light
from dressi_edge.compiler.scene import (
    PBR,
    Adam,
    Binned,
    Outline,
    Scene,
    Texture,
    Unlit,
    Vertex,
    icosphere,
    l2,
    orbit,
    sphere,
)

pytest_plugins = ["gpu"]
LAVAPIPE = Profile.load("lavapipe")
VIEWS = orbit(2, [20, -15], 3.0, 40, (200, 150))


def wide(width, **more):
    return replace(LAVAPIPE, name=f"wide{width}", table_width=width, **more)


def moved(renderer):
    """A ball of 320 faces whose vertices and colours are fitted, and a gradient of its picture."""
    s, ball = Scene(VIEWS, background=(0.1, 0.2, 0.3)), icosphere(2, 0.6)
    colors = s.parameter("colors", np.random.default_rng(0).uniform(size=(162, 3)))
    s.add(ball, s.parameter("vertices", ball.positions), Unlit(Vertex(colors)))
    seen, photo = s.frame(renderer), s.input("photo", np.full((2, 150, 200, 3), 0.5))
    s.phase("fit", 3, {"vertices": Adam(0.01), "colors": Adam(0.02)}, color=l2(seen.color, photo))
    s.vjp("look", ["vertices", "colors"], color=seen.color, alpha=seen.alpha)
    return s.program


def binned():
    return moved(Binned(3.0, gamma=1e-3, over=True))


def contours():
    return moved(Outline(contours=True))


def material():
    """Reflectance with a texture of mip levels, fitted."""
    s, ball = Scene(VIEWS), sphere(162, 1.0)
    image = s.parameter("texture", np.random.default_rng(0).uniform(size=(64, 64, 3)), 0.0, 1.0, kind="image")
    s.add(ball, material=PBR(Texture(image, mips=True), s.parameter("roughness", 0.5), 0.2,
                             lights=[Light("directional", 2.0, (0.3, -0.5, -0.8)), Light("ambient", 0.2)]))
    seen, photo = s.frame(), s.input("photo", np.full((2, 150, 200, 3), 0.5))
    s.phase("fit", 3, {"texture": Adam(0.03), "roughness": Adam(0.01)}, color=l2(seen.color, photo))
    s.vjp("look", ["texture"], color=seen.color)
    return s.program


def layers():
    return whole.colors3().program


CASES = {f.__name__: f for f in (binned, contours, material, layers)}


def everything(gpu, program, profile, **how):
    """All that a user gets of it, by name, and the description."""
    path, found = gpu.compile(program, profile, **how), {}
    with runtime.load(path, gpu.device) as session:
        if "look" in session.plans:
            session.forward("look")
            found |= session.backward("look", color=np.sin(np.arange(2 * 150 * 200 * 3)).reshape(2, 150, 200, 3))
        session.step(3, "fit")
        found |= {name: session.get(name) for name, role in program.roles.items() if role != "input"}
    gpu.silent()
    return {name: array.tobytes() for name, array in found.items()}, bundle.read(path).variants[0].description


HOW = [(64, {}), (64, {"compute": "all"}), *((width, {}) for width in TABLE_WIDTHS if width < 64)]


@pytest.mark.parametrize("name, ways", [("layers", HOW[:1]), ("binned", HOW[:1]), *(
    pytest.param(name, HOW, marks=pytest.mark.full, id=f"{name} all") for name in CASES)])
def test_all_that_a_user_gets_has_the_same_bits_in_rows_of_any_width(gpu, name, ways):
    program = CASES[name]()
    expected, d = everything(gpu, program, LAVAPIPE)
    narrow = sum(image["width"] < 64 <= image["width"] * image["height"] for image in d["images"])
    for width, how in ways:
        found, d = everything(gpu, program, wide(width), **how)
        assert [k for k in expected if found[k] != expected[k]] == [], (width, how)
        left = sum(image["width"] < width and image["width"] * image["height"] >= 4 * width for image in d["images"])
        assert left < narrow / 4, f"{left} of {narrow} are as narrow as before"


def test_tables_hold_the_same_numbers_at_counts_around_their_rows(gpu):
    """Rows that are full, or lack an entry, or have one more; gathers, sums and lookups through constants as wide."""
    def program(count):
        p = Program()
        x = p.input("x", Layout("table", "vec3", count=count))
        y = apply("sin", lookup(x, constant_table(np.random.default_rng(count).integers(0, count, (count + 3, 1)))))
        cols = np.random.default_rng(1).integers(0, count + 3, 7 * count)
        z = gather_sum(y, np.stack([7 * np.arange(count), 7 * np.arange(count) + 7], 1), cols)
        p.plan("p", {}, {"z": (z * 2.0, Layout("table", "vec3", count=count)), "sum": (total(y), Layout("unit", "vec3"))})
        return p

    for count in (31, 256, 257, 1021):
        made, images = program(count), np.random.default_rng(0).normal(size=(-(-count // 4), 4, 3))
        expected = gpu.run(made, {"x": images})
        for width in (8, 64):
            for name, array in gpu.run(made, {"x": images}, wide(width)).items():
                np.testing.assert_array_equal(array, expected[name], err_msg=f"{count} entries, rows of {width}")


def test_without_a_width_nothing_changes_and_what_a_session_sees_never_does():
    program = moved(Outline())
    plain, wider = build(program, LAVAPIPE), build(program, wide(64))
    assert "table_width" not in plain.description["meta"] and wider.description["meta"]["table_width"] == 64
    assert [{**v, "image": 0, "initial": 0} for v in plain.description["values"]] == [
        {**v, "image": 0, "initial": 0} for v in wider.description["values"]]
    assert "table_width" not in canonical(LAVAPIPE) and "table_width" not in to_json(LAVAPIPE)
    narrow = [padded_bytes({"images": [i for i in made.description["images"] if i["width"] < 64]}, 64) for made in (plain, wider)]
    assert narrow[1] < 0.3 * narrow[0], narrow


def test_inspect_says_what_padded_rows_take(gpu, capsys):
    path = gpu.compile(moved(Outline()), wide(64))
    d = bundle.read(path).variants[0].description
    main(["inspect", str(path)])
    told = capsys.readouterr().out.splitlines()[0]
    assert told.endswith(f"images of {padded_bytes(d, 1) / 1e6:.3g} MB, {padded_bytes(d, 64) / 1e6:.3g} MB in rows of whole 64 texels")


def test_a_profile_has_a_width_of_the_list_or_none():
    for width in TABLE_WIDTHS:
        made = Profile.loads(to_json(wide(width)))
        assert made.table_width == width and made.digest != LAVAPIPE.digest
    assert merge([wide(16), LAVAPIPE, wide(64)], "m").table_width == 64
    text = to_json(wide(64))
    for bad in ("4", "24", "true", '"64"', "64.0"):
        with pytest.raises(ProfileError, match="table_width: must be"):
            Profile.loads(text.replace('"table_width": 64', f'"table_width": {bad}'))


@pytest.mark.parametrize("pad, width", [((4, 1), None), ((16, 1), 16), ((64, 4), 64), ((512, 1), 64), ((32, 1), 32), ((8, 16), 8)])
def test_the_width_that_is_captured_is_the_narrowest_that_is_not_padded(monkeypatch, pad, width):
    """pad: texels to which a driver fills rows, and rows to which it fills images."""
    class Asked:
        def __init__(self, record):
            across, down = (-(-record[k] // n) * n for k, n in zip(("width", "height"), pad))
            self.size = 16 * across * down

    monkeypatch.setattr("dressi_edge.runtime.memory.requirements", lambda device, record: Asked(record))
    assert profiles.table_width(None) == width


def test_lavapipe_asks_for_no_width(gpu):
    assert profiles.table_width(gpu.device) is None
