"""What no bundle can hold is refused when it is said, in the words of whoever says it, and leaves the program as it was."""

import pytest

from dressi_edge.cache import bundle
from dressi_edge.cache.errors import BundleError, GraphError
from dressi_edge.cache.layout import Layout
from dressi_edge.compiler import Program, compile_program

UNIT = Layout("unit", "float")


@pytest.fixture
def program():
    p = Program()
    x = p.state("x", UNIT, 1.0)
    p.plan("go", {"x": x * 0.5}, {"go.loss": (x * x, UNIT)}, steps=3)
    return p


def same(p):
    return list(p.values), dict(p.roles), list(p.plans)


@pytest.mark.parametrize("add, told", [
    (lambda p, x: p.plan("go", {"x": x}), "plan go: there is a plan of this name; choose another"),
    (lambda p, x: p.plan("n" * 201, {"x": x}), "has 201 characters; a name has 1 to 200"),
    (lambda p, x: p.plan("", {"x": x}), "plan '' has 0 characters"),
    (lambda p, x: p.plan("a\nb", {"x": x}), "plan 'a\\nb' has 3 characters; a name has 1 to 200, none of them a line end"),
    (lambda p, x: p.plan("a\x85b", {"x": x}), "a name has 1 to 200"),
    (lambda p, x: p.plan("\udc00", {"x": x}), "a name has 1 to 200"),
    (lambda p, x: p.plan(7, {"x": x}), "plan 7: a name is a text"),
    (lambda p, x: p.plan("y", {"x": x}, group="\0"), "group '\\x00' has 1 characters"),
    (lambda p, x: p.plan("y", {"x": x}, steps=-3), "plan y: steps is -3; a whole number from 0"),
    (lambda p, x: p.plan("y", {"x": x}, steps=2.5), "plan y: steps is 2.5; a whole number"),
    (lambda p, x: p.plan("y", {"x": x}, steps=True), "plan y: steps is True; a whole number"),
    (lambda p, x: p.plan("y", {"x": x}, steps=1 << 41), "plan y: steps is 2199023255552; a whole number"),
    (lambda p, x: p.plan("go.prepare", {"x": x}), "plan go.prepare: names that end in .prepare are the compiler's"),
    (lambda p, x: p.plan("go.enter2", {"x": x}), "are the compiler's; choose another"),
    (lambda p, x: p.plan("go.leave", {"x": x}), "are the compiler's; choose another"),
    (lambda p, x: p.plan("y"), "plan y updates nothing and gives nothing out"),
    (lambda p, x: p.plan("y", {}, {"a": (x, UNIT), "b" * 201: (x, UNIT)}), "output 'bbb"),
    (lambda p, x: p.plan("y", {}, {"a": (x, UNIT), "x": (x, UNIT)}), "output x: the name is taken by state"),
    (lambda p, x: p.plan("walk", {"x": x}, {"walk.loss": (p.state("v", Layout("unit", "vec2")), Layout("unit", "vec2"))}),
     "walk.loss is the loss of phase walk, which is one float"),
    (lambda p, x: p.state("\t", UNIT), "state '\\t' has 1 characters"),
    (lambda p, x: p.input("i" * 300, UNIT), "has 300 characters"),
    (lambda p, x: p.state("go.list.x", UNIT), "names with .list. in them are the compiler's"),
    (lambda p, x: p.state("x", UNIT), "state x: the name is taken by state"),
    (lambda p, x: p.input("wide", Layout("image", "float", 70000, 1)), "input wide needs an image of 70000 x 1; at most 65536"),
    (lambda p, x: p.input("none", Layout("image", "float", 0, 4)), "input none: its layout has width 0; a whole number above 0"),
    (lambda p, x: p.input("half", Layout("table", "float", count=1.5)), "its layout has count 1.5; a whole number above 0"),
])
def test_what_no_bundle_can_hold_is_refused_when_it_is_said(program, add, told):
    x, before = program.values["x"].node, same(program)
    with pytest.raises(GraphError) as error:
        add(program, x)
    assert told in str(error.value) and "\n" not in str(error.value)
    program.values.pop("v", None)
    program.roles.pop("v", None)
    assert same(program) == before


def test_a_loss_may_not_be_something_else_before_its_phase_is_there(program):
    x = program.values["x"].node
    wide = program.input("wide", Layout("unit", "vec2"), 0.0)
    program.plan("show", {}, {"walk.loss": (wide, Layout("unit", "vec2"))})
    with pytest.raises(GraphError, match="walk.loss is the loss of phase walk"):
        program.plan("walk", {"x": x * 0.5})
    program.plan("other", {"x": x * 0.5})


def test_a_program_without_a_plan_is_refused(tmp_path):
    with pytest.raises(GraphError, match="the program has no plan; add one with Program.plan"):
        compile_program(Program(), "lavapipe", tmp_path / "x.dressi")
    assert list(tmp_path.iterdir()) == []


def test_names_of_all_kinds_are_written_and_read_back(tmp_path):
    p = Program()
    x = p.state("Äpfel & π", UNIT, 1.0)
    p.plan("a" * 200, {"Äpfel & π": x * 0.5}, steps=1 << 40)
    p.plan("listed.prepared", {"Äpfel & π": x * 0.25})
    compile_program(p, "lavapipe", tmp_path / "x.dressi")
    assert [plan["name"] for plan in bundle.read(tmp_path / "x.dressi").description["plans"]] == ["a" * 200, "listed.prepared"]


def test_what_a_reader_refuses_is_never_put_in_place(program, tmp_path, monkeypatch):
    """Whatever the compiler makes: the very bytes are read back, and the file that was there stays."""
    path = tmp_path / "x.dressi"
    compile_program(program, "lavapipe", path)
    before, real = path.read_bytes(), bundle.dumps

    def spoiled(description, blobs, version=None):
        return real({**description, "samplers": [1]}, blobs, version)

    monkeypatch.setattr(bundle, "dumps", spoiled)
    with pytest.raises(BundleError, match="x.dressi: not written, for every reader would refuse it: samplers.0. is 1; allowed: 0 2"):
        compile_program(program, "lavapipe", path)
    program.meta["time"] = {1: 2}
    monkeypatch.setattr(bundle, "dumps", real)
    with pytest.raises(BundleError, match="meta has a map with a key that is no text"):
        compile_program(program, "lavapipe", path)
    assert path.read_bytes() == before and list(tmp_path.iterdir()) == [path]
