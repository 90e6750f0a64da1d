"""Values of a session that are had one view at a time: pictures that come to the device as steps need them (`cache/feed.py`), outputs that
draw one view, and single views of whatever holds several.

In: a session, in which this has the rights of a method. Out: what is in which slot before a plan runs.
"""
from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import TYPE_CHECKING

import numpy as np

from ..cache import vulkan as v
from ..cache.errors import BundleError, InputError
from ..cache.feed import KINDS, Feed
from ..cache.layout import Layout, is_int, received
from .ahead import Ahead
from .transfer import upload
from .values import KIND, get, known, put, stored

if TYPE_CHECKING:
    from .plans import Plan
    from .session import Session

TOGETHER_BYTES = 1 << 24  # of pictures that go to the device in one submission


class Fed:
    """feed: what the bundle says of its pictures, or None. name: of the value that they fill, or None."""

    def __init__(self, session: Session):
        self.s, self.feed, self.name, self._ahead = session, None, None, None
        if (meta := session.bundle.description["meta"].get("pictures")) is not None:
            self.feed = Feed(meta, session.values, session.bundle.blob, len(session.bundle.description["blobs"]))
            self.name, self._ahead = self.feed.name, Ahead(self.feed.rows)

    def close(self) -> None:
        """Nothing is read ahead any more."""
        if self._ahead is not None:
            self._ahead.close()

    def counters(self) -> dict[str, str]:
        """By plan, the state that counts its steps."""
        return {} if self.feed is None else self.feed.steps

    # ---- values

    def has(self, name: str) -> bool:
        """Whether a value is the feed's, or an output that draws one view at a time."""
        return self.feed is not None and (name == self.name or name in self.feed.shown)

    def shape(self, name: str, shape: tuple[int, ...]) -> tuple[int, ...]:
        """The array shape of a value that `has`; of its image: shape."""
        return self.feed.shape if name == self.name else (self.feed.views, *shape[1:])

    def get(self, name: str, view: int | None) -> np.ndarray:
        """All views of a value that `has`, or one view of any. Raises InputError."""
        s = self.s
        value = known(s, name, ("input", "state", "output"))
        kind = KIND[is_int(value["type"])]
        if not self.has(name):
            return self._cell(value, view, kind)
        one = self._picture if name == self.name else self._drawn
        if view is not None:
            return one(name, number(view, self.feed.views))
        out = np.empty(s.shape(name), np.float32 if name == self.name else kind)
        for k in range(self.feed.views):
            out[k] = one(name, k)
        return out

    def _picture(self, name: str, view: int) -> np.ndarray:
        with self.s.alone():
            return np.array(self.feed.floats(self._ahead.rows(view)))

    def _drawn(self, name: str, view: int) -> np.ndarray:
        with self.s.alone():
            self.s.set(self.feed.shown[name], view)
            return self._cell(self.s.values[name], 0, KIND[is_int(self.s.values[name]["type"])])

    def _cell(self, value: dict, view: int, kind: type) -> np.ndarray:
        s, cell = self.s, self._record(value, view)
        layout = Layout("image", value["type"], cell["width"], cell["height"])
        out = np.empty(layout.shape, kind)
        get(s, {value["name"]: lambda place: layout.take(self._pixels(value, cell, place), out)}, {value["name"]: cell})
        return out

    def set(self, name: str, array, view: int | None) -> None:
        """New pictures, all or one: of the feed they go to the device when they are needed, of any other value at once. Raises
        InputError."""
        s = self.s
        value = known(s, name, ("input", "state"))
        if name == self.name:
            return self._give(array, view)
        cell = self._record(value, view)
        if not s._reactive.given.get(name, True):
            raise InputError(f"{name} has no value yet; set all of it first")
        layout = Layout("image", value["type"], cell["width"], cell["height"])
        array = layout.checked(array, f"{name}, view {view}", stored(s, value) is np.float16)
        put(s, [(name, lambda place: layout.fill(self._pixels(value, cell, place), array))], cells={name: cell})

    def _record(self, value: dict, view: int) -> dict:
        """The part of an image of pictures that is one of them, as a record of its own."""
        if value["layout"] != "atlas":
            raise InputError(f"{value['name']} has no views; leave view away")
        k, image = number(view, value["count"]), self.s._d["images"][value["image"]]
        x, y = k % value["columns"] * value["width"], k // value["columns"] * value["height"]
        return {**image, "x": x, "y": y, "width": value["width"], "height": value["height"]}

    def _pixels(self, value: dict, cell: dict, place: np.ndarray) -> np.ndarray:
        return place.view(stored(self.s, value)).reshape(cell["height"], cell["width"], -1)

    # ---- pictures

    def pictures(self, read_: Callable[[int], np.ndarray]) -> None:
        """`Session.pictures`."""
        if self.feed is None:
            raise InputError("the bundle has its pictures, all of them on the device; give others with set()")
        self._change(lambda: setattr(self.feed, "source", read_), range(self.feed.views))

    def ready(self) -> None:
        """`Session.ready`."""
        if self.feed is not None:
            self.feed.check()

    def _give(self, array, view: int | None) -> None:
        feed, array = self.feed, received(array, self.feed.name)
        if view is None and array.shape != feed.shape:
            raise InputError(f"{feed.name} has shape {array.shape}; {feed.shape} is needed")
        views = range(feed.views) if view is None else [number(view, feed.views)]
        new = {k: feed.packed(array if view is not None else array[k], f"{feed.name}, view {k}").copy() for k in views}
        self._change(lambda: feed.given.update(new), views)

    def _change(self, change: Callable[[], object], views: Iterable[int]) -> None:
        with self.s.alone():
            self.s._work.settle()
            self._ahead.forget()
            change()
            views = set(views)
            for slot in [slot for slot, view in self.feed.held.items() if view in views]:
                del self.feed.held[slot]
            for mapping, key, new in self.s._reactive.set([self.name]):
                mapping[key] = new

    # ---- before a plan runs

    def most(self, plan: Plan, usual: int) -> int:
        """How many iterations of a plan one submission may have: those whose pictures are on the device together."""
        fed = self.feed is not None and self.feed.order is not None and plan.name in self.feed.steps
        return min(usual, self.feed.slots) if fed else usual

    def fill(self, plan: Plan, n: int) -> None:
        """Bring the pictures that n iterations of a plan need to the device, and have the next ones come. Raises InputError where there
        are none."""
        feed, s = self.feed, self.s
        if feed is None or feed.name not in plan.rule.inputs:
            return
        n, step = min(n, feed.slots), 0
        if feed.order is not None:
            if plan.name not in feed.steps:
                raise BundleError(f"meta.pictures does not say which steps {plan.name} counts; compile the bundle again")
            step = s._counters.value(feed.steps[plan.name])
        wanted = feed.wanted(plan.name, step, n)
        self._ahead.expect(wanted.values())
        value = s.values[feed.name]
        handle, image = s._handle(value["image"])
        together = max(1, TOGETHER_BYTES // (feed.size[0] * feed.size[1] * v.TEXEL_BYTES[image["format"]]))
        slots = list(wanted)
        for some in (slots[k:k + together] for k in range(0, len(slots), together)):
            copies = []
            for slot in some:
                x, y = feed.cell(slot)
                rows = np.ascontiguousarray(self._ahead.rows(wanted[slot]), KINDS[feed.bits] if feed.bits < 32 else stored(s, value))
                cell = {**image, "x": x, "y": y, "width": feed.size[0], "height": feed.size[1]}
                copies.append((handle, cell, rows.reshape(-1).view(np.uint8)))
            upload(s._work, s._staging, copies, [*s._reactive.set([feed.name]), *((feed.held, slot, wanted[slot]) for slot in some)])
        if feed.order is not None and plan.states:
            self._ahead.expect(feed.wanted(plan.name, step + n, n).values())


def number(view, count: int) -> int:
    """Of a view, of so many. Raises InputError."""
    if isinstance(view, bool) or not isinstance(view, int | np.integer) or not 0 <= view < count:
        raise InputError(f"view {view!r:.40}; 0 to {count - 1} are there")
    return int(view)
