"""What the pages say is so: commands and options exist, the newcomer's commands run as they stand, words are told once, public names have
docstrings. The code of guide and README runs in test_guide.py and test_job.py."""

import argparse
import importlib.util
import re
import shlex
from pathlib import Path

import pytest
from jobs import ROOT, command
from test_new import folder_of

from dressi_edge import cli

PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]


def commands():
    """Name -> options of each command of the parser."""
    sub = next(a for a in cli.parser()._actions if isinstance(a, argparse._SubParsersAction))
    return {name: {option for action in found._actions for option in action.option_strings} for name, found in sub.choices.items()}


@pytest.mark.parametrize("page", PAGES, ids=lambda p: p.name)
def test_every_command_that_a_page_names_is_one(page):
    known = commands()
    for name, rest in re.findall(r"`?dressi-edge ([a-z]+)((?:[^\n`|]|\\\n)*)", page.read_text(encoding="utf-8")):
        assert name in known, f"{page.name}: dressi-edge {name}"
        for option in re.findall(r"(?<![\w-])--[a-z][a-z-]*", rest):
            assert option in known[name], f"{page.name}: dressi-edge {name} {option}"


def test_every_option_of_run_is_told():
    text = (ROOT / "docs" / "job.md").read_text() + (ROOT / "README.md").read_text() + (ROOT / "docs" / "embedding.md").read_text()
    known = commands()["run"] - {"--help", "--output"}  # -o
    assert [option for option in sorted(known) if option.startswith("--") and option not in text] == []


def test_a_newcomers_commands_run_as_they_stand(tmp_path):
    folder_of(tmp_path, views=4, size=(64, 48))
    blocks = re.findall(r"```sh\n(.*?)```", (ROOT / "docs" / "photographs.md").read_text(), re.S)
    lines = [line for block in blocks for line in block.splitlines()]
    assert [shlex.split(line)[1] for line in lines] == ["new", "compile", "run", "view"]
    for line in lines:
        program, *args = shlex.split(line)
        done = command(*args, cwd=tmp_path)
        assert program == "dressi-edge" and done.returncode == 0, (line, done.stderr)
        if args[0] == "new":  # a tenth of the steps: that it solves the problem is tests/test_new.py's to show
            job = tmp_path / "object.toml"
            job.write_text(re.sub(r"steps = (\d+)0\n", r"steps = \1\n", job.read_text()))
    for name in ("object.glb", "object_sheet.png", "page/index.html", "object.checkpoint", "object.html"):
        assert (tmp_path / name).stat().st_size > 1000, name


def test_the_index_leads_to_every_page():
    text = (ROOT / "docs" / "README.md").read_text()
    missing = [page.name for page in PAGES[1:] if page.name != "README.md" and f"({page.name})" not in text]
    assert missing == []


def test_words_are_told_once_and_in_order():
    rows = re.findall(r"^\| ([^|]+) \| ([^|]+) \|$", (ROOT / "docs" / "glossary.md").read_text(), re.M)[1:]
    rows = [(word, told) for word, told in rows if not word.startswith("---")]
    words = [word for row, _ in rows for word in row.split(", ")]
    assert len(rows) > 40 and len(set(words)) == len(words) and [w for w, _ in rows] == sorted((w for w, _ in rows), key=str.casefold)


def api():
    spec = importlib.util.spec_from_file_location("make_api", ROOT / "docs" / "make_api.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_every_public_name_has_a_docstring_and_is_in_the_reference(tmp_path):
    module = api()
    page = module.api()
    for path in module.MODULES:
        for name, x in module.public(importlib.import_module(path)).items():
            assert (x.__doc__ or "").strip() and not (x.__doc__ or "").startswith(f"{name}("), f"{path}.{name} has no docstring"
            assert re.search(rf"^### `(?:[\w.]+\.)?{name}[(`]", page, re.M), name
    assert "dressi_edge.runtime.load(path: str" in page and "| `lookup` |" in page and page == module.api()
    assert str(Path.home()) not in page and str(ROOT) not in page


def test_installation_is_told_as_the_project_has_it():
    from test_packaging import PROJECT

    from dressi_edge.compiler.backend.tools import COMMANDS
    text = (ROOT / "docs" / "README.md").read_text()
    for extras in re.findall(r"pip install '\.\[([\w,]+)\]'", text + (ROOT / "README.md").read_text()):
        assert set(extras.split(",")) <= set(PROJECT["optional-dependencies"])
    assert all(COMMANDS[system] in text for system in ("debian", "fedora", "arch", "darwin", "win32"))
