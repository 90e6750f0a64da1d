"""Values of a session as arrays: which there are, and how they go to the device and come back, several in one submission.

In: a session, in which this has the rights of a method. Out: values that hold what was given, or arrays of what they hold.
"""
from __future__ import annotations

import functools
from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING

import numpy as np

from ..cache.errors import InputError
from ..cache.layout import is_int
from ..cache.vulkan import HALF_FORMATS
from .running import give_back, refresh
from .serial import serial
from .transfer import Fill, read, upload

if TYPE_CHECKING:
    from .session import Session

KIND = (np.float32, np.int32)


def known(s: Session, name: str, roles: tuple[str, ...]) -> dict:
    """The record of a value that has one of these roles. Raises InputError."""
    s._usable()
    value = s.values.get(name)
    if value is None or value["role"] not in roles:
        names = " ".join(n for n, x in s.values.items() if x["role"] in roles)
        raise InputError(f"{name!r:.60} is no {' or '.join(roles)} of this bundle; there are: {names}")
    return value


def stored(s: Session, value: dict) -> type:
    """The numbers in its image."""
    return np.float16 if s._d["images"][value["image"]]["format"] in HALF_FORMATS else KIND[is_int(value["type"])]


def pixels(s: Session, value: dict, data: np.ndarray) -> np.ndarray:
    """Its image (height, width, channels as stored) in these bytes."""
    image = s._d["images"][value["image"]]
    return data.view(stored(s, value)).reshape(image["height"], image["width"], -1)


# ---- to the device

def set_all(s: Session, arrays: Mapping[str, object]) -> None:
    """`Session.set_all`."""
    copies, fed = [], []
    for name, array in arrays.items():
        value = known(s, name, ("input", "state"))
        if name == s._fed.name:
            fed.append(array)
            continue
        checked = s._layouts[name].checked(array, name, stored(s, value) is np.float16)
        copies.append((name, functools.partial(_fill, s, value, checked)))
    for array in fed:
        s._fed.set(s._fed.name, array, None)
    if copies:
        put(s, copies)


@serial
def put(s: Session, copies: list[tuple[str, np.ndarray | Fill]], more: tuple = (), trim: bool = False, cells: Mapping = {}) -> None:  # noqa: B006
    """Fill images; more: what else is true then. trim: give a staging buffer back that is larger than any value. cells: of a value the
    record of the part of its image that is meant."""
    s._work.settle()  # an interrupted step may yet flip a state
    names = [name for name, _ in copies]
    give_back(s, names)
    upload(s._work, s._staging, [(*_part(s, name, cells), data) for name, data in copies],
           [*s._reactive.set(names), *s._counters.forget(names), *s._kept.unseen(names), *more])
    if trim:
        s._staging.trim(s._largest)


def _part(s: Session, name: str, cells: Mapping) -> tuple[int, dict]:
    """Its current image, and the record of it or of the part that is meant."""
    handle, image = s._handle(s.values[name]["image"])
    return handle, cells.get(name, image)


def _fill(s: Session, value: dict, array: np.ndarray, place: np.ndarray) -> None:
    s._layouts[value["name"]].fill(pixels(s, value, place), array)


# ---- back

def get_all(s: Session, names: Iterable[str], into: Mapping[str, np.ndarray] | None) -> dict[str, np.ndarray]:
    """`Session.get_all`."""
    found, readers = {}, {}
    for name in dict.fromkeys(names):
        value = known(s, name, ("input", "state", "output"))
        out = None if into is None else into.get(name)
        kind, shape = KIND[is_int(value["type"])], s.shape(name)
        if s._fed.has(name):
            kind = np.float32 if name == s._fed.name else kind
        if out is not None and (out.shape != shape or out.dtype != kind or not out.flags.c_contiguous):
            raise InputError(f"{name} is to be written into {out.dtype} {out.shape}; one piece of {np.dtype(kind)} {shape} is needed")
        found[name] = np.empty(shape, kind) if out is None else out
        if s._fed.has(name):
            found[name][...] = s._fed.get(name, None)
            continue
        readers[name] = functools.partial(_take, s, value, found[name])
    if readers:
        get(s, readers)
    return found


@serial
def get(s: Session, readers: Mapping[str, Fill], cells: Mapping = {}) -> None:  # noqa: B006
    """Show each reader the bytes of its value, which is up to date then; cells: as of `put`."""
    s._work.settle()
    for name in readers:
        if s.values[name]["role"] == "output":
            plan = s._giver[name]
            if not plan.states:
                refresh(s, plan)
            elif not s._runs[plan.name]:
                raise InputError(f"{name} is given out by {plan.name}, which has not run yet")
        elif not s._reactive.given.get(name, True):
            raise InputError(f"{name} has no value yet; set it first")
    give_back(s, readers)
    read(s._work, s._staging, [(*_part(s, name, cells), reader) for name, reader in readers.items()])


def _take(s: Session, value: dict, out: np.ndarray, place: np.ndarray) -> None:
    s._layouts[value["name"]].take(pixels(s, value, place), out)
