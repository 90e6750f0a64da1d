"""How soft edges are drawn: widths in pixels, layers, and which distance they are measured by (paper 3.4)."""
from __future__ import annotations

import math
from dataclasses import dataclass

from ....cache.errors import InputError

MAX_LAYERS = 5
DISTANCES = ("outline", "face")
EDGES = ("coverage", "depth", "all")


@dataclass(frozen=True)
class Softness:
    """r, sigma, delta in pixels (defaults of paper 3.4.3: sigma = r / 7, delta = r); layers K.

    distance: "face" is the paper's, to the nearest edge of each layer's face, softened where the edge mask of half width delta says;
    "outline", for one layer, is to the nearest fold or boundary edge of the mesh and softens only pixels beside the outline, so that
    edges inside the shape do not count: its gradient is nearer to that of covered area (docs/numerics.md) and costs less. By default
    outline for one layer without a delta, face otherwise.

    edges, of distance "face": where the edge mask has its edges. "coverage" is the paper's, beside uncovered pixels; "depth": also where
    neighbours are not equally far away (docs/conventions.md); "all": it is 1 everywhere, as in the paper's Figure 7 (c).
    """

    r: float = 2.0
    sigma: float | None = None
    delta: float | None = None
    layers: int = 1
    distance: str | None = None
    edges: str = "coverage"

    def __post_init__(self):
        if not (math.isfinite(self.r) and self.r > 0):
            raise InputError(f"r is {self.r} pixels; a positive number is needed")
        if self.sigma is not None and not (math.isfinite(self.sigma) and self.sigma > 0):
            raise InputError(f"sigma is {self.sigma} pixels; a positive number is needed")
        if self.width < 1e-9:  # 1 / sigma times a distance in pixels must be a number of fp32, and so must its gradient
            raise InputError(f"sigma is {self.width} pixels; at least 1e-9 is needed")
        if self.delta is not None and not (math.isfinite(self.delta) and self.delta >= 0):
            raise InputError(f"delta is {self.delta} pixels; a number >= 0 is needed")
        if not 1 <= self.layers <= MAX_LAYERS:
            raise InputError(f"K is {self.layers}; 1 to {MAX_LAYERS} layers are allowed")
        if self.edges not in EDGES:
            raise InputError(f"edges is {self.edges!r:.40}; allowed: {' '.join(EDGES)}")
        one = self.layers == 1 and self.delta is None and self.edges == "coverage"
        if self.distance is None:
            object.__setattr__(self, "distance", "outline" if one else "face")
        if self.distance not in DISTANCES:
            raise InputError(f"distance is {self.distance!r}; allowed: {' '.join(DISTANCES)}")
        if self.distance == "outline" and not one:
            raise InputError("distance outline is for one layer, without delta and edges; distance face has them")

    @property
    def width(self) -> float:
        """sigma in force."""
        return self.r / 7 if self.sigma is None else self.sigma

    @property
    def reach(self) -> int:
        """Half width of the edge mask's window, delta rounded up."""
        return math.ceil(self.r if self.delta is None else self.delta)
