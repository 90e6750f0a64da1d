"""Fragment shaders are given to glslang as GLSL 4.00, which takes it less time, and come out as they would of 4.50; and many shaders are
given to one process of glslc, where there is one, and come out as they would of a process of glslang each."""

import re
from pathlib import Path

import pytest

from dressi_edge.compiler.backend import spirv, tools

GOLDENS = Path(__file__).parent / "goldens"
NEWER = spirv._VERSION + """layout(location = 0) out ivec4 o0;
void main() { o0 = mix(ivec4(1), ivec4(2), bvec4(gl_FragCoord.x > 1.0)); }
"""


COMPUTE = ("comp", """#version 450
layout(local_size_x = 8, local_size_y = 4) in;
layout(set = 0, binding = 0, rgba32f) uniform writeonly image2D o0;
void main() { imageStore(o0, ivec2(gl_GlobalInvocationID.xy), vec4(gl_LocalInvocationIndex)); }
""")


def shaders(program):
    """The distinct shaders of a golden."""
    parts = re.split(r"// shader \d+ \((vert|frag)\)\n", (GOLDENS / f"{program}.glsl").read_text(encoding="utf-8"))[1:]
    return list(dict.fromkeys(zip(parts[::2], parts[1::2])))


def fragments(program):
    """The distinct fragment shaders of a golden."""
    return [text for stage, text in shaders(program) if stage == "frag"]


@pytest.mark.parametrize("program", ["split", "texture"])
def test_the_older_version_gives_the_same_bytes(program):
    texts = fragments(program)
    assert texts and all(text.startswith(spirv._VERSION) for text in texts)
    for text in texts:
        quick = spirv._compile_as("frag", spirv._QUICK["frag"] + text.removeprefix(spirv._VERSION))  # no error: all of it is there
        assert quick == spirv._compile_as("frag", text)


def test_what_is_new_in_4_50_compiles_as_that(monkeypatch):
    with pytest.raises(spirv.ShaderError):
        spirv._compile_as("frag", spirv._QUICK["frag"] + NEWER.removeprefix(spirv._VERSION))
    assert spirv._compile(("frag", NEWER)) == spirv._compile_as("frag", NEWER)


def test_errors_name_lines_of_the_text_that_was_written():
    text = spirv._VERSION + "void main() { undeclared(); }\n"
    with pytest.raises(spirv.ShaderError, match=r"(?s)s\.frag:2: .*undeclared.*\n   1 #version 450"):
        spirv._compile(("frag", text))


@pytest.fixture
def nothing_kept(monkeypatch):
    """A compiler that has compiled nothing yet."""
    monkeypatch.setenv("DRESSI_CACHE", "off")
    monkeypatch.setattr(spirv, "_compiled", {})


def one_by_one(jobs):
    return {job: spirv._compile(job) for job in jobs}


def glslc_that(monkeypatch, tmp_path, does):
    """A glslc that is this script of the shell."""
    path = tmp_path / "glslc"
    path.write_text(f"#!/bin/sh\n{does}\n")
    path.chmod(0o755)
    monkeypatch.setattr(spirv, "find_glslc", lambda: str(path))
    return path


def test_many_in_one_process_are_the_same_bytes(nothing_kept, monkeypatch):
    if tools.find_glslc() is None:
        pytest.skip("no glslc here (apt-get install glslc): shaders were compiled one by one")
    jobs = [*shaders("split"), *shaders("texture"), COMPUTE, ("frag", NEWER)]
    monkeypatch.setattr(spirv, "BATCH", 16)
    assert len(jobs) > spirv.BATCH and {stage for stage, _ in jobs} == {"vert", "frag", "comp"}
    assert spirv.compile_all(jobs) == one_by_one(jobs)


@pytest.mark.parametrize("does", [None, "exit 1", "for f in *.frag *.vert; do echo nonsense > $f.spv; done", "rm -f *", "kill $$"])
def test_what_one_process_does_not_compile_is_compiled_alone(nothing_kept, monkeypatch, tmp_path, does):
    jobs = shaders("split")[:3]
    path = glslc_that(monkeypatch, tmp_path, does)
    if does is None:
        path.unlink()
    assert spirv.compile_all(jobs) == one_by_one(jobs)


def test_errors_among_many_are_told_as_of_one(nothing_kept):
    wrong = ("frag", spirv._VERSION + "void main() { undeclared(); }\n")
    with pytest.raises(spirv.ShaderError, match=r"(?s)s\.frag:2: .*undeclared.*\n   1 #version 450"):
        spirv.compile_all([*shaders("split")[:3], wrong])


def test_a_glslc_that_does_not_start_is_not_used(monkeypatch, tmp_path):
    path = glslc_that(monkeypatch, tmp_path, "exit 127")
    monkeypatch.setenv("PATH", str(tmp_path))
    assert tools.find_glslc() is None
    path.write_text("#!/bin/sh\nexit 0\n")
    tools._starts.cache_clear()
    assert tools.find_glslc() == str(path)
    path.unlink()
    tools._found.cache_clear()
    tools._starts.cache_clear()
