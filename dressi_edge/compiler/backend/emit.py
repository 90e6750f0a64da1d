"""A substage to GLSL: one vertex and one fragment shader a draw, or one compute shader, and what they bind.

In: packed stages with their domains, the profile. Out: `Code` of each substage: shader texts and bindings in order. Names are local
numbers, so equal substages give equal text and share one module. Ops whose loop headers come out equal share one loop.
"""
from __future__ import annotations

import re
from collections.abc import Collection, Mapping, Sequence
from types import MappingProxyType

from ...cache.profile import Profile
from ..graph.formats import format_of
from ..graph.ir import UNIT, Extent, Node, is_int
from ..graph.ops.leaf import literal_glsl
from ..graph.optable import COUNT, FILTERED, OWN, TILE, VERTEX
from ..passes.compute import NARROW, shape, spread
from ..passes.pressure import keeps
from ..passes.substage import KEPT, LISTED, TEXELS, TILES, Stage, Substage, merged_reads
from .code import ATTACHMENT, SAMPLED, SAMPLER, Binding, Code, DispatchCode, DrawCode
from .rows import Rows

# layout qualifiers of storage images
_STORED = {"R32_SFLOAT": "r32f", "R32_SINT": "r32i", "R32G32B32A32_SFLOAT": "rgba32f", "R32G32B32A32_SINT": "rgba32i",
           "R16G16B16A16_SFLOAT": "rgba16f"}

_HEAD = "#version 450\n#extension GL_EXT_samplerless_texture_functions : require\n"
FULLSCREEN = _HEAD + """void main() {
    gl_Position = vec4(vec2((gl_VertexIndex << 1) & 2, gl_VertexIndex & 2) * 2.0 - 1.0, 0.0, 1.0);
}
"""


_CORNER = "vec2 o = vec2(corner == 1 || corner == 3 || corner == 5 ? high.x : low.x, corner >= 2 && corner != 3 ? high.y : low.y);\n"
_PLACE = "gl_Position = vec4(o / vec2({w}, {h}) * 2.0 - 1.0, 0.0, 1.0);\n"
_TILES = """int tile = gl_VertexIndex / 6, corner = gl_VertexIndex % 6;
ivec2 at = ivec2(tile % {across}, tile / {across});
vec2 low = vec2(at * ivec2({tw}, {th})), high = min(low + vec2({tw}, {th}), vec2({w}, {h}));
""" + _CORNER + """gl_Position = {tiles}(at) != 0 ? vec4(o / vec2({w}, {h}) * 2.0 - 1.0, 0.0, 1.0) : vec4(0.0, 0.0, 0.0, 1.0);
"""
# Of a list: the columns that are full, then the one that is not.
_LISTED = """int corner = gl_VertexIndex % 6, full = {entries} / ({column} * {h}), rest = {entries} - full * {column} * {h};
bool last = gl_VertexIndex >= 6;
vec2 low = vec2(last ? full * {column} : 0, 0);
vec2 high = vec2((last ? full + 1 : full) * {column}, last ? (rest + {column} - 1) / {column} : {h});
""" + _CORNER + _PLACE


class _Names(dict):
    """What a snippet may ask for; `asked`: that it asked for the grid of corners."""

    def __init__(self, names: dict, snap: str):
        super().__init__(names)
        self.snap, self.asked = snap, False

    def __missing__(self, key: str) -> str:
        if key != "snap":
            raise KeyError(key)
        self.asked = True
        return self.snap


def _mark(text: str, names: dict) -> str:
    return re.sub(r"\{(\w+)\}", lambda m: str(names[m.group(1)]), text)


def _channels(node: Node) -> str:
    return {1: ".x", 2: ".xy", 3: ".xyz", 4: ""}[node.channels]


def _scale(node: Node, sign: int) -> str:
    """What turns the numbers in its image into values (sign -1), or back (1)."""
    return f" * {literal_glsl(2.0 ** (sign * node.half))}" if node.half else ""


def hardware_filter(node: Node, profile: Profile) -> bool:
    """Whether the profile promises linear filtering of this image's format."""
    return profile.format_has(format_of(node), "filter")


MANY = 8  # columns of a list, from which on a division finds one sooner than comparisons


def _place(i: str, column: int, height: int, columns: int = 1) -> tuple[str, str]:
    """Column and row of an index, by shifts and comparisons where they do: drivers divide negative numbers, too."""
    if column & (column - 1) or columns > MANY:
        return f"{i} / {column * height} * {column} + {i} % {column}", f"{i} / {column} % {height}"
    low = column.bit_length() - 1
    if height & (height - 1) == 0:
        return f"{i} >> {(column * height).bit_length() - 1} << {low} | {i} & {column - 1}", f"{i} >> {low} & {height - 1}"
    which = " + ".join(f"int({i} >= {k * column * height})" for k in range(1, columns)) or "0"
    return f"({i} & {column - 1}) + {column} * ({which})", f"({i} >> {low}) - {height} * ({which})"


class _Emitter:
    def __init__(self, stage: Substage, profile: Profile, inner: Collection[Node], wide: Mapping[Node, Extent]):
        self.stage, self.profile, self.wide = stage, profile, wide
        self.image = wide.get(stage.outputs[0], stage.extent)  # what its outputs measure
        self.rows = self.rows_of(stage.outputs[0])
        self.snap = literal_glsl(2.0 ** -profile.limit("subPixelPrecisionBits"))
        self.tiled = stage.domain.by if stage.domain.kind == TILES else None
        self.bindings: list[Binding] = []
        self.slots: dict[tuple[Node, str, str], int] = {}
        vertex = {x for x, m in stage.reads if m == VERTEX}
        fragment = {x for x, m in stage.reads if m != VERTEX}
        computed = set(stage.nodes)
        for node in stage.nodes:
            for k, x in enumerate(node.inputs):
                mode = node.op.read(k)
                if x.op.stage == "inline" or (mode == OWN and x in computed) or mode == COUNT:
                    continue
                sampler = mode == FILTERED and hardware_filter(x, profile)
                key = (x, SAMPLER, node.attrs["wrap"]) if sampler else (x, ATTACHMENT if x in inner else SAMPLED, "")
                if key not in self.slots:
                    self.slots[key] = len(self.bindings)
                    self.bindings.append(Binding(x, key[1], x in vertex, x in fragment and x is not self.tiled, key[2]))
        self.values: dict[Node, str] = {}
        self.own: dict[int, None] = {}
        self.lean = not keeps(stage.nodes, stage.outputs, profile.max_live)

    def rows_of(self, x: Node) -> Rows | None:
        """How its image lies, where not as its extent says."""
        return Rows.of(x.extent, self.wide[x]) if x in self.wide else None

    def bind_vertex(self, x: Node) -> int:
        """The binding of an image that the vertex shader of a substage reads, too."""
        slot = self.slots.setdefault((x, SAMPLED, ""), len(self.bindings))
        self.bindings[slot:slot + 1] = [Binding(x, SAMPLED, True, slot < len(self.bindings) and self.bindings[slot].fragment)]
        return slot

    def declarations(self, vertex: bool | None) -> list[str]:
        """Of what the vertex or the fragment shader binds; None: of all."""
        lines = []
        bound = [(k, b) for k, b in enumerate(self.bindings) if vertex is None or (b.vertex if vertex else b.fragment)]
        laid = [self.rows_of(b.node) for _, b in bound]
        if vertex is None:
            laid.append(self.rows)
        lines += dict.fromkeys(rows.function for rows in laid if rows)
        for k, b in bound:
            prefix = "i" if is_int(b.node.vtype) else ""
            if b.kind == ATTACHMENT:
                number = sum(other.kind == ATTACHMENT for other in self.bindings[:k])
                lines.append(f"layout(input_attachment_index = {number}, set = 0, binding = {k}) uniform {prefix}subpassInput t{k};")
                continue
            if b.kind == SAMPLER:
                lines.append(f"layout(set = 0, binding = {k}) uniform {prefix}sampler2D t{k};")
                lines.append(f"#define F{k}(uv) (texture(t{k}, uv){_channels(b.node)}{_scale(b.node, -1)})")
                continue
            lines.append(f"layout(set = 0, binding = {k}) uniform {prefix}texture2D t{k};")
            fetch = f"(texelFetch(t{k}, {{}}, 0){_channels(b.node)}{_scale(b.node, -1)})"
            rows = self.rows_of(b.node)
            if rows:
                lines += [f"#define T{k}(c) {fetch.format(f'{rows.name}(c)')}", f"#define W{k}(c) {fetch.format('c')}",
                          f"#define E{k}(i) W{k}({rows.place('(i)')})"]
                continue
            lines.append(f"#define T{k}(c) {fetch.format('c')}")
            lines.append(f"#define E{k}(i) T{k}({self._place_of('(i)', b.node.extent)})")
        return lines

    def _place_of(self, i: str, e: Extent) -> str:
        """Where in an image of this extent an entry is."""
        if e.height == 1:
            return f"ivec2({'i' if i == '(i)' else i}, 0)"
        if e.column < e.width:
            x, y = _place(i, e.column, e.height, e.width // e.column)
            return f"ivec2({x}, {y})"
        if e.width & (e.width - 1) == 0:
            return f"ivec2({i} & {e.width - 1}, {i} >> {e.width.bit_length() - 1})"
        return f"ivec2({i} % {e.width}, {i} / {e.width})"

    def names(self, node: Node) -> _Names:
        e = node.extent
        names = {"w": e.width, "h": e.height, "n": e.count, "type": node.vtype, "p": "pixel",
                 "i": "entry" if self.rows and not self.stage.compute else
                 f"(pixel.y * {e.width} + pixel.x)" if e.column == e.width else
                 f"(pixel.x / {e.column} * {e.column * e.height} + pixel.y * {e.column} + pixel.x % {e.column})"}
        names = _Names(names, self.snap)
        for key, value in node.attrs.items():
            names[key] = literal_glsl(value) if isinstance(value, (int, float)) else value
        for k, (param, x) in enumerate(zip(node.op.params, node.inputs)):
            mode = node.op.read(k)
            names[param + "_w"], names[param + "_h"], names[param + "_n"] = x.extent.width, x.extent.height, x.extent.count
            if x.op.stage == "inline":
                text = literal_glsl(x.attrs["value"])
                names[param] = f"({text})" if text[0] == "-" else text
            elif mode == OWN:
                names[param] = self.value(x)
            elif mode == COUNT:
                continue
            elif mode == TILE:
                width, height = node.attrs["tile"]
                names[param] = "1" if x is self.tiled else f"T{self.slots[x, SAMPLED, '']}(pixel / ivec2({width}, {height}))"
            else:
                slot = self.slots.get((x, SAMPLED, ""), self.slots.get((x, SAMPLER, node.attrs.get("wrap", ""))))
                names[param], names[param + "_at"] = f"T{slot}", f"E{slot}"
        names["y"] = self.values.get(node, "")
        return names

    def value(self, x: Node) -> str:
        """The variable that holds x at this texel; remembers to load it if it comes from outside."""
        if x not in self.values:
            slot = self.slots.get((x, SAMPLED, ""), self.slots.get((x, ATTACHMENT, "")))
            self.own[slot] = None
            self.values[x] = f"u{slot}"
        return self.values[x]

    def loads(self) -> list[str]:
        lines = []
        for slot in self.own:
            x = self.bindings[slot].node
            if self.bindings[slot].kind == ATTACHMENT:
                lines.append(f"{x.vtype} u{slot} = subpassLoad(t{slot}){_channels(x)}{_scale(x, -1)};")
                continue
            at = "T{}(ivec2(0))" if x.extent == UNIT and self.stage.extent != UNIT else \
                "W{}(texel)" if self.rows and not self.stage.compute and self.rows_of(x) == self.rows else "T{}(pixel)"
            lines.append(f"{x.vtype} u{slot} = {at.format(slot)};")
        return lines

    def functions(self) -> list[str]:
        return list(dict.fromkeys(n.op.functions for n in self.stage.nodes if n.op.functions))

    def pixel_body(self) -> list[str]:
        domain = self.stage.domain
        for k, n in enumerate(self.stage.nodes):
            self.values[n] = f"v{k}"
        if domain.kind != TEXELS:
            lines = self.block(self.stage.nodes)
            return self.loads() + lines
        first = self.block(domain.cone)
        test = f"if ({self.value(domain.by)} == 0) {self.leave() if self.stage.compute else 'discard;'}"
        first = self.loads() + first
        self.own.clear()
        cone = set(domain.cone)
        rest = self.block([n for n in self.stage.nodes if n not in cone])
        return [*first, test, *self.loads(), *rest]

    def block(self, nodes: Sequence[Node]) -> list[str]:
        """Statements of these nodes; loops with equal headers merged."""
        depth: dict[Node, int] = {}
        for n in nodes:
            inner = [depth[x] for k, x in enumerate(n.inputs) if x in depth]
            depth[n] = max(inner, default=0) + (n.op.loop is not None)
        lines = []
        for level in range(max(depth.values(), default=-1) + 1):
            loops: dict[str, list[Node]] = {}
            for n in nodes:
                if depth[n] == level and n.op.loop is not None:
                    lines.append(f"{n.vtype} {self.values[n]} = {n.vtype}(0);")
                    header = self.lean and n.op.loop.lean[0] or n.op.loop.header
                    loops.setdefault(_mark(header, self.names(n)), []).append(n)
            for header, members in loops.items():
                body = " ".join(_mark(n.op.loop.body, self.names(n)) for n in members)
                lines.append(f"{header} {body} {members[0].op.loop.close}")
            for n in nodes:
                if depth[n] == level and n.op.loop is None:
                    lines.append(f"{n.vtype} {self.values[n]};")
                    lines.append(self.snippet(n))
        return lines

    def snippet(self, n: Node) -> str:
        for k, x in enumerate(n.inputs):
            if n.op.read(k) == FILTERED and hardware_filter(x, self.profile):
                slot = self.slots[x, SAMPLER, n.attrs["wrap"]]
                return f"{self.values[n]} = F{slot}({self.names(n)['uv']});"
        text = n.op.glsl(n) if callable(n.op.glsl) else n.op.glsl
        return _mark(text, self.names(n))

    def fragment(self, body: list[str], varyings: list[str]) -> str:
        outs = [f"layout(location = {k}) out {'ivec4' if n.channels == 3 and is_int(n.vtype) else 'vec4' if n.channels == 3 else n.vtype}"
                f" o{k};" for k, n in enumerate(self.stage.outputs)]
        values = [self.values[n] + _scale(n, 1) for n in self.stage.outputs]
        stores = [f"o{k} = " + (f"{'ivec4' if is_int(n.vtype) else 'vec4'}({value}, 0);" if n.channels == 3 else f"{value};")
                  for k, (n, value) in enumerate(zip(self.stage.outputs, values))]
        return "\n".join([_HEAD + "\n".join(self.declarations(False)), *varyings, *outs, *self.functions(), "void main() {",
                          self.rows.pixel() if self.rows else "ivec2 pixel = ivec2(gl_FragCoord.xy);", *body, *stores, "}", ""])

    def pixels(self) -> DrawCode:
        """The draw of a substage of texels: its domain's part of the image."""
        fragment, domain, extent = self.fragment(self.pixel_body(), []), self.stage.domain, self.image
        names = {"w": extent.width, "h": extent.height, "column": extent.width if self.rows else extent.column}
        if domain.kind == LISTED:
            of = domain.by.extent
            names["entries"] = f"T{self.bind_vertex(domain.by)}(ivec2({of.width - 1}, {of.height - 1}))"
            text, vertices = _LISTED, 12
        elif domain.kind == TILES:
            tiles, (width, height) = domain.by.extent, domain.tile
            names |= {"across": tiles.width, "tw": width, "th": height, "tiles": f"T{self.bind_vertex(domain.by)}"}
            text, vertices = _TILES, 6 * tiles.count
        else:
            return DrawCode(FULLSCREEN, fragment, 3)
        vertex = "\n".join([_HEAD + "\n".join(self.declarations(True)), "void main() {", _mark(text, names), "}", ""])
        return DrawCode(vertex, fragment, vertices)

    @property
    def at(self) -> str:
        """Where a compute shader stores."""
        return f"{self.rows.name}(pixel)" if self.rows else "pixel"

    def leave(self) -> str:
        """Of a compute shader, what is done at a texel where nothing is drawn."""
        stores = [f"imageStore(o{k}, {self.at}, {'i' * is_int(n.vtype)}vec4({outside})); " for k, (n, outside) in
                  enumerate(zip(self.stage.outputs, self.stage.domain.outside)) if outside not in (None, KEPT)]
        return f"{{ {''.join(stores)}return; }}"

    def compute(self) -> DispatchCode:
        """The dispatch of a substage of texels, an invocation each."""
        domain, extent, outputs = self.stage.domain, self.stage.extent, self.stage.outputs
        (w, h), ((width, height), many) = (extent.width, extent.height), shape(self.stage)
        if self.stage.count is not None:
            pixel = (f"int at = int(gl_GlobalInvocationID.x); if (at >= {w * h}) return; "
                     f"ivec2 pixel = {self._place_of('at', extent)};")
        elif w < NARROW:
            x, y = _place("at", w, h) if w > 1 else ("0", "at")
            pixel = f"int at = int(gl_GlobalInvocationID.x); if (at >= {w * h}) return; ivec2 pixel = ivec2({x}, {y});"
        else:
            pixel = "ivec2 pixel = ivec2(gl_GlobalInvocationID.xy);" + (
                f" if (pixel.x >= {w} || pixel.y >= {h}) return;" if w % width or h % height else "")
        body = self.pixel_body()
        if domain.kind == LISTED:
            of = domain.by.extent
            i = f"pixel.y * {w} + pixel.x" if extent.column == w else \
                f"pixel.x / {extent.column} * {extent.column * h} + pixel.y * {extent.column} + pixel.x % {extent.column}"
            entries = f"T{self.bind_vertex(domain.by)}(ivec2({of.width - 1}, {of.height - 1}))"
            body.insert(0, f"if ({i} >= {entries}) {self.leave()}")
        elif domain.kind == TILES:
            tiles = f"T{self.bind_vertex(domain.by)}(pixel / ivec2({domain.tile[0]}, {domain.tile[1]}))"
            body.insert(0, f"if ({tiles} == 0) {self.leave()}")
        outs, stores = [], []
        for k, n in enumerate(outputs):
            i, value = "i" * is_int(n.vtype), self.values[n] + _scale(n, 1)
            whole = value if n.channels == 4 else f"{i}vec4({value}{', 0' * (4 - n.channels)})"
            outs.append(f"layout(set = 0, binding = {len(self.bindings) + k}, {_STORED[format_of(n)]}) uniform writeonly {i}image2D o{k};")
            stores.append(f"imageStore(o{k}, {self.at}, {whole});")
        text = "\n".join([_HEAD + f"layout(local_size_x = {width}, local_size_y = {height}) in;", *self.declarations(None), *outs,
                          *self.functions(), "void main() {", pixel, *body, *stores, "}", ""])
        return DispatchCode(text, (*many, 1))

    def kernel(self) -> DispatchCode:
        """The dispatch of a kernel."""
        node = self.stage.nodes[0]
        kernel, e, k = node.op.kernel_of(node), node.extent, len(self.bindings)
        names = self.names(node)
        names |= {"whole": e.width * e.height, "store": "S0", "add": "A0"}
        across, down = spread(kernel.groups(node))
        place = self.rows.place("(i)") if self.rows else self._place_of("(i)", e)
        access = f"#define S0(i, v) imageStore(o0, {place}, ivec4(v, 0, 0, 0))\n#define A0(i, v) imageAtomicAdd(o0, {place}, v)"
        text = "\n".join([_HEAD + f"layout(local_size_x = {kernel.lanes}) in;", *self.declarations(None),
                          f"layout(set = 0, binding = {k}, {_STORED[format_of(node)]}) uniform {'i' * is_int(node.vtype)}image2D o0;",
                          access, *self.functions(), _mark(kernel.shared, names), "void main() {",
                          f"int lane_ = int(gl_LocalInvocationIndex), group_ = int(gl_WorkGroupID.y) * {across} + int(gl_WorkGroupID.x);",
                          _mark(kernel.body, names), "}", ""])
        return DispatchCode(text, (across, down, 1), kernel.clear)

    def geometry(self) -> list[DrawCode]:
        """The draws of a raster op."""
        node, draws = self.stage.nodes[0], []
        self.values[node] = "v0"
        attrs = node.attrs
        for draw in node.op.draws:
            out = [f"layout(location = {k}) flat out {kind} {name};" for k, (kind, name) in enumerate(draw.varyings)]
            into = [f"layout(location = {k}) flat in {kind} {name};" for k, (kind, name) in enumerate(draw.varyings)]
            names = self.names(node)
            vertex = "\n".join([_HEAD + "\n".join(self.declarations(True)), *out, *self.functions(), "void main() {",
                                _mark(draw.vertex, names), "}", ""])
            body = [f"{node.vtype} v0;", _mark(draw.fragment, names)]
            body = self.loads() + body
            factor, items = draw.vertices
            over = {"count": node.inputs[node.op.params.index(draw.count)]} if draw.count else {
                "views": attrs["views"], "cell": (attrs["cell_w"], attrs["cell_h"], attrs["columns"])}
            draws.append(DrawCode(vertex, self.fragment(body, into), factor * attrs[items], depth=draw.depth_test,
                                  topology=draw.topology, grid=names.asked, **over))
        return draws


def emit(stages: Sequence[Stage], profile: Profile, wide: Mapping[Node, Extent] = MappingProxyType({})) -> tuple[tuple[Code, ...], ...]:
    """The code of each substage of each stage. wide: as `rows.wide_rows` has it."""
    return tuple(tuple(emit_substage(s, profile, merged_reads(stage.substages[:k], s), wide) for k, s in enumerate(stage.substages))
                 for stage in stages)


def emit_substage(stage: Substage, profile: Profile, inner: Collection[Node], wide: Mapping[Node, Extent]) -> Code:
    """The code of a substage. `inner` are read as input attachments, written by an earlier subpass of the same render pass."""
    e = _Emitter(stage, profile, inner, wide)
    if stage.compute:
        dispatch = e.kernel() if stage.kernel else e.compute()
        return Code((), tuple(e.bindings), dispatch)
    draws = e.geometry() if stage.raster else [e.pixels()]
    return Code(tuple(draws), tuple(e.bindings))
