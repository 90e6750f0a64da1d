"""The independent count of limits, and the reader of shader interfaces.

Each limit is met by a bundle that needs exactly one more than a profile allows which allows everything else. What the compiler
makes for a profile keeps that profile, and what `needs` says a bundle needs is what the count finds.
"""

import copy
import dataclasses
import random
import struct
import types

import pytest
from profile_bundles import NAMES

from dressi_edge.cache import bundle
from dressi_edge.cache import vulkan as v
from dressi_edge.cache.bundle_check import check_description
from dressi_edge.cache.errors import BundleError, DeviceError, PackError
from dressi_edge.cache.layout import Layout
from dressi_edge.cache.limits import LIMITS
from dressi_edge.cache.profile import Profile
from dressi_edge.cache.shader_check import check_shaders
from dressi_edge.cache.spirv_interface import parse
from dressi_edge.cache.verify import violations
from dressi_edge.compiler import Program, compile_program
from dressi_edge.compiler.graph.optable import apply
from dressi_edge.runtime.session import Session

pytest_plugins = ["gpu", "profile_bundles"]

HUGE = 1 << 30
R32, RG32, RGBA32 = v.FORMATS["R32_SFLOAT"], v.FORMATS["R32G32_SFLOAT"], v.FORMATS["R32G32B32A32_SFLOAT"]
COMBINED, SAMPLED, INPUT = v.DESCRIPTOR_COMBINED_IMAGE_SAMPLER, v.DESCRIPTOR_SAMPLED_IMAGE, v.DESCRIPTOR_INPUT_ATTACHMENT
VERTEX, FRAGMENT = v.STAGE_VERTEX, v.STAGE_FRAGMENT


@pytest.fixture(scope="module")
def compiled(profile_bundle):
    """compiled(profile name, K): the bundle, read from disk."""
    return lambda name, layers=1: bundle.read(profile_bundle(name, layers))


@pytest.fixture()
def description(compiled):
    """A fresh, valid description to spoil."""
    return copy.deepcopy(compiled("limit4").description)


# ---- the compiler keeps its promises

@pytest.mark.parametrize("layers", [1, 3])
@pytest.mark.parametrize("name", NAMES)
def test_what_is_compiled_for_a_profile_keeps_it(compiled, name, layers):
    b = compiled(name, layers)
    assert violations(b.description, Profile.load(name), b.interfaces) == []


@pytest.mark.parametrize("name", ["limit4", "lavapipe"])
def test_what_a_bundle_says_it_needs_is_what_is_counted(compiled, name):
    b = compiled(name, 3)
    needs = b.description["needs"]["limits"]
    exact = dataclasses.replace(roomy(), limits={**roomy().limits, **needs})
    assert violations(b.description, exact, b.interfaces) == []
    for limit, need in needs.items():
        lines = violations(b.description, dataclasses.replace(exact, limits={**exact.limits, limit: need - 1}), b.interfaces)
        assert lines and all(line.endswith(f"allows {need - 1} ({limit})") for line in lines), limit


@pytest.mark.parametrize("name", ["limit4", "lavapipe"])
def test_what_shaders_take_for_granted_is_needed(compiled, gpu, name):
    """The grid of corners goes into the culling margin: a device with a coarser one would punch holes, and does not take the bundle."""
    b = compiled(name)
    bits = Profile.load(name).limit("subPixelPrecisionBits")
    assert b.description["needs"]["limits"]["subPixelPrecisionBits"] == bits
    interfaces = {key: max((getattr(i, key) for i in b.interfaces if i.stage == stage), default=0)
                  for key, stage in (("output_components", VERTEX), ("input_components", FRAGMENT))}
    assert b.description["needs"]["limits"]["maxVertexOutputComponents"] == interfaces["output_components"] > 0
    assert b.description["needs"]["limits"]["maxFragmentInputComponents"] == interfaces["input_components"] > 0
    less = dataclasses.replace(roomy(), limits={**roomy().limits, "subPixelPrecisionBits": bits - 1})
    line = (f"what its shaders do needs {bits} bits of the grid to which corners are rounded; profile roomy allows {bits - 1} "
            "(subPixelPrecisionBits)")
    assert violations(b.description, less, b.interfaces) == [line]
    with pytest.raises(DeviceError, match=f"does not fit .*needs {bits} bits of the grid.* allows {bits - 1} "):
        limits = {**gpu.device.limits, "subPixelPrecisionBits": bits - 1}
        Session(b, types.SimpleNamespace(**{**gpu.device.__dict__, "limits": limits, "format_features": gpu.device.format_features}))


def test_what_relies_on_no_grid_and_no_filter_needs_neither(tmp_path):
    program = Program()
    x = program.input("x", Layout("image", "float", 4, 4), 0.5)
    program.plan("look", {}, {"y": (x * 2.0, Layout("image", "float", 4, 4))})
    compile_program(program, "lavapipe", tmp_path / "x")
    limits = bundle.read(tmp_path / "x").description["needs"]["limits"]
    assert not limits.keys() & {"subPixelPrecisionBits", "subTexelPrecisionBits"}


def test_the_weights_of_a_filter_are_needed_where_one_is_used(tmp_path):
    for name, needed in (("lavapipe", True), ("limit4", False)):
        limits = look(name, tmp_path / name).description["needs"]["limits"]
        assert limits.get("subTexelPrecisionBits") == (Profile.load(name).limit("subTexelPrecisionBits") if needed else None)


def test_what_does_not_fit_the_profile_it_is_made_for_is_not_written(tmp_path):
    program = Program()
    texture = program.input("texture", Layout("image", "float", 8192, 1), 0.5)
    uv = program.input("uv", Layout("image", "vec2", 4, 4), 0.25)
    program.plan("look", {}, {"y": (apply("sample", texture, uv, wrap="clamp"), Layout("image", "float", 4, 4))})
    with pytest.raises(PackError, match="needs 8192 texels a side; profile vulkan_min allows 4096 .maxImageDimension2D.; take less"):
        compile_program(program, "vulkan_min", tmp_path / "x.dressi")
    assert list(tmp_path.iterdir()) == []
    compile_program(program, "lavapipe", tmp_path / "x.dressi")


def test_a_bundle_for_more_breaks_less_with_one_line_each(compiled):
    b = compiled("unlimited", 3)
    lines = violations(b.description, Profile.load("limit4"), b.interfaces)
    assert lines and len(lines) == len(set(lines))
    assert all("\n" not in line and "profile limit4" in line for line in lines)
    assert any(line.startswith("shape.stages[") and "colour attachments; profile limit4 allows 4" in line for line in lines)


# ---- one limit at a time

def roomy(**own) -> Profile:
    """Allows everything that a bundle can ask for."""
    limits = {k: {"size": (HUGE,) * 3, "range": (-HUGE, HUGE)}.get(kind, HUGE) for k, (kind, _) in LIMITS.items()}
    limits |= {"maxViewportDimensions": (HUGE, HUGE), "timestampComputeAndGraphics": True}
    both = {name: {"sampled", "color", "filter"} for name in v.FORMATS} | {"D32_SFLOAT": {"depth"}}
    return Profile("roomy", limits={**limits, **own.pop("limits", {})}, formats={**both, **own.pop("formats", {})}, **own)


def add_image(d, image_format, width=8, height=8):
    d["images"].append({"format": image_format, "width": width, "height": height, "slots": 1, "data": None,
                        "usage": v.USAGE_COLOR | v.USAGE_INPUT | v.USAGE_SAMPLED if image_format else v.USAGE_DEPTH})
    return 2 * (len(d["images"]) - 1)


def add_stage(d, subpasses, bindings=(), size=(8, 8), cell=None, formats=()):
    """One more stage of the last plan. `subpasses`: (colours, inputs) as indices into `formats`; the last one draws, with
    `bindings` of (kind, stages)."""
    refs = [add_image(d, f, *size) for f in formats]
    first = {a for _, inputs in subpasses for a in inputs} - {a for colors, _ in subpasses for a in colors}
    d["passes"].append({
        "attachments": [{"format": f, "load": v.LOAD_LOAD if k in first else v.LOAD_CLEAR, "store": 0, "clear": 0}
                        for k, f in enumerate(formats)],
        "subpasses": [{"colors": list(colors), "inputs": list(inputs), "depth": -1} for colors, inputs in subpasses]})
    constant = next(2 * k for k, i in enumerate(d["images"]) if i["data"] is not None and i["usage"] & v.USAGE_SAMPLED)
    inputs = subpasses[-1][1]
    if any(kind == COMBINED for kind, _ in bindings) and not d["samplers"]:
        d["samplers"].append(v.ADDRESS_CLAMP)
    d["pipelines"].append({**d["pipelines"][0], "pass": len(d["passes"]) - 1, "subpass": len(subpasses) - 1, "depth": False,
                           "bindings": [[kind, stages, 0 if kind == COMBINED else -1] for kind, stages in bindings]})
    images = [refs[inputs[k % len(inputs)]] if kind == INPUT else constant for k, (kind, _) in enumerate(bindings)]
    draw = {"pipeline": len(d["pipelines"]) - 1, "images": images, "vertices": 3, "cells": [list(cell or (0, 0, *size))],
            "depth_range": [0.0, 1.0], "count": -1}
    d["plans"][-1]["stages"].append({"pass": len(d["passes"]) - 1, "width": size[0], "height": size[1], "attachments": refs,
                                     "wait": True, "subpasses": [[] for _ in subpasses[1:]] + [[draw]]})


def colors(n):
    return lambda d: add_stage(d, [(range(n), ())], formats=[R32] * n)


def binds(n, kind, stages):
    return lambda d: add_stage(d, [((0,), ())], [(kind, stages)] * n, formats=[R32])


def inputs(n):
    return lambda d: add_stage(d, [((0,), range(1, n + 1))], [(INPUT, FRAGMENT)] * n, formats=[R32] * (n + 1))


# limit: what needs more of it than anything else in the bundle does, and how much
BREAK = {
    "maxImageDimension2D": (5000, lambda d: add_image(d, R32, 5000, 1)),
    "maxFramebufferWidth": (5000, lambda d: add_stage(d, [((0,), ())], size=(5000, 1), formats=[R32])),
    "maxFramebufferHeight": (5000, lambda d: add_stage(d, [((0,), ())], size=(1, 5000), formats=[R32])),
    "maxColorAttachments": (5, colors(5)),
    "maxFragmentOutputAttachments": (6, colors(6)),
    "maxFragmentCombinedOutputResources": (7, colors(7)),
    "maxPerStageDescriptorSamplers": (40, binds(40, COMBINED, FRAGMENT)),
    "maxPerStageDescriptorSampledImages": (50, binds(50, SAMPLED, VERTEX)),
    "maxPerStageDescriptorInputAttachments": (5, inputs(5)),
    "maxDescriptorSetSamplers": (40, binds(40, COMBINED, VERTEX)),
    "maxDescriptorSetSampledImages": (60, binds(60, SAMPLED, VERTEX | FRAGMENT)),
    "maxDescriptorSetInputAttachments": (5, inputs(5)),
    "maxPerStageResources": (61, binds(60, SAMPLED, FRAGMENT)),
    "maxBoundDescriptorSets": (1, None),
    "maxSamplerAllocationCount": (3, lambda d: d["samplers"].extend([0] * (3 - len(d["samplers"])))),
}


@pytest.mark.parametrize("limit", BREAK)
def test_a_bundle_that_needs_one_more_breaks_that_limit_and_no_other(description, limit):
    need, spoil = BREAK[limit]
    if spoil is not None:
        spoil(description)
    check_description(description)
    assert violations(description, roomy()) == []
    assert violations(description, roomy(limits={limit: need})) == []
    lines = violations(description, roomy(limits={limit: need - 1}))
    told = f"; profile roomy allows {need - 1} ({limit})"
    assert lines and all(f"needs {need} " in line and line.endswith(told) for line in lines)
    if spoil is not None:
        assert len(lines) == 1, lines


def test_a_line_names_plan_stage_subpass_and_pipeline(description):
    binds(60, COMBINED, FRAGMENT)(description)
    stage, pipeline = len(description["plans"][-1]["stages"]) - 1, len(description["pipelines"]) - 1
    assert violations(description, roomy(limits={"maxPerStageDescriptorSampledImages": 59})) == [
        f"shape.stages[{stage}].subpasses[0] (pipeline {pipeline}) needs 60 sampled images in its fragment shader; profile "
        "roomy allows 59 (maxPerStageDescriptorSampledImages)"]


def test_descriptors_of_both_stages_count_once_a_stage_and_once_a_set(description):
    add_stage(description, [((0,), ())], [(SAMPLED, VERTEX)] * 30 + [(SAMPLED, FRAGMENT)] * 40, formats=[R32])
    assert violations(description, roomy(limits={"maxPerStageDescriptorSampledImages": 40})) == []
    assert violations(description, roomy(limits={"maxPerStageResources": 41})) == []
    assert len(violations(description, roomy(limits={"maxDescriptorSetSampledImages": 69}))) == 1


def test_viewports_are_held_to_their_size_and_bounds(description):
    add_stage(description, [((0,), ())], size=(100, 90), cell=(30, 20, 70, 60), formats=[R32])
    check_description(description)
    assert violations(description, roomy(limits={"maxViewportDimensions": (70, 60), "viewportBoundsRange": (0, 100)})) == []
    for size in ((69, 60), (70, 59)):
        line, = violations(description, roomy(limits={"maxViewportDimensions": size}))
        assert f"a viewport of 70 x 60; profile roomy allows {size[0]} x {size[1]} (maxViewportDimensions)" in line
    line, = violations(description, roomy(limits={"viewportBoundsRange": (0, 99)}))
    assert line.endswith("a viewport from 20 to 100; profile roomy allows 0 to 99 (viewportBoundsRange)")


def test_memory_is_one_allocation_a_kind_of_image_and_one_for_transfers(description):
    kinds = len({(i["format"], i["usage"]) for i in description["images"]})
    assert violations(description, roomy(limits={"maxMemoryAllocationCount": kinds + 1})) == []
    line, = violations(description, roomy(limits={"maxMemoryAllocationCount": kinds}))
    assert line.endswith("(maxMemoryAllocationCount)")


def test_what_shaders_pass_on_is_counted_in_whole_locations_with_the_built_ins(compiled):
    b = compiled("lavapipe", 3)
    for limit, side, stage in (("maxVertexOutputComponents", "output_components", VERTEX),
                               ("maxFragmentInputComponents", "input_components", FRAGMENT)):
        most = max(getattr(i, side) for i in b.interfaces if i.stage == stage)
        assert most >= 12
        assert violations(b.description, roomy(limits={limit: most}), b.interfaces) == []
        lines = violations(b.description, roomy(limits={limit: most - 1}), b.interfaces)
        assert lines and all(f"needs {most} " in line and line.endswith(f"({limit})") for line in lines)


# ---- formats

def look(name, path):
    """A bundle that samples a texture of four floats and uses no integers."""
    program = Program()
    texture = program.input("texture", Layout("image", "vec4", 8, 8), 0.5)
    uv = program.input("uv", Layout("image", "vec2", 4, 4), 0.25)
    program.plan("look", {}, {"y": (apply("sample", texture, uv, wrap="clamp"), Layout("image", "vec4", 4, 4))})
    compile_program(program, name, path)
    return bundle.read(path)


@pytest.mark.parametrize("usage, feature", [(v.USAGE_SAMPLED, "sampled"), (v.USAGE_COLOR, "color"), (v.USAGE_INPUT, "color")])
def test_a_format_must_do_what_is_done_with_it(tmp_path, usage, feature):
    d = copy.deepcopy(look("limit4", tmp_path / "x").description)
    ref = add_image(d, v.FORMATS["R32_SINT"])
    d["images"][ref // 2]["usage"] = usage
    check_description(d)
    line, = violations(d, roomy(formats={"R32_SINT": {"sampled", "color"} - {feature}}))
    assert line.startswith(f"images[{ref // 2}] needs R32_SINT with {feature}; profile roomy has ")
    assert violations(d, roomy(formats={"R32_SINT": {feature}})) == []


@pytest.mark.parametrize("name, filtered", [("lavapipe", True), ("limit4", False)])
def test_a_filtered_image_needs_the_filter_and_a_fetched_one_does_not(tmp_path, name, filtered):
    b = look(name, tmp_path / "x")
    lines = violations(b.description, roomy(formats={"R32G32B32A32_SFLOAT": {"sampled", "color"}}), b.interfaces)
    assert len(lines) == filtered and all("R32G32B32A32_SFLOAT with filter" in line for line in lines)
    assert violations(b.description, Profile.load(name), b.interfaces) == []


def test_one_of_the_depth_formats_must_be_promised(description):
    unsure = {"D32_SFLOAT": {"sampled"}, "X8_D24_UNORM_PACK32": ()}
    assert any(image["format"] == 0 for image in description["images"])
    description["depth_formats"] = [126, 125]
    assert violations(description, roomy(formats=unsure)) == []
    description["depth_formats"] = [126]
    line, = violations(description, roomy(formats=unsure))
    assert line == ("depth_formats needs a depth attachment, of D32_SFLOAT; profile roomy promises one of D32_SFLOAT "
                    "X8_D24_UNORM_PACK32")
    assert violations(description, roomy(formats=unsure | {"D32_SFLOAT": {"depth"}})) == []
    assert len(violations(description, roomy(formats={"D32_SFLOAT": (), "X8_D24_UNORM_PACK32": {"depth"}}))) == 1


# ---- tiles

def test_a_lone_colour_passes_however_wide_and_several_share_the_tile(description):
    add_stage(description, [((0,), ())], formats=[RGBA32])
    description["passes"][:-1], description["pipelines"][:-1] = [], []  # what is left is the stage above
    description["pipelines"][0]["pass"] = 0
    plan = description["plans"][-1]
    description["plans"], plan["stages"][:-1] = [plan], []
    plan["stages"][0]["pass"] = plan["stages"][0]["subpasses"][0][0]["pipeline"] = 0
    assert violations(description, roomy(tile_bits=64)) == []
    add_stage(description, [((0, 1), ())], formats=[RGBA32, R32])
    assert violations(description, roomy(tile_bits=160)) == []
    line, = violations(description, roomy(tile_bits=128))
    assert line == ("shape.stages[1].subpasses[0] (pass 1) needs 160 bits of tile colour a pixel; profile roomy allows 128 "
                    "(tile_bits)")


def test_merged_subpasses_share_the_tile_and_the_attachment_count(compiled):
    d = copy.deepcopy(compiled("mali_g76").description)  # whose own passes fit 128 bits
    add_stage(d, [((0,), ()), ((1,), (0,)), ((2,), (0, 1))], [(INPUT, FRAGMENT)] * 2, formats=[R32, RG32, R32])
    check_description(d)
    stage = len(d["plans"][-1]["stages"]) - 1
    where = f"shape.stages[{stage}] (pass {len(d['passes']) - 1}, 3 subpasses)"
    assert violations(d, roomy(tile_bits=128, max_merged_attachments=3)) == []
    assert violations(d, roomy(tile_bits=128, max_merged_attachments=2)) == [
        f"{where} needs 3 merged attachments; profile roomy allows 2 (max_merged_attachments)"]
    add_stage(d, [((0,), ()), ((1,), (0,))], [(INPUT, FRAGMENT)], formats=[RGBA32, R32])
    line, = violations(d, roomy(tile_bits=128, max_merged_attachments=3))
    assert "2 subpasses) needs 160 bits of tile colour a pixel" in line


# ---- shader interfaces

def test_an_interface_is_what_the_shader_says(compiled):
    b = compiled("lavapipe")
    for p in b.description["pipelines"]:
        vertex, fragment = b.interfaces[p["vertex"]], b.interfaces[p["fragment"]]
        assert (vertex.stage, fragment.stage) == (VERTEX, FRAGMENT)
        for number, (kind, stages, _) in enumerate(p["bindings"]):
            users = [i for i in (vertex, fragment) if stages & i.stage]
            assert users and all(i.bindings[number][0] == kind for i in users)
        assert fragment.inputs == {k: x for k, x in vertex.outputs.items() if k in fragment.inputs}


def first(d, want):
    return next(k for k, p in enumerate(d["pipelines"]) if want(p))


def spoil_kind(d):
    d["samplers"].append(0)
    k = first(d, lambda p: p["bindings"])
    d["pipelines"][k]["bindings"][0][::2] = [COMBINED, 0]
    return f"pipelines[{k}].bindings[0] is a combined image sampler; the "


def spoil_visibility(d):
    k = first(d, lambda p: [SAMPLED, FRAGMENT, -1] in p["bindings"])
    b = d["pipelines"][k]["bindings"].index([SAMPLED, FRAGMENT, -1])
    d["pipelines"][k]["bindings"][b][1] = VERTEX
    return f"pipelines[{k}].bindings[{b}] is not visible to the fragment shader, which uses it"


def spoil_count(d):
    k = first(d, lambda p: len(p["bindings"]) > 1)
    d["pipelines"][k]["bindings"] = []
    return f"pipelines[{k}]."


def spoil_stages(d):
    p = d["pipelines"][0]
    p["vertex"] = p["fragment"]
    return f"pipelines[0].vertex: shader {p['vertex']} is for the fragment stage"


def spoil_format(d):
    p = d["pipelines"][0]
    layout = d["passes"][p["pass"]]
    a = layout["attachments"][layout["subpasses"][p["subpass"]]["colors"][0]]
    a["format"] = {R32: 99, RG32: 102, RGBA32: 108, 99: R32, 102: RG32, 108: RGBA32}[a["format"]]
    return "pipelines[0]: colour 0 needs "


def spoil_width(d):
    for k, p in enumerate(d["pipelines"]):
        layout = d["passes"][p["pass"]]
        for location, a in enumerate(layout["subpasses"][p["subpass"]]["colors"]):
            f = layout["attachments"][a]["format"]
            if v.FORMAT_CHANNELS[f] < 4:
                layout["attachments"][a]["format"] = 108 if f in v.INTEGER_FORMATS else RGBA32
                kind = "int" if f in v.INTEGER_FORMATS else "float"
                return f"pipelines[{k}]: colour {location} needs {kind} x 4; the fragment shader gives {kind} x "
    raise AssertionError("every colour has four channels")


def spoil_outputs(d):
    s = d["passes"][d["pipelines"][0]["pass"]]["subpasses"][0]
    found = len(s["colors"])
    s["colors"] = s["colors"][:-1]
    return f"pipelines[0]: the fragment shader gives {found} outputs; the subpass has {found - 1} colours"


def spoil_varying(d):
    plain = [k for k, p in enumerate(d["pipelines"]) if not p["depth"]]
    k = first(d, lambda p: p["depth"])
    d["pipelines"][k]["vertex"] = d["pipelines"][plain[0]]["vertex"]  # the triangle over everything, which gives nothing on
    return f"pipelines[{k}]: the fragment shader takes "


def spoil_draw(d):
    for n, plan in enumerate(d["plans"]):
        for k, stage in enumerate(plan["stages"]):
            for draw in stage["subpasses"][0]:
                for j, ref in enumerate(draw["images"]):
                    f = d["images"][ref // 2]["format"]
                    if f not in v.INTEGER_FORMATS:
                        other = next(i for i, image in enumerate(d["images"]) if image["format"] in v.INTEGER_FORMATS)
                        draw["images"][j] = 2 * other
                        return f"plans[{n}].stages[{k}].subpasses[0][0].images[{j}]: image {other} has format "
    raise AssertionError("no draw reads floats")


@pytest.mark.parametrize("spoil", [spoil_kind, spoil_visibility, spoil_count, spoil_stages, spoil_format, spoil_width,
                                   spoil_outputs, spoil_varying, spoil_draw], ids=lambda f: f.__name__[6:])
def test_a_pipeline_must_offer_what_its_shaders_declare(compiled, spoil):
    b = compiled("lavapipe")
    d = copy.deepcopy(b.description)
    check_shaders(d, b.blob)
    told = spoil(d)
    with pytest.raises(BundleError) as error:
        check_shaders(d, b.blob)
    assert told in str(error.value) and "\n" not in str(error.value)


# ---- hostile modules

@pytest.fixture(scope="module")
def modules(compiled):
    """Real modules as lists of words, the largest first."""
    b = compiled("lavapipe")
    blobs = sorted({bytes(b.blob(k)) for k in b.description["shaders"]}, key=lambda x: (-len(x), x))
    return [list(struct.unpack(f"<{len(x) // 4}I", x)) for x in blobs]


def pack(words):
    return struct.pack(f"<{len(words)}I", *words)


def find(words, opcode, nth=0):
    """Where the nth instruction of this opcode is."""
    at = 5
    while at < len(words):
        if words[at] & 0xFFFF == opcode:
            if not nth:
                return at
            nth -= 1
        at += words[at] >> 16
    raise AssertionError(f"no opcode {opcode}")


def put(words, at, value):
    return [*words[:at], value, *words[at + 1:]]


def cut(words, opcode):
    at = find(words, opcode)
    return words[:at] + words[at + (words[at] >> 16):]


def insert(words, opcode, *new):
    at = find(words, opcode)
    return [*words[:at], *new, *words[at:]]


HOSTILE = {
    "magic": (lambda w: put(w, 0, 0x03022307), "begins with 0x03022307"),
    "version": (lambda w: put(w, 1, 0x00010600), "SPIR-V version 0x10600"),
    "no ids": (lambda w: put(w, 3, 0), "has ids up to 0"),
    "huge bound": (lambda w: put(w, 3, 0xFFFFFFFF), "has ids up to 4294967295; at most one a word"),
    "schema": (lambda w: put(w, 4, 1), "reserved word 1"),
    "small bound": (lambda w: put(w, 3, 10), "ids from 1 to 9 are allowed"),
    "header only": (lambda w: put(w[:5], 3, 1), "has no function"),
    "no words": (lambda w: put(w, 5, w[5] & 0xFFFF), "word 5: an instruction of 0 words"),
    "runs past the end": (lambda w: put(w, 5, 0xFFFF << 16 | 17), "word 5: an instruction of 65535 words"),
    "no words in a function": (lambda w: put(w, find(w, 248), 248), "an instruction of 0 words"),
    "past the end in a function": (lambda w: put(w, find(w, 248), 0xFFFF << 16 | 248), "an instruction of 65535 words"),
    "id beyond the bound": (lambda w: put(w, find(w, 61) + 3, 0x7FFFFFFF), "id 2147483647; ids below "),
    "id at the bound": (lambda w: put(w, find(w, 61) + 3, w[3]), "; ids below "),
    "type beyond the bound": (lambda w: put(w, find(w, 23) + 1, 0xFFFFFFFF), "id 4294967295; ids from 1"),
    "type of itself": (lambda w: put(w, find(w, 23) + 2, w[find(w, 23) + 1]), "is no type defined before"),
    "defined twice": (lambda w: put(w, find(w, 23) + 1, w[find(w, 19) + 1]), "is defined twice"),
    "unknown opcode": (lambda w: put(w, find(w, 248), 2 << 16 | 4999), "opcode 4999 is not allowed in a function"),
    "unknown declaration": (lambda w: insert(w, 54, 2 << 16 | 4999, 1), "opcode 4999 is not allowed before the functions"),
    "too few operands": (lambda w: insert(w, 54, 1 << 16 | 59), "opcode 59 has 0 operands"),
    "buffers": (lambda w: put(put(w, find(w, 32) + 2, 2), find(w, 59) + 3, 2), "storage class"),
    "kernel": (lambda w: put(w, find(w, 17) + 1, 6), "capability 6 is not allowed"),
    "extension": (lambda w: insert(w, 11, 3 << 16 | 10, 0, 0), "opcode 10 is not allowed before the functions"),
    "other instructions": (lambda w: put(w, find(w, 11) + 2, 0x6E65704F), "only the instructions of GLSL.std.450"),
    "addressing": (lambda w: put(w, find(w, 14) + 1, 1), "the memory model must be"),
    "geometry": (lambda w: put(w, find(w, 15) + 1, 3), "execution model 3"),
    "no entry": (lambda w: cut(w, 15), "has no entry point"),
    "two entries": (lambda w: insert(w, 15, *w[find(w, 15):find(w, 15) + (w[find(w, 15)] >> 16)]), "a second entry point"),
    "called otherwise": (lambda w: put(w, find(w, 15) + 3, 0x6E69616E), "must be called main"),
    "entry without function": (lambda w: put(w, find(w, 15) + 2, 1), "lacks the entry point's function"),
    "no origin": (lambda w: cut(w, 16), "without OriginUpperLeft"),
    "unfinished": (lambda w: w[:-1], "ends within a function"),
    "global in a function": (lambda w: put(w, find(w, 59, count_globals(w)) + 3, 6),
                             "a variable in a function that is not its own"),
    "grouped decorations": (lambda w: insert(w, 54, 2 << 16 | 73, 1), "opcode 73 is not allowed before the functions"),
    "binding twice": (lambda w: again(w, 33), "decoration 33 twice"),
    "component": (lambda w: again(w, 33, 31), "decoration 31 is not allowed"),
    "other set": (lambda w: put(w, decoration(w, 34) + 3, 1), "needs set 0 and a binding"),
    "same binding": (lambda w: put(w, decoration(w, 33, 1) + 3, w[decoration(w, 33) + 3]), "is declared twice"),
    "far location": (lambda w: put(w, decoration(w, 30) + 3, 1 << 31), "at location 2147483648"),
    "cube": (lambda w: put(w, find(w, 25) + 3, 3), "neither sampled 2D nor subpass input"),
    "storage image": (lambda w: put(w, find(w, 25) + 7, 2), "neither sampled 2D nor subpass input"),
}


def count_globals(words):
    at, n = 5, 0
    while words[at] & 0xFFFF != 54:
        n += words[at] & 0xFFFF == 59
        at += words[at] >> 16
    return n


def decoration(words, kind, nth=0):
    n = 0
    while True:
        at = find(words, 71, n)
        if words[at + 2] == kind:
            if not nth:
                return at
            nth -= 1
        n += 1


def again(words, kind, other=None):
    at = decoration(words, kind)
    return insert(words, 71, 4 << 16 | 71, words[at + 1], kind if other is None else other, words[at + 3])


@pytest.mark.parametrize("name", HOSTILE)
def test_a_malformed_module_is_named_and_refused(modules, name):
    spoil, told = HOSTILE[name]
    words = next(w for w in modules if is_fragment(w))
    parse(pack(words))
    with pytest.raises(BundleError) as error:
        parse(pack(spoil(words)), "shaders[7]")
    assert str(error.value).startswith("shaders[7]: ") and told in str(error.value)


def is_fragment(words):
    return words[find(words, 15) + 1] == 4


@pytest.mark.parametrize("data", [b"", b"\x03\x02\x23\x07", bytes(19), bytes(21), bytes(20)], ids=len)
def test_what_is_no_module_is_refused(data):
    with pytest.raises(BundleError):
        parse(data)


def test_a_module_cut_anywhere_is_refused(modules):
    for words in modules[-6:]:
        for n in range(len(words)):
            with pytest.raises(BundleError):
                parse(pack(words[:n]))


def test_damaged_modules_raise_nothing_but_bundle_errors(modules):
    random_ = random.Random(0)
    refused = 0
    for _ in range(4000):
        words = list(random_.choice(modules[-10:]))
        for _ in range(random_.randint(1, 4)):
            at = random_.randrange(len(words))
            words[at] = random_.choice([random_.getrandbits(32), random_.getrandbits(8), words[at] ^ 1 << random_.randrange(32),
                                        words[random_.randrange(len(words))]])
        try:
            assert parse(pack(words)).stage in (VERTEX, FRAGMENT)
        except BundleError as error:
            assert "\n" not in str(error)
            refused += 1
    assert refused > 1000


def test_a_bundle_is_refused_for_its_shaders_before_anything_is_made_of_it(compiled):
    b = compiled("limit4")
    d = {k: x for k, x in b.description.items() if k != "blobs"}
    blobs = [bytes(b.blob(k)) for k in range(len(b.description["blobs"]))]
    bundle.loads(bundle.dumps(d, blobs))
    k = d["shaders"][0]
    blobs[k] = blobs[k][:-4]
    with pytest.raises(BundleError, match=r"^shaders\[0\]: ends within a function$"):
        bundle.loads(bundle.dumps(d, blobs))
