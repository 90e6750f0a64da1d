"""Which part may import which, what is installed, and that a checkout names no machine."""

import ast
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

ROOT = Path(__file__).resolve().parents[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
SHIPPED = ("dressi_edge", "device_profiles", "tests", "benchmarks", "docs", "android", ".ci")  # and the files beside them
BUILT = ("__pycache__",)
IMPORT_NAMES = {"pillow": "PIL"}  # distribution: module, where they differ


def modules(part):
    """(dotted name, path) of every module of dressi_edge.PART."""
    for path in sorted((ROOT / "dressi_edge" / part).rglob("*.py")):
        names = path.relative_to(ROOT).with_suffix("").parts
        yield ".".join(names[:-1] if names[-1] == "__init__" else names), path


def imports(path):
    """(line, dotted name) of everything that this file imports, anywhere in it; a name is MODULE or MODULE.MEMBER."""
    package = path.relative_to(ROOT).parts[:-1]
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            yield from ((node.lineno, a.name) for a in node.names)
        elif isinstance(node, ast.ImportFrom):
            base = package[:len(package) - node.level + 1] if node.level else ()
            yield from ((node.lineno, ".".join([*base, *filter(None, [node.module]), a.name])) for a in node.names)


def within(name, parents):
    return any(name == p or name.startswith(p + ".") for p in parents)


def dependencies(*extras):
    """The modules that `pip install .[EXTRAS]` brings, by import name."""
    listed = sum((PROJECT["optional-dependencies"][e] for e in extras), PROJECT["dependencies"])
    names = [re.match(r"[\w-]+", text)[0] for text in listed]
    return {IMPORT_NAMES.get(n, n) for n in names}


def python(*args, cwd=None, **env):
    """The words that a new interpreter prints; it must succeed."""
    done = subprocess.run([sys.executable, *args], cwd=cwd, env={**os.environ, **env}, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout.split()


def test_relative_and_nested_imports_are_seen(tmp_path, monkeypatch):
    monkeypatch.setitem(globals(), "ROOT", tmp_path)
    path = tmp_path / "dressi_edge" / "compiler" / "ops" / "wave.py"
    path.parent.mkdir(parents=True)
    path.write_text("import numpy.linalg as la\nfrom .. import ir\nfrom . import a\ndef f():\n    from ...runtime import vk\n")
    assert sorted(imports(path)) == [(1, "numpy.linalg"), (2, "dressi_edge.compiler.ir"), (3, "dressi_edge.compiler.ops.a"),
                                     (5, "dressi_edge.runtime.vk")]


@pytest.mark.parametrize("part", ["runtime", "cache"])
def test_importing_it_loads_no_compiler_module(part):
    names = [name for name, _ in modules(part)]
    assert len(names) > 1, f"few modules found: {names}"
    code = f"import sys\nfor name in {names}: __import__(name)\nprint(*sys.modules)"
    loaded = python("-c", code, PYTHONPATH=str(ROOT))
    assert [m for m in loaded if within(m, ["dressi_edge.compiler", "PIL", "scipy"])] == []


RUN_BY = {"check_op.py": {"dressi_edge.runtime"},  # tests an op on a device
          "write_usd.py": {"pxr"}}  # of the extra `usd`, asked for when a .usdz is written


@pytest.mark.parametrize("part, ours, extras", [
    ("runtime", ["dressi_edge.runtime", "dressi_edge.cache", "dressi_edge.__version__"], []),
    ("cache", ["dressi_edge.cache", "dressi_edge.__version__"], []),
    ("compiler", ["dressi_edge.compiler", "dressi_edge.cache", "dressi_edge.__version__"], ["compiler"]),
])
def test_it_imports_only_what_its_installation_brings(part, ours, extras):
    allowed = {*sys.stdlib_module_names, *dependencies(*extras), *ours}
    found = [f"{path.relative_to(ROOT)}:{line}: {name}" for _, path in modules(part) for line, name in imports(path)
             if not within(name, allowed | RUN_BY.get(path.name, set()))]
    assert found == [], f"{part} may import {' '.join(sorted(allowed - sys.stdlib_module_names))} and the standard library"


def test_the_runtime_needs_numpy_and_msgpack_alone():
    assert dependencies() == {"numpy", "msgpack"}


def test_the_command_line_is_declared():
    assert PROJECT["scripts"] == {"dressi-edge": "dressi_edge.cli:main"}


def test_no_file_names_a_path_of_a_machine():
    here = [str(p) for p in (ROOT, ROOT.parent / "shared", Path.home()) if len(p.parts) > 2]
    pattern = re.compile("|".join([r"(?<![\w.])/(?:home|root|Users)/\w", r"\b[A-Z]:\\+Users\\",
                                   *(rf"(?<![\w.]){re.escape(p)}(?!\w)" for p in here)]))
    files = [p for p in ROOT.iterdir() if p.is_file()] + [p for top in SHIPPED for p in (ROOT / top).rglob("*") if p.is_file()]
    found = [f"{path.relative_to(ROOT)}: {match[0]}" for path in files if not set(BUILT) & set(path.parts)
             for match in pattern.finditer(path.read_bytes().decode("utf-8", "replace"))]
    assert len(files) > 20 and found == []


def copied(folder):
    """What a wheel is built of, in a folder of its own: setuptools leaves build/ behind."""
    source = folder / "source"
    for top in ("dressi_edge", "device_profiles"):
        shutil.copytree(ROOT / top, source / top, ignore=shutil.ignore_patterns("__pycache__"))
    for name in ("pyproject.toml", "setup.py", "LICENSE"):
        shutil.copy(ROOT / name, source)
    return source


@pytest.mark.full
def test_the_wheel_works_outside_the_checkout(tmp_path):
    """Builds a wheel (build isolation wants the network), and asks what it holds and whether its profiles load."""
    source = copied(tmp_path)
    python("-m", "pip", "wheel", "-q", "--no-deps", "-w", "wheels", "./source", cwd=tmp_path)
    wheel, = (tmp_path / "wheels").iterdir()
    python("-m", "pip", "install", "-q", "--no-deps", "--target", "site", str(wheel), cwd=tmp_path)
    site = tmp_path / "site"

    def listing(top, pattern):
        return sorted(str(p.relative_to(top)) for p in top.rglob(pattern))

    assert listing(site / "dressi_edge", "*.py") == listing(ROOT / "dressi_edge", "*.py")
    for pattern in ("*.html", "*.css", "*.js"):
        assert listing(site / "dressi_edge", pattern) == listing(ROOT / "dressi_edge", pattern) != []
    assert listing(site / "dressi_edge" / "device_profiles", "*") == listing(ROOT / "device_profiles", "*.json")
    shutil.rmtree(source)
    where, name = python("-c", "import dressi_edge\nfrom dressi_edge.cache.profile import Profile\n"
                         "print(dressi_edge.__file__, Profile.load('limit4').name)", cwd=tmp_path, PYTHONPATH=str(site))
    assert Path(where).is_relative_to(site) and name == "limit4"
