"""Device profiles: the files that come with the product, merging, misfits, and files made to hurt."""

import dataclasses
import json
import random
import re
from pathlib import Path

import pytest

from dressi_edge.cache.errors import ProfileError
from dressi_edge.cache.limits import FEATURES, FORMATS, LIMITS
from dressi_edge.cache.profile import STATUS, Profile, canonical, folder, from_device, merge, misfit, profile_names
from dressi_edge.cache.profile_check import check
from dressi_edge.cache.profile_file import MAX_FILE_BYTES, from_khronos, to_json

NAMES = profile_names()
WANTED = set("""vulkan_min android_baseline_2021 android_baseline_2022 mali_g76 adreno_740 uhd620_windows apple_m1_moltenvk
             raspberry_pi_4 rtx2080 radeon lavapipe limit4 limit8 unlimited""".split())


def faults(profile):
    return [line for line in check(profile) if not line.startswith("note: ")]


def text_of(name):
    return (Path(str(folder())) / f"{name}.json").read_text(encoding="utf-8")


# ---- the files ----------------------------------------------------------------------------------------------------------

def test_all_wanted_profiles_are_there():
    assert set(NAMES) >= WANTED


@pytest.mark.parametrize("name", NAMES)
def test_file_is_sound_and_survives_a_round_trip_byte_for_byte(name):
    profile = Profile.load(name)
    assert profile.name == name and profile.description
    assert faults(profile) == []
    assert to_json(profile) == text_of(name)
    assert Profile.loads(to_json(profile)) == profile
    assert Profile.load(Path(str(folder())) / f"{name}.json") == profile


@pytest.mark.parametrize("name", NAMES)
def test_every_value_has_a_source(name):
    profile = Profile.load(name)
    for key in (*profile.limits, *profile.features, *profile.formats, "tile_bits", "prefer_fp16"):
        source = profile.source(key)
        assert source["source"] and source["status"] in STATUS, key


@pytest.mark.parametrize("name", NAMES)
def test_what_is_packed_for_the_floor_fits_every_profile(name):
    floor = canonical(Profile.load("vulkan_min"))
    needs = floor["limits"] | {k: on for k, on in floor["features"].items() if on} | floor["formats"]
    out = misfit(needs, Profile.load(name))
    # MoltenVK reports 1024 samplers where the specification asks for 4000
    assert [line for line in out if not line.startswith("maxSamplerAllocationCount")] == []


def test_tables_are_as_wide_as_drivers_of_the_same_family_pad_rows_to():
    """Where no report says so, what Mesa does for the hardware is assumed, and marked so."""
    width = {name: Profile.load(name).table_width for name in profile_names()}
    for name, like in (("adreno_740", "adreno_740_turnip"), ("mali_g76", "mali_g76_panvk"), ("apple_m1_moltenvk", "apple_m1_honeykrisp"),
                       ("rtx2080", "nvk_turing")):
        assert width[name] == width[like], name
    assert width["radeon"] == width["navi21"] == 16  # Navi 10, as Navi 21
    assert all(Profile.load(name).sources["table_width"]["status"] == "assumed" for name in ("adreno_740", "mali_g76", "radeon"))


def test_facts_that_the_project_rests_on():
    inputs = {name: Profile.load(name).limit("maxPerStageDescriptorInputAttachments") for name in NAMES}
    assert {n: inputs[n] for n in ("vulkan_min", "limit4", "mali_g76", "raspberry_pi_4", "android_baseline_2022")} == {
        "vulkan_min": 4, "limit4": 4, "mali_g76": 4, "raspberry_pi_4": 4, "android_baseline_2022": 4}
    assert inputs["limit8"] == inputs["uhd620_windows"] == inputs["lavapipe"] == 8
    assert min(inputs["unlimited"], inputs["rtx2080"], inputs["radeon"]) >= 1048576
    assert not Profile.load("apple_m1_moltenvk").feature("geometryShader")
    assert Profile.load("limit8").limit("maxColorAttachments") == Profile.load("unlimited").limit("maxColorAttachments") == 8
    assert (Profile.load("mali_g76").tile_bits, Profile.load("mali_g76").max_merged_attachments) == (128, 8)


def test_more_capable_plain_profiles_contain_the_smaller_ones():
    four, eight, unlimited = map(Profile.load, ("limit4", "limit8", "unlimited"))
    assert misfit(canonical(four)["limits"], eight) == [] and misfit(canonical(eight)["limits"], unlimited) == []


def test_unknown_name_lists_the_known_and_the_nearest():
    with pytest.raises(ProfileError, match=r"'mali_g67' is unknown; did you mean mali_g76\? known: adreno_630 .*vulkan_min$"):
        Profile.load("mali_g67")


def test_missing_file_is_one_clear_error(tmp_path):
    with pytest.raises(ProfileError, match=r"nothing\.json: cannot be read: No such file"):
        Profile.load(tmp_path / "nothing.json")


# ---- values in force ----------------------------------------------------------------------------------------------------

def test_absent_means_the_minimum_of_the_specification():
    bare = Profile("bare")
    assert {k: bare.limit(k) for k in LIMITS} == {k: floor for k, (_, floor) in LIMITS.items()} | {"maxPerStageResources": 44}
    assert [f for f in FEATURES if bare.feature(f)] == ["robustBufferAccess"]
    assert all(bare.format_features(f) == features for f, features in FORMATS.items())
    assert canonical(bare) == canonical(Profile.load("vulkan_min")) and bare.digest == Profile.load("vulkan_min").digest
    assert bare.source("maxViewports")["status"] == "specified"


def test_unstated_resources_are_the_sum_of_the_stated_limits_up_to_128():
    limits = {"maxPerStageDescriptorSampledImages": 40}
    assert Profile("p", limits=limits).limit("maxPerStageResources") == 68
    assert Profile("p", limits={**limits, "maxColorAttachments": 200}).limit("maxPerStageResources") == 128


def test_no_fp32_blend_or_filter_at_the_floor_but_both_in_fp16():
    floor = Profile.load("vulkan_min")
    assert not floor.format_has("R32G32B32A32_SFLOAT", "blend") and not floor.format_has("R32_SFLOAT", "filter")
    assert floor.format_has("VK_FORMAT_R16G16B16A16_SFLOAT", "blend", "filter", "color", "sampled")


def test_depth_format_is_chosen_at_load_only_where_the_profile_is_not_certain():
    assert Profile.load("vulkan_min").depth_choice() == ("D32_SFLOAT", "X8_D24_UNORM_PACK32")
    assert Profile.load("limit4").depth_choice() == ("D32_SFLOAT",)
    assert Profile("p", formats={"X8_D24_UNORM_PACK32": {"depth"}}).depth_choice() == ("X8_D24_UNORM_PACK32",)


@pytest.mark.parametrize("ask, words", [
    (lambda p: p.limit("maxColourAttachments"), "did you mean maxColorAttachments"),
    (lambda p: p.feature("geometryShaders"), "did you mean geometryShader"),
    (lambda p: p.format_features("R32_FLOAT"), "did you mean R32_SFLOAT"),
    (lambda p: p.format_has("R32_SFLOAT", "blending"), "did you mean blend"),
])
def test_asking_for_an_unknown_name_suggests_the_nearest(ask, words):
    with pytest.raises(ProfileError, match=words):
        ask(Profile("p"))


def test_a_profile_cannot_be_changed_and_can_be_a_key():
    profile = Profile.load("limit4")
    with pytest.raises(dataclasses.FrozenInstanceError):
        profile.tile_bits = 1
    with pytest.raises(TypeError):
        profile.limits["maxColorAttachments"] = 99
    assert {profile: 1}[Profile.load("limit4")] == 1


def test_canonical_is_plain_data():
    for name in NAMES:
        record = canonical(Profile.load(name))
        assert json.loads(json.dumps(record)) == record
    assert len({Profile.load(name).digest for name in NAMES}) >= len(NAMES) - 2


# ---- merge --------------------------------------------------------------------------------------------------------------

def random_profile(rng, name):
    def limit(kind, floor):
        if kind == "flag":
            return rng.random() < 0.5
        if kind == "size":
            return tuple(v * rng.randint(1, 4) for v in floor)
        if kind == "range":
            return (floor[0] * rng.randint(1, 4), floor[1] * rng.randint(1, 4))
        return floor // rng.randint(1, 4) if kind == "min" else floor * rng.randint(1, 4)
    limits = {k: limit(*v) for k, v in LIMITS.items() if rng.random() < 0.6}
    features = {k: rng.random() < 0.5 for k in FEATURES if rng.random() < 0.6 and k != "robustBufferAccess"}
    formats = {k: v | ({"filter"} if rng.random() < 0.5 else set()) for k, v in FORMATS.items() if rng.random() < 0.6}
    return Profile(name, limits=limits, features=features, formats=formats, tile_bits=rng.choice([None, 128, 256]),
                   max_merged_attachments=rng.choice([None, 8, 9]), prefer_fp16=rng.random() < 0.5)


@pytest.mark.parametrize("seed", range(50))
def test_merge_is_commutative_associative_idempotent_and_never_above_a_member(seed):
    rng = random.Random(seed)
    a, b, c = (random_profile(rng, n) for n in "abc")
    assert merge([a, b], "m") == merge([b, a], "m")
    all_three = canonical(merge([a, b, c], "m"))
    assert canonical(merge([merge([a, b], "x"), c], "m")) == all_three == canonical(merge([a, merge([c, b], "x")], "m"))
    assert canonical(merge([a, a], "m")) == canonical(a) == canonical(merge([a], "m"))
    needs = all_three["limits"] | {k: v for k, v in all_three["features"].items() if v} | all_three["formats"]
    for member in (a, b, c):
        assert misfit(needs, member) == []
        assert member.tile_bits is None or all_three["tile_bits"] <= member.tile_bits


def test_merge_of_all_files_is_sound_and_fits_each():
    merged = merge(map(Profile.load, NAMES), "everywhere")
    assert faults(merged) == []
    assert merged.source("maxSamplerAllocationCount")["source"].startswith("apple_m1_moltenvk: ")
    assert all(misfit(canonical(merged)["limits"], Profile.load(name)) == [] for name in NAMES)
    assert Profile.loads(to_json(merged)) == merged


def test_merge_of_nothing_says_so():
    with pytest.raises(ProfileError, match="nothing to merge"):
        merge([], "none")


# ---- misfit and check ---------------------------------------------------------------------------------------------------

def test_misfit_names_the_thing_what_is_needed_and_what_is_there():
    floor = Profile.load("vulkan_min")
    assert misfit({"maxColorAttachments": 6}, floor) == ["maxColorAttachments: needs 6, vulkan_min has 4"]
    assert misfit({"maxColorAttachments": 4, "maxViewportDimensions": [4096, 4096]}, floor) == []
    assert misfit({"maxViewportDimensions": [4096, 8192]}, floor) == [
        "maxViewportDimensions: needs 4096 8192, vulkan_min has 4096 4096"]
    assert misfit({"nonCoherentAtomSize": 64}, floor) == ["nonCoherentAtomSize: needs 64, vulkan_min has 256"]
    assert misfit({"geometryShader": True, "wideLines": False}, floor) == [
        "geometryShader: needed, vulkan_min has none"]
    assert misfit({"R32_SFLOAT": ["color", "blend"], "VK_FORMAT_R32_SINT": ["color"]}, floor) == [
        "R32_SFLOAT: needs blend color, vulkan_min has color sampled storage"]
    assert misfit({"maxTeapots": 3}, floor) == ["maxTeapots: needs 3, vulkan_min says nothing of it"]


@pytest.mark.parametrize("needs", [{"maxColorAttachments": "6"}, {"maxColorAttachments": True}, {"geometryShader": 1},
                                   {"R32_SFLOAT": 3}, {"maxViewportDimensions": [1]}, {"maxColorAttachments": -1}])
def test_needs_of_the_wrong_type_are_an_error(needs):
    with pytest.raises(ProfileError, match="^needs: "):
        misfit(needs, Profile("p"))


@pytest.mark.parametrize("change, words", [
    (dict(limits={"maxColorAttachments": 3}), "p: maxColorAttachments: 3 is worse than 4, the specification's minimum"),
    (dict(limits={"minUniformBufferOffsetAlignment": 512}), "512 is worse than 256"),
    (dict(limits={"maxColourAttachments": 4}), "unknown limit; did you mean maxColorAttachments"),
    (dict(limits={"maxColorAttachments": "8"}), "must be a whole number from 0"),
    (dict(limits={"maxFramebufferWidth": 8192}), r"maxViewportDimensions\[0\] 4096 is below maxFramebufferWidth 8192"),
    (dict(features={"robustBufferAccess": False}), "the specification requires it"),
    (dict(features={"geometryShader": 1}), "must be true or false"),
    (dict(formats={"R32_SFLOAT": {"color"}}), "lacks sampled storage"),
    (dict(formats={"D16_UNORM": {"sampled", "depth", "blend"}}), "blend without color"),
    (dict(formats={"R64_SFLOAT": {"color"}}), "unknown format"),
])
def test_check_reports(change, words):
    sources = {"*": {"source": "test", "status": "assumed"}}
    assert any(re.search(words, line) for line in faults(Profile("p", sources=sources, **change)))


def test_check_notes_what_drivers_are_known_to_do():
    measured = {"*": {"source": "test", "status": "measured"}}
    limits = {"maxPerStageDescriptorSampledImages": 200, "maxPerStageResources": 128, "maxColorAttachments": 3}
    profile = Profile("p", limits=limits, sources=measured)
    assert faults(profile) == []
    notes = "\n".join(check(profile))
    assert "note: p: maxPerStageDescriptorSampledImages 200 is above maxPerStageResources 128" in notes
    assert "note: p: maxColorAttachments: 3 is worse than 4" in notes


def test_values_without_a_source_are_reported():
    assert check(Profile("p", limits={"maxViewports": 4}))[-1] == "p: maxViewports: no source is given"


# ---- a device at hand ---------------------------------------------------------------------------------------------------

def test_from_device_takes_what_a_driver_reports_and_leaves_out_the_rest():
    limits = {"maxColorAttachments": 8, "maxViewportDimensions": [8192, 8192], "timestampComputeAndGraphics": 1}
    profile = from_device(limits | {"maxTeapots": 1}, {"geometryShader": 1, "logicOp": 0},
                          {"VK_FORMAT_R32_SFLOAT": ["VK_FORMAT_FEATURE_SAMPLED_IMAGE_BIT", "color", "storage", "VK_OTHER"],
                           "R5G6B5": ["color"]}, "here")
    assert dict(profile.limits) == limits | {"maxViewportDimensions": (8192, 8192), "timestampComputeAndGraphics": True}
    assert dict(profile.features) == {"geometryShader": True}
    assert dict(profile.formats) == {"R32_SFLOAT": {"sampled", "color", "storage"}}
    assert faults(profile) == [] and Profile.loads(to_json(profile)) == profile
    assert profile.source("maxColorAttachments")["status"] == "measured"


def test_from_khronos_reads_our_own_files_and_ignores_foreign_keys():
    raw = json.loads(text_of("lavapipe"))
    raw["capabilities"]["lavapipe"]["extensions"] = {"VK_KHR_surface": 1}
    raw["capabilities"]["lavapipe"]["features"]["VkPhysicalDeviceFeatures"]["logicOp"] = True
    profile = from_khronos(json.dumps(raw), "lavapipe")
    assert profile.limits == Profile.load("lavapipe").limits and profile.formats == Profile.load("lavapipe").formats


# ---- hostile files ------------------------------------------------------------------------------------------------------

def broken(change):
    raw = json.loads(text_of("limit4"))
    change(raw)
    return json.dumps(raw)


def at_limits(raw):
    return raw["capabilities"]["limit4"]["properties"]["VkPhysicalDeviceProperties"]["limits"]


def at_features(raw):
    return raw["capabilities"]["limit4"]["features"]["VkPhysicalDeviceFeatures"]


def at_formats(raw):
    return raw["capabilities"]["limit4"]["formats"]


HOSTILE = {
    "empty": ("", "not JSON"),
    "not JSON": ("{", "not JSON"),
    "not text": (b"\xff\xfe\x00", "not JSON"),
    "deep": ("[" * 200000, "not JSON"),
    "a list": ("[]", "must be an object"),
    "a key twice": ('{"$schema": 1, "$schema": 2}', "appears twice"),
    "NaN": ('{"$schema": NaN}', "not a number of JSON"),
    "long number": ('{"$schema": ' + "9" * 5000 + "}", "not JSON"),
    "no schema": (broken(lambda r: r.pop("$schema")), "'\\$schema' is missing"),
    "wrong schema": (broken(lambda r: r.update({"$schema": "https://example.com/x"})), "must be a Khronos profile schema"),
    "no own block": (broken(lambda r: r.pop("dressi_edge")), "'dressi_edge' is missing"),
    "unknown top key": (broken(lambda r: r.update(dressi_edg={})), "unknown key 'dressi_edg'; did you mean dressi_edge"),
    "two devices": (broken(lambda r: r["capabilities"].update(other={})), "must hold one entry"),
    "bad name": (broken(lambda r: r.update(capabilities={"../x": {}})), "a name has 1 to 64"),
    "no profile": (broken(lambda r: r.update(profiles={})), "must be an object"),
    "capabilities a list": (broken(lambda r: r.update(capabilities=[])), "capabilities: must be an object"),
    "negative": (broken(lambda r: at_limits(r).update(maxColorAttachments=-4)), "maxColorAttachments: must be a whole number"),
    "string": (broken(lambda r: at_limits(r).update(maxColorAttachments="4")), "must be a whole number .*found '4'"),
    "bool": (broken(lambda r: at_limits(r).update(maxColorAttachments=True)), "must be a whole number .*found True"),
    "float": (broken(lambda r: at_limits(r).update(maxColorAttachments=4.5)), "must be a whole number"),
    "null": (broken(lambda r: at_limits(r).update(maxColorAttachments=None)), "must be a whole number"),
    "too large": (broken(lambda r: at_limits(r).update(maxColorAttachments=1 << 64)), "from 0 to 2\\^64 - 1"),
    "infinite": (broken(lambda r: at_limits(r).update(viewportBoundsRange=[-1, 7])).replace("[-1, 7]", "[-1, 1e999]"),
                 "must be a number"),
    "short list": (broken(lambda r: at_limits(r).update(maxViewportDimensions=[4096])), "must be a list of 2 numbers"),
    "reversed range": (broken(lambda r: at_limits(r).update(viewportBoundsRange=[1, -1])), r"must be \[low, high\]"),
    "unknown limit": (broken(lambda r: at_limits(r).update(maxColourAttachments=4)), "did you mean maxColorAttachments"),
    "unknown feature": (broken(lambda r: at_features(r).update(flying=True)), "unknown key 'flying'"),
    "feature a number": (broken(lambda r: at_features(r).update(geometryShader=1)), "geometryShader: must be true or false"),
    "unknown format": (broken(lambda r: at_formats(r).update(VK_FORMAT_X={})), "unknown key 'VK_FORMAT_X'"),
    "unknown flag": (broken(lambda r: at_formats(r)["VK_FORMAT_R8_UNORM"]["VkFormatProperties"].update(
        optimalTilingFeatures=["VK_FORMAT_FEATURE_FLY_BIT"])), "unknown flag 'VK_FORMAT_FEATURE_FLY_BIT'"),
    "key of ours": (broken(lambda r: r["dressi_edge"].update(outside_read="guess")), "unknown key 'outside_read'"),
    "no tile": (broken(lambda r: r["dressi_edge"].update(tile_bits=0)), "tile_bits: must be a whole number from 1"),
    "half a string": (broken(lambda r: r["dressi_edge"].update(prefer_fp16="x")), "prefer_fp16: must be true or false"),
    "bad status": (broken(lambda r: r["dressi_edge"]["sources"]["*"].update(status="sure")), "status must be one of measured"),
    "source of nothing": (broken(lambda r: r["dressi_edge"]["sources"].update(maxTeapots={"source": "", "status": "assumed"})),
                          "unknown key 'maxTeapots'"),
    "huge": (" " * (MAX_FILE_BYTES + 1), f"larger than {MAX_FILE_BYTES} bytes"),
}


@pytest.mark.parametrize("case", HOSTILE)
def test_hostile_file_is_one_error_line_that_names_the_file(case, tmp_path):
    data, words = HOSTILE[case]
    path = tmp_path / "hostile.json"
    path.write_bytes(data if isinstance(data, bytes) else data.encode())
    with pytest.raises(ProfileError, match=words) as error:
        Profile.load(path)
    message = str(error.value)
    assert message.startswith(str(path)) and "\n" not in message and len(message) < 2500


def test_random_damage_never_escapes_as_another_exception(tmp_path):
    rng = random.Random(7)
    data = text_of("mali_g76").encode()
    for _ in range(300):
        bad = bytearray(data)
        for _ in range(rng.randint(1, 6)):
            bad[rng.randrange(len(bad))] = rng.randrange(256)
        try:
            Profile.loads(bytes(bad), "damaged")
        except ProfileError as e:
            assert str(e).startswith("damaged: ")
