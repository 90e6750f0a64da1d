"""The guide's code runs as it stands, block after block, in one session."""
import re
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]


def blocks(page):
    return re.findall(r"```python\n(.*?)```", (ROOT / "docs" / page).read_text(), re.S)


def test_every_block_of_the_guide_runs(tmp_path, monkeypatch, capsys, own_ops):
    monkeypatch.chdir(tmp_path)
    names = {}
    found = blocks("guide.md")
    assert len(found) >= 5
    for block in found:
        exec(compile(block, "guide.md", "exec"), names)
    assert "(2, 48, 64, 3)" in capsys.readouterr().out


def test_the_scene_of_the_readme_is_right(tmp_path, monkeypatch):
    """Its second program; tests/test_job.py has the first."""
    monkeypatch.chdir(tmp_path)
    program = re.findall(r"```python\n(.*?)```", (ROOT / "README.md").read_text(), re.S)[1]
    exec(program.replace("128", "32").replace("icosphere(3)", "icosphere(1)"), {})
    assert (tmp_path / "ball.dressi").stat().st_size > 1000


def test_links_between_pages_lead_somewhere():
    broken = []
    for page in [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]:
        for target in re.findall(r"\]\(([^)#:]+)(?:#[^)]*)?\)", page.read_text()):
            if not (page.parent / target).exists():
                broken.append(f"{page.name}: {target}")
    assert broken == []
