"""Renderers: clip coordinates, topology and an atlas in; layers of fragments and their blends out."""
from .binned import MOST, Binned, BinnedFragments
from .fragments import Fragments, Layer, Span, near_faces
from .layers import PeeledFragments
from .outline import OutlineFragments
from .renderer import HardSoftRas, Outline, Renderer, rasterized, renderer_of
from .softness import DISTANCES, EDGES, MAX_LAYERS, Softness

__all__ = ["Binned", "BinnedFragments", "DISTANCES", "EDGES", "Fragments", "HardSoftRas", "Layer", "MAX_LAYERS", "MOST", "Outline",
           "OutlineFragments", "PeeledFragments", "Renderer", "Softness", "Span", "near_faces", "rasterized", "renderer_of"]
