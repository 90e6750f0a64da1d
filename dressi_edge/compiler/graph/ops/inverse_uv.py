"""Inverse UV (paper 3.3.2, Algorithm 1): for each texel one pixel that samples it, by drawing every pixel as a point.

Where several pixels fall on a texel the last in row-major order stays, by Vulkan's primitive order: it is deterministic. Each
step adds a point of a Sobol sequence before the texel is rounded down, so that each of the four texels of a bilinear read is
hit with its weight as probability. Over the steps the stored pixel's gradient is unbiased where a texel has one pixel; where it
has many, each step takes one of them.
"""
from __future__ import annotations

import numpy as np

from ....cache.errors import GraphError
from ..ir import UNIT, image, is_int
from ..optable import Draw, apply, op
from .lookup import constant
from .texture import WRAPS, _infer, _sample_glsl, _sample_ref, _wrap

BITS = 30


def _directions() -> tuple[list[int], list[int]]:
    """Direction numbers of two dimensions (Joe and Kuo 2008): bit reversal; the polynomial x + 1 with m = 1, 3, 5, 15, ..."""
    m = [1]
    while len(m) < BITS:
        m.append(2 * m[-1] ^ m[-1])
    return [1 << (BITS - 1 - k) for k in range(BITS)], [x << (BITS - 1 - k) for k, x in enumerate(m)]


FIRST, SECOND = _directions()


def _sobol_ref(index):
    gray = index[..., 0] ^ (index[..., 0] >> 1)
    points = np.zeros((*gray.shape, 2), np.int64)
    for k in range(BITS):
        points ^= ((gray >> k & 1)[..., None] * np.array([FIRST[k], SECOND[k]]))
    return (points >> (BITS - 24)) * 2.0 ** -24


def _sobol_infer(name, inputs, attrs):
    if inputs[0].vtype != "int":
        raise GraphError(f"{name}: an int is needed, got {inputs[0]!r}")
    return "vec2", inputs[0].extent


op("sobol", "index", infer=_sobol_infer, ref=_sobol_ref, cost=200,
   sample=lambda rng: ([rng.integers(0, 1 << 24, (4, 5, 1))], {}),
   functions=f"""
const int SOBOL[{BITS}] = int[]({', '.join(map(str, SECOND))});
// Point n of the two-dimensional Sobol sequence in Gray code order, 24 bits of each coordinate, in [0, 1).
vec2 sobol(int n) {{
    int gray = n ^ (n >> 1);
    ivec2 point = ivec2(0);
    for (int k = 0; k < {BITS}; ++k) if ((gray >> k & 1) != 0) point ^= ivec2(1 << ({BITS - 1} - k), SOBOL[k]);
    return vec2(point >> {BITS - 24}) * 5.9604644775390625e-8;
}}
""", glsl="{y} = sobol({index});",
   doc="Point `index` >= 0 of the two-dimensional Sobol sequence, not scrambled, in Gray code order; in [0, 1).")


def _inverse_infer(name, inputs, attrs):
    uv, covered, offset = inputs
    if uv.vtype != "vec2" or covered.vtype != "int" or offset.vtype != "vec2" or offset.extent != UNIT:
        raise GraphError(f"{name}: vec2 coordinates, an int mask, a 1x1 vec2 are needed, got {uv!r}, {covered!r}, {offset!r}")
    if uv.extent != covered.extent:
        raise GraphError(f"{name}: the mask {covered!r} needs the extent of {uv!r}")
    if attrs["wrap"] not in WRAPS:
        raise GraphError(f"{name}: wrap {attrs['wrap']!r}; {' or '.join(WRAPS)} is allowed")
    return "int", attrs["extent"]


def _inverse_ref(uv, covered, offset, extent, wrap, pixels, **_):
    k = np.floor(uv * np.array([extent.width, extent.height]) - 0.5 + offset).astype(np.int64)
    texel = _wrap(k[..., 1], extent.height, wrap) * extent.width + _wrap(k[..., 0], extent.width, wrap)
    out = np.full(extent.width * extent.height, -1)
    found = np.flatnonzero(covered.ravel()[:pixels])
    out[texel.ravel()[found]] = found  # of equal indices NumPy keeps the last
    return out.reshape(extent.height, extent.width, 1)


def _points(rng):
    return [rng.uniform(-1, 2, (6, 5, 2)), rng.integers(0, 2, (6, 5, 1)), np.array([[[0.25, 0.75]]])], {
        "extent": image(4, 3), "wrap": "repeat", "pixels": 29, "cell_w": 4, "cell_h": 3, "columns": 1, "views": 1}


_POINT = """
found = gl_VertexIndex;
gl_PointSize = 1.0;
gl_Position = vec4(2.0, 2.0, 0.0, 1.0);
if ({covered_at}(gl_VertexIndex) != 0) {
    ivec2 size = ivec2({cell_w}, {cell_h});
    vec2 texel = floor({uv_at}(gl_VertexIndex) * vec2(size) - 0.5 + {offset_at}(0));
    gl_Position = vec4((vec2({wrap}_texel(ivec2(clamp(texel, -2e9, 2e9)), size)) + 0.5) * 2.0 / vec2(size) - 1.0, 0.0, 1.0);
}
"""
op("inverse_uv", "uv covered offset", attrs="extent wrap pixels cell_w cell_h columns views", infer=_inverse_infer,
   reads="vertex vertex vertex", stage="raster", ref=_inverse_ref, cost=300, sample=_points,
   functions="""
ivec2 repeat_texel(ivec2 k, ivec2 size) { return (k % size + size) % size; }
ivec2 clamp_texel(ivec2 k, ivec2 size) { return clamp(k, ivec2(0), size - 1); }
""", draws=(Draw(_POINT, "{y} = found;\n", (("int", "found"),), vertices=(1, "pixels"), topology="points", depth_test=False),),
   doc="For each texel the last pixel that the offset rounds to it, or -1.")


def inverse_uv(uv, covered, step, extent, wrap):
    """The pixel of each texel of a texture of `extent` at this step, or -1."""
    return apply("inverse_uv", uv, covered, apply("sobol", step), extent=extent, wrap=wrap, pixels=uv.extent.count,
                 cell_w=extent.width, cell_h=extent.height, columns=1, views=1)


def _inverse_vjp(g, y, texture, uv, covered, step, wrap):
    uv_, covered_ = (x if x.extent == y.extent else apply("broadcast", x, extent=y.extent) for x in (uv, covered))
    return (apply("lookup", g, inverse_uv(uv_, covered_, step, texture.extent, wrap)),
            apply("sample_uv_gradient", texture, uv, g, wrap=wrap), None, None)


def _step_infer(name, inputs, attrs):
    if not is_int(inputs[3].vtype) or inputs[3].extent != UNIT:
        raise GraphError(f"{name}: the step counter {inputs[3]!r} is not a 1x1 int")
    return _infer(name, inputs, attrs)


def _centres(rng):
    """Each pixel at the centre of a texel of its own: here the gradient of the texture is exact."""
    uv = np.stack(np.meshgrid((rng.permutation(8) + 0.5) / 8, (rng.permutation(4) + 0.5) / 4), 2)
    return [rng.normal(size=(4, 8, 3)), constant(uv), np.ones((4, 8, 1), np.int64), np.array([[[3]]])], {"wrap": "repeat"}


op("sample_inverse", "texture uv covered step", infer=_step_infer, reads="filtered own own own", cost=40, glsl=_sample_glsl,
   ref=lambda texture, uv, covered, step, wrap: _sample_ref(texture, uv, wrap), vjp=_inverse_vjp,
   sample=_centres,
   doc="Bilinear sample of a texture that is optimized; the texture's gradient is by design the stochastic one of Algorithm 1.")
