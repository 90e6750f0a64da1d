"""Compaction: the entries that are set, as a dense list in ascending order, without atomics and without the host.

A tree of counts over chunks of 64 entries is summed upwards; each slot of the list then descends it. The last texel of the running
counts is the number of vertices to draw for all slots: draws over a list take it from there (`Draw.count`). What is computed for each
slot of a list is drawn only as far as there are entries.
"""
from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ....cache.errors import GraphError
from ..ir import UNIT, Extent, Node, table
from ..optable import Loop, apply, op
from .lookup import constant_table, lookup

CHUNK = 64


def _chunks(x: Node, chunk: int = CHUNK) -> tuple[str, Extent]:
    return "int", table(-(-x.extent.count // chunk))


def _as_table(values: np.ndarray, count: int) -> np.ndarray:
    """(n, channels), the first `count` of them in a table's image, zeros after."""
    extent = table(count)
    out = np.zeros((extent.width * extent.height, values.shape[1]), np.int64)
    out[:count] = values[:count]
    return out.reshape(extent.height, extent.width, -1)


def _counts_ref(flags, count, chunk):
    entries = flags.reshape(-1)[:count]
    starts = np.arange(0, len(entries), chunk)
    return _as_table(np.add.reduceat(entries, starts)[:, None], len(starts))


def _running_ref(counts, count, each):
    entries = np.cumsum(counts.reshape(-1)[:count])
    ends = np.minimum(np.arange(CHUNK, len(entries) + CHUNK, CHUNK), len(entries)) - 1
    chunks, extent = entries[ends] * each, table(len(ends))
    padded = np.concatenate([chunks, np.full(extent.width * extent.height - len(chunks), chunks[-1])])
    return padded.reshape(extent.height, extent.width, 1)


def _chunks_infer(name, inputs, attrs):
    if not 0 < attrs["count"] <= inputs[0].extent.count:
        raise GraphError(f"{name}: count is {attrs['count']}; {inputs[0]!r} has {inputs[0].extent.count} entries")
    return _chunks(*inputs, attrs.get("chunk", CHUNK))


op("chunk_counts", "flags", infer=_chunks_infer, reads="texel", ref=_counts_ref, cost=64,
   loop=Loop("for (int k_ = {i} * {chunk}; k_ < min({i} * {chunk} + {chunk}, {count}); ++k_) {", "{y} += {flags_at}(k_);"),
   sample=lambda rng: ([rng.integers(0, 2, (30, 9, 1))], {"count": 268, "chunk": 64}),
   doc="Sums over chunks of so many entries, the first `count` of them.")
op("running_counts", "counts", infer=_chunks_infer, reads="texel", ref=_running_ref, cost=500,
   loop=Loop(f"for (int k_ = 0; k_ < min({{i}} * {CHUNK} + {CHUNK}, {{count}}); ++k_) {{", "{y} += {counts_at}(k_) * {each};"),
   sample=lambda rng: ([rng.integers(0, 2, (30, 9, 1))], {"count": 268, "each": 3}),
   doc="`each` times the sum of all entries up to the end of each chunk of 64; the last texel has the total.")


def _first_ref(running, total, each, extent):
    ends = running.reshape(-1) // each
    slot = np.arange(extent.width * extent.height)
    chunk = np.searchsorted(ends, slot, side="right")
    start = np.concatenate([[0], ends])[np.minimum(chunk, len(ends))]
    out = np.where((slot < ends[-1])[:, None], np.stack([chunk, slot - start], 1), (-1, 0))
    return out.reshape(extent.height, extent.width, 2)


def _descend_ref(counts, at, count):
    entries = counts.reshape(-1)[:count]
    ends = np.cumsum(entries)
    start = (ends - entries)[np.minimum(np.maximum(at[..., 0], 0) * CHUNK, len(entries) - 1)]
    child = np.searchsorted(ends, start + at[..., 1], side="right")
    rest = start + at[..., 1] - (ends - entries)[np.minimum(child, len(entries) - 1)]
    return np.where(at[..., :1] < 0, (-1, 0), np.stack([child, rest], -1))


op("first_chunk", "running total", infer=lambda name, inputs, attrs: ("ivec2", attrs["extent"]), reads="texel count", ref=_first_ref,
   cost=64,
   glsl="""{y} = ivec2(-1, 0);
{ int s_ = {i} * {each}, end_ = s_ < {running}(ivec2({running_w} - 1, {running_h} - 1)) ? {running_n} : 0, before_ = 0, k_ = 0;
  for (; k_ < end_; ++k_) { int c_ = {running_at}(k_); if (s_ < c_) break; before_ = c_; }
  if (end_ > 0) {y} = ivec2(k_, (s_ - before_) / {each}); }""",
   sample=lambda rng: ([np.array([0, 9, 9, 21, 33, 33])[None, :, None], np.array([[[11]]])], {"each": 3, "extent": table(13)}),
   doc="For each slot of a list the chunk that holds its entry, and which set entry of that chunk it is; -1 after the last. What has the "
       "extent of a list is drawn for as many entries as the last texel of `total` says.")
def _descend_infer(name, inputs, attrs):
    _chunks_infer(name, inputs[:1], attrs)
    return "ivec2", inputs[1].extent


op("descend", "counts at", infer=_descend_infer, reads="texel own", ref=_descend_ref, cost=64,
   glsl=f"""{{ int k_ = {{at}}.x * {CHUNK}, end_ = {{at}}.x < 0 ? k_ : min(k_ + {CHUNK}, {{count}}), rest_ = {{at}}.y;
  for (; k_ < end_; ++k_) {{ int c_ = {{counts_at}}(k_); if (rest_ < c_) break; rest_ -= c_; }}
  {{y}} = {{at}}.x < 0 ? ivec2(-1, 0) : ivec2(k_, rest_); }}""",
   sample=lambda rng: ([np.tile([0, 2, 0, 1, 0, 0, 3, 1], 10)[None, :, None], np.array([[0, 0], [0, 5], [1, 1], [-1, 0]])[None]],
                       {"count": 80}),
   doc="One level down the tree of counts: from a chunk and a number within it to the child and the number within that.")


def _groups_ref(by, each, most):
    return np.array([[[np.clip(-(-by.reshape(-1)[-1] // each), 0, most)]]])


op("group_count", "by", attrs="each most", infer=lambda name, inputs, attrs: ("int", UNIT), reads="texel", ref=_groups_ref, cost=4,
   sample=lambda rng: ([np.array([3, 9, 700])[None, :, None]], {"each": 64, "most": 20}),
   glsl="{y} = clamp(({by}(ivec2({by_w} - 1, {by_h} - 1)) + {each} - 1) / {each}, 0, {most});",
   doc="How many workgroups of `each` invocations go through a list, as long as the last texel of `by` says; at most `most`.")


def _slot_ref(flags, entries, running, each, most=None):
    count = running.reshape(-1)[-1] // each
    own = np.arange(flags.size)
    slot = np.searchsorted(entries.reshape(-1)[:count], own)
    return np.where(flags.reshape(-1) != 0, slot, -1).reshape(flags.shape)


def _slot_infer(name, inputs, attrs):
    flags, entries, _ = inputs
    if entries.extent.count < min(attrs.get("most", flags.extent.count), flags.extent.count):
        raise GraphError(f"{name}: the list {entries!r} has no room for all of {flags!r}")
    return "int", flags.extent


op("slot_of", "flags entries running", infer=_slot_infer, reads="own texel texel",
   ref=_slot_ref, cost=16,
   glsl="""{ int low_ = 0, high_ = {flags} != 0 ? {running}(ivec2({running_w} - 1, {running_h} - 1)) / {each} : 0;
  while (low_ < high_) { int mid_ = (low_ + high_) >> 1; if ({entries_at}(mid_) < {i}) low_ = mid_ + 1; else high_ = mid_; }
  {y} = {flags} != 0 ? low_ : -1; }""",
   sample=lambda rng: ([np.array([0, 1, 1, 0, 0, 1, 0, 1]).reshape(2, 4, 1), np.array([1, 2, 5, 7, -1, -1, -1, -1]).reshape(2, 4, 1),
                        np.array([[[12]]])], {"each": 3}),
   doc="Where each set entry stands in the list (by bisection), of which there are at most so many; -1 for the others.")


@dataclass(frozen=True)
class Compact:
    """A list of set entries: `entries` (a table as long as all could be; after the last -1, or undefined where no draw reads them),
    `total` (its last texel: how many there are), `running` (its last texel: `each` times as many), `slots` (of each entry, its place in
    the list or -1)."""

    flags: Node
    entries: Node
    running: Node
    total: Node
    each: int

    @property
    def slots(self) -> Node:
        """Of each entry its place in the list, or -1."""
        room, all_ = self.entries.extent.count, self.flags.extent.count
        return apply("slot_of", self.flags, self.entries, self.running, each=self.each, **({"most": room} if room < all_ else {}))

    def lookup(self, values: Node, names: np.ndarray) -> Node:
        """`values[names[entry]]` for each entry of the list; zero after the last. names: for each entry there could be one of a table."""
        every = constant_table(names)
        index = apply("select", self.entries >= 0, lookup(every, self.entries), -1)
        return apply("lookup_listed", values, index, every, self.slots)


def _counts(flags: Node, chunk: int = CHUNK) -> Node:
    return apply("chunk_counts", flags, count=flags.extent.count, chunk=chunk)


def count_set(flags: Node) -> Node:
    """How many entries of a table are 1, the others being 0; 1 x 1."""
    counts = _counts(flags)
    while counts.extent.count > CHUNK * CHUNK:
        counts = _counts(counts)
    return _counts(counts, CHUNK * CHUNK)


def compact(flags: Node, each: int, extent: Extent | None = None) -> Compact:
    """The list of the entries of an int table or image that are 1 (the others 0), a table unless `extent` says how it lies; a draw has
    `each` vertices an entry. An extent with room for fewer than all says that no more are ever set."""
    extent = replace(extent or table(flags.extent.count), partial=flags.serial)
    levels = [flags]
    while levels[-1].extent.count > CHUNK * CHUNK:
        levels.append(_counts(levels[-1]))
    running = apply("running_counts", levels[-1], count=levels[-1].extent.count, each=each)
    total = apply("idiv", running, each)
    found = apply("first_chunk", running, total, each=each, extent=extent)
    for counts in reversed(levels):
        found = apply("descend", counts, found, count=counts.extent.count)
    return Compact(flags, found.x, running, total, each)
