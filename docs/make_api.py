"""Every public name with its docstring, as one page: `make api`, or `python docs/make_api.py FILE.md`.

In: the packages as they are imported. Out: Markdown. A name is public if its module lists it in `__all__`, or else if it begins with no _
and comes from this project.
"""
import dataclasses
import importlib
import inspect
import re
import sys
from pathlib import Path

MODULES = {"dressi_edge.runtime": "On the device", "dressi_edge.runtime.session": "", "dressi_edge.compiler.scene": "Problems and scenes",
           "dressi_edge.compiler.graph.reference_session": "The same in float64", "dressi_edge.page.html": "Pages",
           "dressi_edge.page.result": "", "dressi_edge.cache.profile": "Device profiles", "dressi_edge.cache.errors": "Errors"}


def public(module) -> dict[str, object]:
    """Names and what they stand for, in the order of the module."""
    own = [name for name, x in vars(module).items() if not name.startswith("_") and getattr(x, "__module__", "") == module.__name__]
    found = {name: getattr(module, name) for name in getattr(module, "__all__", None) or own}
    return {name: x for name, x in found.items() if inspect.isclass(x) or inspect.isfunction(x)}


def signature(x) -> str:
    """How it is called, on one line; nothing where Python cannot tell."""
    try:
        return re.sub(r"(: |-> )'([^']*)'", r"\1\2", str(inspect.signature(x)))  # annotations are texts here
    except (TypeError, ValueError):
        return ""


def entry(name: str, x, depth: int = 3) -> list[str]:
    """One name, and the public methods of a class."""
    lines = [f"{'#' * depth} `{name}{signature(x)}`", "", inspect.cleandoc(x.__doc__ or ""), ""]
    if inspect.isclass(x):
        made = dataclasses.is_dataclass(x)
        for key, method in vars(x).items():
            own = getattr(method, "__func__", method.fget if isinstance(method, property) else method)
            if not key.startswith("_") and inspect.isfunction(own) and own.__doc__ and not (made and key == "replace"):
                how = "" if isinstance(method, property) else signature(own)
                lines += [f"- `{key}{how}`: {' '.join(inspect.cleandoc(own.__doc__).split())}"]
        lines.append("")
    return lines


def api() -> str:
    """The page."""
    lines, seen = ["# API", "", "Made from docstrings by `make api`. Axes, pixels and colours: docs/conventions.md.", ""], set()
    for path, title in MODULES.items():
        module = importlib.import_module(path)
        if title:
            lines += [f"## {title}", ""]
        for name, x in public(module).items():
            if id(x) not in seen:
                seen.add(id(x))
                lines += entry(name if title == "Errors" else f"{path.removesuffix('.session')}.{name}", x)
    return "\n".join([*lines, *operations()])


def operations() -> list[str]:
    """Every operation of graphs, as `F` has it, with its first sentence."""
    from dressi_edge.compiler.scene import F
    found = {name: getattr(F, name) for name in dir(F) if not name.startswith("_")}
    rows = [f"| `{name}` | {' '.join((x.__doc__ or '').split()).partition('. ')[0].replace('|', 'or')} |" for name, x in found.items()
            if inspect.isfunction(x) and x.__doc__]
    head = "Of `F` in `dressi_edge.compiler.scene`; what each computes in full is in its docstring."
    return ["## Operations", "", head, "", "| | |", "|---|---|", *rows, ""]


if __name__ == "__main__":
    out = Path(sys.argv[1])
    out.parent.mkdir(parents=True, exist_ok=True)
    out.write_text(api(), encoding="utf-8")
    print(f"{out}: {out.stat().st_size / 1e3:.0f} kB")
