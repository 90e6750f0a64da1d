"""Which texels of a substage are drawn, what is in the others, and that leaving texels out changes no bit."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from graphs import Graph

from dressi_edge import runtime
from dressi_edge.cache.errors import PackError
from dressi_edge.cache.layout import Layout
from dressi_edge.cache.profile import Profile
from dressi_edge.compiler import Options, Program, build, passes
from dressi_edge.compiler.backend.check import DefectError, check
from dressi_edge.compiler.graph.functions import apply, select, sigmoid
from dressi_edge.compiler.io.cameras import orbit
from dressi_edge.compiler.io.shapes import icosphere
from dressi_edge.compiler.passes.domains import find_domains
from dressi_edge.compiler.passes.groups import grouped, lowered
from dressi_edge.compiler.passes.pack import pack
from dressi_edge.compiler.passes.plans import LEAVE, PackedPlan, PlanGraph, plan_graphs, stored
from dressi_edge.compiler.passes.substage import FULL, KEPT, LISTED, TEXELS, TILES
from dressi_edge.compiler.scene import Adam, Loss, Problem, Softness

pytest_plugins = ["gpu"]

LAVAPIPE = Profile.load("lavapipe")
IMAGE = Layout("image", "float", 32, 32)


def kinds(built):
    return {s.domain.kind for stages in built.stages.values() for stage in stages for s in stage.substages}


def problem(albedo, softness):
    ball = icosphere(1, 0.6)
    made = Problem(replace(ball, colors=np.tile([0.8, 0.3, 0.2], (len(ball.positions), 1))), orbit(2, (20.0, -15.0), 3.0, 42.0, (40, 33)),
                   albedo=albedo)
    losses = [Loss("silhouette"), *([Loss("color")] if albedo == "colors" else [])]
    made.phase("fit", 3, {"vertices": Adam(0.01)}, losses, softness)
    return made


@pytest.mark.parametrize("albedo, softness", [("constant", Softness(2.0)), ("colors", Softness(2.0)), ("colors", Softness(2.0, layers=3))],
                         ids=["silhouette", "colours", "layers"])
def test_what_is_not_drawn_changes_no_bit(gpu, albedo, softness):
    made = problem(albedo, softness)
    assert {TILES, LISTED} <= kinds(build(made.program, LAVAPIPE)) - {FULL}
    assert kinds(build(made.program, LAVAPIPE, Options(domains=False))) == {FULL}
    targets = np.zeros((2, 33, 40, 4), np.float32)
    targets[:, 8:25, 10:22] = 0.5, 0.4, 0.3, 1.0
    found = []
    for domains in (True, False):
        with runtime.load(gpu.compile(made.program, domains=domains), gpu.device) as session:
            session.set("targets", targets)
            session.step(2)
            found.append((session.get("vertices").tobytes(), session.loss()))
    gpu.silent()
    assert found[0] == found[1]


def guarded(least=False):
    """A plan of which one int leaves out all work where it is zero."""
    program = Program()
    where, x = program.input("where", Layout("image", "int", 32, 32)), program.input("x", IMAGE)
    y = x
    for _ in range(1 if least else 30):
        y = sigmoid(y * 2.0)
    program.plan("all", {}, {"y": (select(where, y, 0.0), IMAGE)})
    return program


def only_substage(program, **options):
    stage, = build(program, LAVAPIPE, Options(cache=False, **options)).stages["all"]
    return stage.substages[0]


def test_a_guard_is_an_int_under_which_all_is_constant():
    domain = only_substage(guarded()).domain
    assert (domain.kind, domain.by.name, domain.outside) == (TEXELS, "where", (0,))
    assert only_substage(guarded(), domains=False).domain.kind == FULL
    assert only_substage(guarded(least=True)).domain.kind == FULL, "too little work to test for it"


def plan_of(root, leaf, kind):
    plan = PlanGraph("back", kind, (root,), (leaf,), (leaf.attrs["name"],))
    return plan, pack(plan.roots, LAVAPIPE)


def test_what_is_put_back_in_place_keeps_the_rest_or_is_an_error():
    program = Program()
    state, where = program.state("s", IMAGE), program.input("where", Layout("image", "int", 32, 32))
    plan, stages = plan_of(select(where, apply("sin", state), 0.0), state, LEAVE)
    stage, = find_domains(plan, stages)
    assert stage.substages[0].domain.outside == (KEPT,) and stage.substages[0].domain.by is where
    for guards in (True, False):  # it is no choice here
        plan, stages = plan_of(apply("sin", state) + 1.0, state, LEAVE)
        with pytest.raises(PackError, match="plan back: nothing says which texels of add.* were copied"):
            find_domains(plan, stages, guards)


# The verifiers


def levels():
    graph = Graph(3, 40)
    graph.plan()
    groups = lowered(grouped(graph.program))
    graphs = tuple(stored(plan, graph.program) for plan in plan_graphs(groups, graph.program))
    packed = tuple(PackedPlan(plan, find_domains(plan, pack(plan.roots, LAVAPIPE))) for plan in graphs)
    return groups, graphs, packed


def test_the_verifiers_take_what_the_passes_give_and_nothing_else():
    groups, graphs, packed = levels()
    for value in (groups, graphs, packed):
        check(value, LAVAPIPE)
    last = packed[-1]
    k, s = next((k, stage.substages[0]) for k, stage in enumerate(last.stages) if stage.substages[0].domain.kind == FULL)

    def with_substage(**changes):
        stages = list(last.stages)
        stages[k] = replace(stages[k], substages=(replace(s, **changes),))
        return (*packed[:-1], replace(last, stages=tuple(stages)))

    wrong = {
        "two plans are named": (*graphs, graphs[-1]),
        "needs .*of which before it": (*graphs[:-1], replace(graphs[-1], needs=(graphs[-1].name,))),
        "has 0 roots for": (*graphs[:-1], replace(graphs[-1], roots=())),
        "leaves what no plan before it enters": (*graphs[:-1], replace(graphs[-1], kind=LEAVE, updates=graphs[-1].outputs, outputs=())),
        "and updates": (*graphs[:-1], replace(graphs[-1], updates=graphs[-1].outputs)),
        "roots$|has . roots|has .. roots": (replace(groups[0], roots=tuple(roots[1:] for roots in groups[0].roots)), *groups[1:]),
        "reads what is not written before it": (*packed[:-1], replace(last, stages=last.stages[::-1])),
        "does not compute all of its roots": (*packed[:-1], replace(last, stages=())),
        "no word of what some outputs are": with_substage(domain=replace(s.domain, outside=())),
        "is to keep what it does not write": with_substage(domain=replace(s.domain, outside=(KEPT,) * len(s.outputs))),
        "is cleared to": with_substage(domain=replace(s.domain, outside=(7,) * len(s.outputs))),
        "has a domain tiles by None": with_substage(domain=replace(s.domain, kind=TILES)),
        "is drawn as a list and is none": with_substage(domain=replace(s.domain, kind=LISTED, by=s.nodes[0])),
        "needs .* maxColorAttachments": with_substage(outputs=s.outputs[:1] * 9, domain=replace(s.domain, outside=(None,) * 9)),
    }
    for message, value in wrong.items():
        with pytest.raises(DefectError, match=message):
            check(value, LAVAPIPE)


def test_no_pass_but_simplify_names_an_op():
    for path in (Path(passes.__file__).parent).glob("*.py"):
        named = re.findall(r"op\.name (?:==|!=|in|not in) .*|op\.name\.\w+\(.*", path.read_text(encoding="utf-8"))
        assert path.name == "simplify.py" or not named, f"{path.name}: {named}; a fact of the op table is wanted"
