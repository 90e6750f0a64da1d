"""Parts of a scene: a mesh with vertices of its own and a material. All parts are drawn together.

In: parts. Out: one topology, clip coordinates of all vertices, and which faces are whose (`Span`). Of a part that nothing moves all
tables are computed once (the reactive cache), for they are made part by part and joined last.
"""
from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ...cache.errors import InputError
from ..graph.ir import Node, topological
from ..graph.ops.join import join
from ..io.mesh import NORMALS, Mesh
from .camera import ViewTable, to_clip
from .raster import Span
from .topology import Topology


@dataclass(frozen=True, eq=False)
class Part:
    """positions: a vec3 table of as many vertices as the mesh has. material: surface -> vec3 (`material.py`). normals: "smooth" (of the
    vertices as they are now), "flat" (of the faces as they are now) or "file" (the mesh's own, which do not turn with it).
    Raises InputError."""

    name: str
    mesh: Mesh
    positions: Node
    material: Callable
    normals: str = "smooth"

    def __post_init__(self) -> None:
        if self.normals not in NORMALS:
            raise InputError(f"part {self.name}: normals are {self.normals!r:.40}; allowed: {' '.join(NORMALS)}")
        if self.normals == "file" and self.mesh.normals is None:
            raise InputError(f"part {self.name}: its mesh has no normals of its own; use smooth or flat")
        p, count = self.positions, len(self.mesh.positions)
        if not isinstance(p, Node) or p.vtype != "vec3" or p.extent.count != count:
            found = f"{p!r} of {p.extent.count} entries" if isinstance(p, Node) else f"{p!r:.60}"
            raise InputError(f"part {self.name}: its positions are {found}; a vec3 table of the mesh's {count} vertices is needed")
        if not callable(self.material):
            raise InputError(f"part {self.name}: its material is {self.material!r:.60}; a function surface -> vec3 is needed")

    @cached_property
    def topology(self) -> Topology:
        return Topology(np.asarray(self.mesh.faces), len(self.mesh.positions))

    @cached_property
    def rests(self) -> bool:
        """Whether nothing that a session can set or update moves its vertices."""
        return not any(n.op.stage == "leaf" and "name" in n.attrs for n in topological([self.positions]))


@dataclass(frozen=True, eq=False)
class Parts:
    """All parts of a scene, in the order in which they were added."""

    parts: Sequence[Part]

    @cached_property
    def topology(self) -> Topology:
        """Of all faces that have three different corners, part after part."""
        if len(self.parts) == 1:
            return self.parts[0].topology
        faces = [part.topology.faces + first for part, first in zip(self.parts, self.first_vertex)]
        return Topology(np.concatenate(faces), self.vertex_count)

    @property
    def vertex_count(self) -> int:
        return sum(len(part.mesh.positions) for part in self.parts)

    @property
    def first_vertex(self) -> list[int]:
        return list(np.cumsum([0, *(len(part.mesh.positions) for part in self.parts)])[:-1])

    @cached_property
    def first_face(self) -> list[int]:
        return [int(k) for k in np.cumsum([0, *(len(part.topology.faces) for part in self.parts)])[:-1]]

    def span(self, k: int, topology: Topology) -> Span | None:
        """The faces of a topology that begins with part k; None where they are all."""
        return None if len(topology.faces) == len(self.topology.faces) else Span(topology, self.first_face[k], int(self.first_vertex[k]))

    def clip(self, views: ViewTable) -> Node:
        """Clip coordinates of all vertices, a view-major table. Neighbours that both move, or both rest, are projected together; what
        rests is projected once, before anything runs."""
        joined, runs = None, [[self.parts[0]]]
        for part in self.parts[1:]:
            if part.rests == runs[-1][0].rests:
                runs[-1].append(part)
            else:
                runs.append([part])
        for run in runs:
            positions = run[0].positions
            for part in run[1:]:
                positions = join(positions, part.positions)
            clip = to_clip(positions, views)
            joined = clip if joined is None else join(joined, clip, views.count)
        return joined
