"""Arrows between the compiler's packages point down only, and a package's modules stay within a page or two."""
import ast
from pathlib import Path

import pytest

PROJECT = Path(__file__).resolve().parents[1] / "dressi_edge"
COMPILER = PROJECT / "compiler"
ORDER = ("graph", "passes", "backend", "render", "io", "scene")  # each may import those before it, and the cache
ALLOWED = {"graph": (), "passes": ("graph",), "backend": ("graph", "passes"), "render": ("graph", "io"), "io": (),
           "scene": ("graph", "render", "io", "compiler", "check_op")}
TABLES = ("runtime/vk.py",)  # the Vulkan API
MODULES = sorted(COMPILER.rglob("*.py"))


def imported(path: Path) -> set[str]:
    """The packages of the compiler that a module imports; "compiler" for the compiler's own __init__."""
    package = list(path.relative_to(COMPILER.parent).parts[:-1])
    found, tree = set(), ast.parse(path.read_text(encoding="utf-8"))
    tree.body = [n for n in tree.body if not (isinstance(n, ast.If) and getattr(n.test, "id", "") == "TYPE_CHECKING")]  # words of hints
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom):
            base = package[:len(package) - node.level + 1] if node.level else ["elsewhere"]
            full = base + (node.module.split(".") if node.module else [])
            if full[:1] == ["compiler"]:
                found.add(full[1] if len(full) > 1 else "compiler")
    return found


def test_every_package_has_its_place():
    assert {p.name for p in COMPILER.iterdir() if (p / "__init__.py").exists()} == set(ORDER) == set(ALLOWED)


@pytest.mark.parametrize("path", MODULES, ids=lambda p: str(p.relative_to(COMPILER)))
def test_arrows_point_down(path):
    own = path.relative_to(COMPILER).parts[0]
    allowed = {own, *ALLOWED[own]} if own in ALLOWED else {*ORDER, "compiler"}
    assert imported(path) <= allowed


@pytest.mark.parametrize("path", sorted(PROJECT.rglob("*.py")), ids=lambda p: str(p.relative_to(PROJECT)))
def test_a_module_holds_one_thing(path):
    """At most 400 lines, but for tables; of both sides, the command line and the bridges too."""
    lines = len(path.read_text(encoding="utf-8").splitlines())
    assert (lines <= 400) != (path.relative_to(PROJECT).as_posix() in TABLES)
