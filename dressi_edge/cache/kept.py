"""Results that are kept for each view: what a bundle says of them (docs/bundle-format.md, "Views that are kept"), and which plans and
images it concerns.

In: meta.kept and the rules of the plans. Out: `Turn`s. Nothing here knows a device.
"""
from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from .bundle_plans import bound, counts, written
from .copies import PHASE
from .errors import BundleError
from .reactive import Rule
from .vulkan import FORMATS


@dataclass(frozen=True)
class Turn:
    """What happens view by view. input: the name of the input that says which view the next step sees. counter: the state that counts
    steps. order: (n,) int32, the view of each step, after which it begins again. memory: bytes for all images, what is kept included,
    or None; room: the same where it was not asked for, within which no more is kept than is usual. makes: the plans that a phase needs and
    whose results depend on the view; images: those results; lists: of those that are lists, the image whose last texel says how many
    entries there are, and how wide the columns are in which they lie. readers: the plans that a user runs and that see the view."""

    input: str
    counter: str
    order: np.ndarray
    memory: int | None
    room: int | None
    makes: tuple[str, ...]
    images: tuple[int, ...]
    lists: Mapping[int, tuple[int, int]]
    readers: tuple[str, ...]

    def view(self, step: int) -> int:
        """The view of a step."""
        return int(self.order[step % len(self.order)])


def turns(d: Mapping, rules: Mapping[str, Rule]) -> list[Turn]:
    """What a description says is kept. Raises BundleError."""
    values, found = {value["name"]: value for value in d["values"]}, []
    try:
        for x in d["meta"].get("kept", ()):
            order = np.frombuffer(x["order"], "<i4")
            shown, counter = values[x["input"]], values[x["counter"]]
            if (shown["role"], shown["type"], shown["layout"]) != ("input", "int", "unit") or not len(order) or order.min() < 0:
                raise ValueError("input or order")
            if (counter["role"], counter["type"], counter["layout"]) != ("state", "int", "unit"):
                raise ValueError("counter")
            memory, room = x["memory"], x.get("room")
            if any(size is not None and (type(size) is not int or size < 0) for size in (memory, room)):
                raise ValueError("memory or room")
            seeing = [rule for rule in rules.values() if x["input"] in rule.inputs]
            phases = [rule for rule in seeing if rule.kind == PHASE]
            makes = tuple(rule.name for rule in seeing if any(rule.name in phase.needs for phase in phases))
            images = _results(d, phases, makes, shown["image"])
            found.append(Turn(x["input"], x["counter"], order, memory, room, makes, images, _lists(d, x["lists"], images),
                              tuple(rule.name for rule in seeing if rule.kind == PHASE or rule.outputs)))
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise BundleError(f"meta.kept is malformed ({error}); compile the bundle again") from None
    return found


def _results(d: Mapping, phases: list[Rule], makes: tuple[str, ...], shown: int) -> tuple[int, ...]:
    """The images that these plans fill, or that of the view's number, and that phases read without filling them."""
    plans = {plan["name"]: plan for plan in d["plans"]}
    filled = {shown, *(ref // 2 for name in makes for stage in plans[name]["stages"] for ref in written(stage))}
    results: set[int] = set()
    for phase in phases:
        mine: set[int] = set()
        for stage in plans[phase.name]["stages"]:
            results |= {ref // 2 for ref in (*bound(stage), *counts(stage)) if ref // 2 in filled and ref // 2 not in mine}
            mine |= {ref // 2 for ref in written(stage)}
    return tuple(sorted(results))


def _lists(d: Mapping, rows: list, images: tuple[int, ...]) -> dict[int, tuple[int, int]]:
    """Image -> image with the number of its entries and the width of its columns, of those that are kept."""
    found = {}
    for image, total, column in rows:
        if image in images:
            if total not in images or d["images"][total]["format"] != FORMATS["R32_SINT"] or d["images"][image]["width"] % column:
                raise ValueError("lists")
            found[image] = total, column
    return found


def part(size: tuple[int, int], column: int, count: int) -> tuple[int, int]:
    """What of an image of this size its first `count` entries need, which lie in columns of this width, in a column row by row."""
    width, height = size
    columns = max(1, -(-count // (column * height)))
    return min(columns * column, width), height if columns > 1 else max(1, -(-count // column))
