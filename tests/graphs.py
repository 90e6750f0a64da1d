"""What tests of graphs share: layouts of nodes and arrays, processes of their own, and random graphs."""

import os
import subprocess
import sys
from pathlib import Path

import numpy as np

from dressi_edge.cache.layout import Layout

ROOT = Path(__file__).resolve().parents[1]


def layout_of(node):
    """The layout in which a user gives or gets a node: a table where the extent has padding, else an image."""
    extent = node.extent
    if extent.count != extent.width * extent.height:
        return Layout("table", node.vtype, count=extent.count)
    return Layout("image", node.vtype, extent.width, extent.height)


def image_layout(array):
    """The image layout of an array (h, w, c), integers as such."""
    h, w, c = array.shape
    integer = array.dtype.kind in "iu"
    name = ("int" if integer else "float") if c == 1 else ("ivec" if integer else "vec") + str(c)
    return Layout("image", name, w, h)


def rounded(array):
    """As the device holds it: floats of fp32, in float64."""
    array = np.asarray(array)
    return array if array.dtype.kind in "iu" else array.astype(np.float32).astype(np.float64)


def python(code, *arguments, **environment):
    """Run code in a process of its own, on this tree."""
    paths = f"{ROOT}:{ROOT / 'tests'}"
    done = subprocess.run([sys.executable, "-c", code, *map(str, arguments)], capture_output=True, text=True, cwd=ROOT,
                          env={**os.environ, "PYTHONPATH": paths, **environment})
    assert done.returncode == 0, done.stderr
    return done.stdout
