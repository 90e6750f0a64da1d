"""Parts that are made alike are shaded together, as if they were one: a second part of the same kind costs no second pass.

In: parts, in the order in which they are drawn. Out: runs of neighbours, each a part: itself where it is alone, else one with the vertices
and faces of all. Materials are alike if they are records of one kind whose settings are equal, but for what belongs to vertices and
corners, which is put side by side.
"""
from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields, is_dataclass, replace

import numpy as np

from ..graph.ir import Node
from ..graph.ops.join import join
from ..io.mesh import Mesh, side_by_side
from .material import Corner, Vertex
from .part import Part


class _Unlike(Exception):
    pass


def runs(parts: Sequence[Part], materials: bool = True) -> list[tuple[int, int, Part]]:
    """Each run as its first part's number, how many parts there are, and one part for all of them. materials=False: only shapes matter,
    and normals; the part has the material of the first."""
    found: list[tuple[int, list[Part]]] = []
    for k, part in enumerate(parts):
        if found and _alike([*found[-1][1], part], materials):
            found[-1][1].append(part)
        else:
            found.append((k, [part]))
    return [(k, len(run), run[0] if len(run) == 1 else _together(run, materials)) for k, run in found]


def _alike(run: Sequence[Part], materials: bool) -> bool:
    one, other = run[0], run[-1]
    if one.normals != other.normals or (one.mesh.uvs is None) != (other.mesh.uvs is None):
        return False
    try:
        return not materials or _joined([part.material for part in run], run) is not None
    except _Unlike:
        return False


def _together(run: Sequence[Part], materials: bool) -> Part:
    positions = run[0].positions
    for part in run[1:]:
        positions = join(positions, part.positions)
    corners = {}
    for values, index in (("uvs", "uv_faces"), ("normals", "normal_faces")):
        if getattr(run[0].mesh, values) is not None and (values == "uvs" or run[0].normals == "file"):
            corners |= {values: np.concatenate([getattr(part.mesh, values) for part in run]),
                        index: side_by_side([getattr(part.mesh, index) for part in run], [len(getattr(part.mesh, values)) for part in run])}
    counts = [len(part.mesh.positions) for part in run]
    mesh = Mesh(np.concatenate([part.mesh.positions for part in run]), side_by_side([part.mesh.faces for part in run], counts), **corners)
    material = _joined([part.material for part in run], run) if materials else run[0].material
    return Part(" ".join(part.name for part in run), mesh, positions, material, run[0].normals)


def _joined(values: Sequence, run: Sequence[Part]):
    """A setting of all parts of a run as one. Raises _Unlike."""
    one = values[0]
    if all(x is one for x in values):
        if isinstance(one, Vertex | Corner):  # entries of one mesh are none of another's
            raise _Unlike
        return one
    if isinstance(one, Node) or any(type(x) is not type(one) for x in values):
        raise _Unlike
    if isinstance(one, Vertex | Corner):
        tables = [x.table for x in values]
        if any(not isinstance(t, Node) or t.vtype != tables[0].vtype for t in tables):
            raise _Unlike
        table = tables[0]
        for t in tables[1:]:
            table = join(table, t)
        if isinstance(one, Vertex):
            if any(t.extent.count != len(part.mesh.positions) for t, part in zip(tables, run)):
                raise _Unlike  # an error, which the part says by itself
            return Vertex(table)
        if any(np.shape(x.faces) != np.shape(part.mesh.faces) for x, part in zip(values, run)):
            raise _Unlike
        return Corner(table, side_by_side([np.asarray(x.faces) for x in values], [t.extent.count for t in tables]))
    if isinstance(one, tuple | list):
        if any(len(x) != len(one) for x in values):
            raise _Unlike
        return type(one)(_joined(items, run) for items in zip(*values))
    if is_dataclass(one):
        return replace(one, **{f.name: _joined([getattr(x, f.name) for x in values], run) for f in fields(one) if f.init})
    if isinstance(one, int | float | str | bool) and all(x == one for x in values):
        return one
    raise _Unlike
