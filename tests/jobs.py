"""A tiny job with its photographs, for the tests of jobs and of the command line."""

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np

from dressi_edge.compiler.io.cameras import orbit
from dressi_edge.compiler.io.writers import save_png

ROOT = Path(__file__).resolve().parents[1]
SIZE = 24

TINY = """
[mesh]
sphere = {vertices = 42, radius = 0.5}

[views]
transforms = "photos/transforms.json"

[render]
r = 2.0
albedo = "colors"

[[phase]]
name = "shape"
steps = 3
optimize.vertices = {optimizer = "adam", rate = {start = 0.01, end = 0.001}}
[[phase.loss]]
kind = "silhouette"
[[phase.loss]]
kind = "laplacian"
weight = 0.05

[[phase]]
name = "paint"
steps = 2
delta = 0.0
optimize.colors = {optimizer = "sgd", rate = 0.1, momentum = 0.5}
[[phase.loss]]
kind = "color"
norm = "l1"
masked = true
"""


def command(*args, cwd=None, **env):
    """The finished process of `dressi-edge ARGS` in an interpreter of its own."""
    return subprocess.run([sys.executable, "-m", "dressi_edge.cli", *map(str, args)], cwd=cwd, capture_output=True, text=True,
                          env={**os.environ, "PYTHONPATH": str(ROOT), **env}, timeout=300)


def disc(size=SIZE, radius=8.0, channels=4):
    """A red disc (size, size, 4), transparent around it."""
    y, x = np.mgrid[:size, :size] + 0.5 - size / 2
    inside = x * x + y * y < radius * radius
    image = np.zeros((size, size, 4))
    image[inside] = (0.8, 0.2, 0.1, 1.0)
    return image[..., :channels]


def write_job(folder, text=TINY, views=2):
    """The path of job.toml in `folder`, with photos/ beside it."""
    photos = folder / "photos"
    photos.mkdir(exist_ok=True)
    frames = []
    for k, camera in enumerate(orbit(views, (10.0, -10.0), 2.5, 50.0, (SIZE, SIZE))):
        save_png(photos / f"{k}.png", disc())
        frames.append({"file_path": f"{k}.png", "transform_matrix": camera.camera_to_world.tolist()})
    (photos / "transforms.json").write_text(json.dumps({"camera_angle_x": np.radians(50.0), "frames": frames}))
    path = folder / "job.toml"
    path.write_text(text)
    return path
