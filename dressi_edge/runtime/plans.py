"""A plan as a session runs it: what it reads, writes and needs, found once instead of at every step.

In: the plan's record and the bundle's description. Out: a `Plan`, which also keeps its recordings; the time of its stages.
"""
from __future__ import annotations

from collections.abc import Callable

import numpy as np

from . import vk
from .record import Recording
from .work import Work


class Plan:
    """name, record (the bundle's). reads: names of all values that it or a plan it needs reads. needs: the names of those
    plans, in the order to run them. states: the values it updates. given: names of the outputs it gives. slots: its images that
    are held twice, whose parity chooses among `recordings`. touches: the values whose images it reads or updates itself. kind: as
    in `cache/copies.py`."""

    def __init__(self, record: dict, description: dict, kind: str):
        plans, values = description["plans"], description["values"]
        self.name, self.record, self.kind, self.kept = record["name"], record, kind, False
        # what the needed plans need is among those it needs
        reads = dict.fromkeys(values[k]["name"] for plan in (record, *(plans[k] for k in record["needs"])) for k in plan["reads"])
        self.reads, self.needs = tuple(reads), tuple(plans[k]["name"] for k in record["needs"])
        inputs = {value["name"] for value in values if value["role"] == "input"}
        self.inputs = tuple(name for name in reads if name in inputs)
        self.states = tuple((values[k]["name"], values[k]["image"]) for k in record["updates"])
        self.touches = tuple(dict.fromkeys(values[k]["name"] for k in (*record["reads"], *record["updates"])))
        self.given = tuple(values[k]["name"] for k in record["outputs"])
        used = {ref // 2 for stage in record["stages"] for ref in stage["attachments"]}
        subpasses = [draws for stage in record["stages"] for draws in stage["subpasses"]]
        used |= {ref // 2 for draws in subpasses for draw in draws for ref in draw["images"]}
        self.slots = tuple(k for k in sorted(used) if description["images"][k]["slots"] == 2)
        self.recordings: dict[tuple[int, ...], Recording] = {}


class Copies:
    """What a phase works on instead of states. names: of the values that `enter` fills; states: of those that `leave` gives them
    back to."""

    def __init__(self, enter: Plan, leave: Plan):
        self.enter, self.leave = enter, leave
        self.names, self.states = ({name for name, _ in plan.states} for plan in (enter, leave))


def profile_stages(device, work: Work, stages: int, record: Callable[[int], Recording], changes: Callable[[], list],
                   runs: int) -> list[float]:
    """Median milliseconds of each stage over some runs. `record(query pool)` gives the commands for the slots that are current,
    `changes()` what has changed when they have run."""
    queries = vk.CreateQueryPool(device.device, vk.VkQueryPoolCreateInfo(
        queryType=vk.VK_QUERY_TYPE_TIMESTAMP, queryCount=stages + 1))
    rows = []
    try:
        for _ in range(runs):
            recording = record(queries)
            try:
                work.submit([recording.commands], changes())
            finally:
                work.finish()
                recording.close()
            buffer = (vk.u64 * (stages + 1))()
            vk.GetQueryPoolResults(device.device, queries, 0, stages + 1, buffer, 8, vk.VK_QUERY_RESULT_64_BIT)
            rows.append(np.diff(np.array(buffer[:], np.float64)) * device.timestamp_period * 1e-6)
    finally:
        vk.DestroyQueryPool(device.device, queries)
    return np.median(rows, axis=0).tolist()
