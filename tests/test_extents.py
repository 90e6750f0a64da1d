"""Every input of every op in turn as one value for all texels, and with an extent of its own: refused when it is built, or computed as the
reference does, and one value for all as the same value at every texel.

What this is about: a colour of 1 x 1 read at the texel of its reader is another texel's, or none.
"""

import numpy as np
import pytest
from graphs import image_layout, layout_of, rounded
from test_ops import DEFAULT_RTOL, RTOL, SNIPPETS, ids, same, sample

from dressi_edge.cache.errors import GraphError
from dressi_edge.cache.layout import Layout
from dressi_edge.compiler import Program
from dressi_edge.compiler.graph.functions import apply, constant, lookup, total
from dressi_edge.compiler.graph.ir import Node, image
from dressi_edge.compiler.graph.reference import evaluate
from dressi_edge.compiler.render.raster.fragments import near_faces

pytest_plugins = ["gpu"]
# Inputs that are tables of what there is, by number or tile: one entry is a table of one, not a value for all.
TABLES = {("texture_bins", "ordered"), ("slot_of", "entries"), ("slot_of", "running"), ("first_chunk", "running"), ("join", "a"),
          ("join", "b"), ("meets_tiles", "tiles")}
# Inputs of which others promise something (which places of a list are in use, where pixels lie that name an entry): with others in their
# place that is broken, and the result open.
PROMISES = {("capsule_sum", "segment"), ("capsule_sum", "center"), ("segment_sum", "bins"), ("gather_listed", "x"),
            ("sample_listed", "entries"),
            *((name, param) for name, params in (("bin_ranges", "starts spilled total"), ("bin_list", "sides starts spilled total marks"),
                                                 ("list_marks", "starts spilled total count"), ("mark_bins", "bases"),
                                                 ("tile_sides", "boxes ranges bases"), ("tile_runs", "sides ranges bases"),
                                                 ("tile_ranges", "starts spilled total ranges bases needed"), ("soft_mask", "v0"),
                                                 ("tile_list", "sides starts spilled total marks of_marks faces ranges bases"),
                                                 ("listed_keys", "footprint entries total"), ("merge_listed", "total"),
                                                 ("listed_bins", "ordered total"),
                                                 ("mip_reads", "ordered footprint"), ("mip_starts", "ordered total"),
                                                 ("mip_spans", "entries runs total"), ("mip_meet", "s00 s10 s01 s11 firsts ends"),
                                                 *((name, "faces masks spilled") for name in (
                                                     "soft_alpha", "soft_sums", "soft_most", "soft_heaviest")),
                                                 ("part_units", "starts"),
                                                 *((f"soft_{name}_parts", "faces masks spilled units") for name in (
                                                     "alpha", "sums", "most")),
                                                 *((f"soft_join_{name}", "starts alpha_parts sums_parts most_parts") for name in (
                                                     "alpha", "sums", "most")),
                                                 ("mip_texels", "where texture half rest"), ("mip_taken", "each"), ("mip_fold", "each"),
                                                 ("mip_block_gradient", "each fold"),
                                                 ("sample_touched", "entries"),
                                                 *((f"mip_sums_{k}", "reads") for k in ("00", "10", "01", "11")),
                                                 ("soft_alpha_gradient", "slope"), ("soft_place_gradient", "slope"),
                                                 ("soft_color_gradient", "slope"))
              for param in params.split())}


def data_of(argument):
    """The numbers (h, w, c) of an argument of a sample."""
    return argument.attrs["data"].array if isinstance(argument, Node) else argument


def forms(array):
    """Its first texel, and an image of another extent made of its texels."""
    yield "unit", array[:1, :1]
    extents = ((2, 3), (3, 2)) if array.shape[:2] != (2, 3) else ((3, 2),)
    yield "other", np.resize(array, (*extents[0], array.shape[2]))


def build(o, arguments, attrs, program, feed, key):
    nodes = []
    for k, a in enumerate(arguments):
        if not isinstance(a, Node):
            feed[f"{key}/{k}"] = rounded(a)
            a = program.input(f"{key}/{k}", image_layout(a))
        nodes.append(a)
    return apply(o.name, *nodes, **attrs)


def variants():
    """{(op, input, form): (arguments, attributes, of the whole sample)}; a form that is the sample itself is none."""
    for o in SNIPPETS:
        arguments, attrs = sample(o)
        for k, param in enumerate(o.params):
            array = data_of(arguments[k])
            for form, new in forms(array):
                if new.shape != array.shape:
                    given = list(arguments)
                    given[k] = constant(new) if isinstance(arguments[k], Node) else new
                    whole = list(arguments)
                    whole[k] = np.broadcast_to(new, array.shape) if form == "unit" else None
                    yield (o, param, form), given, whole, attrs


@pytest.fixture(scope="module")
def built(gpu):
    """What was accepted: {(op, input, form): (device, reference, broadcast first or None)}; and what was refused."""
    program, feed, nodes, first, refused = Program(), {}, {}, {}, {}
    for (o, param, form), given, whole, attrs in variants():
        key = f"{o.name}/{param}/{form}"
        trial, values = Program(), {}
        try:
            build(o, given, attrs, trial, values, key)
        except GraphError as e:
            refused[o.name, param, form] = str(e)
            continue
        if (o.name, param) in PROMISES:
            continue
        nodes[o.name, param, form] = y = build(o, given, attrs, program, feed, key)
        if form == "unit" and (o.name, param) not in TABLES:
            full = build(o, whole, attrs, trial, values, key + "/full")
            if full.extent == y.extent:
                first[o.name, param, form] = evaluate([full], values)[0]
    program.plan("all", {}, {"/".join(key): (y, layout_of(y)) for key, y in nodes.items()})
    device = gpu.run(program, feed)
    reference = dict(zip(nodes, evaluate(nodes.values(), feed)))
    return {key: (device["/".join(key)], program.values["/".join(key)].layout, reference[key], first.get(key)) for key in nodes}, refused


@pytest.mark.parametrize("o", [o for o in SNIPPETS if o.params], **ids)
def test_an_input_of_another_extent_is_refused_or_means_the_same_everywhere(o, built):
    accepted, refused = built
    for (name, param, form), (device, layout, reference, first) in accepted.items():
        if name == o.name:
            where = f"{name}: {param} {form}"
            same(device, layout.from_image(reference), RTOL.get(name, DEFAULT_RTOL), where)
            if first is not None:
                np.testing.assert_allclose(layout.from_image(reference), layout.from_image(first), rtol=1e-6, err_msg=where)
    for (name, _, _), message in refused.items():
        assert name != o.name or (message.startswith(name) or name in message) and "\n" not in message


def test_both_happen(built):
    accepted, refused = built
    assert len(accepted) > 100 and len(refused) > 50
    assert sum(first is not None for *_, first in accepted.values()) > 60


# Reads of literals: there is no image behind a literal


def test_a_literal_that_is_read_elsewhere_is_an_image(gpu):
    """A table of one number, before and after literals are folded."""
    program = Program()
    index = program.input("index", Layout("image", "int", 5, 4))
    two = apply("literal", value=1.0) + 1.0
    outputs = {"plain": lookup(apply("literal", value=2.0), index), "folded": lookup(two, index),
               "vector": lookup(apply("literal", value=(1.0, 2.0, 3.0)), index), "number": apply("lookup", 2.0, index)}
    program.plan("p", {}, {name: (y, layout_of(y)) for name, y in outputs.items()})
    given = np.tile([-1, 0, 0, -1, 0], (4, 1))[..., None]
    device = gpu.run(program, {"index": given})
    for name, y in outputs.items():
        np.testing.assert_array_equal(device[name], layout_of(y).from_image(evaluate([y], {"index": given})[0]))


# The bug itself


@pytest.mark.parametrize("size", [(200, 150), (333, 217), (16, 16), (17, 33)], ids=str)
def test_one_value_for_all_pixels_is_shown_wherever_there_are_faces(gpu, size):
    w, h = size
    face = np.where(np.add.outer((np.arange(h) - 0.6 * h) ** 2 / h, (np.arange(w) - 0.7 * w) ** 2 / w) < 0.04 * (w + h) / 2, 3, -1)
    program = Program()
    faces, color = program.input("face", Layout("image", "int", w, h)), program.input("color", Layout("unit", "vec3"))
    y = near_faces(faces, color)
    assert y.extent == image(w, h)
    loss = total(apply("select", faces >= 0, apply("dot", y, y), 0.0))
    program.plan("p", {}, {"y": (y, layout_of(y)), "loss": (loss, layout_of(loss))})
    result = gpu.run(program, {"face": face[..., None], "color": np.array([[[0.25, 0.5, 1.0]]])})
    shown = face >= 0
    assert 0.02 < shown.mean() < 0.9 or size == (16, 16)
    np.testing.assert_array_equal(result["y"][shown], np.broadcast_to([0.25, 0.5, 1.0], (shown.sum(), 3)))
    np.testing.assert_allclose(result["loss"], 1.3125 * shown.sum(), rtol=1e-6)
