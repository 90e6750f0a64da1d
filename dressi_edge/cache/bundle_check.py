"""Check a bundle's description before anything of it is used: types, ranges, indices, and that no pass reads what was never written.

In: the decoded description. Out: nothing, or a BundleError that names the first thing wrong by its path. The text of the checks
follows docs/bundle-format.md.
"""
from __future__ import annotations

from . import vulkan as v
from .bundle_fields import a_list, a_map, a_text, fail, number, one_of, show
from .bundle_plans import MAX_SIDE, check_copies, check_dataflow, check_plan
from .errors import BundleError
from .layout import CHANNELS, KINDS, MAX_TABLE_ROWS, is_int, table_size

MAX_PLANS = 4096
MAX_PARTS = 1024  # attachments and subpasses of a pass, bindings of a pipeline
MAX_COLORS = 128
MAX_META_DEPTH = 16
MAX_VARIANTS = 16
MAX_OBJECTS = 1 << 16  # of one kind that a driver makes, whatever their size
# What a user or a checkpoint knows of a bundle, in which its variants agree.
SEEN = {"values": ("name", "role", "type", "layout", "width", "height", "count", "columns", "initial"),
        "plans": ("name", "updates", "outputs", "steps")}
NEEDS_LIMITS = ("maxImageDimension2D", "maxFramebufferWidth", "maxFramebufferHeight", "maxColorAttachments",
                "maxFragmentOutputAttachments", "maxFragmentCombinedOutputResources", "maxPerStageResources",
                "maxDescriptorSetSamplers", "maxDescriptorSetSampledImages", "maxDescriptorSetInputAttachments",
                "maxPerStageDescriptorSamplers", "maxPerStageDescriptorSampledImages", "maxPerStageDescriptorInputAttachments",
                "maxVertexOutputComponents", "maxFragmentInputComponents", "subPixelPrecisionBits", "subTexelPrecisionBits")
NEEDS_FEATURES = ("sampled", "color", "filter")
# what only a description with computes may name
COMPUTE_LIMITS = ("maxPerStageDescriptorStorageImages", "maxDescriptorSetStorageImages", "maxComputeWorkGroupInvocations",
                  "maxComputeSharedMemorySize")
COMPUTE_FEATURES = ("storage",)


def _meta(meta) -> None:
    """Plain values, nested no deeper than any walk over them can follow."""
    if type(meta) is not dict:
        fail("meta", meta, "a map is needed")
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
    computes = type(d) is dict and "computes" in d
    a_map("description", d, ("meta", "profile", "needs", "depth_formats", "images", "samplers", "shaders", "passes", "pipelines",
                            *(["computes"] if computes else []), "values", "plans", "blobs"))
    _meta(d["meta"])
    a_map("profile", d["profile"], ("name", "digest"))
    for key in ("name", "digest"):
        a_text(f"profile.{key}", d["profile"][key])
    for k, blob in enumerate(a_list("blobs", d["blobs"])):
        a_list(f"blobs[{k}]", blob, 3)
        number(f"blobs[{k}][0]", blob[0], 0, 1 << 40)
        number(f"blobs[{k}][1]", blob[1], 0, 1 << 40)
        if type(blob[2]) is not bytes or len(blob[2]) != 32:
            fail(f"blobs[{k}][2]", blob[2], "32 bytes are needed")
    _needs(d["needs"], computes)
    for k, f in enumerate(a_list("depth_formats", d["depth_formats"])):
        one_of(f"depth_formats[{k}]", f, tuple(v.DEPTH_FORMATS.values()))
    blobs = len(d["blobs"])
    for k, image in enumerate(a_list("images", d["images"], most=MAX_OBJECTS)):
        _image(f"images[{k}]", image, blobs, computes)
    for k, s in enumerate(a_list("samplers", d["samplers"], most=MAX_OBJECTS)):
        one_of(f"samplers[{k}]", s, (v.ADDRESS_REPEAT, v.ADDRESS_CLAMP))
    for k, s in enumerate(a_list("shaders", d["shaders"], most=MAX_OBJECTS)):
        number(f"shaders[{k}]", s, 0, blobs - 1)
    for k, p in enumerate(a_list("passes", d["passes"], most=MAX_OBJECTS)):
        _pass(f"passes[{k}]", p)
    for k, p in enumerate(a_list("pipelines", d["pipelines"], most=MAX_OBJECTS)):
        _pipeline(f"pipelines[{k}]", p, d)
    for k, c in enumerate(a_list("computes", d["computes"], most=MAX_OBJECTS) if computes else ()):
        _compute(f"computes[{k}]", c, d)
    names, images = set(), {}
    for k, value in enumerate(a_list("values", d["values"])):
        _value(f"values[{k}]", value, d)
        if value["name"] in names:
            raise BundleError(f"values[{k}].name {show(value['name'])} is taken")
        if images.setdefault(value["image"], k) != k:
            raise BundleError(f"values[{k}].image {value['image']} is that of values[{images[value['image']]}]")
        names.add(value["name"])
    for k, image in enumerate(d["images"]):
        if image["slots"] == 2 and (k not in images or d["values"][images[k]]["role"] not in ("state", "copy")):
            raise BundleError(f"images[{k}].slots is 2; only the image of a state or copy has two")
    names = set()
    kinds: list[str] = []
    for k, plan in enumerate(a_list("plans", d["plans"], most=MAX_PLANS)):
        check_plan(f"plans[{k}]", plan, kinds, d)
        if plan["name"] in names:
            raise BundleError(f"plans[{k}].name {show(plan['name'])} is taken")
        names.add(plan["name"])
    check_copies(d, kinds)
    check_dataflow(d, kinds)


def check_variants(d) -> list[dict]:
    """The description of each variant of a file of several, each well formed and for a profile of its own, of equal values and
    plans. Raises BundleError."""
    a_map("description", d, ("variants", "blobs"))
    if len(a_list("variants", d["variants"], most=MAX_VARIANTS)) < 2:
        fail("variants", d["variants"], f"2 to {MAX_VARIANTS} are needed")
    found: dict[str, dict] = {}
    for k, variant in enumerate(d["variants"]):
        if type(variant) is not dict or "blobs" in variant:
            fail(f"variants[{k}]", variant, "a map without blobs is needed")
        whole = {**variant, "blobs": d["blobs"]}
        try:
            check_description(whole)
        except BundleError as e:
            raise BundleError(f"variants[{k}]: {e}") from None
        name = variant["profile"]["name"]
        if name in found:
            raise BundleError(f"variants[{k}].profile.name {show(name)} is taken")
        found[name] = whole
        for key, fields in SEEN.items():
            first = d["variants"][0][key]
            if len(variant[key]) != len(first):
                fail(f"variants[{k}].{key}", variant[key], f"variants[0] has {len(first)}")
            for j, (x, y) in enumerate(zip(variant[key], first)):
                for field in fields:
                    if x[field] != y[field]:
                        fail(f"variants[{k}].{key}[{j}].{field}", x[field], f"that of variants[0] is {show(y[field])}")
    return list(found.values())


def _needs(needs, computes) -> None:
    a_map("needs", needs, ("limits", "formats"))
    if type(needs["limits"]) is not dict or type(needs["formats"]) is not dict:
        fail("needs", needs, "maps are needed")
    for name, x in needs["limits"].items():
        if name not in NEEDS_LIMITS and not (computes and name in COMPUTE_LIMITS):
            raise BundleError(f"needs.limits names {show(name)}, which this reader does not know")
        number(f"needs.limits.{name}", x, 0, 1 << 40)
    for name, features in needs["formats"].items():
        if name not in v.FORMATS:
            raise BundleError(f"needs.formats names {show(name)}, which this reader does not know")
        for k, f in enumerate(a_list(f"needs.formats.{name}", features)):
            one_of(f"needs.formats.{name}[{k}]", f, NEEDS_FEATURES + (COMPUTE_FEATURES if computes else ()))


def _image(where, image, blobs, computes) -> None:
    a_map(where, image, ("format", "width", "height", "slots", "usage", "data"))
    one_of(f"{where}.format", image["format"], (0, *v.FORMAT_NAMES))
    number(f"{where}.width", image["width"], 1, MAX_SIDE)
    number(f"{where}.height", image["height"], 1, MAX_SIDE)
    number(f"{where}.slots", image["slots"], 1, 2)
    allowed = v.USAGE_DEPTH if image["format"] == 0 else \
        v.USAGE_TRANSFER_SRC | v.USAGE_TRANSFER_DST | v.USAGE_SAMPLED | v.USAGE_COLOR | v.USAGE_INPUT | v.USAGE_STORAGE * computes
    if number(f"{where}.usage", image["usage"], 1, 255) & ~allowed:
        fail(f"{where}.usage", image["usage"], f"bits of {allowed} are allowed")
    if image["data"] is not None:
        number(f"{where}.data", image["data"], 0, blobs - 1)
        if not image["usage"] & v.USAGE_TRANSFER_DST or image["format"] == 0 or image["slots"] != 1:
            raise BundleError(f"{where}.data needs a colour format, one slot and usage {v.USAGE_TRANSFER_DST}")


def _pass(where, p) -> None:
    a_map(where, p, ("attachments", "subpasses"))
    count = len(a_list(f"{where}.attachments", p["attachments"], most=MAX_PARTS))
    for k, a in enumerate(p["attachments"]):
        at = f"{where}.attachments[{k}]"
        a_map(at, a, ("format", "load", "store", "clear"))
        one_of(f"{at}.format", a["format"], (0, *v.FORMAT_NAMES))
        depth = a["format"] == 0
        number(f"{at}.load", a["load"], v.LOAD_CLEAR if depth else 0, v.LOAD_CLEAR if depth else 2)
        number(f"{at}.store", a["store"], 0, 1)
        number(f"{at}.clear", a["clear"], -1 if a["format"] in v.INTEGER_FORMATS else 0,
                1 if depth or a["format"] in v.INTEGER_FORMATS else 0)
    if not a_list(f"{where}.subpasses", p["subpasses"], most=MAX_PARTS):
        fail(f"{where}.subpasses", [], "at least one is needed")
    written = {k for k, a in enumerate(p["attachments"]) if a["load"] == v.LOAD_LOAD}
    for k, s in enumerate(p["subpasses"]):
        at = f"{where}.subpasses[{k}]"
        a_map(at, s, ("colors", "inputs", "depth"))
        for key in ("colors", "inputs"):
            for j, a in enumerate(a_list(f"{at}.{key}", s[key], most=MAX_COLORS)):
                number(f"{at}.{key}[{j}]", a, 0, count - 1)
                if p["attachments"][a]["format"] == 0:
                    raise BundleError(f"{at}.{key}[{j}] is a depth attachment")
        if len(set(s["colors"])) != len(s["colors"]) or set(s["colors"]) & set(s["inputs"]):
            raise BundleError(f"{at}: an attachment is used twice")
        for j, a in enumerate(s["inputs"]):
            if a not in written:
                raise BundleError(f"{at}.inputs[{j}]: attachment {a} was neither loaded nor written by an earlier subpass")
        written.update(s["colors"])
        number(f"{at}.depth", s["depth"], -1, count - 1)
        if s["depth"] >= 0 and p["attachments"][s["depth"]]["format"] != 0:
            raise BundleError(f"{at}.depth is no depth attachment")
        if s["depth"] >= 0 and any(other["depth"] >= 0 for other in p["subpasses"][:k]):
            raise BundleError(f"{at}.depth: a second subpass with depth; nothing orders the two")


def _pipeline(where, p, d) -> None:
    a_map(where, p, ("vertex", "fragment", "pass", "subpass", "bindings", "depth", "topology"))
    one_of(f"{where}.topology", p["topology"], tuple(v.TOPOLOGIES.values()))
    for key in ("vertex", "fragment"):
        number(f"{where}.{key}", p[key], 0, len(d["shaders"]) - 1)
    number(f"{where}.pass", p["pass"], 0, len(d["passes"]) - 1)
    subpasses = d["passes"][p["pass"]]["subpasses"]
    number(f"{where}.subpass", p["subpass"], 0, len(subpasses) - 1)
    if type(p["depth"]) is not bool or p["depth"] and subpasses[p["subpass"]]["depth"] < 0:
        fail(f"{where}.depth", p["depth"], "false, or true with a depth attachment")
    for k, b in enumerate(a_list(f"{where}.bindings", p["bindings"], most=MAX_PARTS)):
        at = f"{where}.bindings[{k}]"
        a_list(at, b, 3)
        one_of(f"{at}[0]", b[0], (v.DESCRIPTOR_COMBINED_IMAGE_SAMPLER, v.DESCRIPTOR_SAMPLED_IMAGE, v.DESCRIPTOR_INPUT_ATTACHMENT))
        one_of(f"{at}[1]", b[1], (v.STAGE_VERTEX, v.STAGE_FRAGMENT, v.STAGE_VERTEX | v.STAGE_FRAGMENT))
        sampler = b[0] == v.DESCRIPTOR_COMBINED_IMAGE_SAMPLER
        number(f"{at}[2]", b[2], 0 if sampler else -1, len(d["samplers"]) - 1 if sampler else -1)


def _compute(where, c, d) -> None:
    a_map(where, c, ("shader", "bindings", "outputs"))
    number(f"{where}.shader", c["shader"], 0, len(d["shaders"]) - 1)
    for k, b in enumerate(a_list(f"{where}.bindings", c["bindings"], most=MAX_PARTS)):
        at = f"{where}.bindings[{k}]"
        a_list(at, b, 2)
        one_of(f"{at}[0]", b[0], (v.DESCRIPTOR_COMBINED_IMAGE_SAMPLER, v.DESCRIPTOR_SAMPLED_IMAGE))
        sampler = b[0] == v.DESCRIPTOR_COMBINED_IMAGE_SAMPLER
        number(f"{at}[1]", b[1], 0 if sampler else -1, len(d["samplers"]) - 1 if sampler else -1)
    if not a_list(f"{where}.outputs", c["outputs"], most=MAX_COLORS):
        fail(f"{where}.outputs", [], "at least one is needed")
    for k, o in enumerate(c["outputs"]):
        at = f"{where}.outputs[{k}]"
        a_map(at, o, ("format", "load", "clear"))
        one_of(f"{at}.format", o["format"], tuple(sorted(v.STORABLE.values())))
        number(f"{at}.load", o["load"], 0, 2)
        integer = o["format"] in v.INTEGER_FORMATS
        number(f"{at}.clear", o["clear"], -integer, +integer)


def _value(where, value, d) -> None:
    a_map(where, value, ("name", "role", "image", "type", "layout", "width", "height", "count", "columns", "initial"))
    a_text(f"{where}.name", value["name"])
    one_of(f"{where}.role", value["role"], ("input", "state", "output", "copy"))
    one_of(f"{where}.type", value["type"], tuple(CHANNELS))
    one_of(f"{where}.layout", value["layout"], KINDS)
    for key in ("width", "height", "count", "columns"):
        number(f"{where}.{key}", value[key], 1, 1 << 30)
    image = d["images"][number(f"{where}.image", value["image"], 0, len(d["images"]) - 1)]
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
    if (start := value["initial"]) is not None:
        if type(start) is not bytes:
            number(f"{where}.initial", start, 0, len(d["blobs"]) - 1)
        elif len(start) != (texel := v.TEXEL_BYTES[image["format"]]):
            raise BundleError(f"{where}.initial: {len(start)} bytes; a texel of its image has {texel}")
        if value["role"] in ("output", "copy"):
            raise BundleError(f"{where}.initial: {'an output' if value['role'] == 'output' else 'a copy'} has none")


def _layout_size(value) -> tuple[int, int]:
    kind, width, height, count, columns = (value[k] for k in ("layout", "width", "height", "count", "columns"))
    if kind == "unit":
        return 1, 1
    if kind == "table":
        return table_size(count) if count <= MAX_TABLE_ROWS * MAX_SIDE else (0, 0)
    return (width, height) if kind == "image" else (width * columns, height * -(-count // columns))


