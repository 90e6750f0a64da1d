"""GLSL to SPIR-V with glslang, validated by spirv-val. Equal texts are compiled once."""
from __future__ import annotations

import os
import subprocess
import tempfile
from collections.abc import Iterable
from concurrent.futures import ThreadPoolExecutor

from ...cache.errors import DressiError
from ...cache.progress import tell
from . import spirv_cache
from .tools import environment, find

_compiled: dict[tuple[str, str], bytes] = {}


class ShaderError(DressiError):
    """glslang or spirv-val refused a shader: a defect of the compiler, with the text that shows it."""


def _commands(source: str, out: str) -> list[list[str]]:
    return [[find("glslangValidator"), "-V", "--target-env", "vulkan1.0", "-g0", "-o", out, source],
            [find("spirv-val"), "--target-env", "vulkan1.0", out]]


# glslang declares all built-in functions of the shader's version of GLSL anew in each process: of 4.50 that takes ten times as long as the
# shader, of 4.00 a third of that, of 4.30, the first with compute shaders, half. Fragment and compute shaders come out the same in every
# byte; vertex shaders have one built-in output more in 4.50.
_VERSION = "#version 450\n"
_QUICK = {"frag": "#version 400\n#extension GL_ARB_separate_shader_objects : require\n"
                  "#extension GL_ARB_shading_language_420pack : require\n", "comp": "#version 430\n"}


def _compile(job: tuple[str, str]) -> bytes:
    """The SPIR-V of a shader. One that needs its own version of GLSL, for a function that is new there, is compiled as that."""
    stage, text = job
    if stage in _QUICK and text.startswith(_VERSION):
        try:
            return _compile_as(stage, _QUICK[stage] + text[len(_VERSION):])
        except ShaderError:
            pass
    return _compile_as(stage, text)


def _compile_as(stage: str, text: str) -> bytes:
    with tempfile.TemporaryDirectory() as folder:
        source, out = os.path.join(folder, f"s.{stage}"), os.path.join(folder, "s.spv")
        with open(source, "w") as f:
            f.write(text)
        for command in _commands(source, out):
            done = subprocess.run(command, capture_output=True, text=True, env=environment(command[0]))
            if done.returncode:
                numbered = "\n".join(f"{k + 1:4} {line}" for k, line in enumerate(text.splitlines()))
                raise ShaderError(f"{os.path.basename(command[0])} refused a shader: {(done.stdout + done.stderr).strip()}\n{numbered}")
        with open(out, "rb") as f:
            return f.read()


def compile_all(jobs: Iterable[tuple[str, str]]) -> dict[tuple[str, str], bytes]:
    """SPIR-V for each (stage "vert" or "frag", GLSL text). What a process before this one compiled is taken from the disk
    (`spirv_cache.py`). Raises ShaderError."""
    jobs = list(dict.fromkeys(jobs))
    missing = [job for job in jobs if job not in _compiled]
    folder = spirv_cache.folder() if missing else None
    names = {}
    if folder:
        tools = {name: find(name) for name in ("glslangValidator", "spirv-val")}
        options = " ".join(word for command in _commands("s", "o") for word in command[1:])
        names = {job: spirv_cache.key(tools, options, *job) for job in missing}
        _compiled.update({job: code for job, name in names.items() if (code := spirv_cache.load(folder, name))})
        missing = [job for job in missing if job not in _compiled]
    with ThreadPoolExecutor(max_workers=os.cpu_count() or 1) as pool:
        for k, (job, code) in enumerate(zip(missing, pool.map(_compile, missing))):
            tell("compiling shaders", k, len(missing))
            _compiled[job] = code
    if folder and missing:
        spirv_cache.store(folder, {names[job]: _compiled[job] for job in missing})
    return {job: _compiled[job] for job in jobs}
