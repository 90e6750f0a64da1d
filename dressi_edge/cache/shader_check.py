"""Whether a bundle's pipelines offer what their shaders declare.

In: a checked description and its blobs. Out: the `Interface` of each shader, or a BundleError that names the first thing wrong:
a malformed module, a binding that is missing, of another kind or unseen by the stage, outputs that are not the colours of the
subpass, varyings that do not meet, an image that a draw binds and the shader reads as something else.
"""
from __future__ import annotations

from . import vulkan as v
from .errors import BundleError
from .spirv_interface import Interface, parse

STAGE_NAMES = {v.STAGE_VERTEX: "vertex", v.STAGE_FRAGMENT: "fragment", v.STAGE_COMPUTE: "compute"}
KIND_NAMES = {v.DESCRIPTOR_COMBINED_IMAGE_SAMPLER: "combined image sampler", v.DESCRIPTOR_SAMPLED_IMAGE: "sampled image",
              v.DESCRIPTOR_INPUT_ATTACHMENT: "input attachment", v.DESCRIPTOR_STORAGE_IMAGE: "storage image"}


def check_shaders(d: dict, blob) -> list[Interface]:
    """The interface of each shader of a checked description; `blob(k)` gives bytes. Raises BundleError where a module is
    malformed, or a pipeline, its pass or its draws do not offer what the shaders declare."""
    parsed: dict[int, Interface] = {}
    interfaces = []
    for k, number in enumerate(d["shaders"]):
        if number not in parsed:
            parsed[number] = parse(blob(number), f"shaders[{k}]")
        interfaces.append(parsed[number])
        if parsed[number].stage == v.STAGE_COMPUTE and "computes" not in d:
            raise BundleError(f"shaders[{k}] is for the compute stage, of which this version of the format has none")
    integer: list[list[bool | None]] = []
    for k, p in enumerate(d["pipelines"]):
        integer.append(_check_pipeline(f"pipelines[{k}]", p, d, interfaces))
    computed = [_check_compute(f"computes[{k}]", c, interfaces) for k, c in enumerate(d.get("computes", ()))]
    for n, plan in enumerate(d["plans"]):
        for k, stage in enumerate(plan["stages"]):
            if "compute" in stage:
                kinds = [kind for kind, _ in d["computes"][stage["compute"]]["bindings"]]
                for j, (ref, kind, wanted) in enumerate(zip(stage["images"], kinds, computed[stage["compute"]])):
                    _check_image(f"plans[{n}].stages[{k}].images[{j}]: image {ref // 2}", d["images"][ref // 2]["format"], kind, wanted)
                continue
            for j, draws in enumerate(stage["subpasses"]):
                inputs = d["passes"][stage["pass"]]["subpasses"][j]["inputs"]
                for i, draw in enumerate(draws):
                    where = f"plans[{n}].stages[{k}].subpasses[{j}][{i}]"
                    _check_draw(where, draw, stage["attachments"], inputs, d, interfaces, integer[draw["pipeline"]])
    return interfaces


def _check_pipeline(where: str, p: dict, d: dict, interfaces: list[Interface]) -> list[bool | None]:
    """For each binding whether the shaders read integers from it (None: no shader uses it)."""
    vertex, fragment = interfaces[p["vertex"]], interfaces[p["fragment"]]
    layout = d["passes"][p["pass"]]
    subpass = layout["subpasses"][p["subpass"]]
    integer: list[bool | None] = [None] * len(p["bindings"])
    for key, shader, stage in (("vertex", vertex, v.STAGE_VERTEX), ("fragment", fragment, v.STAGE_FRAGMENT)):
        if shader.stage != stage:
            raise BundleError(f"{where}.{key}: shader {p[key]} is for the {STAGE_NAMES[shader.stage]} stage")
        if len(shader.bindings) > len(p["bindings"]):
            raise BundleError(f"{where}.{key}: the shader uses {len(shader.bindings)} bindings; the pipeline has "
                              f"{len(p['bindings'])}")
        for number, (kind, is_integer, index) in shader.bindings.items():
            if number >= len(p["bindings"]):
                raise BundleError(f"{where}.{key}: the shader uses binding {number}; the pipeline has {len(p['bindings'])}")
            found, stages, _ = p["bindings"][number]
            if found != kind:
                raise BundleError(f"{where}.bindings[{number}] is a {KIND_NAMES[found]}; the {key} shader uses a "
                                  f"{KIND_NAMES[kind]}")
            if not stages & stage:
                raise BundleError(f"{where}.bindings[{number}] is not visible to the {key} shader, which uses it")
            if index >= len(subpass["inputs"]):
                raise BundleError(f"{where}.bindings[{number}]: input attachment {index}; the subpass has "
                                  f"{len(subpass['inputs'])}")
            if integer[number] not in (None, is_integer):
                raise BundleError(f"{where}.bindings[{number}]: one shader reads integers, the other floats")
            integer[number] = is_integer
    if p["topology"] == v.TOPOLOGIES["points"] and not vertex.point_size:
        raise BundleError(f"{where}.topology: points, of which the vertex shader gives no size")
    for number, (kind, stages, _) in enumerate(p["bindings"]):
        if kind == v.DESCRIPTOR_INPUT_ATTACHMENT and (stages != v.STAGE_FRAGMENT or number not in fragment.bindings):
            raise BundleError(f"{where}.bindings[{number}]: an input attachment belongs to the fragment shader, which must use "
                              "it")
    _check_outputs(where, fragment, [layout["attachments"][a]["format"] for a in subpass["colors"]])
    for location, wanted in fragment.inputs.items():
        given = vertex.outputs.get(location)
        if given != wanted:
            raise BundleError(f"{where}: the fragment shader takes {_words(wanted)} at location {location}; the vertex shader "
                              f"gives {_words(given)}")
    return integer


def _check_compute(where: str, c: dict, interfaces: list[Interface]) -> list[bool | None]:
    """For each image that is read whether the shader reads integers from it (None: it does not use it)."""
    shader, bindings = interfaces[c["shader"]], c["bindings"]
    if shader.stage != v.STAGE_COMPUTE:
        raise BundleError(f"{where}.shader: shader {c['shader']} is for the {STAGE_NAMES[shader.stage]} stage")
    integer: list[bool | None] = [None] * len(bindings)
    wanted = {len(bindings) + k: o["format"] for k, o in enumerate(c["outputs"])}
    for number, (kind, is_integer, image_format) in shader.bindings.items():
        if number >= len(bindings) + len(wanted):
            raise BundleError(f"{where}.shader: the shader uses binding {number}; the pipeline has {len(bindings) + len(wanted)}")
        found = v.DESCRIPTOR_STORAGE_IMAGE if number in wanted else bindings[number][0]
        if found != kind:
            raise BundleError(f"{where}: binding {number} is a {KIND_NAMES[found]}; the shader uses a {KIND_NAMES[kind]}")
        if number not in wanted:
            integer[number] = is_integer
        elif image_format != wanted[number]:
            raise BundleError(f"{where}.outputs[{number - len(bindings)}].format is {wanted[number]}; the shader writes format "
                              f"{image_format}")
    if missing := wanted.keys() - shader.bindings.keys():
        raise BundleError(f"{where}.outputs[{min(missing) - len(bindings)}]: the shader has no storage image at binding {min(missing)}")
    return integer


def _words(x) -> str:
    return f"{x[0]} x {x[1]}" if x else "nothing"


def _check_outputs(where: str, fragment: Interface, formats: list[int]) -> None:
    if len(fragment.outputs) != len(formats):
        raise BundleError(f"{where}: the fragment shader gives {len(fragment.outputs)} outputs; the subpass has {len(formats)} "
                          "colours")
    for location, image_format in enumerate(formats):
        wanted = "int" if image_format in v.INTEGER_FORMATS else "float", v.FORMAT_CHANNELS[image_format]
        given = fragment.outputs.get(location)
        if given is None or given[0] != wanted[0] or given[1] < wanted[1]:
            raise BundleError(f"{where}: colour {location} needs {_words(wanted)}; the fragment shader gives {_words(given)}")


def _check_draw(where: str, draw: dict, attached: list[int], inputs: list[int], d: dict, interfaces, integer) -> None:
    p = d["pipelines"][draw["pipeline"]]
    shader = interfaces[p["fragment"]]
    for k, (ref, binding, wanted) in enumerate(zip(draw["images"], p["bindings"], integer)):
        at, image_format = f"{where}.images[{k}]: image {ref // 2}", d["images"][ref // 2]["format"]
        _check_numbers(at, image_format, wanted)
        if binding[0] == v.DESCRIPTOR_INPUT_ATTACHMENT and ref != attached[inputs[shader.bindings[k][2]]]:
            raise BundleError(f"{at} is not input attachment {shader.bindings[k][2]} of the subpass")
        _check_filter(at, image_format, binding[0])


def _check_image(at: str, image_format: int, kind: int, wanted: bool | None) -> None:
    _check_numbers(at, image_format, wanted)
    _check_filter(at, image_format, kind)


def _check_numbers(at: str, image_format: int, wanted: bool | None) -> None:
    if image_format == 0 or wanted is not None and wanted != (image_format in v.INTEGER_FORMATS):
        raise BundleError(f"{at} has format {image_format}; the shader reads {'integers' if wanted else 'floats'}")


def _check_filter(at: str, image_format: int, kind: int) -> None:
    if kind == v.DESCRIPTOR_COMBINED_IMAGE_SAMPLER and image_format in v.INTEGER_FORMATS:
        raise BundleError(f"{at} holds integers, which no sampler filters")
