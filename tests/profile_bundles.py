"""One small problem for every profile: a pytest plugin, `pytest_plugins = ["profile_bundles"]`.

Bundles are compiled once for the whole session, whichever module asks first.
"""

import pytest
from corpus import scenes
from drivers.catalog import CAPTURED

from dressi_edge.cache.layout import Layout
from dressi_edge.cache.profile import profile_names
from dressi_edge.compiler import Program, compile_program
from dressi_edge.compiler.graph.autodiff import gradients
from dressi_edge.compiler.graph.functions import dot, total
from dressi_edge.compiler.render.atlas import Atlas
from dressi_edge.compiler.render.raster import Softness, rasterized
from dressi_edge.compiler.render.topology import Topology

SCENE = scenes()["icosphere"]
# every profile; those of drivers that `make test-drivers` compiles for only in the long run
NAMES = [pytest.param(name, marks=pytest.mark.full) if name in CAPTURED else name for name in profile_names()]


def hardsoftras(layers: int) -> Program:
    """Silhouette and colour of a small sphere, and their gradients."""
    width, height = SCENE.size
    count, image = len(SCENE.clip), {"width": width, "height": height}
    program = Program()
    clip = program.input("clip", Layout("table", "vec4", count=count), SCENE.clip)
    attributes = program.input("attributes", Layout("table", "vec3", count=count), SCENE.attributes)
    what = clip, Topology(SCENE.faces, count), Atlas(width, height, 1, 1), Softness(3.0, layers=layers), SCENE.near
    ras, alpha = rasterized(*what), rasterized(*what, faces=False).silhouette()
    color = ras.color([ras.interpolate(layer, attributes) for layer in ras.layers], 0.0)
    g = gradients(total(alpha) + total(dot(color, color)), [clip, attributes])
    program.plan("shape", {}, {
        "alpha": (alpha, Layout("image", "float", **image)), "color": (color, Layout("image", "vec3", **image)),
        "by_clip": (g[0], Layout("table", "vec4", count=count)), "by_attributes": (g[1], Layout("table", "vec3", count=count))})
    return program


@pytest.fixture(scope="session")
def profile_bundle(tmp_path_factory):
    """profile_bundle(profile name, K): the path of the bundle."""
    folder, made = tmp_path_factory.mktemp("profiles"), {}

    def get(name, layers):
        if (name, layers) not in made:
            made[name, layers] = folder / f"{name}.{layers}.dressi"
            compile_program(hardsoftras(layers), name, made[name, layers])
        return made[name, layers]

    return get
