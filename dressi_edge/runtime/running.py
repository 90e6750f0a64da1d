"""Plans of a session: what must run before which, on which slots of images, in one submission.

In: a session, in which this has the rights of a method. Out: plans that have run, and what is true of their values then.
"""
from __future__ import annotations

from collections.abc import Collection, Iterable, Sequence
from typing import TYPE_CHECKING

from ..cache.copies import LEAVE
from ..cache.errors import InputError
from ..cache.reactive import Rule
from .record import Recording

if TYPE_CHECKING:
    from .kept import Copy
    from .plans import Plan
    from .session import Session

MAX_SUBMIT = 1 << 16  # iterations in one submission


def give_back(s: Session, names: Iterable[str]) -> None:
    """Bring those of these states up to date of which a phase has newer copies."""
    _each(s, s._reactive.leaves(names))


def _each(s: Session, rules: Iterable[Rule]) -> set[str]:
    """Run these, one after another; their names."""
    ran = set()
    for rule in rules:
        submit(s, s._plans[rule.name])
        ran.add(rule.name)
    return ran


def refresh(s: Session, plan: Plan) -> None:
    """Run a plan that gives something out unless that is up to date."""
    s._kept.look(plan)
    if s._reactive.stale(plan.rule):
        run(s, plan, 1)
    else:
        s._skipped[plan.name] += 1


def prepare(s: Session, plan: Plan, but: Collection[str] = ()) -> None:
    """Run all that must run before it, without those of `but`."""
    ran = _each(s, s._reactive.before(plan.rule, but))
    for name in plan.rule.needs:
        s._skipped[name] += name not in ran


def ready(s: Session, plan: Plan, n: int = 1) -> None:
    """Have what n iterations need that is not made by plans. Raises InputError where it is missing."""
    s._fed.fill(plan, n)
    s._kept.look(plan)
    if missing := s._reactive.missing(plan.rule):
        raise InputError(f"{plan.name} needs {' '.join(missing)}; set it first")


def run(s: Session, plan: Plan, n: int) -> None:
    """Run n iterations, after all that must run before."""
    while n > 0:
        k = min(n, s._fed.most(plan, MAX_SUBMIT))
        ready(s, plan, k)
        s._work.settle()
        if plan.name in s._kept.turns:
            k = s._kept.run(plan, k)
        else:
            prepare(s, plan)
            submit(s, plan, k)
        n -= k


def submit(s: Session, plan: Plan, n: int = 1, copies: Sequence[Copy | None] = ()) -> None:
    """Run a plan on what there is; copies: what is kept of the view of each iteration."""
    if copies:
        flips = (), tuple(k for _, k in plan.states)
        commands = [_recording(s, plan, flips[k % 2], copy).commands for k, copy in enumerate(copies)]
    else:
        commands = [_recording(s, plan).commands]
    if not copies and plan.states and n > 1:
        commands = ([*commands, _recording(s, plan, tuple(k for _, k in plan.states)).commands] * (n // 2 + 1))[:n]
    s._work.submit(commands, [(s._runs, plan.name, s._runs[plan.name] + n), *stepped(s, plan, n)])
    s._work.settle()
    if not plan.kept:
        plan.kept = True
        s._store.keep()


def stepped(s: Session, plan: Plan, n: int) -> list:
    """What is true after n iterations."""
    flipped = () if plan.rule.kind == LEAVE else plan.states  # a leave writes in place
    swapped = [(s._parity, image, s._parity[image] ^ n & 1) for _, image in flipped]
    return [*s._reactive.ran(plan.rule), *s._counters.stepped(plan, n), *swapped]


def _recording(s: Session, plan: Plan, flip: tuple = (), copy: Copy | None = None) -> Recording:
    """The plan's commands for the slots that are current, or with those of the images `flip` exchanged; copy: what is kept of a view,
    to be read instead of what was made last."""
    parity = tuple([s._parity[k] ^ (k in flip) if k in s._parity else 0 for k in plan.slots])
    key = parity if copy is None else (*parity, copy.number)
    found = plan.recordings.get(key)
    if found is None:
        found = plan.recordings[key] = record(s, plan, dict(zip(plan.slots, parity)), images=copy)
    return found


def record(s: Session, plan: Plan, parity: dict[int, int], timestamps: int = 0, images: Copy | None = None) -> Recording:
    """The plan's commands for these slots, on the bundle's images or those of a copy; timestamps: a query pool that gets the time of each
    stage."""
    return Recording(s.device, s._work.pool, s.bundle, images or s._images, s._pipelines, plan.record, parity, timestamps)
