"""Photographs as the public synthetic sets have them: RGBA pictures of a textured pear from all around, with transforms_train.json."""
from __future__ import annotations

import json
import math
import sys
from pathlib import Path

import numpy as np
from PIL import Image

ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT)]

from dressi_edge import runtime  # noqa: E402
from dressi_edge.compiler.io.cameras import Camera, orbit, rotation_vector  # noqa: E402
from dressi_edge.compiler.io.images import to_bytes  # noqa: E402
from dressi_edge.compiler.io.shapes import pear  # noqa: E402
from dressi_edge.compiler.render.raster import renderer_of  # noqa: E402
from dressi_edge.compiler.scene import F, Scene, Softness, Texture, Unlit  # noqa: E402

FOV = 52.0


def cameras(count: int, size: int) -> tuple[Camera, ...]:
    """Around the unit ball, at four heights."""
    return orbit(count, (25.0, -20.0, 50.0, 5.0), 2.5, FOV, (size, size))


def draw(folder: Path, count: int, size: int, profile: str = "lavapipe") -> Path:
    """Writes `count` pictures of size x size, unless they are there; the folder."""
    listing = folder / "transforms_train.json"
    if listing.exists():
        return folder
    (folder / "train").mkdir(parents=True, exist_ok=True)
    mesh, views = pear(), cameras(count, size)
    focal = views[0].fx
    scene = Scene([Camera(np.eye(4), focal, focal, size / 2, size / 2, size, size)])
    turn, shift = (scene.parameter(name, np.zeros((1, 3)), kind="table") for name in ("turn", "shift"))
    scene.pose_cameras(turn, shift)
    scene.add(mesh, None, Unlit(Texture(F.constant(mesh.texture), mesh.wrap)))
    seen = scene.frame(renderer_of(Softness(1.0, delta=0.0)))
    scene.output("look", color=F.compose(seen.color, seen.alpha))
    scene.compile(profile, folder / "draw.dressi")
    frames = []
    with runtime.load(folder / "draw.dressi") as session:
        for k, camera in enumerate(views):
            session.set("turn", rotation_vector(camera.world_to_camera[:3, :3])[None])
            session.set("shift", camera.world_to_camera[None, :3, 3])
            Image.fromarray(to_bytes(session.get("look.color")[0])).save(folder / "train" / f"r_{k}.png")
            frames.append({"file_path": f"./train/r_{k}", "transform_matrix": camera.camera_to_world.tolist()})
    listing.write_text(json.dumps({"camera_angle_x": 2.0 * math.atan(size / 2.0 / focal), "frames": frames}))
    (folder / "draw.dressi").unlink()
    return folder


if __name__ == "__main__":
    draw(Path(sys.argv[1]), int(sys.argv[2]), int(sys.argv[3]))
