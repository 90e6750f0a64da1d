"""Phases that see another view each step of a shape at rest: what depends on a view alone is made once for each, and kept while there is
memory (`cache/kept.py`).

The bundle's own images hold what was made last, of one view. `Copy`s hold it of others, and a step of a view that has one is recorded
on its images instead: nothing is moved, and a submission has steps of as many views as have copies. The first views to come have
them, until the memory is used up; the others are made when they are needed.

In: a session, in which this has the rights of a method. Out: what runs before a plan, and on which images it runs.
"""
from __future__ import annotations

import functools
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from ..cache import vulkan as v
from ..cache.errors import DeviceError
from ..cache.kept import Turn, part, turns
from . import vk
from .memory import Images, image_bytes
from .record import wait
from .running import prepare, submit
from .transfer import read, to_general, upload

if TYPE_CHECKING:
    from .plans import Plan
    from .session import Session

USUAL_BYTES = 1 << 29  # for what is kept, unless the bundle says how much all images may take
HEAP_SHARE = 2  # of the memory that a device has beside the bundle's images, one part in so many


@dataclass(eq=False)
class Copy:
    """number: its own. images: those of the bundle with its results in their place. own: what it holds. seen: by plan, the versions of
    what its results were made of."""

    number: int
    handles: list
    views: list
    own: Images
    seen: dict[str, tuple[int, ...]]


class Kept:
    """turns: by plan that sees one view a step. images: those of which there may be copies."""

    def __init__(self, session: Session):
        self.s = session
        found = turns(session.bundle.description, session._reactive.rules)
        self.turns: dict[str, Turn] = {name: turn for turn in found for name in turn.readers}
        self.images = {image for turn in found for image in turn.images}
        self.inputs = tuple(turn.input for turn in found)
        self._shown: dict[str, int | None] = dict.fromkeys(self.inputs)  # by input, the view whose number its image holds
        self._copies: dict[str, dict[int, Copy]] = {name: {} for name in self.inputs}
        self.bytes = self._made = 0

    def close(self) -> None:
        """Give everything back; nothing may be running."""
        for copies in self._copies.values():
            for copy in copies.values():
                copy.own.close()
            copies.clear()
        self.bytes = 0

    def copied(self, records: list[dict]) -> list[dict]:
        """The bundle's images as they are to be made: those of which there may be copies can be copied from."""
        return [{**x, "usage": x["usage"] | v.USAGE_TRANSFER_SRC} if k in self.images else x for k, x in enumerate(records)]

    def counters(self) -> dict[str, str]:
        """By plan, the state that counts its steps."""
        return {name: turn.counter for name, turn in self.turns.items()}

    def report(self) -> dict[str, int]:
        """By phase, of how many views there are copies."""
        return {name: len(self._copies[turn.input]) for name, turn in self.turns.items() if name in self.s.phases}

    def unseen(self, names) -> list:
        """What is true once these have new values: the images of views' numbers hold others."""
        return [(self._shown, name, None) for name in names if name in self._shown]

    # ---- before a plan runs, and which images it takes

    def look(self, plan: Plan) -> None:
        """Say which view a plan will see: the version of its input stands for that."""
        turn = self.turns.get(plan.name)
        if turn is not None:
            self.s._reactive.version[turn.input] = _version(self._view(turn, 0))
            self.s._reactive.given[turn.input] = True

    def _view(self, turn: Turn, ahead: int) -> int:
        return turn.view(self.s._counters.value(turn.counter) + ahead)

    def prepare(self, plan: Plan) -> None:
        """Have the bundle's own images hold what belongs to the plan's view."""
        s, turn = self.s, self.turns.get(plan.name)
        if turn is not None and self._shown[turn.input] != (view := self._view(turn, 0)):
            handle, record = s._handle(s.values[turn.input]["image"])
            upload(s._work, s._staging, [(handle, record, np.array([view], np.int32).view(np.uint8))], [(self._shown, turn.input, view)])
        prepare(s, plan)

    def run(self, plan: Plan, n: int) -> int:
        """Run at most n iterations of a plan that sees a view in one submission; how many."""
        s, turn = self.s, self.turns[plan.name]
        if not plan.states:
            self.prepare(plan)
            submit(s, plan)
            return 1
        first = self._fresh(turn, self._view(turn, 0))
        if first is None:
            self.prepare(plan)
            first = self._keep(turn, self._view(turn, 0))
        else:
            prepare(s, plan, turn.makes)
        copies = [first]
        while len(copies) < n and (copy := self._fresh(turn, self._view(turn, len(copies)))) is not None:
            copies.append(copy)
        submit(s, plan, len(copies), copies)
        return len(copies)

    def _fresh(self, turn: Turn, view: int) -> Copy | None:
        """The copy of a view, if what it was made of is as it was."""
        copy, reactive = self._copies[turn.input].get(view), self.s._reactive
        known = {turn.input: _version(view)}
        stale = copy is None or any(copy.seen.get(name) != reactive.versions(reactive.rules[name], known) for name in turn.makes)
        return None if stale else copy

    def _keep(self, turn: Turn, view: int) -> Copy | None:
        """Copy what was just made of a view, if there is room."""
        s = self.s
        records = self._records(turn)
        copy = self._room(turn, view, records)
        if copy is None:
            return None
        copies = [(s._images.handles[image][0], record, handle)
                  for image, record, (handle,) in zip(turn.images, records, copy.own.handles)]

        def move(c: int) -> None:
            wait(c, s._work.compute)
            to_general(copy.own, c)
            for source, record, target in copies:
                vk.CmdCopyImage(c, source, vk.VK_IMAGE_LAYOUT_GENERAL, target, vk.VK_IMAGE_LAYOUT_GENERAL, [_whole(record)])
            wait(c, s._work.compute)

        seen = {name: s._reactive.seen(name) for name in turn.makes}
        s._work.once(move, [(copy.seen, name, versions) for name, versions in seen.items()])
        return copy

    def _records(self, turn: Turn) -> list[dict]:
        """The images of a copy of what was just made: of lists as much as there are entries in."""
        s, sizes = self.s, {}

        def counted(total: int, place: np.ndarray) -> None:
            sizes[total] = int(place.view(np.int32)[0])

        readers = []
        for total in sorted({total for total, _ in turn.lists.values()}):
            handle, record = s._handle(total)
            last = {**record, "x": record["width"] - 1, "y": record["height"] - 1, "width": 1, "height": 1}
            readers.append((handle, last, functools.partial(counted, total)))
        if readers:
            read(s._work, s._staging, readers)
        found = []
        for image in turn.images:
            record = s._d["images"][image]
            width, height = record["width"], record["height"]
            if image in turn.lists:
                total, column = turn.lists[image]
                width, height = part((width, height), column, sizes[total])
            found.append({**record, "usage": record["usage"] | v.USAGE_TRANSFER_DST, "width": width, "height": height})
        return found

    def _room(self, turn: Turn, view: int, records: list[dict]) -> Copy | None:
        """A copy of a view, which holds nothing; None once there is no memory for more."""
        s, copies = self.s, self._copies[turn.input]
        old = copies.get(view)
        if old is not None:
            old.seen.clear()
            if all(a[side] >= b[side] for side in ("width", "height") for a, b in zip(old.own.records, records)):
                return old
            self._drop(turn, view)
        most = USUAL_BYTES if turn.memory is None else max(0, turn.memory - s._images.bytes)
        most = most if turn.room is None else min(most, max(0, turn.room - s._images.bytes))
        most = min(most, max(0, max(s.device.local_heaps, default=0) - s._images.bytes) // HEAP_SHARE)
        if self.bytes + sum(map(image_bytes, records)) > most:
            return None
        try:
            own = Images(s.device, records, s._depth_format)
        except DeviceError:
            return None
        if self.bytes + own.bytes > most:
            own.close()
            return None
        self.bytes += own.bytes
        handles, views = list(s._images.handles), list(s._images.views)
        for image, handle, seen in zip(turn.images, own.handles, own.views):
            handles[image], views[image] = handle, seen
        self._made += 1
        copies[view] = Copy(self._made, handles, views, own, {})
        return copies[view]

    def _drop(self, turn: Turn, view: int) -> None:
        """Give a copy back, and what was recorded on it."""
        copy = self._copies[turn.input].pop(view)
        for name in turn.readers:
            recordings = self.s._plans[name].recordings
            for key in [key for key in recordings if len(key) > len(self.s._plans[name].slots) and key[-1] == copy.number]:
                recordings.pop(key).close()
        self.bytes -= copy.own.bytes
        copy.own.close()


def _version(view: int) -> int:
    """Of an input that says which view is seen: no other value has it."""
    return -1 - view


def _whole(record: dict):
    layers = (vk.VK_IMAGE_ASPECT_COLOR_BIT, 0, 0, 1)
    return vk.VkImageCopy(layers, (0, 0, 0), layers, (0, 0, 0), (record["width"], record["height"], 1))
