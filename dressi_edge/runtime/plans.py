"""A plan as a session runs it: its images and recordings, found once instead of at every step; the time of its stages.

In: the plan's record, the bundle's description, the plan's rule (`cache/reactive.py`). Out: a `Plan`.
"""
from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ..cache.bundle_plans import bound, written
from ..cache.reactive import Rule
from . import vk
from .record import Recording
from .work import Work


class Plan:
    """name, record (the bundle's), rule (what it has to do with others). states: the values it updates, with their images. slots: its
    images that are held twice, whose parity chooses among `recordings`. kept: whether it has run, so that the driver has compiled it."""

    def __init__(self, record: dict, description: dict, rule: Rule):
        values = description["values"]
        self.name, self.record, self.rule, self.kept = record["name"], record, rule, False
        self.states = tuple((values[k]["name"], values[k]["image"]) for k in record["updates"])
        used = {ref // 2 for stage in record["stages"] for ref in (*written(stage), *bound(stage))}
        self.slots = tuple(k for k in sorted(used) if description["images"][k]["slots"] == 2)
        self.recordings: dict[tuple[int, ...], Recording] = {}


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
