"""Images are shared by values that do not live at the same time: whatever a stage reads is what it is meant to read."""

from dataclasses import replace

import pytest
from graphs import Graph

from dressi_edge.cache.layout import Layout
from dressi_edge.cache.profile import Profile
from dressi_edge.compiler import Program
from dressi_edge.compiler.backend.allocate import allocate
from dressi_edge.compiler.backend.check import DefectError, check
from dressi_edge.compiler.graph.functions import sigmoid
from dressi_edge.compiler.graph.ir import Node
from dressi_edge.compiler.passes.domains import find_domains
from dressi_edge.compiler.passes.groups import grouped, lowered
from dressi_edge.compiler.passes.pack import pack
from dressi_edge.compiler.passes.plans import PREPARE, PackedPlan, plan_graphs, stored


def random_program(seed):
    graph = Graph(seed, 40)
    graph.plan()
    return graph.program


def packed(program, profile, naive=False):
    graphs = [stored(plan, program) for plan in plan_graphs(lowered(grouped(program)), program)]
    return [PackedPlan(plan, find_domains(plan, pack(plan.roots, profile, naive))) for plan in graphs]


@pytest.mark.parametrize("naive", [False, True], ids=["packed", "naive"])
@pytest.mark.parametrize("profile", ["lavapipe", "limit4", "mali_g76"])
@pytest.mark.parametrize("seed", range(3))
def test_an_image_holds_what_its_readers_expect(seed, profile, naive):
    program = random_program(seed)
    plans = packed(program, Profile.load(profile), naive)
    places = allocate(program, plans)
    check(places, Profile.load(profile))
    held = {}  # ref -> the node in it, of leaves the leaf
    for plan, placed in zip(plans, places.plans):
        for stage, where in zip(plan.stages, placed.stages):
            written = iter(where.attachments)
            for s in stage.substages:
                for x in (*s.images, *s.counts):
                    assert held.setdefault(placed.refs[x], x) is x if x.op.stage == "leaf" else held[placed.refs[x]] is x
                for n in s.outputs:
                    assert next(written) == placed.refs[n]
                    held[placed.refs[n]] = n
        for root, target in zip(plan.graph.roots, plan.graph.targets):
            assert held[placed.refs[root]] is root, "what is given is still there when the plan has run"
            if isinstance(target, Node) and plan.graph.kind == PREPARE:
                held[placed.refs[root]] = target


def test_values_that_do_not_live_together_share_images():
    program, layout = Program(), Layout("image", "float", 8, 8)
    y = program.input("x", layout)
    for _ in range(20):
        y = sigmoid(y)
    program.plan("all", {}, {"y": (y, layout)})
    places = allocate(program, packed(program, Profile.load("lavapipe"), naive=True))
    assert len(places.plans[-1].stages) == 20 and len(places.images) == 4, "x, y, and two by turns"


def test_the_verifier_of_places_finds_what_overlaps():
    program, lavapipe = random_program(2), Profile.load("lavapipe")
    places = allocate(program, packed(program, lavapipe))
    k, plan = next((k, plan) for k, plan in enumerate(places.plans) if len(plan.stages) > 1)
    first = plan.stages[0]

    def with_stages(*stages):
        return replace(places, plans=(*places.plans[:k], replace(plan, stages=stages), *places.plans[k + 1:]))

    wrong = {"attaches an image twice": with_stages(replace(first, attachments=first.attachments * 2)),
             "may still be written": with_stages(first, replace(first, wait=False)),
             "two values share an image": replace(places, values=dict.fromkeys(places.values, 0))}
    for message, value in wrong.items():
        with pytest.raises(DefectError, match=message):
            check(value, lavapipe)
