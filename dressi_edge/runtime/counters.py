"""What states that count steps hold, as far as that is known without asking the device.

In: a session, and of each plan the state that counts its steps. Out: numbers of steps, and what becomes true of them.
"""
from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING

import numpy as np

from .transfer import read

if TYPE_CHECKING:
    from .plans import Plan
    from .session import Session


class Counters:
    """of: by plan the name of its counter. at: of each counter, its value where that is known."""

    def __init__(self, session: Session, of: Mapping[str, str]):
        self.s, self.of = session, dict(of)
        self.at: dict[str, int | None] = dict.fromkeys(self.of.values())

    def value(self, counter: str) -> int:
        """The steps that a state counts, asked of the device where they are not known."""
        at, s = self.at, self.s
        if at[counter] is None:
            found: list[int] = []
            read(s._work, s._staging, [(*s._handle(s.values[counter]["image"]), lambda place: found.append(int(place.view(np.int32)[0])))])
            at[counter] = found[0]
        return at[counter]

    def stepped(self, plan: Plan, n: int) -> list:
        """What is true of a counter after n iterations."""
        counter = self.of.get(plan.name) if plan.states else None
        if counter is None:
            return []
        at = self.at[counter]
        return [(self.at, counter, None if at is None else at + n)]

    def forget(self, names: Iterable[str]) -> list:
        """What is true of counters once these have new values: nothing is known."""
        return [(self.at, name, None) for name in names if name in self.at]
