"""The pictures of a job and the order in which steps see them, whichever kind of job it is.

In: a job's table, the profiles to compile for, what a command says of pictures and memory. Out: `JobViews`.
"""
from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from ...cache.profile import Profile
from ..io.views import Views
from .limits import fits_views
from .scene import ORDERS
from .sections import views_of
from .tables import Table
from .targets import Carried, at_once


@dataclass(frozen=True)
class JobViews:
    """table: [views]; load: reads the pictures, once; asked: the order that the job names; linear: pictures are linear light. carried:
    what the command says, with the heap of the profiles."""

    table: Table
    load: Callable[[], Views]
    asked: str
    seed: int
    linear: bool
    carried: Carried

    def order(self, views: Views) -> str:
        """The order of the steps: the job's, or where all views cannot be drawn at once in the memory that there is, "accumulate"."""
        return self.carried.order(self.asked, len(views), *views.images.shape[2:0:-1])

    def meta(self, views: Views) -> dict:
        """What was chosen for the job, for the bundle's meta and whoever compiles; nothing where nothing was."""
        order = self.order(views)
        return {} if order == self.asked else {"chosen": {"order": order, "room": self.carried.room}}


def job_views(job: Table, folder: Path, profiles: Sequence[Profile], told: Callable[[int, int], None] | None,
              carried: Carried) -> JobViews:
    """Reads [views] but for the pictures. What is too large for one of the profiles is said before they are decoded."""
    carried = carried.on(profiles)

    def fits(count: int, width: int, height: int) -> None:
        order = carried.order(asked, count, width, height)
        fits_views(profiles)(at_once(order, count, width, height, carried.whole), width, height)

    table, load = views_of(job, folder, fits, told)
    asked, seed = table.word("order", "batch", ORDERS), table.number("seed", 0, 0, 2 ** 31 - 1, whole=True)
    return JobViews(table, load, asked, seed, table.word("color", "srgb", ("srgb", "linear")) == "linear", carried)
