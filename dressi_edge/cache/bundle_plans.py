"""The plans of a description: their stages and draws, what they may read and write, and where they wait.

In: a description whose other parts are checked. Out: nothing, or a BundleError that names the first thing wrong by its path.
"""
from __future__ import annotations

from collections import Counter

from . import vulkan as v
from .bundle_fields import a_list, a_map, a_text, distinct, fail, number, show
from .copies import kind_of
from .errors import BundleError

MAX_SIDE = 1 << 16
MAX_NEEDS = 16
MAX_GROUPS = (1 << 31) - 1


def check_plan(where, plan, kinds, d) -> None:
    """`kinds`: of the plans before; this one's is added."""
    count, leave = len(kinds), kinds[-1:] == ["enter"]
    a_map(where, plan, ("name", "stages", "updates", "reads", "outputs", "needs", "steps"))
    a_text(f"{where}.name", plan["name"])
    number(f"{where}.steps", plan["steps"], 0, 1 << 40)
    for key, role in (("updates", ("state", "copy")), ("reads", ("input", "state", "copy")), ("outputs", ("output",))):
        for k, x in enumerate(a_list(f"{where}.{key}", plan[key])):
            number(f"{where}.{key}[{k}]", x, 0, len(d["values"]) - 1)
            if d["values"][x]["role"] not in role:
                raise BundleError(f"{where}.{key}[{k}] is {d['values'][x]['role']} {show(d['values'][x]['name'])}; "
                                  f"{' or '.join(role)} is allowed")
            if key == "updates" and not leave and d["images"][d["values"][x]["image"]]["slots"] != 2:
                raise BundleError(f"{where}.updates[{k}]: the image of {show(d['values'][x]['name'])} has one slot; two are "
                                  "needed")
        distinct(f"{where}.{key}", plan[key])
    low = 0
    for k, x in enumerate(a_list(f"{where}.needs", plan["needs"], most=MAX_NEEDS)):
        low = number(f"{where}.needs[{k}]", x, low, count - 1) + 1
        if kinds[x] not in ("output", "enter"):
            raise BundleError(f"{where}.needs[{k}]: plans[{x}] updates something")
        if missing := set(d["plans"][x]["needs"]).difference(plan["needs"][:k]):
            raise BundleError(f"{where}.needs[{k}]: plans[{x}] needs plans[{min(missing)}], which is not among them")
    kinds.append(kind_of(d, plan, kinds))
    if leave:
        _leave(where, plan, count, d)
    for k, stage in enumerate(a_list(f"{where}.stages", plan["stages"])):
        _stage(f"{where}.stages[{k}]", stage, d)


def _leave(where, plan, count, d) -> None:
    """A plan after an enter gives each copy back to the state it stands for, in place."""
    enter, values = d["plans"][count - 1], d["values"]
    for k, x in enumerate(plan["updates"]):
        if values[x]["role"] != "state":
            raise BundleError(f"{where}.updates[{k}] is copy {show(values[x]['name'])}; what comes after an enter updates states")
    pairs = [[values[x]["type"] for x in p["updates"]] for p in (enter, plan)]
    if pairs[0] != pairs[1] or plan["outputs"] or plan["needs"] != [*enter["needs"], count - 1]:
        raise BundleError(f"{where}: after the enter plans[{count - 1}] a plan is needed that updates states of the same types, gives "
                          "nothing out, and needs it and what it needs")
    if strange := set(plan["reads"]).difference(enter["updates"]):
        raise BundleError(f"{where} reads {show(values[min(strange)]['name'])}; what comes after an enter reads its copies alone")


def _ref(where, ref, d) -> dict:
    image = d["images"][number(where, ref, 0, 2 * len(d["images"]) - 1) // 2]
    if ref % 2 and image["slots"] != 2:
        raise BundleError(f"{where} is {ref}: the second slot of an image that has one")
    return image


def _stage(where, stage, d) -> None:
    if "computes" in d and type(stage) is dict and "compute" in stage:
        _dispatch(where, stage, d)
        return
    a_map(where, stage, ("pass", "width", "height", "attachments", "wait", "subpasses"))
    layout = d["passes"][number(f"{where}.pass", stage["pass"], 0, len(d["passes"]) - 1)]
    number(f"{where}.width", stage["width"], 1, MAX_SIDE)
    number(f"{where}.height", stage["height"], 1, MAX_SIDE)
    if type(stage["wait"]) is not bool:
        fail(f"{where}.wait", stage["wait"], "a boolean is needed")
    a_list(f"{where}.attachments", stage["attachments"], len(layout["attachments"]))
    for k, (ref, a) in enumerate(zip(stage["attachments"], layout["attachments"])):
        at = f"{where}.attachments[{k}]"
        image = _ref(at, ref, d)
        usage = v.USAGE_COLOR if a["format"] else v.USAGE_DEPTH
        if image["format"] != a["format"] or not image["usage"] & usage:
            raise BundleError(f"{at}: image {ref // 2} of format {image['format']} and usage {image['usage']} does not fit the pass")
        if (image["width"], image["height"]) != (stage["width"], stage["height"]):
            raise BundleError(f"{at}: image {ref // 2} is {image['width']} x {image['height']}, the stage is "
                              f"{stage['width']} x {stage['height']}")
    distinct(f"{where}.attachments", stage["attachments"])
    attached = set(stage["attachments"])
    a_list(f"{where}.subpasses", stage["subpasses"], len(layout["subpasses"]))
    for k, draws in enumerate(stage["subpasses"]):
        for j, draw in enumerate(a_list(f"{where}.subpasses[{k}]", draws)):
            _draw(f"{where}.subpasses[{k}][{j}]", draw, stage, k, attached, d)


def _draw(where, draw, stage, subpass, attached, d) -> None:
    a_map(where, draw, ("pipeline", "images", "vertices", "cells", "depth_range", "count"))
    pipeline = d["pipelines"][number(f"{where}.pipeline", draw["pipeline"], 0, len(d["pipelines"]) - 1)]
    if pipeline["pass"] != stage["pass"] or pipeline["subpass"] != subpass:
        raise BundleError(f"{where}.pipeline {draw['pipeline']} is made for another pass")
    a_list(f"{where}.images", draw["images"], len(pipeline["bindings"]))
    for k, (ref, binding) in enumerate(zip(draw["images"], pipeline["bindings"])):
        image = _ref(f"{where}.images[{k}]", ref, d)
        usage = v.USAGE_INPUT if binding[0] == v.DESCRIPTOR_INPUT_ATTACHMENT else v.USAGE_SAMPLED
        if not image["usage"] & usage:
            raise BundleError(f"{where}.images[{k}]: image {ref // 2} lacks usage {usage}")
        if usage == v.USAGE_SAMPLED and ref in attached:
            raise BundleError(f"{where}.images[{k}]: image {ref // 2} is written by the same stage")
    number(f"{where}.vertices", draw["vertices"], 1, (1 << 31) - 1)
    for k, cell in enumerate(a_list(f"{where}.cells", draw["cells"])):
        at = f"{where}.cells[{k}]"
        for j, x in enumerate(a_list(at, cell, 4)):
            number(f"{at}[{j}]", x, 0 if j < 2 else 1, MAX_SIDE)
        if cell[0] + cell[2] > stage["width"] or cell[1] + cell[3] > stage["height"]:
            raise BundleError(f"{at} leaves the stage of {stage['width']} x {stage['height']}")
    if _count(where, draw, attached, d) and len(draw["cells"]) != 1:
        fail(f"{where}.count", draw["count"], "-1, or a draw of one cell")
    low_high = a_list(f"{where}.depth_range", draw["depth_range"], 2)
    if any(type(x) is not float or not 0 <= x <= 1 for x in low_high):
        fail(f"{where}.depth_range", low_high, "two floats from 0 to 1 are needed")


def _count(where, x, written, d) -> bool:
    """Whether an image says how much of a draw or dispatch there is to do."""
    if number(f"{where}.count", x["count"], -1, 2 * len(d["images"]) - 1) < 0:
        return False
    image = _ref(f"{where}.count", x["count"], d)
    if image["format"] != v.FORMATS["R32_SINT"] or not image["usage"] & v.USAGE_TRANSFER_SRC:
        raise BundleError(f"{where}.count: image {x['count'] // 2} is not R32_SINT with usage {v.USAGE_TRANSFER_SRC}")
    if x["count"] in written:
        raise BundleError(f"{where}.count: image {x['count'] // 2} is written by the same stage")
    return True


def _dispatch(where, stage, d) -> None:
    """A stage of compute."""
    a_map(where, stage, ("compute", "groups", "images", "outputs", "count", "wait"))
    compute = d["computes"][number(f"{where}.compute", stage["compute"], 0, len(d["computes"]) - 1)]
    for k, x in enumerate(a_list(f"{where}.groups", stage["groups"], 3)):
        number(f"{where}.groups[{k}]", x, 1, MAX_GROUPS)
    if type(stage["wait"]) is not bool:
        fail(f"{where}.wait", stage["wait"], "a boolean is needed")
    a_list(f"{where}.outputs", stage["outputs"], len(compute["outputs"]))
    for k, (ref, output) in enumerate(zip(stage["outputs"], compute["outputs"])):
        image = _ref(f"{where}.outputs[{k}]", ref, d)
        if image["format"] != output["format"] or not image["usage"] & v.USAGE_STORAGE:
            raise BundleError(f"{where}.outputs[{k}]: image {ref // 2} of format {image['format']} and usage {image['usage']} does not "
                              "fit the compute pipeline")
    distinct(f"{where}.outputs", stage["outputs"])
    a_list(f"{where}.images", stage["images"], len(compute["bindings"]))
    for k, ref in enumerate(stage["images"]):
        image = _ref(f"{where}.images[{k}]", ref, d)
        if not image["usage"] & v.USAGE_SAMPLED:
            raise BundleError(f"{where}.images[{k}]: image {ref // 2} lacks usage {v.USAGE_SAMPLED}")
        if ref in stage["outputs"]:
            raise BundleError(f"{where}.images[{k}]: image {ref // 2} is written by the same stage")
    _count(where, stage, stage["outputs"], d)


def written(stage) -> list[int]:
    """The refs that a stage writes: its attachments, or its outputs."""
    return stage["outputs"] if "compute" in stage else stage["attachments"]


def bound(stage) -> list[int]:
    """The refs of the images that its shaders read, in order."""
    return stage["images"] if "compute" in stage else [ref for draws in stage["subpasses"] for draw in draws for ref in draw["images"]]


def counts(stage) -> set[int]:
    """The refs of the images that say how much there is to draw or dispatch."""
    return {x["count"] for x in ([stage] if "compute" in stage else (draw for draws in stage["subpasses"] for draw in draws))} - {-1}


def check_copies(d, kinds) -> None:
    """Each copy is filled by one enter, which whatever else touches it needs."""
    enter_of: dict[int, int] = {}
    for k, plan in enumerate(d["plans"]):
        copies = [x for x in plan["updates"] if d["values"][x]["role"] == "copy"]
        if kinds[k] == "enter":
            if len(copies) != len(plan["updates"]) or kinds[k + 1:k + 2] != ["leave"]:
                raise BundleError(f"plans[{k}] fills copies; it updates nothing else, and the plan after it gives them back")
            for x in copies:
                if enter_of.setdefault(x, k) != k:
                    raise BundleError(f"plans[{k}] fills copy {show(d['values'][x]['name'])}, as plans[{enter_of[x]}] does")
    for k, plan in enumerate(d["plans"]):
        for x in (*plan["updates"], *plan["reads"]):
            if d["values"][x]["role"] == "copy" and enter_of.get(x) != k and enter_of.get(x, -1) not in plan["needs"]:
                raise BundleError(f"plans[{k}] has to do with copy {show(d['values'][x]['name'])}, and needs no plan that fills it")
        for n, some in Counter(enter_of[x] for x in plan["updates"] if x in enter_of).items():
            if some != len(d["plans"][n]["updates"]):
                raise BundleError(f"plans[{k}] updates {some} of the {len(d['plans'][n]['updates'])} copies that plans[{n}] fills; all "
                                  "or none is allowed")


def check_dataflow(d, kinds) -> None:
    """What plans read was filled, by a constant, input, state, earlier stage or a plan they need; they write what is theirs;
    they wait where they must; and they say what they read."""
    value_of = {value["image"]: k for k, value in enumerate(d["values"])}
    given = {2 * k for k, image in enumerate(d["images"]) if image["data"] is not None}
    given |= {2 * value["image"] for value in d["values"] if value["role"] != "output"}
    writes: list[set[int]] = []
    kept: dict[int, int] = {}  # what a plan reads of one that it needs -> that plan
    for k, plan in enumerate(d["plans"]):
        mine: set[int] = set()
        hazards = _Hazards()
        leave = kinds[k] == "leave"
        reads, owned = set(plan["reads"]), {2 * d["values"][x]["image"] + (not leave) for x in plan["updates"]}
        owned |= {2 * d["values"][x]["image"] for x in plan["outputs"]}
        fixed = given - owned  # a leave attaches the current slot
        for j, stage in enumerate(plan["stages"]):
            where, attached = f"plans[{k}].stages[{j}]", set(written(stage))
            key, how = ("outputs", d["computes"][stage["compute"]]["outputs"]) if "compute" in stage else \
                ("attachments", d["passes"][stage["pass"]]["attachments"])
            for n, ref in enumerate(written(stage)):
                if ref in fixed or ref // 2 in value_of and ref not in owned:
                    raise BundleError(f"{where}.{key}[{n}]: image {ref // 2} is not for this plan to write")
                if leave and ref in owned and how[n]["load"] != v.LOAD_LOAD:
                    raise BundleError(f"{where}.{key}[{n}]: what comes after an enter loads the states that it updates")
            counted = counts(stage)
            if from_outside := counted & given:
                raise BundleError(f"{where} draws as often as image {min(from_outside) // 2} says, which is given from outside; what a "
                                  "stage makes is allowed")
            sampled = set(bound(stage)) - attached | counted
            for ref in sorted(sampled):
                if ref in fixed:
                    if ref // 2 in value_of and value_of[ref // 2] not in reads:
                        raise BundleError(f"{where} reads {show(d['values'][value_of[ref // 2]]['name'])}, which "
                                          f"plans[{k}].reads lacks")
                elif ref not in mine:
                    source = next((n for n in plan["needs"] if ref in writes[n]), None)
                    if source is None:
                        raise BundleError(f"{where} reads image {ref // 2}, which nothing has written")
                    kept[ref] = source
            if hazards.stage(sampled, attached) and not stage["wait"]:
                raise BundleError(f"{where}.wait is false; the stage touches what was written, or writes what was read, since "
                                  "the last wait")
            if stage["wait"]:
                hazards = _Hazards(sampled, set(attached))
            mine |= attached
        for ref in sorted(owned - mine):
            raise BundleError(f"plans[{k}] does not write {show(d['values'][value_of[ref // 2]]['name'])}")
        writes.append(mine)
    for k, mine in enumerate(writes):
        for ref in sorted(mine & kept.keys()):
            if kept[ref] != k:
                raise BundleError(f"plans[{k}] writes image {ref // 2}, which plans[{kept[ref]}] keeps for others")


class _Hazards:
    """What was read and written since the last wait; None before the first."""

    def __init__(self, read: set[int] | None = None, written: set[int] | None = None):
        self.read, self.written = read, written

    def stage(self, read: set[int], written: set[int]) -> bool:
        """Whether this stage must wait; remembers it."""
        if self.read is None or self.written is None:
            return True
        must = not (self.written.isdisjoint(read) and self.written.isdisjoint(written) and self.read.isdisjoint(written))
        self.read |= read
        self.written |= written
        return must
