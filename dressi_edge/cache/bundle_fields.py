"""Values of a description as they are checked: what each takes and how a refusal reads.

In: where a value is, as errors name it, and the value. Out: the value, or a BundleError.
"""
from __future__ import annotations

from typing import NoReturn

from .errors import BundleError

MAX_ITEMS = 1 << 20


def fail(where: str, found, allowed: str) -> NoReturn:
    """Raise BundleError."""
    raise BundleError(f"{where} is {show(found)}; {allowed}")


def show(x) -> str:
    """Short, whatever it is: a value from a file may be large, and nested deeper than repr can follow."""
    if isinstance(x, (list, tuple)):
        return f"a list of {len(x)}"
    if isinstance(x, dict):
        return f"a map of {len(x)}"
    short = x[:60] if isinstance(x, (str, bytes)) else x
    return f"{short!r:.60}"


def number(where: str, x, low: int, high: int) -> int:
    """An integer between two bounds, which a boolean is not."""
    if type(x) is not int or not low <= x <= high:
        fail(where, x, f"an integer from {low} to {high} is allowed")
    return x


def one_of(where: str, x, allowed):
    """One of these integers or texts."""
    if type(x) not in (int, str) or x not in allowed:
        fail(where, x, "allowed: " + " ".join(map(str, allowed)))
    return x


def a_list(where: str, x, length: int | None = None, most: int = MAX_ITEMS) -> list:
    """A list of so many, or of at most so many."""
    if type(x) is not list or len(x) > most or (length is not None and len(x) != length):
        fail(where, x, "a list of " + (f"{length} is needed" if length is not None else f"at most {most} is allowed"))
    return x


def distinct(where: str, xs: list) -> None:
    """Nothing is there twice."""
    if len(set(xs)) != len(xs):
        raise BundleError(f"{where} names something twice")


def a_map(where: str, x, keys) -> dict:
    """A map of exactly these keys."""
    if type(x) is not dict:
        fail(where, x, "a map is needed")
    for key in keys:
        if key not in x:
            raise BundleError(f"{where} lacks {key}")
    for key in x:
        if key not in keys:
            raise BundleError(f"{where} has the unknown key {show(key)}")
    return x


def a_text(where: str, x) -> str:
    """What a name may be."""
    if type(x) is not str or not 0 < len(x) <= 200 or any(c < " " or "\x7f" <= c < "\xa0" for c in x):
        fail(where, x, "a text of 1 to 200 characters, none of control, is needed")
    return x
