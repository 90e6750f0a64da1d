"""What several test modules share."""

import gc
import os
from pathlib import Path

import pytest

pytest.register_assert_rewrite("profile_bundles")  # a plugin that modules import names of, too
SHARED = Path(__file__).resolve().parents[2] / "shared"


def pytest_configure(config):
    """Where Python is told to keep no compiled modules, processes that tests start find them in build/: reading all sources takes each of
    them half a second."""
    if os.environ.pop("PYTHONDONTWRITEBYTECODE", None):
        os.environ.setdefault("PYTHONPYCACHEPREFIX", str(Path(__file__).resolve().parents[1] / "build" / "modules"))


def pytest_addoption(parser):
    parser.addoption("--update-golden", action="store_true", help="write tests/goldens anew instead of comparing with it")


@pytest.fixture(scope="session")
def shared_dir():
    """The folder shared/ beside the checkout: data sets and meshes too large for it."""
    if not SHARED.is_dir():
        pytest.skip("no folder shared/ beside the checkout: its data sets and meshes are not in the repository")
    return SHARED


@pytest.fixture
def own_ops():
    """What a test adds to the op table is gone after it."""
    from dressi_edge.compiler.graph.optable import OPS
    before = set(OPS)
    yield
    for name in set(OPS) - before:
        del OPS[name]


@pytest.fixture(autouse=True)
def patience(request, monkeypatch):
    """On a slow machine commands say every two seconds what they are at; what else they say is compared without that."""
    if "test_run" not in request.module.__name__:
        monkeypatch.setattr("dressi_edge.commands.progress.SILENCE", 600.0)


def pytest_collection_finish():
    """What is imported by now stays: the garbage collector need not look through it again at every test."""
    gc.collect()
    gc.freeze()
