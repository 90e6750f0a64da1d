"""Malformed bundles as a table: a test vector, what to change, and the message that must come.

A change is (path, value): the value replaces what the path names in the description; `DROP` removes it. Paths are those of the
messages. Checksums and offsets are right again afterwards, so that only the check behind the change can find it. `FILES` are changes
of the bytes themselves.
"""

import copy
import hashlib
import re
import struct

import msgpack
from make_vectors import FOLDER

from dressi_edge.cache import bundle

DROP = object()
HEAD = bundle.HEADER
DEEP = []
for _ in range(500):
    DEEP = [DEEP]
STAGE = "plans[1].stages[0]"
PASS = "passes[0]"


def vector(name: str) -> tuple[dict, list[bytes]]:
    """A fresh description without "blobs", and the blobs."""
    b = bundle.read(FOLDER / f"{name}.dressi")
    blobs = [bytes(b.blob(k)) for k in range(len(b.description["blobs"]))]
    found = [{k: x for k, x in copy.deepcopy(one.description).items() if k != "blobs"} for one in b.variants]
    return found[0] if len(found) == 1 else {"variants": found}, blobs


def change(d, path: str, value) -> None:
    """Set what the path names."""
    *way, last = [int(n) if n else k for k, n in re.findall(r"(\w+)|\[(\d+)\]", path) for k, n in [(k, n)]]
    for step in way:
        d = d[step]
    if value is DROP:
        del d[last]
    elif isinstance(d, list) and last == len(d):
        d.append(value)
    else:
        d[last] = value


def packed(description, tail: bytes = b"", version: int = bundle.VERSION) -> bytes:
    """A file whose description is this msgpack or object, with a right checksum and nothing behind it."""
    text = description if isinstance(description, bytes) else msgpack.packb(description)
    return HEAD.pack(bundle.MAGIC, version, 0, len(text), hashlib.sha256(text).digest()) + text + tail


ROWS = [
    # the top, meta, needs
    ("lacks", "ops", [("plans", DROP)], "description lacks plans"),
    ("unknown_key", "ops", [("surprise", 1)], "description has the unknown key 'surprise'"),
    ("unknown_key_is_cut", "ops", [("s" * 1000, 1)], "has the unknown key 'sss"),
    ("meta_list", "ops", [("meta", [])], "meta is a list of 0; a map is needed"),
    ("meta_deep", "ops", [("meta.x", DEEP)], "meta is nested deeper than 16"),
    ("meta_time", "ops", [("meta.x", msgpack.Timestamp(1, 1))], "the description has the byte 0xd7 at "),
    ("profile_name", "ops", [("profile.name", "")], "profile.name is ''; a text of 1 to 200 characters"),
    ("profile_deep", "ops", [("profile.name", DEEP)], "profile.name is a list of 1; a text"),
    ("profile_control", "ops", [("profile.name", "\x1b[2J")], "profile.name is '\\x1b[2J'; a text"),
    ("needs_limit", "ops", [("needs.limits.maxHats", 1)], "needs.limits names 'maxHats', which this reader does not know"),
    ("needs_value", "ops", [("needs.limits.maxImageDimension2D", -1)], "needs.limits.maxImageDimension2D is -1; an integer from 0"),
    ("needs_format", "ops", [("needs.formats.R8_UNORM", [])], "needs.formats names 'R8_UNORM', which this reader does not know"),
    ("needs_feature", "ops", [("needs.formats.R32_SFLOAT", ["blend"])], "needs.formats.R32_SFLOAT[0] is 'blend'; allowed: sampled"),
    ("depth_format", "silhouette", [("depth_formats", [99])], "depth_formats[0] is 99; allowed: 126 125"),
    # images and samplers
    ("image_format", "ops", [("images[0].format", 37)], "images[0].format is 37; allowed: 0 76 83 97 99 100 102 103 108 109"),
    ("image_format_bool", "ops", [("images[0].format", False)], "images[0].format is False; allowed"),
    ("image_width", "ops", [("images[0].width", 0)], "images[0].width is 0; an integer from 1 to 65536 is allowed"),
    ("image_height", "ops", [("images[0].height", 1 << 63)], "images[0].height is 9223372036854775808; an integer from 1"),
    ("image_float", "ops", [("images[0].width", 4.0)], "images[0].width is 4.0; an integer"),
    ("image_slots", "ops", [("images[0].slots", 3)], "images[0].slots is 3; an integer from 1 to 2"),
    ("image_two_slots", "ops", [("images[0].slots", 2)], "images[0].slots is 2; only the image of a state or copy has two"),
    ("image_usage", "ops", [("images[0].usage", 8)], "images[0].usage is 8; bits of 151 are allowed"),
    ("depth_usage", "silhouette", [("images[4].usage", 36)], "images[4].usage is 36; bits of 32 are allowed"),
    ("image_data", "states", [("images[2].data", 99)], "images[2].data is 99; an integer from 0 to 11"),
    ("image_data_usage", "states", [("images[2].usage", 4)], "images[2].data needs a colour format, one slot and usage 2"),
    ("image_data_size", "states", [("images[2].data", 2)], "images[2].data: blobs[2] has 4 bytes; 32 are needed"),
    ("sampler", "texture", [("samplers[0]", 1)], "samplers[0] is 1; allowed: 0 2"),
    # shaders and passes
    ("shader", "ops", [("shaders[0]", -1)], "shaders[0] is -1; an integer from 0"),
    ("shader_is_data", "states", [("shaders[0]", 0)], "shaders[0]: begins with"),
    ("shader_small", "states", [("shaders[0]", 2)], "shaders[0]: 4 bytes are no SPIR-V module"),
    ("pass_load", "ops", [(f"{PASS}.attachments[0].load", 3)], "passes[0].attachments[0].load is 3; an integer from 0 to 2"),
    ("pass_store", "ops", [(f"{PASS}.attachments[0].store", None)], "passes[0].attachments[0].store is None"),
    ("pass_clear", "ops", [(f"{PASS}.attachments[0].clear", -1)], "passes[0].attachments[0].clear is -1; an integer from 0 to 0"),
    ("depth_load", "silhouette", [("passes[0].attachments[1].load", 0)], "passes[0].attachments[1].load is 0; an integer from 1"),
    ("pass_empty", "ops", [(f"{PASS}.subpasses", [])], "passes[0].subpasses is a list of 0; at least one is needed"),
    ("pass_many", "ops", [(f"{PASS}.subpasses", [0] * 1025)], "passes[0].subpasses is a list of 1025; a list of at most 1024"),
    ("pass_color", "ops", [(f"{PASS}.subpasses[0].colors", [1])], "passes[0].subpasses[0].colors[0] is 1; an integer from 0 to 0"),
    ("pass_twice", "ops", [(f"{PASS}.subpasses[0].colors", [0, 0])], "passes[0].subpasses[0]: an attachment is used twice"),
    ("pass_both", "ops", [(f"{PASS}.subpasses[0].inputs", [0])], "passes[0].subpasses[0]: an attachment is used twice"),
    ("pass_input_first", "states", [("passes[1].subpasses[0].colors", [0, 1]), ("passes[1].subpasses[0].inputs", [2])],
     "passes[1].subpasses[0].inputs[0]: attachment 2 was neither loaded nor written by an earlier subpass"),
    ("pass_depth", "ops", [(f"{PASS}.subpasses[0].depth", 0)], "passes[0].subpasses[0].depth is no depth attachment"),
    ("pass_two_depths", "silhouette", [(f"{PASS}.subpasses[1]", {"colors": [], "inputs": [], "depth": 1})],
     "passes[0].subpasses[1].depth: a second subpass with depth; nothing orders the two"),
    ("images_many", "ops", [("images", [0] * 65537)], "images is a list of 65537; a list of at most 65536 is allowed"),
    ("pipelines_many", "ops", [("pipelines", [0] * 65537)], "pipelines is a list of 65537; a list of at most 65536 is allowed"),
    ("pass_depth_color", "silhouette", [("passes[0].subpasses[0].colors", [1])], "passes[0].subpasses[0].colors[0] is a depth att"),
    # pipelines
    ("pipeline_shader", "ops", [("pipelines[0].vertex", 9)], "pipelines[0].vertex is 9; an integer from 0 to 1"),
    ("pipeline_swapped", "ops", [("pipelines[0].vertex", 1)], "pipelines[0].vertex: shader 1 is for the fragment stage"),
    ("pipeline_subpass", "ops", [("pipelines[0].subpass", 1)], "pipelines[0].subpass is 1; an integer from 0 to 0"),
    ("pipeline_depth", "ops", [("pipelines[0].depth", True)], "pipelines[0].depth is True; false, or true with a depth attachment"),
    ("pipeline_topology", "ops", [("pipelines[0].topology", 4)], "pipelines[0].topology is 4; allowed: 0 3"),
    ("binding_kind", "ops", [("pipelines[0].bindings[0][0]", 7)], "pipelines[0].bindings[0][0] is 7; allowed: 1 2 10"),
    ("binding_stage", "ops", [("pipelines[0].bindings[0][1]", 32)], "pipelines[0].bindings[0][1] is 32; allowed: 1 16 17"),
    ("binding_unseen", "ops", [("pipelines[0].bindings[0][1]", 1)], "pipelines[0].bindings[0] is not visible to the fragment"),
    ("binding_sampler", "texture", [("pipelines[0].bindings[0][2]", 1)], "pipelines[0].bindings[0][2] is 1; an integer from 0 to 0"),
    ("binding_short", "ops", [("pipelines[0].bindings[0]", [2, 16])], "pipelines[0].bindings[0] is a list of 2; a list of 3"),
    ("binding_missing", "states", [("pipelines[3].bindings", []), ("plans[2].stages[0].subpasses[0][0].images", [])],
     "pipelines[3].fragment: the shader uses 1 bindings; the pipeline has 0"),
    ("binding_other_kind", "texture", [("pipelines[0].bindings[1]", [1, 16, 0])], "pipelines[0].bindings[1] is a combined image"),
    # values
    ("value_name", "ops", [("values[1].name", "x")], "values[1].name 'x' is taken"),
    ("value_role", "ops", [("values[0].role", "god")], "values[0].role is 'god'; allowed: input state output"),
    ("value_type", "ops", [("values[0].type", "mat4")], "values[0].type is 'mat4'; allowed: float vec2"),
    ("value_half", "half", [("values[2].role", "state")], "values[2]: its image has format 97; only inputs may have 16 bits"),
    ("value_half_int", "half", [("values[2].type", "ivec3")], "values[2]: its image has format 97, which does not hold ivec3"),
    ("value_kind", "ops", [("values[0].layout", "cube")], "values[0].layout is 'cube'; allowed: unit table image atlas"),
    ("value_count", "ops", [("values[0].count", 130)], "values[0]: its image is 4 x 4; 4 x 33 is needed"),
    ("value_count_huge", "ops", [("values[0].count", 1 << 30)], "values[0]: its image is 4 x 4; 0 x 0 is needed"),
    ("value_atlas_huge", "silhouette", [("values[1].columns", 1 << 30)], "values[1]: its image is 32 x 24; "),
    ("value_format", "ops", [("values[0].type", "ivec3")], "values[0]: its image has format 109, which does not hold ivec3"),
    ("value_usage", "ops", [("images[1].usage", 4)], "values[0]: its image lacks usage 3"),
    ("value_image", "ops", [("values[2].image", 77)], "values[2].image is 77; an integer from 0"),
    ("value_shared", "states", [("values[2].image", 3)], "values[2].image 3 is that of values[0]"),
    ("value_constant", "states", [("images[1].data", 5)], "values[4]: its image 1 is a constant"),
    ("value_slots", "states", [("values[2].role", "input"), ("plans[1].updates", [0, 1])], "images[4].slots is 2; only the image of a"),
    ("value_initial", "states", [("values[0].initial", 2)], "values[0].initial: blobs[2] has 4 bytes; 32 are needed"),
    ("value_initial_texel", "states", [("values[0].initial", b"abc")], "values[0].initial: 3 bytes; a texel of its image has 4"),
    ("value_initial_empty", "filled", [("values[0].initial", b"")], "values[0].initial: 0 bytes; a texel of its image has 16"),
    ("value_initial_long", "filled", [("values[1].initial", bytes(16))], "values[1].initial: 16 bytes; a texel of its image has 4"),
    ("value_output_initial_texel", "states", [("values[6].initial", bytes(4))], "values[6].initial: an output has none"),
    ("value_output_initial", "states", [("values[6].initial", 1)], "values[6].initial: an output has none"),
    # plans
    ("plan_name", "states", [("plans[3].name", "rest")], "plans[3].name 'rest' is taken"),
    ("plan_steps", "states", [("plans[1].steps", 1 << 41)], "plans[1].steps is 2199023255552; an integer from 0"),
    ("plan_updates_input", "states", [("plans[1].updates[0]", 3)], "plans[1].updates[0] is input 'rate'; state or copy is allowed"),
    ("plan_updates_twice", "states", [("plans[1].updates", [0, 2, 1, 0])], "plans[1].updates names something twice"),
    ("plan_updates_one_slot", "states", [("images[4].slots", 1)], "plans[1].updates[1]: the image of 'b' has one slot; two are needed"),
    ("plan_outputs_state", "states", [("plans[1].outputs[0]", 0)], "plans[1].outputs[0] is state 'a'; output is allowed"),
    ("plan_needs_itself", "states", [("plans[1].needs", [1])], "plans[1].needs[0] is 1; an integer from 0 to 0"),
    ("plan_needs_twice", "states", [("plans[1].needs", [0, 0])], "plans[1].needs[1] is 0; an integer from 1 to 0"),
    ("plan_needs_needy", "states", [("plans[3].needs", [1])], "plans[3].needs[0]: plans[1] updates something"),
    ("plan_needs_open", "variants", [("variants[0].plans[3].needs", [0, 2])],
     "plans[3].needs[1]: plans[2] needs plans[1], which is not among them"),
    ("plan_lacks_read", "states", [("plans[1].reads", [2, 3, 0])], "plans[1].stages[1] reads 't', which plans[1].reads lacks"),
    ("plan_without_output", "states", [("plans[3].outputs", [5])], "plans[3].stages[0].attachments[0]: image 9 is not for this plan"),
    ("plan_lost_need", "states", [("plans[1].needs", [])], "plans[1].stages[0] reads image 0, which nothing has written"),
    ("plan_idle", "states", [("plans[2].stages", [])], "plans[2] does not write 'a'"),
    # stages
    ("stage_pass", "states", [(f"{STAGE}.pass", 5)], "plans[1].stages[0].pass is 5; an integer from 0 to 2"),
    ("stage_wait", "states", [(f"{STAGE}.wait", 1)], "plans[1].stages[0].wait is 1; a boolean is needed"),
    ("stage_first_wait", "states", [(f"{STAGE}.wait", False)], "plans[1].stages[0].wait is false; the stage touches what was written"),
    ("stage_hazard", "states", [("plans[1].stages[1].wait", False)], "plans[1].stages[1].wait is false"),
    ("stage_size", "states", [(f"{STAGE}.width", 5)], "plans[1].stages[0].attachments[0]: image 3 is 4 x 2, the stage is 5 x 2"),
    ("stage_attachments", "states", [(f"{STAGE}.attachments", [7, 9])], "plans[1].stages[0].attachments is a list of 2; a list of 3"),
    ("stage_attached_twice", "states", [(f"{STAGE}.attachments", [7, 7, 14])], "plans[1].stages[0].attachments names something twice"),
    ("stage_attachment_deep", "states", [(f"{STAGE}.attachments[0]", DEEP)], "plans[1].stages[0].attachments[0] is a list of 1; an"),
    ("stage_slot", "states", [(f"{STAGE}.attachments[2]", 17)], "plans[1].stages[0].attachments[2] is 17: the second slot of an image"),
    ("stage_format", "states", [(f"{STAGE}.attachments[0]", 11)], "plans[1].stages[0].attachments[0]: image 5 of format 99 and usage"),
    ("stage_current", "states", [(f"{STAGE}.attachments[0]", 6), (f"{STAGE}.subpasses[0][0].images[3]", 8)],
     "plans[1].stages[0].attachments[0]: image 3 is not for this plan to write"),
    ("stage_foreign", "states", [("plans[2].stages[0].attachments[0]", 9)], "plans[2].stages[0].attachments[0]: image 4 is not for"),
    ("stage_none", "states", [("plans[3].stages[1]", None)], "plans[3].stages[1] is None; a map is needed"),
    ("stage_kept", "states", [("plans[3].stages[1]", {
        "pass": 0, "width": 4, "height": 2, "attachments": [0], "wait": True, "subpasses": [[]]})],
     "plans[3] writes image 0, which plans[0] keeps for others"),
    ("stage_subpasses", "states", [(f"{STAGE}.subpasses", [])], "plans[1].stages[0].subpasses is a list of 0; a list of 1 is needed"),
    ("draw_pipeline", "states", [(f"{STAGE}.subpasses[0][0].pipeline", 0)], "[0][0].pipeline 0 is made for another pass"),
    ("draw_images", "states", [(f"{STAGE}.subpasses[0][0].images", [10])], "subpasses[0][0].images is a list of 1; a list of 4"),
    ("draw_ref", "states", [(f"{STAGE}.subpasses[0][0].images[0]", 20)], "[0][0].images[0] is 20; an integer from 0 to 19"),
    ("draw_usage", "states", [(f"{STAGE}.subpasses[0][0].images[0]", 12)], "[0][0].images[0]: image 6 lacks usage 4"),
    ("draw_feedback", "states", [(f"{STAGE}.subpasses[0][0].images[0]", 14)], "images[0]: image 7 is written by the same stage"),
    ("draw_next_slot", "states", [("plans[2].stages[0].subpasses[0][0].images[0]", 11)], "reads image 5, which nothing has written"),
    ("draw_integers", "texture", [("images[2].format", 102), ("values[1].type", "ivec2")], "image 2 has format 102; the shader reads"),
    ("draw_vertices", "states", [(f"{STAGE}.subpasses[0][0].vertices", 0)], "[0][0].vertices is 0; an integer from 1 to 2147483647"),
    ("draw_cell", "states", [(f"{STAGE}.subpasses[0][0].cells[0]", [1, 0, 4, 2])], "cells[0] leaves the stage of 4 x 2"),
    ("draw_cell_negative", "states", [(f"{STAGE}.subpasses[0][0].cells[0]", [-1, 0, 4, 2])], "cells[0][0] is -1; an integer from 0"),
    ("draw_depth", "states", [(f"{STAGE}.subpasses[0][0].depth_range", [0.0, 1.5])], "depth_range is a list of 2; two floats"),
    ("draw_depth_nan", "states", [(f"{STAGE}.subpasses[0][0].depth_range", [float("nan"), 1.0])], "depth_range is a list of 2; two"),
    ("draw_count", "states", [(f"{STAGE}.subpasses[0][0].count", 20)], "[0][0].count is 20; an integer from -1 to 19"),
    ("draw_count_format", "states", [(f"{STAGE}.subpasses[0][0].count", 0)], "count: image 0 is not R32_SINT with usage 1"),
    ("draw_count_missing", "states", [(f"{STAGE}.subpasses[0][0].count", DROP)], "lacks count"),
    ("cycle", "lists", [("plans[1].stages[0].subpasses[0][0].images[0]", 4)], "images[0]: image 2 is written by the same stage"),
    ("late", "lists", [("plans[1].stages[4].subpasses[0][0].images[2]", 2)], "image 1 lacks usage 4"),
    ("late_count", "lists", [("images[15].usage", 21), ("plans[1].stages[3].subpasses[0][0].count", 30)],
     "plans[1].stages[3] reads image 15, which nothing has written"),
    ("count_of_a_state", "states", [(f"{STAGE}.subpasses[0][0].count", 10)],
     "plans[1].stages[0] draws as often as image 5 says, which is given from outside; what a stage makes is allowed"),
    ("count_of_an_input", "copies", [("plans[1].stages[0].subpasses[0][0].count", 10)],
     "plans[1].stages[0] draws as often as image 5 says, which is given from outside"),
    ("count_of_a_constant", "lists", [("images[5].usage", 7), ("plans[1].stages[3].subpasses[0][0].count", 10)],
     "plans[1].stages[3] draws as often as image 5 says, which is given from outside"),
    ("point_size", "ops", [("pipelines[0].topology", 0)], "pipelines[0].topology: points, of which the vertex shader gives no size"),
    ("needs_texels", "ops", [("needs.limits.subPixelPrecisionBits", -1)], "needs.limits.subPixelPrecisionBits is -1; an integer from 0"),
    ("count_cells", "lists", [("plans[1].stages[0].subpasses[0][0].count", 18)], "count is 18; -1, or a draw of one cell"),
    ("count_attached", "lists", [("plans[1].stages[5].subpasses[0][0].count", 30)], "count: image 15 is not R32_SINT with usage 1"),
    # variants
    ("variants_lacks", "variants", [("variants[1].plans", DROP)], "variants[1]: description lacks plans"),
    ("variants_beside", "variants", [("plans", [])], "description has the unknown key 'plans'"),
    ("variants_map", "variants", [("variants", {})], "variants is a map of 0; a list of at most 16 is allowed"),
    ("variants_none", "variants", [("variants", [])], "variants is a list of 0; 2 to 16 are needed"),
    ("variants_one", "variants", [("variants[1]", DROP)], "variants is a list of 1; 2 to 16 are needed"),
    ("variants_many", "variants", [("variants", [0] * 17)], "variants is a list of 17; a list of at most 16 is allowed"),
    ("variants_number", "variants", [("variants[1]", 7)], "variants[1] is 7; a map without blobs is needed"),
    ("variants_blobs", "variants", [("variants[0].blobs", [])], "; a map without blobs is needed"),
    ("variants_nested", "variants", [("variants[1]", {"variants": []})], "variants[1]: description lacks meta"),
    ("variants_deep", "variants", [("variants[1]", DEEP)], "variants[1] is a list of 1; a map without blobs is needed"),
    ("variants_name", "variants", [("variants[1].profile.name", "limit8")], "variants[1].profile.name 'limit8' is taken"),
    ("variants_image", "variants", [("variants[1].images[0].width", 0)], "variants[1]: images[0].width is 0; an integer from 1"),
    ("variants_shader", "variants", [("variants[1].shaders[0]", 99)], "variants[1]: shaders[0] is 99; an integer from 0 to "),
    ("variants_shader_is_other", "variants", [("variants[1].pipelines[0].vertex", 1)],
     "variants[1]: pipelines[0].vertex: shader 1 is for the fragment stage"),
    ("variants_values", "variants", [("variants[1].values[0].name", "z")], "variants[1].values[0].name is 'z'; that of variants[0] is 'x'"),
    ("variants_value_columns", "variants", [("variants[1].values[0].columns", 2)],
     "variants[1].values[0].columns is 2; that of variants[0] is 1"),
    ("variants_initial", "variants", [("variants[1].values[1].initial", None)], "variants[1].values[1].initial is None; that of"),
    ("variants_fewer_plans", "variants", [("variants[1].plans[4]", DROP)], "variants[1].plans is a list of 4; variants[0] has 5"),
    ("variants_plan_name", "variants", [("variants[1].plans[0].name", "p")], "variants[1].plans[0].name is 'p'; that of variants[0]"),
    # copies
    ("variants_initial_texel", "variants", [("variants[1].values[1].initial", bytes(4))],
     "variants[1].values[1].initial is b'\\x00\\x00\\x00\\x00'; that of"),
    ("copy_initial", "copies", [("values[7].initial", 0)], "values[7].initial: a copy has none"),
    ("copy_set", "copies", [("values[7].role", "state")], "values[7]: its image lacks usage 3"),
    ("copy_unfilled", "copies", [("plans[4].needs", [0])], "plans[4] has to do with copy 'fit.list.texels', and needs no plan that"),
    ("copy_alone", "copies", [("plans[3].updates", [7, 3])], "plans[3] updates 1 of the 2 copies that plans[1] fills; all or none"),
    ("enter_more", "copies", [("plans[1].updates", [7, 8, 3])], "plans[2]: after the enter plans[1] a plan is needed that updates states"),
    ("enter_last", "copies", [(f"plans[{k}]", DROP) for k in (5, 4, 3, 2)], "plans[1] fills copies; it updates nothing else, and the plan"),
    ("enter_of_a_phase", "copies", [("plans[3].needs", [0])], "plans[4]: after the enter plans[3] a plan is needed that updates states"),
    ("leave_copy", "copies", [("plans[2].updates", [0, 8])], "plans[2].updates[1] is copy 'fit.list.texels.momentum'; what comes after"),
    ("leave_type", "copies", [("plans[2].updates", [0, 3])], "plans[2]: after the enter plans[1] a plan is needed that updates states of"),
    ("leave_needs", "copies", [("plans[2].needs", [0])], "plans[2]: after the enter plans[1] a plan is needed that"),
    ("leave_reads", "copies", [("plans[2].reads", [7, 8, 1])], "plans[2] reads 'uv'; what comes after an enter reads its copies alone"),
    ("leave_clears", "copies", [("passes[8].attachments[0].load", 1)],
     "plans[2].stages[0].attachments[0]: what comes after an enter loads the states that it updates"),
    ("leave_next", "copies", [("plans[2].stages[0].attachments[0]", 43)], "plans[2].stages[0].attachments[0]: image 21 is not for this"),
    ("leave_needed", "copies", [("plans[4].needs", [0, 1, 2])], "plans[4].needs[2]: plans[2] updates something"),
    # compute
    ("compute_lacks", "counted", [("computes[0].outputs", DROP)], "computes[0] lacks outputs"),
    ("computes_missing", "counted", [("computes", DROP)], "description lacks computes"),
    ("computes_none", "counted", [("computes", [])], "plans[0].stages[0].compute is 0; an integer from 0 to -1"),
    ("computes_map", "counted", [("computes", {})], "computes is a map of 0; a list of at most 65536"),
    ("computes_too_early", "ops", [("computes", [])], "description has the unknown key 'computes'"),
    ("compute_shader", "counted", [("computes[0].shader", 2)], "computes[0].shader is 2; an integer from 0 to 1"),
    ("compute_shader_of_a_draw", "dispatched", [("computes[0].shader", 0)], "computes[0].shader: shader 0 is for the vertex stage"),
    ("compute_drawn", "dispatched", [("pipelines[0].fragment", 4)], "pipelines[0].fragment: shader 4 is for the compute stage"),
    ("compute_binding", "counted", [("computes[0].bindings[0]", [10, -1])], "computes[0].bindings[0][0] is 10; allowed: 1 2"),
    ("compute_binding_row", "counted", [("computes[0].bindings[0]", [2, 32, -1])], "computes[0].bindings[0] is a list of 3; a list of 2"),
    ("compute_sampler", "dispatched", [("computes[7].bindings[0][1]", 1)], "computes[7].bindings[0][1] is 1; an integer from 0 to 0"),
    ("compute_no_sampler", "counted", [("computes[0].bindings[0]", [1, 0])], "computes[0].bindings[0][1] is 0; an integer from 0 to -1"),
    ("compute_binding_kind", "dispatched", [("computes[7].bindings[0]", [2, -1])],
     "computes[7]: binding 0 is a sampled image; the shader uses a combined image sampler"),
    ("compute_binding_missing", "counted", [("computes[0].bindings", []), ("plans[0].stages[0].images", [])],
     "computes[0]: binding 0 is a storage image; the shader uses a sampled image"),
    ("compute_no_outputs", "counted", [("computes[0].outputs", [])], "computes[0].outputs is a list of 0; at least one is needed"),
    ("compute_output_format", "counted", [("computes[0].outputs[0].format", 102)], "outputs[0].format is 102; allowed: 97 99 100 108 109"),
    ("compute_output_load", "counted", [("computes[0].outputs[0].load", 3)], "computes[0].outputs[0].load is 3; an integer from 0 to 2"),
    ("compute_output_clear", "counted", [("computes[1].outputs[0].clear", 1)], "computes[1].outputs[0].clear is 1; an integer from 0 to 0"),
    ("compute_output_other", "dispatched", [("computes[7].outputs[0].format", 97), ("images[19].format", 97),
                                            ("values[4].role", "copy")], "values[4]: its image has format 97"),
    ("compute_output_written_otherwise", "dispatched", [("computes[4].outputs[1].format", 97), ("images[13].format", 97)],
     "computes[4].outputs[1].format is 97; the shader writes format 109"),
    ("compute_output_more", "counted", [("computes[0].outputs[1]", {"format": 100, "load": 2, "clear": 0}),
                                        ("plans[0].stages[0].outputs[1]", 2)],
     "computes[0].outputs[1]: the shader has no storage image at binding 2"),
    ("compute_storage_bound", "dispatched", [("computes[7].outputs[0].store", 0)], "computes[7].outputs[0] has the unknown key 'store'"),
    ("dispatch_unknown", "counted", [("plans[0].stages[0].width", 1)], "plans[0].stages[0] has the unknown key 'width'"),
    ("dispatch_of_a_pass", "dispatched", [("plans[1].stages[0].compute", 0)], "plans[1].stages[0] lacks groups"),
    ("dispatch_groups", "counted", [("plans[0].stages[0].groups", [1, 0, 1])], "stages[0].groups[1] is 0; an integer from 1 to 2147483647"),
    ("dispatch_axes", "counted", [("plans[0].stages[0].groups", [1, 1])], "stages[0].groups is a list of 2; a list of 3 is needed"),
    ("dispatch_wait", "counted", [("plans[0].stages[0].wait", 1)], "plans[0].stages[0].wait is 1; a boolean is needed"),
    ("dispatch_no_wait", "counted", [("plans[0].stages[1].wait", False)], "plans[0].stages[1].wait is false; the stage touches what"),
    ("dispatch_images", "counted", [("plans[0].stages[0].images", [])], "plans[0].stages[0].images is a list of 0; a list of 1"),
    ("dispatch_image_usage", "counted", [("plans[0].stages[0].images[0]", 2)], "stages[0].images[0]: image 1 lacks usage 4"),
    ("dispatch_image_ints", "counted", [("plans[0].stages[0].images[0]", 6), ("plans[0].reads", [1, 0])],
     "plans[0].stages[0].images[0]: image 3 has format 100; the shader reads integers"),
    ("dispatch_image_written", "dispatched", [("plans[1].stages[1].images[0]", 12)], "images[0]: image 6 is written by the same stage"),
    ("dispatch_unread", "counted", [("plans[0].reads", [0])], "plans[0].stages[0] reads 'n', which plans[0].reads lacks"),
    ("dispatch_late", "dispatched", [("plans[1].stages[2].images[3]", 18)], "plans[1].stages[2] reads image 9, which nothing has written"),
    ("dispatch_outputs", "counted", [("plans[0].stages[0].outputs", [])], "plans[0].stages[0].outputs is a list of 0; a list of 1"),
    ("dispatch_output_twice", "dispatched", [("plans[1].stages[3].outputs", [18, 18])], "plans[1].stages[3].outputs names something twice"),
    ("dispatch_output_format", "counted", [("plans[0].stages[0].outputs[0]", 2)],
     "plans[0].stages[0].outputs[0]: image 1 of format 100 and usage 9 does not fit the compute pipeline"),
    ("dispatch_output_usage", "counted", [("images[0].usage", 1)], "outputs[0]: image 0 of format 99 and usage 1 does not fit the compute"),
    ("dispatch_output_input", "counted", [("images[2].usage", 15), ("plans[0].stages[0].outputs[0]", 4),
                                          ("plans[0].stages[0].images[0]", 0),
                                          ("images[0].usage", 13)], "plans[0].stages[0].outputs[0]: image 2 is not for this plan to write"),
    ("dispatch_count", "counted", [("plans[0].stages[1].count", 2)], "stages[1].count: image 1 is not R32_SINT with usage 1"),
    ("dispatch_count_written", "counted", [("plans[0].stages[0].count", 0)], "stages[0].count: image 0 is written by the same stage"),
    ("dispatch_count_given", "counted", [("plans[0].stages[1].count", 4)], "stages[1] draws as often as image 2 says, which is given from"),
    ("storage_needs", "ops", [("needs.formats.R32_SFLOAT", ["storage"])], "R32_SFLOAT[0] is 'storage'; allowed: sampled color"),
    ("storage_limits", "ops", [("needs.limits.maxComputeSharedMemorySize", 1)],
     "needs.limits names 'maxComputeSharedMemorySize', which this reader does not know"),
    ("storage_of_depth", "dispatched", [("images[17].usage", 40)], "images[17].usage is 40; bits of 32 are allowed"),
    ("variants_plan_steps", "variants", [("variants[1].plans[3].steps", 3)], "variants[1].plans[3].steps is 3; that of variants[0] is 2"),
]


def files() -> dict[str, tuple[bytes, str]]:
    """Name -> bytes and message, for what is wrong with the file as such."""
    good = (FOLDER / "ops.dressi").read_bytes()
    d, blobs = vector("ops")
    size = struct.unpack_from("<Q", good, 16)[0]

    def shift(at, x):
        return good[:at] + x + good[at + len(x):]

    several, half, copies, compute, filled = ((FOLDER / f"{name}.dressi").read_bytes()
                                              for name in ("variants", "half", "copies", "counted", "filled"))
    computing, more = vector("counted")
    both = bundle.combine([({**vector("ops")[0], "computes": [], "profile": {"name": f"p{k}", "digest": "d"}}, blobs) for k in range(2)])
    without = bundle.combine([(d, blobs), (d, blobs)])
    of_compute = next(bytes(more[k]) for k in computing["shaders"])
    entries = bundle.loads(good).description["blobs"]
    moved = {**d, "blobs": [[entries[0][0] + 64, *entries[0][1:]], *entries[1:]]}
    huge = {**d, "blobs": [*entries[:-1], [entries[-1][0], 1 << 40, entries[-1][2]]]}
    return {
        "empty": (b"", "0 bytes; a bundle has at least 56"),
        "magic": (shift(0, b"PNG"), "not a bundle: the file does not begin with DRESSI"),
        "line_ends": (shift(6, b"\n"), "not a bundle"),
        "version": (shift(8, b"\6"), "format version 6; this reader knows 1 to 5"),
        "version_without_filled": (bundle.dumps({**d, "computes": []}, blobs, 5), "version 5; what the file holds is written as version 1"),
        "version_with_filled": (filled[:8] + b"\4" + filled[9:], "format version 4; what the file holds is written as version 5"),
        "version_of_filled_lacks_computes": (shift(8, b"\5"), "description lacks computes"),
        "version_without_compute": (shift(8, b"\4"), "description lacks computes"),
        "version_with_compute": (compute[:8] + b"\3" + compute[9:], "description has the unknown key 'computes'"),
        "version_of_nothing_computed": (bundle.dumps({**d, "computes": []}, blobs, 4), "version 4; what the file holds is written as"),
        "variants_without_compute": (bundle.dumps(*both, 4), "format version 4; what the file holds is written as version 2"),
        "variants_with_compute_too_early": (bundle.dumps(*both, 2), "variants[0]: description has the unknown key 'computes'"),
        "variants_lack_computes": (bundle.dumps(*without, 4), "variants[0]: description lacks computes"),
        "compute_shader_too_early": (bundle.dumps({**d, "shaders": [*d["shaders"], len(blobs)]}, [*blobs, of_compute]),
                                     "shaders[2] is for the compute stage, of which this version of the format has none"),
        "version_without_half": (shift(8, b"\3"), "format version 3; what the file holds is written as version 1"),
        "version_with_half": (half[:8] + b"\1" + half[9:], "format version 1; what the file holds is written as version 3"),
        "version_with_copies": (copies[:8] + b"\1" + copies[9:], "format version 1; what the file holds is written as version 3"),
        "version_of_several": (shift(8, b"\2"), "description lacks variants"),
        "version_of_one": (several[:8] + b"\1" + several[9:], "description lacks meta"),
        "reserved": (shift(12, b"\1"), "reserved field is 1; 0 is allowed"),
        "size": (shift(16, b"\xff" * 8), "truncated: the description has 18446744073709551615 bytes"),
        "digest": (shift(24, b"\0" * 32), "the description's checksum does not match; the file is damaged"),
        "text": (shift(60, b"\0\0"), "the description's checksum does not match; the file is damaged"),
        "padding": (shift(56 + size, b"\1"), "blobs[0]: at "),
        "blob": (shift(entries[0][0], b"\xff"), "blobs[0]: the checksum does not match; the file is damaged"),
        "after": (good + b"\0", f"{len(good) + 1} bytes; {len(good)} are needed, zeros after the last blob"),
        "short": (good[:-1], f"{len(good) - 1} bytes; {len(good)} are needed"),
        "no_msgpack": (packed(b"\xc1"), "the description has the byte 0xc1 at 0"),
        "extension": (packed(b"\xd4\1\1"), "the description has the byte 0xd4 at 0"),
        "claims": (packed(b"\xdd\xff\xff\xff\xff"), "the description claims more than its 5 bytes can hold"),
        "float32": (packed(b"\x81\xa1x\xca\0\0\0\0"), "the description has the byte 0xca at 3; nil, booleans, integers, float 64"),
        "items_in_all": (packed(b"\xdd" + struct.pack(">I", 1 << 22) + bytes(1 << 22)), "has more than 4194304 items"),
        "claims_nested": (packed(b"\xdc\xff\xff" * 30000), "the description claims more than its 90000 bytes can hold"),
        "claims_map": (packed(b"\xdf\0\1\0\0" + b"\xa0\xc0" * 50000), "the description claims more than"),
        "claims_text": (packed(b"\xdb\xff\xff\xff\xff"), "the description ends within a value"),
        "deep": (packed(b"\x91" * 5000 + b"\xc0"), "the description is no msgpack: StackError"),
        "utf8": (packed(b"\x81\xa1\xff\xc0"), "the description is no msgpack: UnicodeDecodeError"),
        "two_values": (packed(b"\xc0\xc0"), "the description is no msgpack: ExtraData"),
        "number": (packed(b"\x07"), "description is 7; a map is needed"),
        "integer_key": (packed(b"\x81\1\1"), "the description is no msgpack: ValueError"),
        "key_twice": (packed(b"\x82\xa1a\xc0\xa1a\xc0"), "a map of the description names a key twice"),
        "moved": (packed(moved), "blobs[0]: at "),
        "huge": (packed(huge, good[56 + size:]), "blobs[0]: the checksum does not match"),
        "no_blobs": (packed({**d, "blobs": []}), "shaders[0] is 1; an integer from 0 to -1 is allowed"),
        "blob_row": (packed({**d, "blobs": [[0, 1]]}), "blobs[0] is a list of 2; a list of 3 is needed"),
        "blob_digest": (packed({**d, "blobs": [[0, 1, b"x"]]}), "blobs[0][2] is b'x'; 32 bytes are needed"),
        "blob_size": (packed({**d, "blobs": [[0, 1 << 41, bytes(32)]]}), "blobs[0][1] is 2199023255552; an integer from 0"),
    }


def spoiled(base: str, changes) -> bytes:
    """The file with these changes."""
    d, blobs = vector(base)
    version = bundle.version_of(d.get("variants", [d]))
    for path, value in changes:
        change(d, path, value)
    return bundle.dumps(d, blobs, version)
