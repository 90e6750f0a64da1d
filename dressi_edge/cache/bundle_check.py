"""Check a bundle's description before anything of it is used: types, ranges, indices, and that no pass reads what was never written.

In: the decoded description. Out: nothing, or a BundleError that names the first thing wrong by its path. The text of the checks
follows docs/bundle-format.md.
"""
from __future__ import annotations

from collections import Counter

from . import vulkan as v
from .copies import kind_of
from .errors import BundleError
from .layout import CHANNELS, KINDS, MAX_TABLE_ROWS, is_int, table_size

MAX_SIDE = 1 << 16
MAX_ITEMS = 1 << 20
MAX_PLANS = 4096
MAX_PARTS = 1024  # attachments and subpasses of a pass, bindings of a pipeline
MAX_COLORS = 128
MAX_NEEDS = 16
MAX_META_DEPTH = 16
MAX_VARIANTS = 16
# What a user or a checkpoint knows of a bundle, in which its variants agree.
SEEN = {"values": ("name", "role", "type", "layout", "width", "height", "count", "columns", "initial"),
        "plans": ("name", "updates", "outputs", "steps")}
NEEDS_LIMITS = ("maxImageDimension2D", "maxFramebufferWidth", "maxFramebufferHeight", "maxColorAttachments",
                "maxFragmentOutputAttachments", "maxFragmentCombinedOutputResources", "maxPerStageResources",
                "maxDescriptorSetSamplers", "maxDescriptorSetSampledImages", "maxDescriptorSetInputAttachments",
                "maxPerStageDescriptorSamplers", "maxPerStageDescriptorSampledImages", "maxPerStageDescriptorInputAttachments")
NEEDS_FEATURES = ("sampled", "color", "filter")


def _fail(where: str, found, allowed: str):
    raise BundleError(f"{where} is {_show(found)}; {allowed}")


def _show(x) -> str:
    """Short, whatever it is: a value from a file may be large, and nested deeper than repr can follow."""
    if isinstance(x, (list, tuple)):
        return f"a list of {len(x)}"
    if isinstance(x, dict):
        return f"a map of {len(x)}"
    short = x[:60] if isinstance(x, (str, bytes)) else x
    return f"{short!r:.60}"


def _number(where, x, low, high):
    if type(x) is not int or not low <= x <= high:
        _fail(where, x, f"an integer from {low} to {high} is allowed")
    return x


def _one_of(where, x, allowed):
    if type(x) not in (int, str) or x not in allowed:
        _fail(where, x, "allowed: " + " ".join(map(str, allowed)))
    return x


def _list(where, x, length=None, most=MAX_ITEMS):
    if type(x) is not list or len(x) > most or (length is not None and len(x) != length):
        _fail(where, x, "a list of " + (f"{length} is needed" if length is not None else f"at most {most} is allowed"))
    return x


def _distinct(where, xs):
    if len(set(xs)) != len(xs):
        raise BundleError(f"{where} names something twice")


def _map(where, x, keys):
    if type(x) is not dict:
        _fail(where, x, "a map is needed")
    for key in keys:
        if key not in x:
            raise BundleError(f"{where} lacks {key}")
    for key in x:
        if key not in keys:
            raise BundleError(f"{where} has the unknown key {_show(key)}")
    return x


def _text(where, x):
    if type(x) is not str or not 0 < len(x) <= 200 or any(c < " " or "\x7f" <= c < "\xa0" for c in x):
        _fail(where, x, "a text of 1 to 200 characters, none of control, is needed")
    return x


def _meta(meta) -> None:
    """Plain values, nested no deeper than any walk over them can follow."""
    if type(meta) is not dict:
        _fail("meta", meta, "a map is needed")
    layer = [meta]
    for _ in range(MAX_META_DEPTH):
        below: list = []
        for x in layer:
            if type(x) is dict and not all(type(key) is str for key in x):
                raise BundleError("meta has a map with a key that is no text")
            below.extend(x.values() if type(x) is dict else x)
        bad = next((x for x in below if x is not None and type(x) not in (bool, int, float, str, bytes, list, dict)), None)
        if bad is not None:
            raise BundleError(f"meta holds a {type(bad).__name__}; nil, booleans, numbers, text, bytes, lists and maps are "
                              "allowed")
        layer = [x for x in below if type(x) in (list, dict)]
        if not layer:
            return
    raise BundleError(f"meta is nested deeper than {MAX_META_DEPTH}")


def check_description(d) -> None:
    """Raise BundleError unless the description is well formed."""
    _map("description", d, ("meta", "profile", "needs", "depth_formats", "images", "samplers", "shaders", "passes", "pipelines",
                            "values", "plans", "blobs"))
    _meta(d["meta"])
    _map("profile", d["profile"], ("name", "digest"))
    for key in ("name", "digest"):
        _text(f"profile.{key}", d["profile"][key])
    for k, blob in enumerate(_list("blobs", d["blobs"])):
        _list(f"blobs[{k}]", blob, 3)
        _number(f"blobs[{k}][0]", blob[0], 0, 1 << 40)
        _number(f"blobs[{k}][1]", blob[1], 0, 1 << 40)
        if type(blob[2]) is not bytes or len(blob[2]) != 32:
            _fail(f"blobs[{k}][2]", blob[2], "32 bytes are needed")
    _needs(d["needs"])
    for k, f in enumerate(_list("depth_formats", d["depth_formats"])):
        _one_of(f"depth_formats[{k}]", f, tuple(v.DEPTH_FORMATS.values()))
    blobs = len(d["blobs"])
    for k, image in enumerate(_list("images", d["images"])):
        _image(f"images[{k}]", image, blobs)
    for k, s in enumerate(_list("samplers", d["samplers"])):
        _one_of(f"samplers[{k}]", s, (v.ADDRESS_REPEAT, v.ADDRESS_CLAMP))
    for k, s in enumerate(_list("shaders", d["shaders"])):
        _number(f"shaders[{k}]", s, 0, blobs - 1)
    for k, p in enumerate(_list("passes", d["passes"])):
        _pass(f"passes[{k}]", p)
    for k, p in enumerate(_list("pipelines", d["pipelines"])):
        _pipeline(f"pipelines[{k}]", p, d)
    names, images = set(), {}
    for k, value in enumerate(_list("values", d["values"])):
        _value(f"values[{k}]", value, d)
        if value["name"] in names:
            raise BundleError(f"values[{k}].name {_show(value['name'])} is taken")
        if images.setdefault(value["image"], k) != k:
            raise BundleError(f"values[{k}].image {value['image']} is that of values[{images[value['image']]}]")
        names.add(value["name"])
    for k, image in enumerate(d["images"]):
        if image["slots"] == 2 and (k not in images or d["values"][images[k]]["role"] not in ("state", "copy")):
            raise BundleError(f"images[{k}].slots is 2; only the image of a state or copy has two")
    names = set()
    kinds: list[str] = []
    for k, plan in enumerate(_list("plans", d["plans"], most=MAX_PLANS)):
        _plan(f"plans[{k}]", plan, kinds, d)
        if plan["name"] in names:
            raise BundleError(f"plans[{k}].name {_show(plan['name'])} is taken")
        names.add(plan["name"])
    _copies(d, kinds)
    _dataflow(d, kinds)


def check_variants(d) -> list[dict]:
    """The description of each variant of a file of several, each well formed and for a profile of its own, of equal values and
    plans. Raises BundleError."""
    _map("description", d, ("variants", "blobs"))
    if len(_list("variants", d["variants"], most=MAX_VARIANTS)) < 2:
        _fail("variants", d["variants"], f"2 to {MAX_VARIANTS} are needed")
    found: dict[str, dict] = {}
    for k, variant in enumerate(d["variants"]):
        if type(variant) is not dict or "blobs" in variant:
            _fail(f"variants[{k}]", variant, "a map without blobs is needed")
        whole = {**variant, "blobs": d["blobs"]}
        try:
            check_description(whole)
        except BundleError as e:
            raise BundleError(f"variants[{k}]: {e}") from None
        name = variant["profile"]["name"]
        if name in found:
            raise BundleError(f"variants[{k}].profile.name {_show(name)} is taken")
        found[name] = whole
        for key, fields in SEEN.items():
            first = d["variants"][0][key]
            if len(variant[key]) != len(first):
                _fail(f"variants[{k}].{key}", variant[key], f"variants[0] has {len(first)}")
            for j, (x, y) in enumerate(zip(variant[key], first)):
                for field in fields:
                    if x[field] != y[field]:
                        _fail(f"variants[{k}].{key}[{j}].{field}", x[field], f"that of variants[0] is {_show(y[field])}")
    return list(found.values())


def _needs(needs) -> None:
    _map("needs", needs, ("limits", "formats"))
    if type(needs["limits"]) is not dict or type(needs["formats"]) is not dict:
        _fail("needs", needs, "maps are needed")
    for name, x in needs["limits"].items():
        if name not in NEEDS_LIMITS:
            raise BundleError(f"needs.limits names {_show(name)}, which this reader does not know")
        _number(f"needs.limits.{name}", x, 0, 1 << 40)
    for name, features in needs["formats"].items():
        if name not in v.FORMATS:
            raise BundleError(f"needs.formats names {_show(name)}, which this reader does not know")
        for k, f in enumerate(_list(f"needs.formats.{name}", features)):
            _one_of(f"needs.formats.{name}[{k}]", f, NEEDS_FEATURES)


def _image(where, image, blobs) -> None:
    _map(where, image, ("format", "width", "height", "slots", "usage", "data"))
    _one_of(f"{where}.format", image["format"], (0, *v.FORMAT_NAMES))
    _number(f"{where}.width", image["width"], 1, MAX_SIDE)
    _number(f"{where}.height", image["height"], 1, MAX_SIDE)
    _number(f"{where}.slots", image["slots"], 1, 2)
    allowed = v.USAGE_DEPTH if image["format"] == 0 else \
        v.USAGE_TRANSFER_SRC | v.USAGE_TRANSFER_DST | v.USAGE_SAMPLED | v.USAGE_COLOR | v.USAGE_INPUT
    if _number(f"{where}.usage", image["usage"], 1, 255) & ~allowed:
        _fail(f"{where}.usage", image["usage"], f"bits of {allowed} are allowed")
    if image["data"] is not None:
        _number(f"{where}.data", image["data"], 0, blobs - 1)
        if not image["usage"] & v.USAGE_TRANSFER_DST or image["format"] == 0 or image["slots"] != 1:
            raise BundleError(f"{where}.data needs a colour format, one slot and usage {v.USAGE_TRANSFER_DST}")


def _pass(where, p) -> None:
    _map(where, p, ("attachments", "subpasses"))
    count = len(_list(f"{where}.attachments", p["attachments"], most=MAX_PARTS))
    for k, a in enumerate(p["attachments"]):
        at = f"{where}.attachments[{k}]"
        _map(at, a, ("format", "load", "store", "clear"))
        _one_of(f"{at}.format", a["format"], (0, *v.FORMAT_NAMES))
        depth = a["format"] == 0
        _number(f"{at}.load", a["load"], v.LOAD_CLEAR if depth else 0, v.LOAD_CLEAR if depth else 2)
        _number(f"{at}.store", a["store"], 0, 1)
        _number(f"{at}.clear", a["clear"], -1 if a["format"] in v.INTEGER_FORMATS else 0,
                1 if depth or a["format"] in v.INTEGER_FORMATS else 0)
    if not _list(f"{where}.subpasses", p["subpasses"], most=MAX_PARTS):
        _fail(f"{where}.subpasses", [], "at least one is needed")
    written = {k for k, a in enumerate(p["attachments"]) if a["load"] == v.LOAD_LOAD}
    for k, s in enumerate(p["subpasses"]):
        at = f"{where}.subpasses[{k}]"
        _map(at, s, ("colors", "inputs", "depth"))
        for key in ("colors", "inputs"):
            for j, a in enumerate(_list(f"{at}.{key}", s[key], most=MAX_COLORS)):
                _number(f"{at}.{key}[{j}]", a, 0, count - 1)
                if p["attachments"][a]["format"] == 0:
                    raise BundleError(f"{at}.{key}[{j}] is a depth attachment")
        if len(set(s["colors"])) != len(s["colors"]) or set(s["colors"]) & set(s["inputs"]):
            raise BundleError(f"{at}: an attachment is used twice")
        for j, a in enumerate(s["inputs"]):
            if a not in written:
                raise BundleError(f"{at}.inputs[{j}]: attachment {a} was neither loaded nor written by an earlier subpass")
        written.update(s["colors"])
        _number(f"{at}.depth", s["depth"], -1, count - 1)
        if s["depth"] >= 0 and p["attachments"][s["depth"]]["format"] != 0:
            raise BundleError(f"{at}.depth is no depth attachment")


def _pipeline(where, p, d) -> None:
    _map(where, p, ("vertex", "fragment", "pass", "subpass", "bindings", "depth", "topology"))
    _one_of(f"{where}.topology", p["topology"], tuple(v.TOPOLOGIES.values()))
    for key in ("vertex", "fragment"):
        _number(f"{where}.{key}", p[key], 0, len(d["shaders"]) - 1)
    _number(f"{where}.pass", p["pass"], 0, len(d["passes"]) - 1)
    subpasses = d["passes"][p["pass"]]["subpasses"]
    _number(f"{where}.subpass", p["subpass"], 0, len(subpasses) - 1)
    if type(p["depth"]) is not bool or p["depth"] and subpasses[p["subpass"]]["depth"] < 0:
        _fail(f"{where}.depth", p["depth"], "false, or true with a depth attachment")
    for k, b in enumerate(_list(f"{where}.bindings", p["bindings"], most=MAX_PARTS)):
        at = f"{where}.bindings[{k}]"
        _list(at, b, 3)
        _one_of(f"{at}[0]", b[0], (v.DESCRIPTOR_COMBINED_IMAGE_SAMPLER, v.DESCRIPTOR_SAMPLED_IMAGE, v.DESCRIPTOR_INPUT_ATTACHMENT))
        _one_of(f"{at}[1]", b[1], (v.STAGE_VERTEX, v.STAGE_FRAGMENT, v.STAGE_VERTEX | v.STAGE_FRAGMENT))
        sampler = b[0] == v.DESCRIPTOR_COMBINED_IMAGE_SAMPLER
        _number(f"{at}[2]", b[2], 0 if sampler else -1, len(d["samplers"]) - 1 if sampler else -1)


def _value(where, value, d) -> None:
    _map(where, value, ("name", "role", "image", "type", "layout", "width", "height", "count", "columns", "initial"))
    _text(f"{where}.name", value["name"])
    _one_of(f"{where}.role", value["role"], ("input", "state", "output", "copy"))
    _one_of(f"{where}.type", value["type"], tuple(CHANNELS))
    _one_of(f"{where}.layout", value["layout"], KINDS)
    for key in ("width", "height", "count", "columns"):
        _number(f"{where}.{key}", value[key], 1, 1 << 30)
    image = d["images"][_number(f"{where}.image", value["image"], 0, len(d["images"]) - 1)]
    size = _layout_size(value)
    if (image["width"], image["height"]) != size:
        raise BundleError(f"{where}: its image is {image['width']} x {image['height']}; {size[0]} x {size[1]} is needed")
    channels = CHANNELS[value["type"]]
    if image["format"] not in v.FORMAT_NAMES or v.FORMAT_CHANNELS[image["format"]] != (4 if channels == 3 else channels) \
            or (image["format"] in v.INTEGER_FORMATS) != is_int(value["type"]):
        raise BundleError(f"{where}: its image has format {image['format']}, which does not hold {value['type']}")
    if image["format"] in v.HALF_FORMATS and value["role"] != "input":
        raise BundleError(f"{where}: its image has format {image['format']}; only inputs may have 16 bits a channel")
    wanted = {"output": v.USAGE_TRANSFER_SRC, "copy": 0}.get(value["role"], v.USAGE_TRANSFER_SRC | v.USAGE_TRANSFER_DST)
    if image["usage"] & wanted != wanted:
        raise BundleError(f"{where}: its image lacks usage {wanted}")
    if image["data"] is not None:
        raise BundleError(f"{where}: its image {value['image']} is a constant")
    if value["initial"] is not None:
        _number(f"{where}.initial", value["initial"], 0, len(d["blobs"]) - 1)
        if value["role"] in ("output", "copy"):
            raise BundleError(f"{where}.initial: {'an output' if value['role'] == 'output' else 'a copy'} has none")


def _layout_size(value) -> tuple[int, int]:
    kind, width, height, count, columns = (value[k] for k in ("layout", "width", "height", "count", "columns"))
    if kind == "unit":
        return 1, 1
    if kind == "table":
        return table_size(count) if count <= MAX_TABLE_ROWS * MAX_SIDE else (0, 0)
    return (width, height) if kind == "image" else (width * columns, height * -(-count // columns))


def _plan(where, plan, kinds, d) -> None:
    """`kinds`: of the plans before; this one's is added."""
    number, leave = len(kinds), kinds[-1:] == ["enter"]
    _map(where, plan, ("name", "stages", "updates", "reads", "outputs", "needs", "steps"))
    _text(f"{where}.name", plan["name"])
    _number(f"{where}.steps", plan["steps"], 0, 1 << 40)
    for key, role in (("updates", ("state", "copy")), ("reads", ("input", "state", "copy")), ("outputs", ("output",))):
        for k, x in enumerate(_list(f"{where}.{key}", plan[key])):
            _number(f"{where}.{key}[{k}]", x, 0, len(d["values"]) - 1)
            if d["values"][x]["role"] not in role:
                raise BundleError(f"{where}.{key}[{k}] is {d['values'][x]['role']} {_show(d['values'][x]['name'])}; "
                                  f"{' or '.join(role)} is allowed")
            if key == "updates" and not leave and d["images"][d["values"][x]["image"]]["slots"] != 2:
                raise BundleError(f"{where}.updates[{k}]: the image of {_show(d['values'][x]['name'])} has one slot; two are "
                                  "needed")
        _distinct(f"{where}.{key}", plan[key])
    low = 0
    for k, x in enumerate(_list(f"{where}.needs", plan["needs"], most=MAX_NEEDS)):
        low = _number(f"{where}.needs[{k}]", x, low, number - 1) + 1
        if kinds[x] not in ("output", "enter"):
            raise BundleError(f"{where}.needs[{k}]: plans[{x}] updates something")
        if missing := set(d["plans"][x]["needs"]).difference(plan["needs"][:k]):
            raise BundleError(f"{where}.needs[{k}]: plans[{x}] needs plans[{min(missing)}], which is not among them")
    kinds.append(kind_of(d, plan, kinds))
    if leave:
        _leave(where, plan, number, d)
    for k, stage in enumerate(_list(f"{where}.stages", plan["stages"])):
        _stage(f"{where}.stages[{k}]", stage, d)


def _leave(where, plan, number, d) -> None:
    """A plan after an enter gives each copy back to the state it stands for, in place."""
    enter, values = d["plans"][number - 1], d["values"]
    for k, x in enumerate(plan["updates"]):
        if values[x]["role"] != "state":
            raise BundleError(f"{where}.updates[{k}] is copy {_show(values[x]['name'])}; what comes after an enter updates states")
    pairs = [[values[x]["type"] for x in p["updates"]] for p in (enter, plan)]
    if pairs[0] != pairs[1] or plan["outputs"] or plan["needs"] != [*enter["needs"], number - 1]:
        raise BundleError(f"{where}: after the enter plans[{number - 1}] a plan is needed that updates states of the same types, gives "
                          "nothing out, and needs it and what it needs")
    if strange := set(plan["reads"]).difference(enter["updates"]):
        raise BundleError(f"{where} reads {_show(values[min(strange)]['name'])}; what comes after an enter reads its copies alone")


def _ref(where, ref, d) -> dict:
    image = d["images"][_number(where, ref, 0, 2 * len(d["images"]) - 1) // 2]
    if ref % 2 and image["slots"] != 2:
        raise BundleError(f"{where} is {ref}: the second slot of an image that has one")
    return image


def _stage(where, stage, d) -> None:
    _map(where, stage, ("pass", "width", "height", "attachments", "wait", "subpasses"))
    layout = d["passes"][_number(f"{where}.pass", stage["pass"], 0, len(d["passes"]) - 1)]
    _number(f"{where}.width", stage["width"], 1, MAX_SIDE)
    _number(f"{where}.height", stage["height"], 1, MAX_SIDE)
    if type(stage["wait"]) is not bool:
        _fail(f"{where}.wait", stage["wait"], "a boolean is needed")
    _list(f"{where}.attachments", stage["attachments"], len(layout["attachments"]))
    for k, (ref, a) in enumerate(zip(stage["attachments"], layout["attachments"])):
        at = f"{where}.attachments[{k}]"
        image = _ref(at, ref, d)
        usage = v.USAGE_COLOR if a["format"] else v.USAGE_DEPTH
        if image["format"] != a["format"] or not image["usage"] & usage:
            raise BundleError(f"{at}: image {ref // 2} of format {image['format']} and usage {image['usage']} does not fit the pass")
        if (image["width"], image["height"]) != (stage["width"], stage["height"]):
            raise BundleError(f"{at}: image {ref // 2} is {image['width']} x {image['height']}, the stage is "
                              f"{stage['width']} x {stage['height']}")
    _distinct(f"{where}.attachments", stage["attachments"])
    attached = set(stage["attachments"])
    _list(f"{where}.subpasses", stage["subpasses"], len(layout["subpasses"]))
    for k, draws in enumerate(stage["subpasses"]):
        for j, draw in enumerate(_list(f"{where}.subpasses[{k}]", draws)):
            _draw(f"{where}.subpasses[{k}][{j}]", draw, stage, k, attached, d)


def _draw(where, draw, stage, subpass, attached, d) -> None:
    _map(where, draw, ("pipeline", "images", "vertices", "cells", "depth_range", "count"))
    pipeline = d["pipelines"][_number(f"{where}.pipeline", draw["pipeline"], 0, len(d["pipelines"]) - 1)]
    if pipeline["pass"] != stage["pass"] or pipeline["subpass"] != subpass:
        raise BundleError(f"{where}.pipeline {draw['pipeline']} is made for another pass")
    _list(f"{where}.images", draw["images"], len(pipeline["bindings"]))
    for k, (ref, binding) in enumerate(zip(draw["images"], pipeline["bindings"])):
        image = _ref(f"{where}.images[{k}]", ref, d)
        usage = v.USAGE_INPUT if binding[0] == v.DESCRIPTOR_INPUT_ATTACHMENT else v.USAGE_SAMPLED
        if not image["usage"] & usage:
            raise BundleError(f"{where}.images[{k}]: image {ref // 2} lacks usage {usage}")
        if usage == v.USAGE_SAMPLED and ref in attached:
            raise BundleError(f"{where}.images[{k}]: image {ref // 2} is written by the same stage")
    _number(f"{where}.vertices", draw["vertices"], 1, (1 << 31) - 1)
    for k, cell in enumerate(_list(f"{where}.cells", draw["cells"])):
        at = f"{where}.cells[{k}]"
        for j, x in enumerate(_list(at, cell, 4)):
            _number(f"{at}[{j}]", x, 0 if j < 2 else 1, MAX_SIDE)
        if cell[0] + cell[2] > stage["width"] or cell[1] + cell[3] > stage["height"]:
            raise BundleError(f"{at} leaves the stage of {stage['width']} x {stage['height']}")
    if _number(f"{where}.count", draw["count"], -1, 2 * len(d["images"]) - 1) >= 0:
        image = _ref(f"{where}.count", draw["count"], d)
        if image["format"] != v.FORMATS["R32_SINT"] or not image["usage"] & v.USAGE_TRANSFER_SRC:
            raise BundleError(f"{where}.count: image {draw['count'] // 2} is not R32_SINT with usage {v.USAGE_TRANSFER_SRC}")
        if draw["count"] in attached:
            raise BundleError(f"{where}.count: image {draw['count'] // 2} is written by the same stage")
        if len(draw["cells"]) != 1:
            _fail(f"{where}.count", draw["count"], "-1, or a draw of one cell")
    low_high = _list(f"{where}.depth_range", draw["depth_range"], 2)
    if any(type(x) is not float or not 0 <= x <= 1 for x in low_high):
        _fail(f"{where}.depth_range", low_high, "two floats from 0 to 1 are needed")


def _copies(d, kinds) -> None:
    """Each copy is filled by one enter, which whatever else touches it needs."""
    enter_of: dict[int, int] = {}
    for k, plan in enumerate(d["plans"]):
        copies = [x for x in plan["updates"] if d["values"][x]["role"] == "copy"]
        if kinds[k] == "enter":
            if len(copies) != len(plan["updates"]) or kinds[k + 1:k + 2] != ["leave"]:
                raise BundleError(f"plans[{k}] fills copies; it updates nothing else, and the plan after it gives them back")
            for x in copies:
                if enter_of.setdefault(x, k) != k:
                    raise BundleError(f"plans[{k}] fills copy {_show(d['values'][x]['name'])}, as plans[{enter_of[x]}] does")
    for k, plan in enumerate(d["plans"]):
        for x in (*plan["updates"], *plan["reads"]):
            if d["values"][x]["role"] == "copy" and enter_of.get(x) != k and enter_of.get(x, -1) not in plan["needs"]:
                raise BundleError(f"plans[{k}] has to do with copy {_show(d['values'][x]['name'])}, and needs no plan that fills it")
        for n, count in Counter(enter_of[x] for x in plan["updates"] if x in enter_of).items():
            if count != len(d["plans"][n]["updates"]):
                raise BundleError(f"plans[{k}] updates {count} of the {len(d['plans'][n]['updates'])} copies that plans[{n}] fills; all "
                                  "or none is allowed")


def _dataflow(d, kinds) -> None:
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
            where, attached = f"plans[{k}].stages[{j}]", set(stage["attachments"])
            for n, ref in enumerate(stage["attachments"]):
                if ref in fixed or ref // 2 in value_of and ref not in owned:
                    raise BundleError(f"{where}.attachments[{n}]: image {ref // 2} is not for this plan to write")
                if leave and ref in owned and d["passes"][stage["pass"]]["attachments"][n]["load"] != v.LOAD_LOAD:
                    raise BundleError(f"{where}.attachments[{n}]: what comes after an enter loads the states that it updates")
            sampled = {ref for draws in stage["subpasses"] for draw in draws for ref in (*draw["images"], draw["count"])} - attached - {-1}
            for ref in sorted(sampled):
                if ref in fixed:
                    if ref // 2 in value_of and value_of[ref // 2] not in reads:
                        raise BundleError(f"{where} reads {_show(d['values'][value_of[ref // 2]]['name'])}, which "
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
            raise BundleError(f"plans[{k}] does not write {_show(d['values'][value_of[ref // 2]]['name'])}")
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
