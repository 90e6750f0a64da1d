"""The pictures that a scene is fitted to: how they lie on the device, and how they come there.

Few of them (`SMALL`) are on the device and in the bundle, as floats. Of more, pictures of 8 bits stay so, an int a pixel, and those of 16,
two, taken apart in the shader to the same bits. Where a step sees one view, the device has a window of some views at a time, which the
session fills in the order that is known beforehand (`cache/feed.py`); pictures are then in the bundle compressed, or not at all.

In: a scene, its views, the order of steps. Out: `Targets`, whose `at` is what a frame is compared with, and the bundle's meta.
"""
from __future__ import annotations

import zlib
from collections.abc import Iterable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from ...cache.errors import InputError
from ...cache.feed import differences
from ...cache.layout import Layout
from ..graph.functions import apply, constant_table, lookup, to_int
from ..graph.ir import Node, topological
from ..graph.ops.packed import unorm8, unorm16
from ..io.again import recorded
from ..io.color import srgb_to_linear
from ..io.pictures import AS_FLOAT, AS_FLOAT16, Pictures
from ..io.views import Views
from ..render.atlas import COMMON_SIDE, Atlas
from ..render.frame import Frame

if TYPE_CHECKING:
    from ...cache.profile import Profile
    from .scene import Scene

SMALL = 1 << 20  # pixels of all views together up to which pictures are floats, all of them on the device and in the bundle
SLOTS = 32  # views in a window: a step does not wait for the picture of the next
WINDOW_BYTES = 1 << 26  # of pictures on the device, unless said otherwise
LAYOUTS = {8: ("int", 4), 16: ("ivec2", 8), 32: ("vec4", 16)}  # by bits a channel: the type of a pixel, and its bytes
SHARE = 4  # of a budget for all images a window takes one part in so many
HEAP_SHARE = 2  # of a profile's heap all images should take one part in so many: the rest is other programs', and the driver's
BATCH_BYTES = 48  # a pixel of all images where all views are drawn at once, at the least: 62 with silhouettes, 204 with a texture, too


@dataclass(frozen=True)
class Carried:
    """What a command says of pictures and memory. embed: whether the bundle has the pictures; None: those of few views alone. memory: bytes
    for all images of the device, None for what is usual. whole: all pictures as floats at once, whatever they take, as a reference has
    them. heap: the smallest of the profiles, where one is known."""

    embed: bool | None = None
    memory: int | None = None
    whole: bool = False
    heap: int | None = None

    def on(self, profiles: Iterable[Profile]) -> Carried:
        """The same for these profiles."""
        return replace(self, heap=min((p.heap_bytes for p in profiles if p.heap_bytes is not None), default=None))

    @property
    def room(self) -> int | None:
        """Bytes that all images should take: as was said, else a share of the heap, else None."""
        return self.memory if self.memory is not None or self.heap is None else self.heap // HEAP_SHARE

    def order(self, order: str, count: int, width: int, height: int) -> str:
        """The order of a job, or where that is "batch" and so many views cannot be drawn at once in the room that there is, the one that
        gives the same gradient view by view."""
        much = order == "batch" and not self.whole and large(count, width, height) and self.room is not None
        return "accumulate" if much and count * width * height * BATCH_BYTES > self.room else order

    def of(self, count: int, width: int, height: int) -> dict:
        """The arguments of `targets_of` and `Problem` for so many views."""
        embed = not large(count, width, height) if self.embed is None else self.embed
        return {"embed": embed, "memory": self.memory, "whole": self.whole, "room": self.room}


def large(count: int, width: int, height: int) -> bool:
    """Whether so many views are more than lie on the device as floats by themselves."""
    return count * width * height > SMALL


def windowed(order: str, count: int, width: int, height: int, whole: bool = False) -> bool:
    """Whether a step and a drawing need one view on the device at a time."""
    return order != "batch" and not whole and large(count, width, height)


def at_once(order: str, count: int, width: int, height: int, whole: bool = False) -> int:
    """How many views lie side by side on the device at the most."""
    return 1 if windowed(order, count, width, height, whole) else count


def slots_for(count: int, width: int, height: int, bytes_a_pixel: int, memory: int | None, room: int | None = None) -> int:
    """How many views a window has: within its bytes and in an image that every device has, of this `memory` for all images; room: where
    nobody said that, what they should take."""
    if memory is not None:
        room = memory // SHARE
    else:
        room = WINDOW_BYTES if room is None else min(WINDOW_BYTES, room // SHARE)
    most = max(1, min(count, SLOTS, room // (width * height * bytes_a_pixel)))
    fits = [n for n in range(1, most + 1) if max(_extent(width, height, n)) <= COMMON_SIDE]
    return max(fits, default=1)


def _extent(width: int, height: int, n: int) -> tuple[int, int]:
    extent = Atlas.of(width, height, n).extent
    return extent.width, extent.height


@dataclass(frozen=True, eq=False)
class Targets:
    """node: the input. slots: the cells of its image. order: the view of each step, (n,), where the image is a window. steps: the same,
    also where it is none, if a step sees one view. bits: 8, 16 or 32 a channel. table: (2^bits,) float32, what bits of a colour stand for,
    where that is not k / 255 or k / 65535. views: the pictures, where they come from outside the program. embed: whether the bundle has
    them. memory: bytes for all images, if that was said; room: bytes that they should take where it was not, if that is known."""

    node: Node
    slots: Atlas
    order: np.ndarray | None = None
    steps: np.ndarray | None = None
    bits: int = 32
    table: np.ndarray | None = None
    views: Views | None = None
    embed: bool = False
    memory: int | None = None
    room: int | None = None

    @property
    def fed(self) -> bool:
        """Whether the session brings the pictures to the device."""
        return self.views is not None

    def turned(self, scene: Scene, phase: str, optimize: Iterable[str]) -> Node | None:
        """The input that says which view a step of a phase sees, where the session is to say so: what depends on a view alone is then
        worked out once for each, and kept while there is memory (docs/bundle-format.md, "Views that are kept"). None where a step works it
        out from its number: of all views at once, and of a shape that moves, of which nothing could be kept."""
        if not self.fed or self.steps is None or not _rests(scene, optimize):
            return None
        name = f"{phase}.view"
        scene.program.turned[phase] = name
        return scene.program.input(name, Layout("unit", "int"))

    def at(self, frame: Frame) -> Node:
        """vec4: the pictures of the views of a frame, straight colour and alpha."""
        node = self.node
        if frame.step is not None and self.steps is not None:  # by the step's number: where a picture lies is nothing to keep
            slot = apply("imod", frame.step, self.slots.views if self.order is not None else len(self.steps))
            slot = slot if self.order is not None else lookup(constant_table(self.steps), slot)
            node = apply("fetch", node, to_int(frame.pixel) + self.slots.corner(slot))
        else:
            node = frame.at(node)
        return node if self.bits == 32 else (unorm8 if self.bits == 8 else unorm16)(node, self.table)

    def meta(self, program, shown: dict[str, str]) -> dict:
        """What a session must know to bring pictures to the device: meta.pictures (docs/bundle-format.md). shown: outputs that draw one
        view, and the input that says which."""
        if not self.fed:
            return {}
        pictures, n = self.views.images, len(self.views)
        steps = {}
        for spec in program.plans if self.order is not None else ():
            leaves = {x.name for x in topological([*spec.updates.values(), *spec.outputs.values()]) if x.op.held}
            if self.node.name in leaves:
                steps[spec.name] = f"{spec.group.partition('.')[0]}.step"  # names of phases have no dots
        found = {"value": self.node.name, "views": n, "bits": self.bits,
                 "table": None if self.table is None else self.table.astype("<f4").tobytes(),
                 "order": None if self.order is None else self.order.astype("<i4").tobytes(), "steps": steps, "shown": shown,
                 "names": list(self.views.names), "size": [self.slots.width, self.slots.height], "files": [], "blobs": [],
                 "room": self.memory if self.memory is not None else self.room}
        if isinstance(pictures, Pictures):
            found |= recorded(pictures)
        kept = [{"input": name, "counter": f"{group}.step", "order": self.steps.astype("<i4").tobytes(), "memory": self.memory,
                 "room": self.room} for group, name in program.turned.items()]
        return {"pictures": found, **({"kept": kept} if kept else {})}

    def blobs(self) -> list[bytes]:
        """The pictures as a bundle has them: zlib of the differences of their rows."""
        if not self.fed or not self.embed:
            return []
        images = self.views.images
        with ThreadPoolExecutor() as pool:
            return list(pool.map(lambda k: zlib.compress(differences(self._rows(images, k)), 3), range(len(images))))

    def _rows(self, images, k: int) -> np.ndarray:
        if self.bits < 32:
            return images.rows(k) if isinstance(images, Pictures) else _integers(images[k], self.bits)
        return images.picture(k) if isinstance(images, Pictures) else np.asarray(images[k], np.float32)


def _rests(scene: Scene, optimize: Iterable[str]) -> bool:
    """Whether what the cameras see stays where it is while these parameters change."""
    moving = {scene.parameters[name].node for name in optimize if name in scene.parameters}
    return moving.isdisjoint(topological([*(part.positions for part in scene.parts), *scene.views.rows, scene.views.projection]))


def targets_of(scene, views: Views | None, order: str, seed: int, embed: bool = True, memory: int | None = None,
               whole: bool = False, room: int | None = None) -> Targets:
    """The input "targets" of a scene, the pictures of `views` (None: the session sets them). embed: whether the bundle has them. memory:
    bytes for all images of the device, None for what is usual; room: bytes that they should take where memory says nothing. whole: all
    pictures as floats whatever they take, as a reference has them."""
    program, count, width, height = scene.program, len(scene.cameras), scene.width, scene.height
    if memory is not None and (type(memory) is not int or memory < 1):
        raise InputError(f"memory is {memory!r:.40}; a number of bytes above 0 is needed")
    few = not large(count, width, height)
    if views is None or whole or few and embed:
        images = None if views is None else np.asarray(views.images)
        return Targets(program.input("targets", scene.pictures_layout("vec4"), images, narrow=True), scene.atlas, memory=memory)
    images = views.images
    if isinstance(images, Pictures):
        bits, linear = images.bits, images.linear
    else:
        bits, linear = _bits(images), False
    table = srgb_to_linear(AS_FLOAT if bits == 8 else AS_FLOAT16) if linear and bits < 32 else None
    atlas, window = scene.atlas, None
    steps = None if order == "batch" else scene.order_of(order, seed)
    if windowed(order, count, width, height, whole):
        slots = slots_for(count, width, height, LAYOUTS[bits][1], memory, room)
        if slots < count:
            atlas, window = Atlas.of(width, height, slots), steps
    layout = Layout("atlas", LAYOUTS[bits][0], atlas.width, atlas.height, atlas.views, atlas.columns)
    return Targets(program.input("targets", layout, narrow=True), atlas, window, steps, bits, table, views, embed, memory, room)


def _bits(images: Iterable[np.ndarray]) -> int:
    """The fewest a channel that hold these floats exactly."""
    for bits, known in ((8, AS_FLOAT), (16, AS_FLOAT16)):
        if all(np.array_equal(known[_integers(x, bits)], x) for x in images):
            return bits
    return 32


def _integers(image: np.ndarray, bits: int) -> np.ndarray:
    return np.rint(image * np.float32((1 << bits) - 1)).astype(np.uint8 if bits == 8 else np.uint16)
