"""A session of the little program of `test_session`: a pytest plugin, `pytest_plugins = ["gpu", "sessions"]`."""

import pytest

from dressi_edge import runtime


@pytest.fixture(scope="module")
def bundle(gpu):
    from test_session import walk  # here, so that pytest has rewritten its assertions

    return gpu.compile(walk())


@pytest.fixture
def session(gpu, bundle):
    with runtime.load(bundle, gpu.device) as s:
        yield s
    gpu.silent()
