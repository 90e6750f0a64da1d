"""What tests of graphs share: layouts of nodes and arrays, processes of their own, and random graphs."""

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
from undertest import DEVICE

from dressi_edge.cache.layout import Layout
from dressi_edge.compiler.check_op import image_layout, layout_of, rounded  # noqa: F401  (tests take them from here)
from dressi_edge.compiler.graph.autodiff import gradients
from dressi_edge.compiler.graph.functions import apply, compose, constant_table, dot, gather_sum, lookup, mean, total
from dressi_edge.compiler.graph.ir import image, is_int, table, vector_type
from dressi_edge.compiler.graph.ops.pixels import sum_named
from dressi_edge.compiler.graph.program import Program

ROOT = Path(__file__).resolve().parents[1]


def python(code, *arguments, **environment):
    """Run code in a process of its own, on this tree; its device is the one under test."""
    paths = f"{ROOT}:{ROOT / 'tests'}"
    done = subprocess.run([sys.executable, "-c", code, *map(str, arguments)], capture_output=True, text=True, cwd=ROOT,
                          env={**os.environ, "PYTHONPATH": paths, "DRESSI_DEVICE": DEVICE, **environment})
    assert done.returncode == 0, done.stderr
    return done.stdout


# Random graphs


EXTENTS = {"unit": (1, 1), "wide": (7, 5), "tall": (3, 11), "table": 9, "long": 150}


def extent_named(name):
    size = EXTENTS[name]
    return table(size) if isinstance(size, int) else image(*size)


class Graph:
    """A random graph: `program` with inputs of every extent, `feed` for them as images, `nodes` in order of making.

    Floats stay within [-4, 4] and comparisons look at inputs only, so that fp32 cannot decide otherwise than float64.
    `exact=True` takes only ops whose results do not depend on the order of additions, on small dyadic numbers.
    `differentiable=True` takes only ops with a gradient by every input.
    """

    def __init__(self, seed, size=24, exact=False, differentiable=False):
        self.rng, self.exact, self.differentiable = np.random.default_rng(seed), exact, differentiable
        self.program, self.feed, self.nodes, self.given = Program(), {}, [], []
        for name in EXTENTS:
            e = extent_named(name)
            for c in (1, 3):
                self.given.append(self._input(f"{name}{c}", c, e, self._numbers((e.height, e.width, c))))
        self.indices = {name: self._index(name) for name in ("wide", "table")}
        self.nodes += self.given
        while len(self.nodes) < size + len(self.given):
            self.nodes.append(self._op())

    def _numbers(self, shape):
        return self.rng.integers(-16, 17, shape) / 8.0 if self.exact else rounded(self.rng.uniform(-2, 2, shape))

    def _input(self, name, c, extent, array):
        kind = vector_type(c, array.dtype.kind == "i")
        full = extent.count == extent.width * extent.height
        layout = Layout("image", kind, extent.width, extent.height) if full else Layout("table", kind, count=extent.count)
        self.feed[name] = layout.to_image(layout.from_image(array), name)  # zeros in the padding
        return self.program.input(name, layout)

    def _index(self, name):
        e = extent_named(name)
        return self._input(f"{name}_index", 1, e, self.rng.integers(-1, 9, (e.height, e.width, 1)))

    def pick(self, channels=None, extent=None, among=None):
        """A float node made so far; late ones more often. Always exists for 1 and 3 channels."""
        found = [n for n in among or self.nodes if not is_int(n.vtype) and (channels is None or n.channels == channels)
                 and (extent is None or n.extent == extent)]
        return found[int(len(found) * self.rng.random() ** 0.6)]

    def _beside(self, a):
        """A node that may stand beside a: its extent or 1 x 1, its channels or a scalar; or a literal."""
        if self.rng.random() < 0.15:
            return apply("literal", value=float(self.rng.integers(-4, 5)) / 4)
        e = a.extent if self.rng.random() < 0.7 else extent_named("unit")
        found = [n for n in self.nodes if n.extent == e and not is_int(n.vtype) and n.channels in (1, a.channels)]
        return found[self.rng.integers(len(found))]

    def _bounded(self, a):
        return apply("min", apply("max", a, -4.0), 4.0)

    def _condition(self, e):
        a, b = (self.pick(1, e, self.given) for _ in range(2))
        return apply(self.rng.choice(["less", "greater_equal", "not_equal"]), a, b if self.rng.random() < 0.5 else 0.125)

    def _op(self):
        rng, a = self.rng, self.pick()
        choices = ["arithmetic"] * 5 + ["channels"] * 2 + ["select", "lookup", "computed", "boxed", "fetch", "reduce",
                                                          "broadcast", "gather", "window"]
        if self.differentiable:
            choices = ["arithmetic"] * 4 + ["function"] * 2
            choices += ["channels", "select", "lookup", "boxed", "reduce", "broadcast", "gather", "normalized"]
        elif not self.exact:
            choices += ["function"] * 3 + ["normalized", "sample", "transpose"]
        return getattr(self, "_" + rng.choice(choices))(a)

    def _arithmetic(self, a):
        name = self.rng.choice(["add", "sub", "mul", "min", "max"])
        b = self._beside(a)
        y = apply(name, *((a, b) if self.rng.random() < 0.5 else (b, a)))
        if self.exact:  # a bounded number of digits: products are cut to 1/8
            return self._bounded(apply("floor", y * 8.0) * 0.125) if name == "mul" else self._bounded(y)
        return self._bounded(y)

    def _function(self, a):
        name = self.rng.choice(["sigmoid", "sin", "cos", "neg", "abs", "exp", "sqrt"])
        if name == "exp":
            return apply("exp", apply("min", a, 1.0))
        return apply("sqrt", apply("abs", a) + 0.25) if name == "sqrt" else apply(name, a)

    def _channels(self, a):
        if a.channels > 1 and self.rng.random() < 0.5:
            count = self.rng.integers(1, 5)
            return apply("swizzle", a, channels="".join(self.rng.choice(list("xyzw"[:a.channels]), count)))
        if a.channels > 1:
            return self._bounded(apply("sum_channels", a))
        return compose(a, *(self.pick(1, a.extent) for _ in range(self.rng.integers(1, 4))))

    def _select(self, a):
        return apply("select", self._condition(a.extent), a, self._beside(a))

    def _normalized(self, a):
        b = self._beside(a)
        return a / (b * b + 1.0)

    def _lookup(self, a):
        index = self.rng.integers(-1, a.extent.count, EXTENTS[self.rng.choice(["table", "long"])])
        return lookup(a, index)

    def _computed(self, a):
        return apply("lookup", self.pick(None, extent_named("table")), self.indices[self.rng.choice(["wide", "table"])])

    def _boxed(self, a):
        box = np.zeros((9, 4), int)
        for k in range(9):  # the box of an entry holds every pixel that names it, and sometimes no more
            ys, xs, _ = np.nonzero(self.feed["wide_index"] == k)
            if len(ys):
                box[k] = xs.min(), ys.min(), xs.max() + 1, ys.max() + 1
        if self.rng.random() < 0.5:
            return lookup(self.pick(None, extent_named("table")), self.indices["wide"], constant_table(box))
        index, box = self.indices["wide"], constant_table(box)
        return self._bounded(sum_named(self.pick(None, extent_named("wide")), index, box))

    def _fetch(self, a):
        wide = extent_named("wide")
        xy = compose(apply("imod", apply("texel_index", extent=wide), 5), apply("to_int", self.pick(1, wide, self.given)))
        return apply("fetch", a, xy)

    def _reduce(self, a):
        return self._bounded(total(a) * (1 / 64))

    def _broadcast(self, a):
        unit = self.pick(None, extent_named("unit"))
        return apply("broadcast", unit, extent=extent_named(self.rng.choice(["wide", "long"])))

    def _gather(self, a):
        lengths = self.rng.integers(0, 4, 9)
        ends = np.cumsum(lengths)
        cols = self.rng.integers(0, a.extent.count, ends[-1])
        weights = self.rng.integers(-4, 5, len(cols)) / 4 if self.rng.random() < 0.5 else None
        return self._bounded(gather_sum(a, np.stack([ends - lengths, ends], 1), cols, weights))

    def _window(self, a):
        codes = apply("select", self._condition(extent_named("wide")), 1, -1)
        window = {"cell_w": EXTENTS["wide"][0], "cell_h": EXTENTS["wide"][1], "tile": (16, 16)}
        tiles = apply("edge_tiles", codes, reach=2, tile=(16, 16))
        across = apply("covered_window", codes, tiles, dx=1, dy=0, **window)
        return apply("to_float", apply("edge_mask", across, tiles, dx=0, dy=2, **window))

    def _sample(self, a):
        uv = compose(*(self.pick(1, extent_named("tall")) for _ in range(2)))
        return apply("sample", self.pick(3, extent_named("wide")), uv, wrap=self.rng.choice(["repeat", "clamp"]))

    def _transpose(self, a):
        """The gradient of a small loss by an earlier node: what the AD writes."""
        x = self.pick(None, None, self.given)
        y = apply("sin", x) * self.pick(1, x.extent, self.given)
        return self._bounded(gradients(mean(dot(y, y)), [x])[0])

    def roots(self, count=6):
        """The last nodes, and some before them."""
        made = self.nodes[len(self.given):]
        return list(dict.fromkeys(made[-3:] + [made[k] for k in self.rng.choice(len(made), count - 3)]))

    def plan(self):
        """Give out `roots` as y0, y1, ... and return them."""
        roots = self.roots()
        self.program.plan("all", {}, {f"y{k}": (n, layout_of(n)) for k, n in enumerate(roots)})
        return roots
