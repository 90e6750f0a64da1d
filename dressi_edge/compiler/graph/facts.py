"""What an op of the table knows of lists: how it is read or summed where of an image there is only a list of some texels. `Op.listed` and
`Op.ordered` give these for a node; passes ask for them.
"""
from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from .ir import Node


@dataclass(frozen=True)
class Listed:
    """How a node reads input 0 where of that only a list of texels is kept (`compiler/passes/lists.py`): `find` makes the node's places in
    it from an image of places, one for each texel (counted from 1, 0: not in the list), `read` the same values from list and places."""

    find: Callable[[Node], Node]
    read: Callable[[Node, Node], Node]


@dataclass(frozen=True)
class InOrder:
    """How a node sums over pixels of which there is a list in the order of the sum (`compiler/passes/ordered.py`). pixels: the numbers of
    the listed pixels. flag: an image that is not 0 there. total: of the sum, from the values of input 0 at the listed pixels, and a
    function that takes other images of the pixels there."""

    pixels: Node
    flag: Node
    total: Callable[[Node, Callable[[Node], Node]], Node]
