"""Functions to substages to stages (paper 3.3.3), under one device profile.

In: the roots of one plan, lowered and simplified. Out: `Stage`s in running order, each a list of `Substage`s: one shader over one extent.

A value must be stored where a reader is not at the same texel: another extent, a fetch, a sampler, the vertex stage. Those reads
cut the graph into levels; all pixelwise work of one extent and one level can be one shader. A node is placed as late as
its readers allow, at a level where a substage of its extent already exists if there is one. Values that are cheap to
recompute from what the reader fetches anyway are recomputed instead of stored. What is apart (`apart.py`) has groups of its own, and a read
from one kind to another cuts, too. Then substages that break a limit are split.
`pack_naive` is the simple twin: one function a substage.
"""
from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

from ...cache.profile import Profile
from ..graph.formats import format_bits
from ..graph.ir import UNIT, Extent, Node, topological
from ..graph.ops import lookup as _lookup  # noqa: F401  (fills the op table)
from ..graph.optable import OWN
from .apart import Apart, find_apart
from .known import Known
from .split import split
from .substage import Stage, Substage, edges, is_alone, is_inline, is_leaf, merged_reads, substage

RECOMPUTE_COST = 24  # work a value may cost to be computed again


def _crosses(x: Node, user: Node, mode: str) -> bool:
    """Whether this read needs x stored in an image."""
    return (mode != OWN or x.extent != user.extent or is_alone(x) or is_alone(user))


def _later(x: Node, user: Node, mode: str, apart: Apart) -> bool:
    """Whether the user is at a later level than x."""
    return not is_leaf(x) and (_crosses(x, user, mode) or apart.tiles.get(x) is not apart.tiles.get(user))


def _levels(order: Sequence[Node], apart: Apart) -> dict[Node, int]:
    """The level of each node; see the module's text."""
    order = apart.ordered(order)
    low: dict[Node, int] = {}
    for n in order:
        low[n] = 0 if is_leaf(n) else max([1] + [low[x] + _later(x, n, m, apart) for x, m in apart.edges(n)])
    top = max(low.values(), default=0)
    high = dict.fromkeys(order, top)
    level: dict[Node, int] = {}
    groups: dict[tuple[Extent, Node | None], set[int]] = {}
    read: set[Node] = set()
    for n in reversed(order):
        if is_leaf(n):
            continue
        kind = n.extent, apart.tiles.get(n)
        existing = [] if is_alone(n) else [g for g in groups.get(kind, ()) if low[n] <= g <= high[n]]
        level[n] = max(existing) if existing else (high[n] if n in read else low[n])
        if not is_alone(n):
            groups.setdefault(kind, set()).add(level[n])
        for x, m in apart.edges(n):
            high[x] = min(high[x], level[n] - _later(x, n, m, apart))
            read.add(x)
    _merge(order, level, apart)
    return level


def _merge(order: Sequence[Node], level: dict[Node, int], apart: Apart) -> None:
    """Move whole groups down to an earlier group of their kind wherever their inputs are there in time."""
    groups: dict[tuple[Extent, Node | None, int], list[Node]] = {}
    for n in order:
        if n in level and not is_alone(n):
            groups.setdefault((n.extent, apart.tiles.get(n), level[n]), []).append(n)
    for extent, tiles, top in sorted(groups, key=lambda key: key[2]):
        members = set(groups[extent, tiles, top])
        ready = max((level.get(x, 0) + _later(x, n, m, apart) for n in members for x, m in apart.edges(n) if x not in members), default=1)
        inner = any(x in members and _crosses(x, n, m) for n in members for x, m in edges(n))
        target = next((k for k in range(max(1, ready), top) if groups.get((extent, tiles, k))), None)
        if target is not None and not inner:
            for n in groups[extent, tiles, top]:
                level[n] = target
            groups[extent, tiles, target] += groups[extent, tiles, top]
            groups[extent, tiles, top] = []


def _groups(order: Sequence[Node], level: dict[Node, int], apart: Apart) -> list[list[Node]]:
    groups: dict[tuple, list[Node]] = {}
    for n in order:
        if not is_leaf(n):
            key = (level[n], 0 if is_alone(n) else 1, n.extent.width, n.extent.height, n.extent.count, n.extent.partial,
                   n.serial if is_alone(n) else 0, apart.tiles.get(n))  # those three tell groups apart and order none
            groups.setdefault(key, []).append(n)
    return [groups[key] for key in sorted(groups, key=lambda key: key[:5])]


def _cone(xs: Sequence[Node], stored: set[Node], reads: set[Node], budget: int) -> list[Node] | None:
    """Nodes to recompute so that none of xs need be stored, or None if storing them is better: too much work, or more new reads than
    the values themselves would be."""
    cone, fetched, cost, stack, seen = [], set(), 0, list(xs), set(xs)
    while stack:
        n = stack.pop()
        cost += n.op.cost
        cone.append(n)
        if cost > budget or n in stored or n.op.loop is not None or n.op.stage != "pixel":
            return None
        for y, mode in edges(n):
            if y in stored or mode != OWN:
                fetched.add(y)
            elif y not in seen:
                seen.add(y)
                stack.append(y)
    new = {y for y in fetched if y not in reads and y.extent != UNIT}
    return None if len(new) > len(xs) else cone


def _ordered(nodes: Iterable[Node], at: Mapping[Node, int]) -> list[Node]:
    """These nodes, inputs first, in an order that follows from the graph alone (`at`: where each stands in it)."""
    members = set(nodes)
    return topological(sorted(members, key=at.__getitem__), members)


def pack_substages(roots: Sequence[Node], profile: Profile) -> list[Substage]:
    """Substages in running order. Raises PackError where one function alone breaks a limit."""
    root_set = {r for r in roots if not is_leaf(r)}
    order = [n for n in topological(roots) if not is_inline(n)]
    at = {n: k for k, n in enumerate(order)}
    apart = find_apart(order, root_set, Known(order))
    level = _levels(order, apart)
    groups = _groups(order, level, apart)
    stored = {n for n in order if is_leaf(n) or n in root_set or is_alone(n)}
    for n in order:
        stored.update(x for x, m in edges(n) if _crosses(x, n, m))
    members: list[list[Node]] = []
    for group in groups:
        inside, tiles = set(group), apart.tiles.get(group[0])
        stored.update(x for n in group for x, _ in edges(n) if apart.tiles.get(x, tiles) is not tiles)  # and not computed everywhere
        reads = {x for n in group for x, m in edges(n) if x not in inside and x in stored}
        wanted = list(dict.fromkeys(x for n in group for x, m in edges(n) if x not in inside and x not in stored))
        extra = _cone(wanted, stored, reads, RECOMPUTE_COST * len(wanted))
        if extra is None:
            extra = []
            for x in wanted:
                cone = None if x in stored else _cone([x], stored, reads, RECOMPUTE_COST)
                if cone is None:
                    stored.add(x)
                    reads.add(x)
                else:
                    extra += cone
        members.append(_ordered([*group, *extra], at) if extra else group)
    read_elsewhere = set(root_set)
    for nodes in members:
        inside = set(nodes)
        read_elsewhere.update(x for n in nodes for x, m in edges(n) if x not in inside or _crosses(x, n, m))
    result = []
    for group, nodes in zip(groups, members):
        own = set(group)
        outputs = [n for n in nodes if n in own and n in read_elsewhere]
        if outputs:
            kernel = nodes[0].op.stage == "kernel"
            result += [substage(nodes, outputs)] if kernel else split(_needed(nodes, outputs), outputs, profile)
    return result


def _needed(nodes, outputs) -> list[Node]:
    """Those nodes that the outputs depend on."""
    inside, keep, stack = set(nodes), set(outputs), list(outputs)
    while stack:
        for x, _ in edges(stack.pop()):
            if x in inside and x not in keep:
                keep.add(x)
                stack.append(x)
    return [n for n in nodes if n in keep]


def pack_naive(roots: Sequence[Node], profile: Profile) -> list[Substage]:
    """The simple twin: every function is a substage of its own."""
    return [substage([n], [n]) for n in topological(roots) if not is_leaf(n) and not is_inline(n)]


def _joins(stage: Sequence[Substage], s: Substage, profile: Profile) -> bool:
    """Whether s may be one more subpass of the stage: the same size, reads of its outputs at the same texel only, and within the
    profile's input attachments and the merge rules of tile-based GPUs (docs/packing.md)."""
    first = stage[0]
    alone = any(is_alone(part.nodes[0]) for part in (s, *stage))
    if alone or (first.extent.width, first.extent.height) != (s.extent.width, s.extent.height):
        return False
    inner = merged_reads(stage, s)
    if not inner or any(x in inner and m != OWN for x, m in s.reads):
        return False
    if len(inner) > profile.limit("maxPerStageDescriptorInputAttachments"):
        return False
    attachments = [n for part in (*stage, s) for n in part.outputs]
    if profile.max_merged_attachments is not None and len(attachments) > profile.max_merged_attachments:
        return False
    return profile.tile_bits is None or sum(map(format_bits, attachments)) <= profile.tile_bits


def pack_stages(substages: Sequence[Substage], profile: Profile) -> list[Stage]:
    """Substages to render passes: each joins the pass before it where it may."""
    stages: list[list[Substage]] = []
    for s in substages:
        if stages and _joins(stages[-1], s, profile):
            stages[-1].append(s)
        else:
            stages.append([s])
    return [Stage(group[0].extent, tuple(group)) for group in stages]


def pack(roots: Sequence[Node], profile: Profile, naive: bool = False, stage_packing: bool = True) -> list[Stage]:
    """Stages in running order for one plan. The simple twins: `naive`, one function a pass; no stage packing, one substage a pass."""
    substages = pack_naive(roots, profile) if naive else pack_substages(roots, profile)
    if naive or not stage_packing:
        return [Stage(s.extent, (s,)) for s in substages]
    return pack_stages(substages, profile)
