"""Lists made on the device against `np.flatnonzero`, from one entry to more than three levels of counts hold."""

import make_vectors
import numpy as np
import pytest

from dressi_edge.cache import bundle
from dressi_edge.cache import vulkan as v
from dressi_edge.cache.layout import Layout
from dressi_edge.compiler import Program
from dressi_edge.compiler.graph.autodiff import gradients
from dressi_edge.compiler.graph.functions import dot, total
from dressi_edge.compiler.graph.ops.compact import compact
from dressi_edge.compiler.graph.optable import apply
from dressi_edge.compiler.graph.reference import evaluate

pytest_plugins = ["gpu"]

COUNTS = (1, 2, 3, 64, 65, 4096, 4097, 20000, 270000)


def names(count):
    """Whose value each entry of a list takes: of the last third of a long table all take one of five."""
    return np.where(np.arange(count) < 2 * count // 3, np.arange(count), np.arange(count) % min(count, 5))


def program_of(count, each=3):
    program = Program()
    kind = Layout("table", "int", count=count)
    flags = program.input("flags", kind)
    values = program.input("values", Layout("table", "vec2", count=count))
    weights = program.input("weights", Layout("table", "vec2", count=count))
    listed = compact(flags, each)
    gathered = listed.lookup(values, names(count))
    back = apply("lookup", gathered, listed.slots)
    g, = gradients(total(dot(gathered, apply("lookup", weights, listed.entries))), [values])
    running = listed.running.extent
    pairs = Layout("table", "vec2", count=count)
    first = apply("texel_index", extent=flags.extent)  # of a list nothing is drawn but its entries
    program.plan("all", {}, {"entries": (apply("lookup", listed.entries, first), kind), "slots": (listed.slots, kind),
                             "gathered": (apply("lookup", gathered, first), pairs), "back": (back, pairs), "by_values": (g, pairs),
                             "running": (listed.running, Layout("table", "int", count=running.count))})
    return program


def patterns(count):
    rng = np.random.default_rng(count)
    yield np.zeros(count, int)
    yield np.ones(count, int)
    yield (np.arange(count) == count - 1).astype(int)
    for share in (0.001, 0.02, 0.5):
        yield (rng.random(count) < share).astype(int)


@pytest.mark.parametrize("count", COUNTS)
def test_the_list_is_every_set_entry_in_order(gpu, count):
    rng = np.random.default_rng(1)
    values, weights = (rng.integers(-8, 9, (count, 2)) / 4 for _ in range(2))
    program = program_of(count)
    with gpu.open(program) as session:
        session.set("values", values)
        session.set("weights", weights)
        for flags in patterns(count):
            session.set("flags", flags)
            found = np.flatnonzero(flags)
            slots = np.full(count, -1)
            slots[found] = np.arange(len(found))
            named = names(count)[found]
            gradient = np.zeros((count, 2))
            np.add.at(gradient, named, weights[found])
            want = {"entries": found, "slots": slots, "gathered": values[named],
                    "back": np.where(flags[:, None], values[names(count)], 0), "by_values": gradient}
            for name, x in want.items():
                np.testing.assert_array_equal(session.get(name).reshape(-1, *x.shape[1:])[:len(x)], x, err_msg=name)
            assert session.get("running").reshape(-1)[-1] == 3 * len(found)
            if count <= 4097:
                feed = {k: program.values[k].layout.to_image(x, k) for k, x in (("flags", flags), ("values", values), ("weights", weights))}
                outputs = program.plans[0].outputs
                for name, value in zip(outputs, evaluate(outputs.values(), feed)):
                    got = program.values[name].layout.from_image(value)
                    last = len(want[name]) if name in want else None
                    np.testing.assert_array_equal(got[:last], session.get(name)[:last], err_msg=f"reference {name}")
    gpu.silent()


def test_what_a_draw_may_run_over_holds_nothing_after_the_last_entry():
    """A player may draw all vertices: what such a draw takes entries from is -1 wherever the list does not reach."""
    d = bundle.read(make_vectors.FOLDER / "lists.dressi").description
    seen = 0
    for plan in d["plans"]:
        cleared = {}
        for stage in plan["stages"]:
            for draw in (draw for draws in stage["subpasses"] for draw in draws if draw["count"] >= 0):
                bound = zip(draw["images"], d["pipelines"][draw["pipeline"]]["bindings"])
                for ref in (ref for ref, (_, stages, _) in bound if stages & v.STAGE_VERTEX and ref in cleared):
                    if d["images"][ref // 2]["format"] == v.FORMATS["R32_SINT"]:
                        assert cleared[ref] == (v.LOAD_CLEAR, -1)
                        seen += 1
            attachments = d["passes"][stage["pass"]]["attachments"]
            cleared |= {ref: (a["load"], a["clear"]) for ref, a in zip(stage["attachments"], attachments)}
    assert seen
