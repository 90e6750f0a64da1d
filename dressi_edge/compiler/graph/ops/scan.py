"""Counting and running sums of whole numbers: `bincount` and `exclusive_scan`, each with and without shared memory.

Where a profile computes (`passes/compute.py`), workgroups share what they add up: a scan sums chunks of 1024 entries, scans those sums and
goes over the chunks again, each up and down a tree (Blelloch 1990), so that it adds twice as often as there are entries, not log n times;
a count adds to bins atomically, in the workgroup's memory where they fit. Elsewhere a scan goes up and down a tree of chunks of 64,
and a count sorts the entries and finds each bin's begin and end. Sums of integers are the same in any order, so all of them give the
same bits; they wrap around beyond 32 bits.
"""
from __future__ import annotations

import numpy as np

from ....cache.errors import GraphError
from ..ir import Node, is_int, table
from ..optable import Kernel, apply, op
from .compact import CHUNK
from .lookup import constant, constant_table, to_table
from .texture_sort import LAST

SMALL_CHUNK = 16  # of many entries: each reads those before it in its chunk
LANES, EACH = 64, 16  # invocations of a workgroup, entries of each
SHARED_CHUNK = LANES * EACH
COUNTED = 64 * LANES  # entries that a workgroup counts
SHARED_BINS = 2048  # 8 KB: half of what every device has
MAX_ENTRIES = 1 << 24


def _entries(name: str, x: Node) -> None:
    if x.vtype != "int" or x.extent.count > MAX_ENTRIES:
        raise GraphError(f"{name}: an int table or image of at most {MAX_ENTRIES} entries is needed, got {x!r}")


# ---- running sums

def _wrapped(x: np.ndarray) -> np.ndarray:
    return (np.asarray(x, np.int64) + 2 ** 31) % 2 ** 32 - 2 ** 31


def _scan_ref(x, count):
    out = np.zeros(x.size, np.int64)
    entries = x.reshape(-1)[:count]
    out[:count] = _wrapped(np.cumsum(entries) - entries)
    return out.reshape(x.shape)


def _scan_infer(name, inputs, attrs):
    _entries(name, inputs[0])
    if not 0 < attrs["count"] <= inputs[0].extent.count:
        raise GraphError(f"{name}: count is {attrs['count']}; {inputs[0]!r} has {inputs[0].extent.count} entries")
    return "int", inputs[0].extent


def _lower_scan(x: Node, count: int, room: int | None) -> Node:
    """Chunk sums up, starts down, by kernels where workgroups have `room` for them."""
    shared = room is not None and room >= 4 * LANES
    chunk = SHARED_CHUNK if shared else CHUNK if count <= CHUNK * CHUNK else SMALL_CHUNK
    if count <= chunk:
        starts = constant_table(np.zeros(1, int))
    elif shared:
        sums = apply("sum_chunks_shared", x, count=count)
        starts = _lower_scan(sums, sums.extent.count, room)
    else:
        sums = apply("chunk_counts", x, count=count, chunk=chunk)
        starts = _lower_scan(sums, sums.extent.count, room)
    return apply("scan_chunks_shared", x, starts, count=count) if shared else apply("scan_chunks", x, starts, count=count, chunk=chunk)


def _part_ref(x, starts, count, chunk=SHARED_CHUNK):
    out = np.zeros(x.size, np.int64)
    flat = x.reshape(-1)[:count]
    for k in range(0, count, chunk):
        part = flat[k:k + chunk]
        out[k:k + chunk][:len(part)] = _wrapped(starts.reshape(-1)[k // chunk] + np.cumsum(part) - part)
    return out.reshape(x.shape)


def _part_infer(name, inputs, attrs):
    x, starts = inputs
    chunk = attrs.get("chunk", SHARED_CHUNK)
    if not 0 < attrs["count"] <= x.extent.count or starts.extent.count < -(-attrs["count"] // chunk):
        raise GraphError(f"{name}: {attrs['count']} entries of {x!r} in chunks of {chunk} do not fit the starts {starts!r}")
    return "int", x.extent


op("scan_chunks", "x starts", infer=_part_infer, reads="texel texel", ref=_part_ref, attrs="count chunk", cost=40,
   glsl="""{y} = 0;
if ({i} < {count}) {y} = {starts_at}({i} / {chunk});
for (int k_ = {i} < {count} ? {i} - {i} % {chunk} : {i}; k_ < {i}; ++k_) {y} += {x_at}(k_);""",
   sample=lambda rng: ([rng.integers(0, 9, (7, 5, 1)), rng.integers(0, 100, (5, 1, 1))], {"chunk": 8, "count": 33}),
   doc="For each entry the start of its chunk plus the sum of the entries before it in the chunk; 0 from `count` on.")

# Entries are read again when they are needed again: sixteen of them over two trees are too many for small register files.
_ENTRY = "first_ + k_ < {count} ? {x_at}(first_ + k_) : 0"
_OWN = f"""int first_ = (group_ * {LANES} + lane_) * {EACH}, sum_ = 0;
for (int k_ = 0; k_ < {EACH}; ++k_) sum_ += {_ENTRY};
part_[lane_] = sum_;
barrier();
"""
# Up the tree: the last part of 2, 4, 8 .. neighbours becomes their sum.
_UP = f"""for (int step_ = 1; step_ < {LANES}; step_ <<= 1) {{
    int at_ = (lane_ + 1) * 2 * step_ - 1;
    if (at_ < {LANES}) part_[at_] += part_[at_ - step_];
    barrier();
}}
"""
# And down again: the left half begins where both do, the right half after the left one.
_DOWN = f"""if (lane_ == 0) part_[{LANES - 1}] = 0;
barrier();
for (int step_ = {LANES // 2}; step_ > 0; step_ >>= 1) {{
    int at_ = (lane_ + 1) * 2 * step_ - 1;
    if (at_ < {LANES}) {{ int left_ = part_[at_ - step_]; part_[at_ - step_] = part_[at_]; part_[at_] += left_; }}
    barrier();
}}
"""
_SHARED = f"shared int part_[{LANES}];"


def _whole(node: Node) -> int:
    """Entries of the image, padding included."""
    return node.extent.width * node.extent.height


def _sums_ref(x, count):
    flat = x.reshape(-1)[:count]
    return to_table(_wrapped(np.add.reduceat(flat, np.arange(0, count, SHARED_CHUNK))))


op("sum_chunks_shared", "x", stage="kernel", reads="texel", attrs="count", ref=_sums_ref, cost=200,
   infer=lambda name, inputs, attrs: (_scan_infer(name, inputs, attrs)[0], table(-(-attrs["count"] // SHARED_CHUNK))),
   kernel=Kernel(_OWN + _UP + f"if (lane_ == 0 && group_ < {{whole}}) {{store}}(group_, part_[{LANES - 1}]);", _SHARED, LANES, 4 * LANES,
                 _whole),
   sample=lambda rng: ([to_table(rng.integers(-9, 9, 2500))], {"count": 2407}),
   doc="Sums of chunks of 1024 entries, each by a workgroup.")
op("scan_chunks_shared", "x starts", stage="kernel", reads="texel texel", attrs="count", ref=_part_ref, infer=_part_infer, cost=200,
   kernel=Kernel(_OWN + _UP + _DOWN + f"""int before_ = {{starts_at}}(min(group_, {{starts_n}} - 1)) + part_[lane_];
for (int k_ = 0; k_ < {EACH}; ++k_) {{
    if (first_ + k_ < {{whole}}) {{store}}(first_ + k_, first_ + k_ < {{count}} ? before_ : 0);
    before_ += {_ENTRY};
}}""", _SHARED, LANES, 4 * LANES, lambda node: -(-_whole(node) // SHARED_CHUNK)),
   sample=lambda rng: ([to_table(rng.integers(-9, 9, 2500)), to_table(rng.integers(0, 99, 3))], {"count": 2407}),
   doc="For each entry the start of its chunk of 1024 plus the sum of those before it there, by a workgroup; 0 from `count` on.")
op("exclusive_scan", "x", stage="composite", reads="texel", attrs="count", ref=_scan_ref, infer=_scan_infer, lower=_lower_scan,
   sample=lambda rng: ([to_table(rng.integers(-9, 99, 2500))], {"count": 2407}),
   doc="For each of the first `count` entries the sum of all before it; 0 from there on. Integers that wrap around.")


def _given(name: str, x: Node, **numbers) -> None:
    """Raises GraphError unless these are what a user may give."""
    if not isinstance(x, Node) or not is_int(x.vtype):
        raise GraphError(f"{name}: an int table or image is needed, got {x!r:.80}")
    for key, value in numbers.items():
        if isinstance(value, bool) or not isinstance(value, int | np.integer):
            raise GraphError(f"{name}: {key} is {value!r:.40}; a whole number is needed")


def exclusive_scan(x: Node, count: int | None = None) -> Node:
    """For each of the first `count` entries of an int table or image, all unless given, the sum of the entries before it, row by row."""
    _given("exclusive_scan", x, count=0 if count is None else count)
    return apply("exclusive_scan", x, count=x.extent.count if count is None else int(count))


# ---- counts

def _count_ref(index, bins, count):
    found = index.reshape(-1)[:count]
    return to_table(np.bincount(found[(found >= 0) & (found < bins)], minlength=bins))


def _count_infer(name, inputs, attrs):
    _entries(name, inputs[0])
    if not 0 < attrs["bins"] <= MAX_ENTRIES or not 0 < attrs["count"] <= inputs[0].extent.count:
        raise GraphError(f"{name}: {attrs['bins']} bins of {attrs['count']} entries of {inputs[0]!r}; 1 to {MAX_ENTRIES} bins, and as many "
                         "entries as there are, are allowed")
    return "int", table(attrs["bins"])


def _lower_count(index: Node, bins: int, count: int, room: int | None) -> Node:
    """Atomically, in a workgroup's memory where there is `room` for the bins; by sorting where there are no kernels."""
    if room is not None:
        return apply("count_in_bins", index, bins=bins, count=count, shared=int(bins <= SHARED_BINS and room >= 4 * bins))
    ordered, run = apply("count_keys", index, bins=bins, count=count), 1
    while run < ordered.extent.width * ordered.extent.height:
        ordered = apply("merge_runs", ordered, constant(np.array([[[run]]])))
        run *= 2
    ends = apply("texture_bins", ordered, extent=table(bins))
    return ends.y - ends.x


def _keys_ref(index, bins, count):
    out = np.stack([np.full(index.size, LAST), np.arange(index.size)], 1)
    found = index.reshape(-1)[:count]
    out[:count, 0] = np.where((found >= 0) & (found < bins), found, LAST)
    padded = np.stack([np.full(_size(index.size), LAST), np.arange(_size(index.size))], 1)
    padded[:len(out)] = out
    extent = table(index.size)
    return padded.reshape(extent.height, extent.width, 2)


def _size(count: int) -> int:
    extent = table(count)
    return extent.width * extent.height


op("count_keys", "index", reads="texel", attrs="bins count", ref=_keys_ref, cost=10,
   infer=lambda name, inputs, attrs: ("ivec2", table(inputs[0].extent.width * inputs[0].extent.height)),
   glsl="""{y} = ivec2(2147483647, {i});
    if ({i} < {count}) { int b_ = {index_at}({i}); if (b_ >= 0 && b_ < {bins}) {y}.x = b_; }""",
   sample=lambda rng: ([rng.integers(-3, 12, (6, 5, 1))], {"bins": 9, "count": 28}),
   doc="(bin, entry) of each of the first `count` entries as a table; bin 2^31 - 1 where there is none of `bins`.")


# Entries of a workgroup, those of neighbours side by side; what is done with the bin b_ of each.
_EACH_COUNTED = f"""for (int k_ = 0; k_ < {COUNTED // LANES}; ++k_) {{
    int i_ = group_ * {COUNTED} + k_ * {LANES} + lane_, b_ = i_ < {{count}} ? {{index_at}}(i_) : -1;
    if (b_ >= 0 && b_ < {{bins}}) DO;
}}
"""
_EACH_BIN = f"for (int b_ = lane_; b_ < {{bins}}; b_ += {LANES}) "


def _count_kernel(node: Node) -> Kernel:
    """Bins in a workgroup's memory, which it adds to those of all when it has counted; or those of all at once."""
    def groups(node: Node) -> int:
        return -(-node.attrs["count"] // COUNTED)

    if not node.attrs["shared"]:
        return Kernel(_EACH_COUNTED.replace("DO", "{add}(b_, 1)"), "", LANES, 0, groups, 0)
    body = (_EACH_BIN + "part_[b_] = 0;\nbarrier();\n" + _EACH_COUNTED.replace("DO", "atomicAdd(part_[b_], 1)") + "barrier();\n"
            + _EACH_BIN + "if (part_[b_] != 0) {add}(b_, part_[b_]);")
    return Kernel(body, "shared int part_[{bins}];", LANES, 4 * node.attrs["bins"], groups, 0)


op("count_in_bins", "index", stage="kernel", reads="texel", attrs="bins count shared", infer=_count_infer, cost=200, kernel=_count_kernel,
   ref=lambda index, bins, count, shared: _count_ref(index, bins, count),
   sample=lambda rng: ([to_table(rng.integers(-3, 40, 9000))], {"bins": 37, "count": 8905, "shared": 1}),
   doc="How many of the first `count` entries name each bin, by atomic sums; in a workgroup's memory first where `shared`.")
op("bincount", "index", stage="composite", reads="texel", attrs="bins count", ref=_count_ref, infer=_count_infer, lower=_lower_count,
   sample=lambda rng: ([to_table(rng.integers(-3, 40, 900))], {"bins": 37, "count": 805}),
   doc="How many of the first `count` entries are 0, 1, 2 .. up to `bins`, as a table; others are not counted.")


def bincount(index: Node, bins: int, count: int | None = None) -> Node:
    """How many entries of an int table or image are 0, 1, 2 .. up to `bins`, as a table, as np.bincount; those that are none of these are
    not counted. count: of the first so many entries, row by row."""
    _given("bincount", index, bins=bins, count=0 if count is None else count)
    return apply("bincount", index, bins=int(bins), count=index.extent.count if count is None else int(count))
