"""Renderers: clip coordinates, topology and an atlas in; layers of fragments and their blends out."""
from __future__ import annotations

from ...graph.ir import Node
from ..atlas import Atlas
from ..topology import Topology
from .fragments import Layer, near_faces
from .layers import Layers
from .outline import Outline
from .softness import DISTANCES, MAX_LAYERS, Softness

__all__ = ["DISTANCES", "Layer", "Layers", "MAX_LAYERS", "Outline", "Softness", "near_faces", "rasterized"]


def rasterized(clip: Node, topology: Topology, atlas: Atlas, softness: Softness, near: float, faces: bool = True) -> Outline | Layers:
    """A mesh rasterized as `softness` says: clip coordinates (views x vertices), `near` the smallest w in front of the cameras.
    faces: what pixels show is asked for, colours or attributes; without, only silhouettes, whose layers have no `face` and which draw
    half of a closed surface (`ops/raster.py`)."""
    return (Outline if softness.distance == "outline" else Layers)(clip, topology, atlas, softness, near, faces)
