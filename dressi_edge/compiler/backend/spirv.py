"""GLSL to SPIR-V with glslang, validated by spirv-val. Equal texts are compiled once.

A process of glslang declares all built-in functions of the shader's version of GLSL before it looks at the shader, which takes ten times
as long as the shader itself. So where there is `glslc`, which is glslang behind another command, it compiles many shaders in one process;
else glslangValidator compiles each in a process of its own. Both are told of errors by the latter, and the bytes are the same.
"""
from __future__ import annotations

import contextlib
import os
import subprocess
import tempfile
from collections.abc import Iterable
from concurrent.futures import ThreadPoolExecutor

import numpy as np

from ...cache.errors import DressiError
from ...cache.progress import tell
from . import spirv_cache
from .tools import environment, find, find_glslc

_compiled: dict[tuple[str, str], bytes] = {}


GLSLC_OPTIONS = ("--target-env=vulkan1.0", "-O0", "-c")
BATCH = 32  # shaders of a process at most: the built-in functions cost little then, and every core has some of a large program
DEBUG = (2, 3, 4, 5, 6, 7, 8, 317, 330)  # the instructions that name things and lines of a source: OpSource, OpName, OpLine and their like
GLSLANG = np.array([8 << 16 | 11], "<u4")  # the generator that glslang writes


class ShaderError(DressiError):
    """glslang or spirv-val refused a shader: a defect of the compiler, with the text that shows it."""


def _commands(source: str, out: str) -> list[list[str]]:
    return [[find("glslangValidator"), "-V", "--target-env", "vulkan1.0", "-g0", "-o", out, source],
            [find("spirv-val"), "--target-env", "vulkan1.0", out]]


# The built-in functions of GLSL 4.00 take a third of the time of those of 4.50, and of 4.30, the first with compute shaders, half of it.
# Fragment and compute shaders come out the same in every byte; vertex shaders have one built-in output more in 4.50.
_VERSION = "#version 450\n"
_QUICK = {"frag": "#version 400\n#extension GL_ARB_separate_shader_objects : require\n"
                  "#extension GL_ARB_shading_language_420pack : require\n", "comp": "#version 430\n"}


def _older(stage: str, text: str) -> str:
    """The text as the oldest version of GLSL that a shader of this stage may be."""
    return _QUICK[stage] + text[len(_VERSION):] if stage in _QUICK and text.startswith(_VERSION) else text


def _compile(job: tuple[str, str]) -> bytes:
    """The SPIR-V of a shader. One that needs its own version of GLSL, for a function that is new there, is compiled as that."""
    stage, text = job
    older = _older(stage, text)
    if older != text:
        try:
            return _compile_as(stage, older)
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


def _compile_some(glslc: str | None, jobs: list[tuple[str, str]]) -> list[bytes]:
    """The SPIR-V of some shaders, by one process where there is glslc. What it refuses, `_compile` does, or says what is wrong with it."""
    if glslc is None:
        return [_compile(job) for job in jobs]
    with tempfile.TemporaryDirectory() as folder:
        names = [f"{k}.{stage}" for k, (stage, _) in enumerate(jobs)]
        for name, (stage, text) in zip(names, jobs):
            with open(os.path.join(folder, name), "w") as f:
                f.write(_older(stage, text))
        with contextlib.suppress(OSError):  # it is gone since it was found
            subprocess.run([glslc, *GLSLC_OPTIONS, *names], cwd=folder, capture_output=True)
        codes = []
        for name, job in zip(names, jobs):
            path = os.path.join(folder, name + ".spv")
            try:
                with open(path, "rb") as f:
                    code = without_debug(f.read())
                with open(path, "wb") as f:
                    f.write(code)
                valid = subprocess.run(_commands("", path)[1], capture_output=True, env=environment(find("spirv-val"))).returncode == 0
            except (OSError, ValueError):  # not written, or not whole words
                valid = False
            codes.append(code if valid else _compile(job))
        return codes


def without_debug(code: bytes) -> bytes:
    """A module without names and sources, as from glslang itself with -g0: glslc has no option for that."""
    array = np.frombuffer(code, "<u4")
    words, kept, at, since = array.tolist(), [array[:2], GLSLANG, array[3:5]], 5, 5
    while at < len(words):
        after = at + (words[at] >> 16 or 1)
        if words[at] & 0xffff in DEBUG:
            kept.append(array[since:at])
            since = after
        at = after
    return np.concatenate([*kept, array[since:]]).tobytes()


def compile_all(jobs: Iterable[tuple[str, str]]) -> dict[tuple[str, str], bytes]:
    """SPIR-V for each (stage "vert" or "frag", GLSL text). What a process before this one compiled is taken from the disk
    (`spirv_cache.py`). Raises ShaderError."""
    jobs = list(dict.fromkeys(jobs))
    missing = [job for job in jobs if job not in _compiled]
    glslc = find_glslc() if missing else None
    folder = spirv_cache.folder() if missing else None
    names = {}
    if folder:
        tools = {name: find(name) for name in ("glslangValidator", "spirv-val")} | ({"glslc": glslc} if glslc else {})
        options = " ".join([*GLSLC_OPTIONS, *(word for command in _commands("s", "o") for word in command[1:])])
        names = {job: spirv_cache.key(tools, options, *job) for job in missing}
        _compiled.update({job: code for job, name in names.items() if (code := spirv_cache.load(folder, name))})
        missing = [job for job in missing if job not in _compiled]
    missing.sort(key=lambda job: job[0])  # by stage, for the functions that are built in differ from stage to stage
    batches = [missing[k:k + BATCH] for k in range(0, len(missing), BATCH)] if glslc else [[job] for job in missing]
    done = 0
    with ThreadPoolExecutor(max_workers=os.cpu_count() or 1) as pool:
        for batch, codes in zip(batches, pool.map(lambda jobs: _compile_some(glslc, jobs), batches)):
            tell("compiling shaders", done, len(missing))
            _compiled.update(zip(batch, codes))
            done += len(batch)
    if folder and missing:
        spirv_cache.store(folder, {names[job]: _compiled[job] for job in missing})
    return {job: _compiled[job] for job in jobs}
