"""Lambert's absolute value: numbers computed by hand, of one surface element and of a square before a camera."""

import math

import numpy as np
import pytest
from graphs import layout_of

from dressi_edge import runtime
from dressi_edge.cache.layout import Layout
from dressi_edge.compiler import Program
from dressi_edge.compiler.graph.autodiff import gradients
from dressi_edge.compiler.graph.functions import compose, constant, total
from dressi_edge.compiler.graph.reference import evaluate
from dressi_edge.compiler.render.light import diffuse
from dressi_edge.compiler.scene import Light, Mesh, Problem, Softness, look_at

pytest_plugins = ["gpu"]
PI = math.pi
# A white element at the origin, normal (0, 0, 2): its length does not count. Light: radiance by hand.
ELEMENT = {
    "from above": (Light("directional", (PI, 2 * PI, 3 * PI), (0, 0, -5)), (1.0, 2.0, 3.0)),
    "at 60 degrees": (Light("directional", (PI, PI, 0.0), (math.sqrt(3), 0, -1)), (0.5, 0.5, 0.0)),
    "at 45 degrees": (Light("directional", 2.0, (0, 1, -1)), (math.sqrt(2) / PI,) * 3),
    "grazing": (Light("directional", 9.0, (1, 0, 0)), (0.0,) * 3),
    "from behind": (Light("directional", 9.0, (0, 0, 1)), (0.0,) * 3),
    "a point two away": (Light("point", (4 * PI, 8 * PI, 0.0), (0, 0, 2)), (1.0, 2.0, 0.0)),
    "a point aside": (Light("point", 50 * PI, (3, 0, 4)), (1.6,) * 3),  # d = 5, cosine 4 / 5: 50 / 25 * 0.8
    "a point behind": (Light("point", 50.0, (0, 0, -1)), (0.0,) * 3),
    "from everywhere": (Light("ambient", (0.1, 0.2, 0.3)), (0.1, 0.2, 0.3)),
}


def test_an_element_reflects_what_is_computed_by_hand(gpu):
    normal, position = constant(np.array([[[0.0, 0.0, 2.0]]])), constant(np.zeros((1, 1, 3)))
    outputs = {name: diffuse(normal, position, [light]) for name, (light, _) in ELEMENT.items()}
    outputs["all"] = diffuse(normal, position, [light for light, _ in ELEMENT.values()])
    expected = {name: value for name, (_, value) in ELEMENT.items()}
    expected["all"] = np.sum(list(expected.values()), axis=0)
    program = Program()
    program.plan("p", {}, {name: (y, layout_of(y)) for name, y in outputs.items()})
    device = gpu.run(program, {})
    for name, y in outputs.items():
        np.testing.assert_allclose(evaluate([y])[0].ravel(), expected[name], rtol=1e-12, atol=1e-12, err_msg=name)
        np.testing.assert_allclose(device[name].ravel(), expected[name], rtol=2e-6, atol=1e-6, err_msg=name)


@pytest.mark.parametrize("kind", [{"kind": "point"}, {"kind": "spot", "direction": (-1.0, 0.0, -1.0)}], ids=["point", "spot"])
@pytest.mark.parametrize("away", [0.0, 1e-7, 9e-5, 1.1e-4, 1.0])
def test_a_light_on_the_surface_has_no_slope(kind, away):
    """Within 1e-4: the direction's would be 1 / distance, and the square of the gradient beyond fp32. Beyond it is that of differences."""
    light, at = Light(power=9.0, vector=(0.0, 0.0, 0.0), **kind), away * np.array([-0.8, 0.0, -0.6])
    position = Program().input("x", Layout("unit", "vec3"))
    shown = total(diffuse(compose(0.1, 0.0, 1.0), position, [light]).x)

    def value(x):
        return evaluate([shown], {"x": x.reshape(1, 1, 3)})[0].item()

    slope = evaluate(gradients(shown, [position]), {"x": at.reshape(1, 1, 3)})[0].ravel()
    if away < 1e-4:
        assert not slope.any() and (away == 0 or value(at) > 1e7)
    else:
        step = 1e-5 * away
        np.testing.assert_allclose(slope, [(value(at + d) - value(at - d)) / (2 * step) for d in step * np.eye(3)], rtol=1e-6,
                                   atol=1e-6 * abs(slope).max())
        assert (slope[[0, 2]] != 0).all()


@pytest.mark.parametrize("turned", [0.0, 60.0], ids=["facing", "turned"])
def test_a_square_before_a_camera_has_the_colour_computed_by_hand(gpu, turned):
    """albedo (E / pi cos + ambient): the sun along -z with E = 2 pi, the square turned about y, the ambient 0.1."""
    a = math.radians(turned)
    corners = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)]) @ np.array([[math.cos(a), 0, math.sin(a)], [0, 1, 0]])
    lights = [Light("directional", 2 * PI, (0, 0, -1)), Light("ambient", 0.1)]
    problem = Problem(Mesh(corners, np.array([(0, 1, 2), (0, 2, 3)])), [look_at((0, 0, 3), (0, 0, 0), (0, 1, 0), 45.0, 61, 47)],
                      albedo="constant", albedo_color=(0.5, 0.25, 0.8), shading="lambert", lights=lights, normals="flat")
    problem.render("look", Softness(1.0, delta=0.0))
    with runtime.load(gpu.compile(problem.program), gpu.device) as session:
        color = session.get("look.color")[0]
    gpu.silent()
    inside = color[..., 3] == 1
    assert inside[23, 30] and inside.mean() > 0.1
    value = 2 * math.cos(a) + 0.1  # 2.1 facing, 1.1 turned
    np.testing.assert_allclose(color[inside][:, :3], np.broadcast_to(np.array([0.5, 0.25, 0.8]) * value, (inside.sum(), 3)), rtol=1e-5)
