"""What pixels read of a texture with mip levels, as lists that are made on the device: reads by cell, runs of them, touched texels.

    uv, lod, covered -> footprint -> reads, sorted by cell -> runs -> cells of texels -> touched texels

Each sample is two bilinear reads, 2 k and 2 k + 1: of its level and of the next. A pixel has one sample, or several that stand evenly on a
line (`mip_along.py`): sample n of pixel g is number k = n x pixels + g. A read lies in a cell, between four texels; a cell is known
by the number of the texel at its lower corner among the texels of all levels, and wraps within its level. Where many pixels see few
texels, a cell's reads are several runs of a fixed length. No list depends on the texture.
"""
from __future__ import annotations

from dataclasses import dataclass
from math import isqrt

import numpy as np

from ....cache.errors import GraphError
from ..ir import COLUMN, UNIT, Extent, Node, image, table
from ..optable import apply, op
from .compact import Compact, compact
from .lookup import lookup
from .mip_pyramid import Pyramid, found
from .mips import bilinear, split_lod, texels_of, wrapped, wraps_of
from .texture_sort import MAX_PIXELS, sorted_list

MAX_SIDE = 4096  # of an image on every device
RUN = 128  # reads that one sum takes, at least


def numbered(p: Pyramid) -> Extent:
    """An image with a place for each texel of all levels."""
    count, width = p.starts[-1], p.width
    while -(-count // width) > MAX_SIDE and width < MAX_SIDE:
        width *= 2
    return image(width, -(-count // width))


def columns(count: int, most: int = MAX_SIDE) -> Extent:
    """Room for a list of so many entries: one column of 64 texels, or several of `most` rows (`passes/columns.py`)."""
    rows = -(-count // COLUMN)
    wide = -(-rows // most)
    return Extent(COLUMN * wide, min(rows, most), COLUMN * rows)


def run_length(reads: int, texels: int) -> int:
    """Of how many reads a sum is: as many as there are sums then for a texel, where that is more than RUN; a power of two."""
    run = RUN
    while run < isqrt(reads // texels):
        run *= 2
    return run


@dataclass(frozen=True)
class Reads:
    """What pixels read of a texture with levels, as lists. reads: sorted by cell; spans: the runs of which each sum is; cells: of each
    texel of all levels the runs of its own cell; touched: the list of texels that some pixel reads."""

    reads: Node
    spans: Node
    cells: Node
    touched: Compact


def middle(count: int) -> float:
    """Of the numbers of so many samples that stand evenly on a line: the place that they stand around."""
    return 0.5 * (count - 1)


def reads_of(p: Pyramid, uv: Node, lod: Node, covered: Node, wrap: tuple[str, str], apart: Node | None = None, count: int = 1) -> Reads:
    """The lists of a sample at these coordinates, or of `count` that are `apart` from one another."""
    size, places = {"width": p.width, "height": p.height}, numbered(p)
    several = {} if count == 1 else {"count": count}
    if several:
        footprint = apply("mip_footprints", uv, apart, lod, covered, across=places.width, wrap=wrap, **size, **several)
    else:
        footprint = apply("mip_footprint", uv, lod, covered, across=places.width, wrap=wrap, **size)
    asked = compact(apply("greater_equal", apply("swizzle", footprint, channels="x"), 0.0), 1, columns(footprint.extent.count))
    ordered = sorted_list(footprint, places.width, asked)
    reads, run = footprint.extent.count, run_length(2 * count * uv.extent.count, p.starts[-1])
    starts = apply("mip_starts", ordered, asked.total, run=run, count=reads)
    runs = compact(starts, 1, columns(min(reads, p.starts[-1] + -(-reads // run))))
    spans = apply("mip_spans", runs.entries, runs.total, asked.total)
    cells = apply("listed_bins", lookup(ordered, apply("swizzle", spans, channels="x")), runs.total, extent=places)
    touched = compact(apply("mip_touched", cells, **size), 1, columns(min(cells.extent.count, 4 * reads)))
    return Reads(apply("mip_reads", ordered, footprint, lod, **size, **several), spans, cells, touched)


def over(extent: Extent, *nodes: Node) -> tuple[Node, ...]:
    """Nodes over all of an extent."""
    return tuple(x if x.extent != UNIT or extent == UNIT else apply("broadcast", x, extent=extent) for x in nodes)


# ---- footprints

def _footprint_infer(name, inputs, attrs):
    uv, lod, covered = inputs[0], *inputs[-2:]
    if {x.vtype for x in inputs[:-2]} != {"vec2"} or lod.vtype != "float" or covered.vtype != "int":
        raise GraphError(f"{name}: vec2 coordinates, a float and an int mask are needed, got {', '.join(map(repr, inputs))}")
    wraps_of(name, attrs["wrap"])
    samples = uv.extent.width * uv.extent.height * attrs.get("count", 1)
    if samples > MAX_PIXELS:
        raise GraphError(f"{name}: {uv!r} has {samples} samples; {MAX_PIXELS} are allowed")
    return "vec4", table(2 * samples)


def _footprint_ref(uv, lod, covered, width, height, across, wrap):
    return _footprints_ref(uv, 0 * uv, lod, covered, width, height, across, wrap, 1)


def _footprints_ref(uv, apart, lod, covered, width, height, across, wrap, count):
    flat = np.concatenate([_footprint_of(uv + apart * (n - middle(count)), lod, covered, Pyramid(width, height), across, wrap)
                           for n in range(count)])
    e = table(len(flat))
    filled = np.tile([-1.0, 0.0, 0.0, 0.0], (e.width * e.height, 1))
    filled[:len(flat)] = flat
    return filled.reshape(e.height, e.width, 4)


def _footprint_of(uv, lod, covered, p: Pyramid, across: int, wrap) -> np.ndarray:
    """(2 pixels, 4): of one sample a pixel."""
    level, t = split_lod(lod, p.last)
    out = np.tile([-1.0, 0.0, 0.0, 0.0], (*covered.shape[:2], 2, 1))
    for k in range(p.last + 1):
        xs, ys, fx, fy = bilinear(uv, p, k, wrap)
        number = p.starts[k] + ys[..., :1] * p.size(k)[0] + xs[..., :1]
        f = [np.where(x[..., :1] == x[..., 1:], 0, s) if p.size(k)[axis] > 1 or wrap[axis] == "clamp" else s
             for axis, (x, s) in enumerate(((xs, fx), (ys, fy)))]
        found = np.concatenate([number % across, number // across, *f], 2)
        for j in (0, 1):
            here = (level + j == k) & (covered != 0) & ((j == 0) | (t > 0))
            out[:, :, j] = np.where(here, found, out[:, :, j])
    return out.reshape(-1, 4)


def _footprint_glsl(node: Node) -> str:
    p, wrap, count = Pyramid(node.attrs["width"], node.attrs["height"]), node.attrs["wrap"], node.attrs.get("count", 1)
    pixels = node.inputs[0].extent.width * node.inputs[0].extent.height
    none = " ".join(f"if (lo_.{c} == hi_.{c}) s_.{c} = 0.0;" for c, w in zip("xy", wrap) if w == "clamp")
    pixel, at = f"int g_ = min({{i}} >> 1, {pixels - 1}), j_ = {{i}} & 1;", "{uv_at}(g_)"
    if count > 1:
        pixel = f"int n_ = ({{i}} >> 1) / {pixels}, g_ = ({{i}} >> 1) - n_ * {pixels}, j_ = {{i}} & 1;"
        at = f"({{uv_at}}(g_) + {{apart_at}}(g_) * (float(n_) - {middle(count)}))"
    return f"""{{ {{y}} = vec4(-1.0, 0.0, 0.0, 0.0); {pixel}
    float d_ = clamp({{lod_at}}(g_), 0.0, {float(p.last)}), f_ = min(floor(d_), {float(p.last - 1)}); int m_ = int(f_) + j_; f_ = d_ - f_;
    if ({f'n_ < {count}' if count > 1 else '{i} >> 1 == g_'} && {{covered_at}}(g_) != 0 && (j_ == 0 || f_ > 0.0)) {{ {p.glsl}
    {wrapped(wrap).replace("{uv}", at)} ivec2 z_ = (ivec2({{width}}, {{height}}) + (1 << m_) - 1) >> m_;
    {texels_of(wrap)} {none}
    int q_ = o_[m_] + lo_.y * z_.x + lo_.x;
    {{y}} = vec4(q_ % {{across}}, q_ / {{across}}, s_); }} }}"""


def _pixels(rng):
    return [rng.uniform(-0.6, 1.6, (6, 5, 2)), rng.uniform(-0.5, 4.5, (6, 5, 1)), rng.integers(0, 2, (6, 5, 1))]


SIZE = {"width": 13, "height": 6}
op("mip_footprint", "uv lod covered", alike=((1, 0), (2, 0)), attrs="width height across wrap", infer=_footprint_infer,
   reads="texel texel texel", cost=60, ref=_footprint_ref, glsl=_footprint_glsl,
   sample=lambda rng: (_pixels(rng), {**SIZE, "across": 13, "wrap": ("repeat", "clamp")}),
   doc="Of both bilinear reads of each pixel: the number of the lower texel among all levels, as column and row of an image `across` "
       "wide, and the fractions towards the next, which wraps within its level; column -1 where nothing is read.")


op("mip_footprints", "uv apart lod covered", alike=((1, 0), (2, 0), (3, 0)), attrs="width height across wrap count", infer=_footprint_infer,
   reads="texel texel texel texel", cost=70, ref=_footprints_ref, glsl=_footprint_glsl,
   sample=lambda rng: ((lambda x: [x[0], rng.uniform(-0.1, 0.1, x[0].shape), *x[1:]])(_pixels(rng)),
                       {**SIZE, "across": 13, "wrap": ("repeat", "clamp"), "count": 3}),
   doc="mip_footprint of `count` samples a pixel that are `apart` and stand evenly about uv: of the first of each pixel, then of others.")


# ---- reads, runs and touched texels

class Chain:
    """What each op makes of random pixels; sums are of `run` reads."""

    def __init__(self, rng: np.random.Generator, run: int = 2):
        from .texture_gradient import _bins_ref
        self.uv, self.lod, self.covered = _pixels(rng)
        e = numbered(Pyramid(**SIZE))
        self.footprint = _footprint_ref(self.uv, self.lod, self.covered, across=e.width, wrap=("repeat", "clamp"), **SIZE)
        flat = self.footprint.reshape(-1, 4)
        asked = np.flatnonzero(flat[:, 0] >= 0)
        keys = (flat[asked, 1] * e.width + flat[asked, 0]).astype(np.int64)
        order = np.argsort(keys, kind="stable")
        self.total, self.ordered = np.array([[[len(asked)]]]), _listed(np.stack([keys[order], asked[order]], 1), len(flat))
        starts = np.flatnonzero(_starts_ref(self.ordered, self.total, run, len(flat)).reshape(-1))
        self.entries, self.runs = _listed(starts[:, None], len(flat)), np.array([[[len(starts)]]])
        self.spans = _spans_ref(self.entries, self.runs, self.total)
        self.reads = _reads_ref(self.ordered, self.footprint, self.lod, **SIZE)
        self.cells = _bins_ref(keys[order][starts][None, :, None], e)
        touched = _touched_ref(self.cells, **SIZE)
        self.texels = _listed(np.flatnonzero(touched.reshape(-1))[:, None], touched.size)
        self.slots = np.where(touched != 0, (np.cumsum(touched) - 1).reshape(touched.shape), -1)


def _listed(values: np.ndarray, count: int) -> np.ndarray:
    """(n, c) at the beginning of a table's image of so many entries, zeros after."""
    e = table(count)
    out = np.zeros((e.width * e.height, values.shape[1]), np.int64)
    out[:len(values)] = values
    return out.reshape(e.height, e.width, -1)


def _reads_ref(ordered, footprint, lod, width, height, count=1):
    sample = np.clip(ordered[..., 1], 0, 2 * count * lod.size - 1)
    pixel, far = (sample >> 1) % lod.size, sample & 1
    t = split_lod(lod.reshape(-1)[pixel], Pyramid(width, height).last)[1]
    weight = np.where(far, t, 1 - t) * _level_share(Pyramid(width, height), lod, pixel, far) / count
    return np.stack([pixel, *np.moveaxis(footprint.reshape(-1, 4)[sample, 2:], -1, 0), weight], -1)


def _level_share(p: Pyramid, lod, pixel, far):
    """Where all texels of a level stand for as many, 1 over how many, of reads; else 1."""
    level = split_lod(lod.reshape(-1)[pixel], p.last)[0] + far
    return 1.0 / (1 << 2 * np.minimum(level, p.last)) if p.even else np.ones(pixel.shape)


def _reads_infer(name, inputs, attrs):
    ordered, footprint, lod = inputs
    if footprint.extent != table(2 * attrs.get("count", 1) * lod.extent.width * lod.extent.height) or ordered.vtype != "ivec2":
        raise GraphError(f"{name}: an ivec2 list and two reads a sample of {lod!r} are needed, got {ordered!r} and {footprint!r}")
    return "vec4", ordered.extent


def _reads_glsl(node: Node) -> str:
    p, e, count = Pyramid(node.attrs["width"], node.attrs["height"]), node.inputs[2].extent, node.attrs.get("count", 1)
    pixels = e.width * e.height
    share = " * exp2(-2.0 * (f_ + float(k_ & 1)))" if p.even else ""
    share += f" * {1.0 / count!r}" if count > 1 else ""
    pixel = f"(k_ >> 1) % {pixels}" if count > 1 else "k_ >> 1"
    return f"""{{ int k_ = clamp({{ordered}}.y, 0, {2 * count * pixels - 1}), g_ = {pixel};
    float d_ = clamp({{lod_at}}(g_), 0.0, {float(p.last)}), f_ = min(floor(d_), {float(p.last - 1)}), t_ = d_ - f_;
    {{y}} = vec4(g_, {{footprint_at}}(k_).zw, ((k_ & 1) == 0 ? 1.0 - t_ : t_){share}); }}"""


op("mip_reads", "ordered footprint lod", reads="own texel texel", cost=40, ref=_reads_ref, infer=_reads_infer,
   glsl=_reads_glsl, sample=lambda rng: ((lambda c: [c.ordered, c.footprint, c.lod])(Chain(rng)), dict(SIZE)),
   doc="Of each read of a list: its pixel, the fractions of its footprint, and how much of it comes from its level; divided by how many "
       "samples a pixel has, and by how many of the texture's texels one of that level stands for, where they all stand for as many.")


def _starts_ref(ordered, total, run, count):
    keys, k = ordered.reshape(-1, 2)[:, 0], np.arange(ordered.shape[0] * ordered.shape[1])
    first = (k % run == 0) | (keys != np.roll(keys, 1))
    return _listed((first & (k < total.reshape(-1)[-1])).astype(np.int64)[:count, None], count)


_TOTAL = "{total}(ivec2({total_w} - 1, {total_h} - 1))"
op("mip_starts", "ordered total", attrs="run count", reads="texel texel", cost=20, ref=_starts_ref,
   infer=lambda name, inputs, attrs: ("int", table(attrs["count"])),
   glsl="{y} = {i} < " + _TOTAL + " && ({i} % {run} == 0 || {ordered_at}({i}).x != {ordered_at}(max({i} - 1, 0)).x) ? 1 : 0;",
   sample=lambda rng: ((lambda c: [c.ordered, c.total])(Chain(rng)), {"run": 4, "count": 60}),
   doc="1 where a run of reads of one cell begins in their sorted list: with the cell, and each `run` entries.")


def _spans_ref(entries, runs, total):
    n, out = int(runs.reshape(-1)[-1]), np.zeros((entries.size, 2), np.int64)
    begins = entries.reshape(-1)[:n]
    out[:n] = np.stack([begins, np.append(begins[1:], total.reshape(-1)[-1:])[:n]], 1)
    return out.reshape(*entries.shape[:2], 2)


op("mip_spans", "entries runs total", attrs="", reads="texel texel texel", cost=20, ref=_spans_ref,
   infer=lambda name, inputs, attrs: ("ivec2", inputs[0].extent),
   glsl="{ int n_ = {runs}(ivec2({runs_w} - 1, {runs_h} - 1)); {y} = ivec2(0);\n"
        "    if ({i} < n_) {y} = ivec2({entries_at}({i}), {i} + 1 < n_ ? {entries_at}({i} + 1) : " + _TOTAL + "); }",
   sample=lambda rng: ((lambda c: [c.entries, c.runs, c.total])(Chain(rng)), {}),
   doc="Begin and end of each run of a list of where runs begin, of which `runs` says how many there are; the last ends with the reads.")


def _around(cells: np.ndarray, p: Pyramid, level: int) -> list[np.ndarray]:
    """The runs (h, w, 2) of the four cells around each texel of a level: own, left, above, above to the left."""
    own = p.texels(cells.reshape(-1, 2), level)
    return [np.roll(own, (j, i), (0, 1)) for j in (0, 1) for i in (0, 1)]


def _touched_ref(cells, width, height):
    p, out = Pyramid(width, height), np.zeros(cells.shape[0] * cells.shape[1], np.int64)
    for level in range(p.last + 1):
        some = np.any([x[..., 1] > x[..., 0] for x in _around(cells, p, level)], 0)
        p.texels(out[:, None], level)[..., 0] = some
    return out.reshape(*cells.shape[:2], 1)


_FOUR = """int l_ = a_.x == 0 ? z_.x - 1 : a_.x - 1, u_ = a_.y == 0 ? z_.y - 1 : a_.y - 1;
    ivec2 own_ = {cells_at}(o_[m_] + a_.y * z_.x + a_.x), left_ = {cells_at}(o_[m_] + a_.y * z_.x + l_),
          above_ = {cells_at}(o_[m_] + u_ * z_.x + a_.x), corner_ = {cells_at}(o_[m_] + u_ * z_.x + l_);"""


def _cells_infer(vtype):
    def infer(name, inputs, attrs):
        if inputs[0].vtype != "ivec2" or inputs[0].extent != numbered(Pyramid(attrs["width"], attrs["height"])):
            raise GraphError(f"{name}: the cells of {attrs['width']}x{attrs['height']} texels and their levels are needed, got "
                             f"{inputs[0]!r}")
        return vtype, inputs[-1].extent
    return infer


op("mip_touched", "cells", attrs="width height", reads="texel", cost=40, ref=_touched_ref, infer=_cells_infer("int"),
   glsl=lambda node: "{ int q_ = {i}; " + found(node) + " a_.y = min(a_.y, z_.y); int in_ = int(a_.y < z_.y); a_.y *= in_;\n    " + _FOUR
   + " {y} = own_.x < own_.y || left_.x < left_.y || above_.x < above_.y || corner_.x < corner_.y ? in_ : 0; }",
   sample=lambda rng: ([Chain(rng).cells], dict(SIZE)),
   doc="1 for each texel of all levels that has reads in one of the four cells around it.")


def around_ref(cells, entries, width, height, ends):
    p, out = Pyramid(width, height), np.zeros((cells.shape[0] * cells.shape[1], 4), np.int64)
    for level in range(p.last + 1):
        begin, end = np.moveaxis(np.stack(_around(cells, p, level), 2), -1, 0)
        p.texels(out, level)[:] = end if ends else np.where(begin < end, 2 * begin + (end > begin + 1), -1)
    return out[np.clip(entries[..., 0], 0, p.starts[-1] - 1)]


def _around_glsl(node: Node) -> str:
    each = [f"{x}_.y" if node.attrs["ends"] else f"{x}_.x < {x}_.y ? 2 * {x}_.x + int({x}_.y > {x}_.x + 1) : -1"
            for x in ("own", "left", "above", "corner")]
    last = Pyramid(node.attrs["width"], node.attrs["height"]).starts[-1] - 1
    return f"{{ int q_ = clamp({{entries}}, 0, {last}); " + found(node) + f" {_FOUR}\n    {{y}} = ivec4({', '.join(each)}); }}"


op("mip_around", "cells entries", attrs="width height ends", reads="texel own", cost=40, ref=around_ref, infer=_cells_infer("ivec4"),
   glsl=_around_glsl, sample=lambda rng: ((lambda c: [c.cells, c.texels])(Chain(rng)), {**SIZE, "ends": 0}),
   doc="Of each texel of a list its own cell, the one to the left, the one above and the one above to the left: twice the number of the "
       "cell's first run, and 1 more where it has several, -1 where it has none; or, of `ends`, where its runs end.")


def share_ref(entries, width, height):
    p = Pyramid(width, height)
    counts = np.concatenate([p.counts(level).ravel() for level in range(p.last + 1)])
    return 1.0 / counts[np.clip(entries, 0, len(counts) - 1)]


op("mip_share", "entries", attrs="width height", cost=30, ref=share_ref, infer=lambda name, inputs, attrs: ("float", inputs[0].extent),
   glsl=lambda node: "{ int q_ = clamp({entries}, 0, " + str(Pyramid(node.attrs["width"], node.attrs["height"]).starts[-1] - 1) + "); "
   + found(node) + " ivec2 c_ = min(ivec2(1 << m_), ivec2({width}, {height}) - (a_ << m_)); {y} = 1.0 / float(c_.x * c_.y); }",
   sample=lambda rng: ([Chain(rng).texels], dict(SIZE)),
   doc="1 over how many of the texture's texels each texel of a list stands for.")
