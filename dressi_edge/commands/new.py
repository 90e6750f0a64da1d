"""`new`: a starting job for a folder of pictures, written after looking at what is in it."""
from __future__ import annotations

import os
import shlex

from ..cache.errors import InputError
from .files import check_folder, write_file
from .progress import Events, Terminal


def new(args) -> None:
    """The command."""
    path = args.output
    check_folder(path)
    if not path.endswith(".toml"):
        raise InputError(f"output {path}: a job is written; name it .toml")
    beside = os.path.dirname(os.path.abspath(path))
    from ..compiler.scene.job import load_job
    from ..compiler.scene.starting import starting_job
    with Events(Terminal()) as events:
        events.doing(f"looking at {args.folder}")
        start = starting_job(args.folder, beside, os.path.splitext(os.path.basename(path))[0], args.start == "hull")
        files = {path: start.text.encode(), **{os.path.join(beside, name): data for name, data in start.files.items()}}
        if (taken := next((name for name in files if os.path.exists(name)), None)) and not args.force:
            raise InputError(f"output {taken} exists; name another with -o, or replace it with --force")
        for name, data in reversed(files.items()):  # what the job names before it
            write_file(name, data)
        events.doing(f"trying {path}")

        def reading(done: int, of: int) -> None:
            events.doing("reading pictures", done, of)
            if done == of and start.carved:
                events.doing("carving the hull of the masks")

        try:
            load_job(path, (), reading)
        except InputError as error:
            raise InputError(f"{error}; {path} is written, correct it there") from None
    for line in start.told:
        print(f"- {line}")
    name = os.path.splitext(path)[0]
    views = "" if start.apart is None else f" --views {shlex.quote(os.path.relpath(start.apart))}"
    print(f"in {os.path.dirname(path) or '.'}: {' '.join(os.path.basename(name) for name in files)}; next:\n"
          f"  dressi-edge compile {path} -p vulkan_min -o {name}.dressi\n  dressi-edge run {name}.dressi{views} -o {name}.glb --serve")
