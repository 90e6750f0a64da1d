"""The reactive rule: what is stale, and what runs because of it (docs/bundle-format.md, "From bytes to results", 7 to 10, and "Copies").

In: a bundle's description, then what a user sets and what has run. Out: of each plan the ones that must run before it, in order, and what
is true once something has run. Every input, state and copy has a version; an output or an enter is up to date if it has run and all that it
and the plans it needs read have the versions of then. Nothing here knows images, devices or time: a session asks, runs, and makes the
changes.
"""
from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass

from .copies import ENTER, LEAVE, PHASE, kinds

Change = tuple[dict, object, object]  # mapping, key, value: safe to make twice


@dataclass(frozen=True)
class Rule:
    """What a plan has to do with others, by names. kind: as in `copies.py`. reads: all values that it or a plan it needs reads; inputs:
    those of them that a user sets. needs: the plans to bring up to date before it, in order. updates: values that it gives a next
    value; touches: values whose images it reads or updates itself; outputs: values that it gives out."""

    name: str
    kind: str
    reads: tuple[str, ...]
    inputs: tuple[str, ...]
    needs: tuple[str, ...]
    updates: tuple[str, ...]
    touches: tuple[str, ...]
    outputs: tuple[str, ...]


def rules(d: Mapping) -> dict[str, Rule]:
    """Of the plans of a description, in its order."""
    plans, values = d["plans"], d["values"]

    def names(numbers: Iterable[int]) -> tuple[str, ...]:
        return tuple(dict.fromkeys(values[k]["name"] for k in numbers))

    found = {}
    for plan, kind in zip(plans, kinds(d)):
        reads = [k for p in (plan, *(plans[n] for n in plan["needs"])) for k in p["reads"]]
        found[plan["name"]] = Rule(
            plan["name"], kind, names(reads), names(k for k in reads if values[k]["role"] == "input"),
            tuple(plans[n]["name"] for n in plan["needs"]), names(plan["updates"]), names((*plan["reads"], *plan["updates"])),
            names(plan["outputs"]))
    return found


class Reactive:
    """What is known of the values and plans of a session. rules: by name. version: of each value. given: of each input, whether it has a
    value. out: of each enter, whether its copies are newer than the states."""

    def __init__(self, d: Mapping):
        self.rules = rules(d)
        self.version = dict.fromkeys((value["name"] for value in d["values"]), 0)
        self.given = {value["name"]: value["initial"] is not None for value in d["values"] if value["role"] == "input"}
        listed = list(self.rules.values())
        self._leaves = {enter.name: leave for enter, leave in zip(listed, listed[1:]) if enter.kind == ENTER}
        self.out = dict.fromkeys(self._leaves, False)
        self._seen: dict[str, tuple[int, ...]] = {}

    def missing(self, plan: Rule) -> list[str]:
        """The inputs without a value that it or a plan it needs reads."""
        return [name for name in plan.inputs if not self.given[name]]

    def stale(self, plan: Rule) -> bool:
        """Whether an output or an enter has to run before what it makes is of use."""
        return self._seen.get(plan.name) != self._versions(plan)

    def before(self, plan: Rule, but: Collection[str] = ()) -> Iterator[Rule]:
        """What must run before it, in order, without those of `but`. Each is asked for when the one before has run and its changes are
        made."""
        for need in map(self.rules.__getitem__, plan.needs):
            if need.name not in but and self.stale(need):
                yield from self.leaves(need.touches)
                yield need
        yield from self.leaves(plan.touches)

    def leaves(self, names: Iterable[str]) -> Iterator[Rule]:
        """What must run before these values are read or set by others: the leaves of those of which copies are newer."""
        for enter, leave in self._leaves.items():
            if self.out[enter] and not set(leave.updates).isdisjoint(names):
                yield leave

    def set(self, names: Iterable[str]) -> list[Change]:
        """What is true once these have new values."""
        names = list(names)
        return [*self._newer(names), *((self.given, name, True) for name in names if name in self.given)]

    def unset(self, names: Iterable[str]) -> list[Change]:
        """What is true once these inputs have none: what was made from them is of no use."""
        names = list(names)
        return [*self._newer(names), *((self.given, name, False) for name in names)]

    def ran(self, plan: Rule) -> list[Change]:
        """What is true once it has run, now that all before it has."""
        if plan.kind == LEAVE:  # it changes where values are, and none of them
            enter = next(name for name, leave in self._leaves.items() if leave.name == plan.name)
            return [(self.out, enter, False)]
        changes = self._newer(plan.updates)
        if plan.kind != PHASE:
            return [*changes, (self._seen, plan.name, self._versions(plan))]
        for name, leave in self._leaves.items():
            enter = self.rules[name]
            if not set(enter.updates).isdisjoint(plan.updates):  # its copies are what the enter would make of the new states
                states = self._newer(leave.updates)
                versions = self.version | {state: version for _, state, version in states}
                changes += [*states, (self._seen, name, tuple(map(versions.__getitem__, enter.reads))), (self.out, name, True)]
        return changes

    def seen(self, name: str) -> tuple[int, ...] | None:
        """The versions of what an output or an enter last ran on."""
        return self._seen.get(name)

    def versions(self, plan: Rule, known: Mapping[str, int] = {}) -> tuple[int, ...]:  # noqa: B006
        """Of all that it reads; of some values as they are given."""
        return tuple(known.get(name, self.version[name]) for name in plan.reads)

    def _versions(self, plan: Rule) -> tuple[int, ...]:
        return tuple(map(self.version.__getitem__, plan.reads))

    def _newer(self, names: Iterable[str]) -> list[Change]:
        return [(self.version, name, self.version[name] + 1) for name in names]
