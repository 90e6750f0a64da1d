"""What each plan of a bundle is for: docs/bundle-format.md, "Copies".

In: a description. Out: of each plan "output" (updates nothing), "phase" (what a user steps), "enter" (fills copies of states), or
"leave" (gives the copies of the enter before it back to the states).
"""
from __future__ import annotations

from collections.abc import Mapping, Sequence

OUTPUT, PHASE, ENTER, LEAVE = "output", "phase", "enter", "leave"


def kind_of(d: Mapping, plan: Mapping, before: Sequence[str]) -> str:
    """Of a plan, given those of the plans before it."""
    if before and before[-1] == ENTER:
        return LEAVE
    if any(d["values"][x]["role"] == "copy" for x in plan["updates"]) and all(before[k] != ENTER for k in plan["needs"]):
        return ENTER
    return PHASE if plan["updates"] else OUTPUT


def kinds(d: Mapping) -> list[str]:
    """Of each plan, in order."""
    found: list[str] = []
    for plan in d["plans"]:
        found.append(kind_of(d, plan, found))
    return found
