"""What the compiler made, while it still knows names: functions, stages and GLSL, for DRESSI_DEBUG and DRESSI_DUMP.

In: an `Assembler` that has assembled, and its description. Out: counts, text on stderr, files.
"""
from __future__ import annotations

import os
import sys
from pathlib import Path

from ...cache.errors import InputError
from ...cache.summary import dot, text


def count_functions(assembler) -> dict[str, int]:
    """Plan -> how many functions (nodes of the graph, each counted once) its stages hold."""
    return {name: len({node for stage in stages for s in stage.substages for node in s.nodes})
            for name, stages in assembler.stage_lists}


def stages_text(assembler) -> str:
    """Every substage: extent, its functions, what it reads and what it writes."""
    lines = []
    for name, stages in assembler.stage_lists:
        lines.append(f"plan {name}")
        for k, stage in enumerate(stages):
            for j, s in enumerate(stage.substages):
                lines.append(f"  stage {k} substage {j} {s.extent.width} x {s.extent.height}: "
                             + " ".join(n.op.name for n in s.nodes))
                lines.append("    reads " + (" ".join(f"{x.name}:{mode}" for x, mode in s.reads) or "nothing"))
                lines.append("    writes " + " ".join(f"{n.name} ({n.op.name} {n.vtype})" for n in s.outputs))
    return "\n".join(lines) + "\n"


def glsl_text(assembler) -> str:
    return "\n".join(f"// shader {k} ({stage})\n{source}" for k, (stage, source) in enumerate(assembler.shaders))


def trace(description: dict, assembler, variant: str = "") -> None:
    """What DRESSI_DEBUG asks for (1 a summary, 2 the substages, 3 the GLSL) on stderr; all of it as files in $DRESSI_DUMP, of
    several variants in a folder each."""
    level, folder = os.environ.get("DRESSI_DEBUG", ""), os.environ.get("DRESSI_DUMP")
    level = int(level) if level.isdecimal() else 0
    if level >= 1:
        sys.stderr.write(text(description))
    if level >= 2:
        sys.stderr.write(stages_text(assembler))
    if level >= 3:
        sys.stderr.write(glsl_text(assembler))
    if folder:
        folder = os.path.join(folder, variant)
        try:
            Path(folder).mkdir(parents=True, exist_ok=True)
            for name, content in (("summary.txt", text(description)), ("stages.txt", stages_text(assembler)),
                                  ("stages.dot", dot(description)),
                                  *((f"shader{k:03}.{stage}", source) for k, (stage, source) in enumerate(assembler.shaders))):
                (Path(folder) / name).write_text(content, encoding="utf-8")
        except OSError as error:
            raise InputError(f"DRESSI_DUMP={folder}: cannot be written: {error.strerror}; "
                             "name a folder that can be, or unset it") from None
