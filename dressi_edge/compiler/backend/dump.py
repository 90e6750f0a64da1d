"""What every pass of the compiler gave, as text: for DRESSI_DEBUG, DRESSI_DUMP and the goldens of the tests.

In: a value of any level. Out: text in which nodes have local numbers in order of use, so that it depends on the graph alone; counts on
stderr; files.
"""
from __future__ import annotations

import os
import sys
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import singledispatch
from pathlib import Path

from ...cache.errors import InputError
from ...cache.summary import dot
from ...cache.summary import text as summary
from ...cache.vulkan import FORMAT_NAMES
from ..graph.ir import Extent, Node, topological
from ..graph.program import PlanSpec, Program
from ..passes.groups import Group, grouped
from ..passes.plans import PackedPlan, PlanGraph
from ..passes.substage import FULL, TILES, Domain
from .allocate import Allocation


class Names:
    """Leaves by their own names, literals by value, all else by number in order of first use."""

    def __init__(self):
        self.numbers: dict[Node, int] = {}

    def of(self, n: Node) -> str:
        if n.op.stage == "inline":
            return str(n.attrs["value"])
        return n.attrs.get("name") or f"%{self.numbers.setdefault(n, len(self.numbers))}"

    def line(self, n: Node) -> str:
        """Its name, op, inputs, attributes, type and extent."""
        attrs = [f"{key}={_attribute(x)}" for key, x in n.attrs.items() if key not in ("name", "vtype", "extent")]
        return f"{self.of(n)} = " + " ".join([n.op.name, *map(self.of, n.inputs), *attrs]) + f": {n.vtype} {_extent(n.extent)}"


def _attribute(x) -> str:
    return str(x).replace(" ", "")


def _extent(e: Extent) -> str:
    return f"{e} of a list" if e.partial else str(e)


def _lines(names: Names, nodes: Iterable[Node]) -> list[str]:
    return [f"  {names.line(n)}" for n in nodes if n.op.stage != "inline"]


@singledispatch
def text(value) -> str:
    """A value of any level."""
    return "\n".join(map(text, value))


@text.register
def _program(program: Program) -> str:
    return text(grouped(program))


@text.register
def _group(group: Group) -> str:
    names, lines = Names(), [f"group {group.name}"]
    given = [root for spec, roots in zip(group.specs, group.roots) for root in roots[len(spec.updates):]]
    forward = topological(given)
    seen = set(forward)
    lines += _lines(names, forward)
    if back := [n for n in topological(root for roots in group.roots for root in roots) if n not in seen]:
        lines += ["  for updates alone: gradients, and what is made of them", *_lines(names, back)]
    for x in group.lists:
        lines.append(f"  list {x.number} of {_extent(x.extent)}: total {names.of(x.total)}")
        lines += _lines(names, (n for n in topological((*x.enter.values(), *x.leave.values())) if n not in seen))
        lines += [f"    enter {leaf.attrs['name']} = {names.of(n)}" for leaf, n in x.enter.items()]
        lines += [f"    leave {name} = {names.of(n)}" for name, n in x.leave.items()]
    for spec, roots in zip(group.specs, group.roots):
        lines.append(f"  plan {spec.name}, between whose runs change: {' '.join(sorted(spec.dynamic)) or 'nothing'}")
        lines += [f"    {what} {name} = {names.of(root)}" for (what, name), root in zip(_of_spec(spec), roots)]
    return "\n".join(lines) + "\n"


def _of_spec(spec: PlanSpec) -> list[tuple[str, str]]:
    return [*(("update", name) for name in spec.updates), *(("output", name) for name in spec.outputs)]


def _head(plan: PlanGraph) -> str:
    return f"plan {plan.name} ({plan.kind})" + (f", needs {' '.join(plan.needs)}" if plan.needs else "")


@text.register
def _plan(plan: PlanGraph) -> str:
    names, lines = Names(), [_head(plan)]
    lines += _lines(names, topological(plan.roots))
    lines += [f"  {'output ' + x if isinstance(x, str) else x.attrs['name']} = {names.of(root)}"
              for x, root in zip(plan.targets, plan.roots)]
    return "\n".join(lines) + "\n"


@text.register
def _packed(plan: PackedPlan) -> str:
    names, lines = Names(), [_head(plan.graph)]
    for k, stage in enumerate(plan.stages):
        for j, s in enumerate(stage.substages):
            lines += [f"  stage {k} substage {j}: {_extent(s.extent)}{_domain(s.domain, names)}{', compute' if s.compute else ''}",
                      "    reads " + (" ".join(f"{names.of(x)}:{mode}" for x, mode in s.reads) or "nothing"),
                      *(f"  {line}" for line in _lines(names, s.nodes)),
                      "    writes " + " ".join(_output(n, outside, names) for n, outside in zip(s.outputs, s.domain.outside))]
    return "\n".join(lines) + "\n"


def _domain(domain: Domain, names: Names) -> str:
    if domain.kind == FULL:
        return ""
    tile = f" of {domain.tile[0]}x{domain.tile[1]}" if domain.kind == TILES else ""
    return f", {domain.kind}{tile} by {names.of(domain.by)}"


def _output(n: Node, outside: int | str | None, names: Names) -> str:
    return f"{names.of(n)}" + ("" if outside is None else f" (else {outside})")


@text.register
def _allocation(places: Allocation) -> str:
    values = {image: name for name, image in places.values.items()}
    lines = []
    for k, image in enumerate(places.images):
        what = values.get(k) or (f"constant {image.data.vtype}" if image.data is not None else "")
        lines.append(f"image {k}: {FORMAT_NAMES.get(image.format, 'depth')} {image.width} x {image.height}"
                     + (" twice" if image.slots == 2 else "") + (f" {what}" if what else ""))
    for p, plan in enumerate(places.plans):
        lines.append(f"plan {p}")
        for k, stage in enumerate(plan.stages):
            attached = " ".join(f"{ref // 2}{'+' * (ref % 2)}" for ref in stage.attachments)
            lines.append(f"  stage {k}{' waits,' if stage.wait else ''} attached {attached}"
                         + (f", depth {stage.depth // 2}" if stage.depth >= 0 else ""))
    return "\n".join(lines) + "\n"


@text.register
def _description(description: dict) -> str:
    return summary(description)


def glsl(shaders: Sequence[tuple[str, str]]) -> str:
    return "\n".join(f"// shader {k} ({stage})\n{source}" for k, (stage, source) in enumerate(shaders))


def shown(name: str, value) -> str:
    """What the pass of this name gave."""
    return glsl(value) if name == "shaders" else text(value)


def functions(plan: PackedPlan) -> int:
    """How many functions (nodes of the graph, each counted once) its stages hold."""
    return len({node for stage in plan.stages for s in stage.substages for node in s.nodes})


def holds(plan: PackedPlan) -> list[str]:
    """Of each substage in order, which ops it holds, the most frequent first: "multiply*12 add*9 dot"."""
    told = []
    for stage in plan.stages:
        for s in stage.substages:
            counts = Counter(node.op.name for node in s.nodes if node.op.stage != "inline")
            told.append(" ".join(name if n == 1 else f"{name}*{n}" for name, n in sorted(counts.items(), key=lambda x: (-x[1], x[0]))))
    return told


# What DRESSI_DEBUG prints, by the least level that asks for it.
_LEVELS = {"described": 1, "packed": 2, "shaders": 3}


def nowhere(name: str, value) -> None:
    """Where what passes give is shown by default."""


def watcher(variant: str = "") -> Callable[[str, object], None]:
    """Where $DRESSI_DEBUG (1 a summary, 2 the substages, 3 the GLSL, on stderr) and $DRESSI_DUMP (a folder for files of everything, one in
    it for each of several variants) want to see it: a function of the name of a pass and what it gave."""
    level, folder = os.environ.get("DRESSI_DEBUG", ""), os.environ.get("DRESSI_DUMP")
    level, count = int(level) if level.isdecimal() else 0, 0

    def see(name: str, value) -> None:
        nonlocal count
        if level >= _LEVELS.get(name, level + 1):
            sys.stderr.write(shown(name, value))
        if folder:
            files = {f"{count:02}-{name}.txt": shown(name, value)}
            if name == "shaders":
                files |= {f"shader{k:03}.{stage}": source for k, (stage, source) in enumerate(value)}
            if isinstance(value, Mapping):
                files["stages.dot"] = dot(value)
            _write(folder, variant, files)
            count += 1
    return see


def _write(folder: str, variant: str, files: Mapping[str, str]) -> None:
    try:
        path = Path(folder, variant)
        path.mkdir(parents=True, exist_ok=True)
        for name, content in files.items():
            (path / name).write_text(content, encoding="utf-8")
    except OSError as error:
        raise InputError(f"DRESSI_DUMP={folder}: cannot be written: {error.strerror}; name a folder that can be, or unset it") from None
