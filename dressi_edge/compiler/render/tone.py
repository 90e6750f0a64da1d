"""From linear radiance to what is looked at: exposure, tone curves, transfer, as graph; all of it differentiable."""
from __future__ import annotations

from dataclasses import dataclass

from ...cache.errors import GraphError, InputError
from ...cache.layout import beyond_fp32
from ..graph.functions import apply, maximum, minimum, select
from ..graph.ir import UNIT, Node

CURVES = ("linear", "reinhard", "aces", "filmic")
_HABLE = (0.15, 0.50, 0.10, 0.20, 0.02, 0.30)  # shoulder, linear strength and angle, toe strength, numerator, denominator
_HABLE_WHITE = 11.2


def encode_srgb(linear: Node) -> Node:
    """IEC 61966-2-1 transfer of linear values to sRGB, clamped to [0, 1]."""
    x = minimum(maximum(linear, 0.0), 1.0)
    return select(x <= 0.0031308, x * 12.92, 1.055 * apply("pow", maximum(x, 0.0031308), 1.0 / 2.4) - 0.055)


def decode_srgb(encoded: Node) -> Node:
    """IEC 61966-2-1: of sRGB values in [0, 1] the linear ones; clamped."""
    x = minimum(maximum(encoded, 0.0), 1.0)
    return select(x <= 0.04045, x * (1.0 / 12.92), apply("pow", (maximum(x, 0.04045) + 0.055) * (1.0 / 1.055), 2.4))


@dataclass(frozen=True)
class Tone:
    """Radiance times 2^exposure, through a curve, then encoded; a scene's `encode`.

    curve: "linear" leaves it; "reinhard" is x (1 + x / white^2) / (1 + x), 1 at `white` (Reinhard et al. 2002, equation 4); "aces" the fit
    of the ACES curve by Narkowicz (2015); "filmic" Hable's (2010) of twice the radiance, 1 at radiance 5.6. exposure: in stops, a number
    or a float of extent 1x1: a parameter. srgb: encodes what the curve gives, clamped to [0, 1]; else it stays linear. Of negative
    radiance all curves but "linear" give what they give of 0. Raises InputError, GraphError.
    """

    curve: str = "linear"
    exposure: float | Node = 0.0
    white: float = 4.0
    srgb: bool = True

    def __post_init__(self) -> None:
        if self.curve not in CURVES:
            raise InputError(f"tone curve {self.curve!r:.40}; {' '.join(CURVES)} are allowed")
        if isinstance(self.exposure, Node):
            if (self.exposure.vtype, self.exposure.extent) != ("float", UNIT):
                raise GraphError(f"tone: exposure is {self.exposure!r}; a float of extent 1x1 is needed")
        elif not isinstance(self.exposure, (int, float)) or not abs(self.exposure) <= 60:
            raise InputError(f"tone: exposure is {self.exposure!r:.40}; stops from -60 to 60 are needed")
        if not isinstance(self.white, (int, float)) or beyond_fp32(self.white) or not self.white > 0:
            raise InputError(f"tone: white is {self.white!r:.40}; a number above 0 is needed")

    def __call__(self, linear: Node) -> Node:
        factor = apply("exp2", self.exposure) if isinstance(self.exposure, Node) else 2.0 ** self.exposure
        y = curve(linear * factor, self.curve, self.white)
        return encode_srgb(y) if self.srgb else y


def curve(x: Node, name: str, white: float = 4.0) -> Node:
    """One of CURVES at radiance x, channel by channel."""
    if name == "linear":
        return x
    x = maximum(x, 0.0)
    if name == "reinhard":
        return x * (1.0 + x * (1.0 / white ** 2)) / (1.0 + x)
    if name == "aces":
        x = minimum(x, 1e4)  # its squares stay finite
        return x * (2.51 * x + 0.03) / (x * (2.43 * x + 0.59) + 0.14)
    x = minimum(x * 2.0, 1e4)
    return _hable(x) * (1.0 / _hable(_HABLE_WHITE))


def _hable(x):
    a, b, c, d, e, f = _HABLE
    return (x * (x * a + c * b) + d * e) / (x * (x * a + b) + d * f) - e / f
