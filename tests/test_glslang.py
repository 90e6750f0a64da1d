"""Fragment shaders are given to glslang as GLSL 4.00, which takes it less time, and come out as they would of 4.50."""

import re
from pathlib import Path

import pytest

from dressi_edge.compiler.backend import spirv

GOLDENS = Path(__file__).parent / "goldens"
NEWER = spirv._VERSION + """layout(location = 0) out ivec4 o0;
void main() { o0 = mix(ivec4(1), ivec4(2), bvec4(gl_FragCoord.x > 1.0)); }
"""


def fragments(program):
    """The distinct fragment shaders of a golden."""
    parts = re.split(r"// shader \d+ \((vert|frag)\)\n", (GOLDENS / f"{program}.glsl").read_text(encoding="utf-8"))[1:]
    return list(dict.fromkeys(text for stage, text in zip(parts[::2], parts[1::2]) if stage == "frag"))


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
