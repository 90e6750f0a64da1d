"""The reactive rule without a device: nobody can tell a session that runs what is stale from one that computes everything anew.

Random bundles (inputs, states, plans that prepare what others read, phases, outputs, copies of states), random sequences of calls. A value
is a text that says how it was made, so that two of them are equal only if they were made alike.
"""

import random

import pytest

from dressi_edge.cache.copies import ENTER, LEAVE, OUTPUT, PHASE
from dressi_edge.cache.reactive import Reactive, rules

SEEDS = range(60)


def bundle(rng):
    """A description as far as the rule looks at it."""
    values = [{"name": f"i{k}", "role": "input", "initial": rng.choice([None, 0])} for k in range(rng.randint(1, 4))]
    values += [{"name": f"s{k}", "role": "state", "initial": None} for k in range(rng.randint(1, 4))]
    plans, users = [], len(values)
    states = [k for k, value in enumerate(values) if value["role"] == "state"]

    def add(name, reads=(), updates=(), outputs=(), needs=()):
        needs = sorted(set(needs).union(*(plans[k]["needs"] for k in needs)))
        plans.append({"name": name, "reads": list(reads), "updates": list(updates), "outputs": list(outputs), "needs": needs})
        return len(plans) - 1

    def some(xs, least=0):
        return sorted(rng.sample(list(xs), rng.randint(min(least, len(xs)), len(xs))))

    prepares = []
    for k in range(rng.randint(0, 4)):
        prepares.append(add(f"prepare{k}", some(range(users), 1), needs=some(prepares)))
    enters, copied = [], {}  # copy -> state
    for k in range(rng.choice([0, 1, 1, 2])):
        free = [s for s in states if s not in copied.values()]
        if free:
            of = some(free, 1) or free[:1]
            first = len(values)
            values += [{"name": f"{values[s]['name']}.copy", "role": "copy", "initial": None} for s in of]
            copies = list(range(first, len(values)))
            enters.append((add(f"enter{k}", of, copies, needs=some(prepares)), copies))
            add(f"leave{k}", copies, of, needs=[enters[-1][0]])
            copied |= dict(zip(copies, of))
    for k in range(rng.randint(1, 3)):
        mine = some(enters)
        updated = [x for _, copies in mine for x in copies]
        updated += [s for s in some(states) if s not in {copied[x] for x in updated}]
        reads = [x for x in some(range(users)) if x not in {copied[x] for _, copies in mine for x in copies}]
        updated = updated or states[:1]
        add(f"phase{k}", dict.fromkeys([*reads, *(x for _, copies in mine for x in copies), *updated]), updated,
            needs=[*some(prepares), *(enter for enter, _ in mine)])
    for k in range(rng.randint(1, 4)):
        values.append({"name": f"o{k}", "role": "output", "initial": None})
        mine = some(enters)
        reads = [x for x in some(range(users), 1) if x not in {copied[x] for _, copies in mine for x in copies}]
        add(f"output{k}", [*reads, *(x for _, copies in mine for x in copies)], (), [len(values) - 1],
            [*some(prepares), *(enter for enter, _ in mine)])
    return {"values": values, "plans": plans}, {values[c]["name"]: values[s]["name"] for c, s in copied.items()}


class Truth:
    """Copies are their states, and everything is computed when it is asked for."""

    def __init__(self, d, of):
        self.rules, self.of, self.d = rules(d), of, {plan["name"]: plan for plan in d["plans"]}
        self.names = [value["name"] for value in d["values"]]
        self.values = {value["name"]: "0" for value in d["values"] if value["role"] in ("input", "state")}

    def result(self, plan):
        reads = [self.values[self.of.get(self.names[k], self.names[k])] for k in self.d[plan]["reads"]]
        return str(hash((plan, *reads, *(self.result(name) for name in self.rules[plan].needs if self.rules[name].kind == OUTPUT))))

    def step(self, plan):
        made = self.result(plan)
        self.values |= {self.of.get(name, name): f"{made} {self.of.get(name, name)}" for name in self.rules[plan].updates}


class Machine(Truth):
    """What images would hold, run as the rule says."""

    def __init__(self, d, of):
        super().__init__(d, of)
        self.reactive, self.made, self.runs = Reactive(d), {}, []
        self.held = {value["name"]: "0" for value in d["values"]}

    def run(self, rule):
        self.runs.append(rule.name)
        assert not self.reactive.missing(rule)
        if rule.kind == ENTER:
            self.held |= {name: self.held[self.of[name]] for name in rule.updates}
        elif rule.kind == LEAVE:
            self.held |= {name: self.held[next(c for c, s in self.of.items() if s == name)] for name in rule.updates}
        else:
            reads = [self.held[self.names[k]] for k in self.d[rule.name]["reads"]]
            kept = [self.made[name] for name in rule.needs if self.rules[name].kind == OUTPUT]
            self.made[rule.name] = str(hash((rule.name, *reads, *kept)))
            self.held |= {name: f"{self.made[rule.name]} {self.of.get(name, name)}" for name in rule.updates}
        for mapping, key, value in self.reactive.ran(rule) * 2:  # made twice, as after an interrupt
            mapping[key] = value

    def bring(self, rules):
        for rule in rules:
            self.run(rule)

    def set(self, name, value):
        self.bring(self.reactive.leaves([name]))
        self.held[name] = value
        for mapping, key, new in self.reactive.set([name]):
            mapping[key] = new

    def get(self, name):
        self.bring(self.reactive.leaves([name]))
        return self.held[name]

    def step(self, plan):
        self.bring(self.reactive.before(self.rules[plan]))
        self.run(self.rules[plan])

    def refresh(self, plan):
        if self.reactive.stale(self.rules[plan]):
            self.step(plan)
        return self.made[plan]


def calls(rng, d, count=60):
    """A random sequence of calls, on a machine beside the truth; yields after each."""
    d, of = d
    machine, truth = Machine(d, of), Truth(d, of)
    by_kind = {kind: [r.name for r in machine.rules.values() if r.kind == kind] for kind in (PHASE, OUTPUT)}
    unset = [name for name, given in machine.reactive.given.items() if not given]
    for k in range(count):
        what = "set" if k < len(unset) else rng.choice(["set", "step", "step", "output", "output", "get"])
        if what == "set":
            name = unset[k] if k < len(unset) else rng.choice(list(truth.values))
            machine.set(name, f"set{k}")
            truth.values[name] = f"set{k}"
        elif what == "get":
            name = rng.choice(list(truth.values))
            assert machine.get(name) == truth.values[name]
        else:
            plan = rng.choice(by_kind[PHASE if what == "step" else OUTPUT])
            if what == "step":
                machine.step(plan)
                truth.step(plan)
            else:
                assert machine.refresh(plan) == truth.result(plan)
        yield machine, truth


@pytest.mark.parametrize("seed", SEEDS)
def test_nobody_can_tell_what_is_kept_from_what_is_computed_anew(seed):
    rng = random.Random(seed)
    *_, (machine, _) = calls(rng, bundle(rng))
    assert {PHASE, OUTPUT} <= {machine.rules[name].kind for name in machine.runs}


@pytest.mark.parametrize("seed", SEEDS)
def test_nothing_runs_again_unless_what_it_is_made_of_has_changed(seed):
    rng, made = random.Random(seed), {}
    count = 0
    for machine, _ in calls(rng, bundle(rng)):
        for name in machine.runs[count:]:
            rule = machine.rules[name]
            if rule.kind == OUTPUT and all(machine.rules[need].kind != ENTER for need in rule.needs):  # copies may be made alike again
                assert made.get(name) != machine.made[name], f"{name} came to the same again"
                made[name] = machine.made[name]
        count = len(machine.runs)
        for name, rule in machine.rules.items():  # asked twice, nothing runs
            if rule.kind == OUTPUT and not machine.reactive.missing(rule) and not machine.reactive.stale(rule):
                machine.refresh(name)
                assert len(machine.runs) == count


def test_a_phase_that_runs_on_pays_for_neither_enter_nor_leave():
    value = {"initial": None}
    d = {"values": [{"name": "s", "role": "state", **value}, {"name": "c", "role": "copy", **value}], "plans": [
        {"name": "enter", "reads": [0], "updates": [1], "outputs": [], "needs": []},
        {"name": "leave", "reads": [1], "updates": [0], "outputs": [], "needs": [0]},
        {"name": "fit", "reads": [1], "updates": [1], "outputs": [], "needs": [0]}]}
    machine = Machine(d, {"c": "s"})
    for _ in range(3):
        machine.step("fit")
    assert machine.runs == ["enter", "fit", "fit", "fit"]
    machine.get("s")
    machine.get("s")
    machine.step("fit")
    assert machine.runs[4:] == ["leave", "fit"], "one leave, and the copies are still those of the state"
    machine.set("s", "other")
    machine.step("fit")
    assert machine.runs[6:] == ["leave", "enter", "fit"]


def test_an_input_without_value_is_told_and_unset_again():
    value = {"role": "input", "initial": None}
    d = {"values": [{"name": "a", **value}, {"name": "b", "role": "input", "initial": 0}, {"name": "o", "role": "output", "initial": None}],
         "plans": [{"name": "prepare", "reads": [0], "updates": [], "outputs": [], "needs": []},
                   {"name": "look", "reads": [1], "updates": [], "outputs": [2], "needs": [0]}]}
    machine = Machine(d, {})
    look = machine.rules["look"]
    assert machine.reactive.missing(look) == ["a"] and look.inputs == ("b", "a")
    machine.set("a", "x")
    machine.refresh("look")
    assert not machine.reactive.missing(look) and not machine.reactive.stale(look)
    for mapping, key, new in machine.reactive.unset(["a"]):
        mapping[key] = new
    assert machine.reactive.missing(look) == ["a"] and machine.reactive.stale(look)
