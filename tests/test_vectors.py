"""The test vectors: replayed they give what they say, and compiling them again gives the same bytes."""

import make_vectors
import numpy as np
import pytest

from dressi_edge import runtime
from dressi_edge.cache import bundle

pytest_plugins = ["gpu"]

NAMES = list(make_vectors.VECTORS)


def test_every_vector_is_there_and_nothing_else():
    assert {p.name for p in make_vectors.FOLDER.iterdir()} == {f"{n}.{end}" for n in NAMES for end in ("dressi", "json")}
    assert all((make_vectors.FOLDER / f"{n}.dressi").stat().st_size < 80_000 for n in NAMES)


@pytest.mark.parametrize("name", NAMES)
def test_a_vector_gives_what_it_says(gpu, name):
    steps, expected, tolerance = make_vectors.load(name)
    with runtime.load(make_vectors.FOLDER / f"{name}.dressi", gpu.device) as session:
        for step, want in zip(steps, expected):
            found = make_vectors.perform(session, step)
            if want is not None:
                assert found.dtype == want.dtype and found.shape == want.shape, step
                assert np.abs(found - want).max() <= tolerance * max(1, np.abs(want).max()), step
    gpu.silent()


@pytest.mark.parametrize("name", NAMES)
def test_compiling_again_gives_the_same_bytes(name):
    """Whatever made the SPIR-V, the description is the same; with the same compiler of shaders every byte is. If this
    fails after a change to the compiler, `python -m tests.make_vectors`."""
    old, new = (make_vectors.FOLDER / f"{name}.dressi").read_bytes(), make_vectors.compiled(name)[0]
    assert new == make_vectors.compiled(name)[0]
    was, now = bundle.loads(old), bundle.loads(new)
    without = [{k: x for k, x in b.description.items() if k != "blobs"} for b in (was, now)]
    assert without[0] == without[1]
    if make_vectors.same_compiler():
        assert new == old
