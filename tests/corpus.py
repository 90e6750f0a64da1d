"""Small seeded scenes for the rasterizer tests, as clip coordinates of a perspective camera (docs/conventions.md)."""

from typing import NamedTuple

import numpy as np

FAR = 20.0


class Scene(NamedTuple):
    clip: np.ndarray  # (V, 4)
    faces: np.ndarray  # (F, 3)
    size: tuple[int, int]  # (width, height)
    attributes: np.ndarray  # (V, 3), 0..1
    near: float = 0.1


def project(positions, size, near=0.1, focal=1.2, camera_to_world=None):
    """World positions (V, 3) to clip (V, 4), seen from the origin along -z unless placed; focal is in units of the width."""
    width, height = size
    to_camera = np.linalg.inv(np.eye(4) if camera_to_world is None else camera_to_world)
    x, y, z = (np.asarray(positions, np.float64) @ to_camera[:3, :3].T + to_camera[:3, 3]).T
    w, f, cx, cy = -z, focal * width, width / 2 + 0.37, height / 2 - 0.21
    x, y = 2 * (cx * w + f * x) / width - w, 2 * (cy * w - f * y) / height - w
    return np.stack([x, y, FAR * (w - near) / (FAR - near), w], axis=-1)


def icosahedron():
    g = (1 + 5**0.5) / 2
    corners = [(-1, g, 0), (1, g, 0), (-1, -g, 0), (1, -g, 0), (0, -1, g), (0, 1, g)]
    corners += [(0, -1, -g), (0, 1, -g), (g, 0, -1), (g, 0, 1), (-g, 0, -1), (-g, 0, 1)]
    faces = [(0, 11, 5), (0, 5, 1), (0, 1, 7), (0, 7, 10), (0, 10, 11), (1, 5, 9), (5, 11, 4), (11, 10, 2), (10, 7, 6)]
    faces += [(7, 1, 8), (3, 9, 4), (3, 4, 2), (3, 2, 6), (3, 6, 8), (3, 8, 9), (4, 9, 5), (2, 4, 11), (6, 2, 10)]
    faces += [(8, 6, 7), (9, 8, 1)]
    return np.array(corners) / np.hypot(1, g), np.array(faces)


def rotation(seed):
    q, _ = np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))
    return q * np.sign(np.linalg.det(q))


def scenes() -> dict[str, Scene]:
    out = {}

    def add(name, positions, faces, size=(24, 24), near=0.1):
        rng = np.random.default_rng(len(out))
        out[name] = Scene(project(positions, size, near), np.array(faces), size, rng.uniform(size=(len(positions), 3)), near)

    one = [(0, 1, 2)]
    acute = [(-0.71, -0.62, -3.1), (0.83, -0.54, -2.7), (0.04, 0.77, -3.4)]
    add("acute", acute, one)
    add("obtuse", [(-1.02, -0.21, -3.0), (0.97, -0.13, -3.2), (-0.11, 0.17, -2.9)], one)
    sliver = [(-0.9, -0.613, -3.0), (0.87, 0.544, -3.3), (0.02, -0.008, -3.144)]  # 20 px long, 0.02 px wide
    add("sliver", sliver, one)  # covers no pixel centre
    behind = [(-0.8, -0.9, -3.6), (0.9, -0.6, -3.9), (0.1, 0.9, -3.7)]
    add("sliver_in_front", [*sliver, *behind], [(0, 1, 2), (3, 4, 5)])
    add("overlapping", [*acute, (-0.5, -0.8, -4.3), (1.4, -0.1, -4.1), (-0.3, 1.2, -4.6)], [(0, 1, 2), (3, 4, 5)])
    add(
        "intersecting",
        [(-0.9, -0.6, -3.4), (0.8, -0.5, -2.5), (0.0, 0.8, -3.0), (-0.8, 0.5, -2.5), (0.9, 0.6, -3.5), (0.1, -0.9, -3.0)],
        [(0, 1, 2), (3, 4, 5)],
    )
    add("quad", [(-0.7, -0.6, -3), (0.6, -0.7, -3.2), (0.8, 0.5, -3.1), (-0.6, 0.7, -2.8)], [(0, 1, 2), (0, 2, 3)])
    tetrahedron = np.array([(1, 1, 1), (1, -1, -1), (-1, 1, -1), (-1, -1, 1)]) * 0.6
    add("tetrahedron", tetrahedron @ rotation(1).T + (0.03, -0.05, -3.4), [(0, 1, 2), (0, 3, 1), (0, 2, 3), (1, 3, 2)])
    ball, ball_faces = icosahedron()
    add("icosphere", 0.9 * ball @ rotation(2).T + (0.02, 0.04, -3.5), ball_faces)
    add("one_behind", [(-0.9, -0.7, -3.0), (0.8, -0.6, -2.4), (0.3, 0.9, 0.5)], one)
    add("two_behind", [(0.05, 0.4, -4.0), (-0.8, -0.9, 0.6), (0.9, -0.7, 0.4)], one)
    add("near_cut", [(-0.5, -0.3, -2.2), (0.6, -0.2, -1.9), (0.05, 0.3, -0.4)], one, near=1.0)  # the cut is in the picture
    add("behind", [(-0.7, -0.6, 3.1), (0.8, -0.5, 2.7), (0.0, 0.8, 3.4)], one)
    add("off_screen", [(4.0, 3.0, -3.0), (5.1, 3.2, -3.2), (4.4, 4.1, -2.9)], one)
    add("larger_than_screen", [(-9.0, -7.0, -3.0), (11.0, -6.0, -3.5), (0.4, 12.0, -4.0)], one)
    add("smaller_than_pixel", [(0.101, 0.083, -3.0), (0.121, 0.081, -3.1), (0.113, 0.104, -3.0)], one)
    add("coincident", [*acute, *acute], [(0, 1, 2), (3, 4, 5)])
    add("odd_size", 0.7 * ball @ rotation(3).T + (0.1, -0.1, -3.1), ball_faces, size=(17, 23))
    rng = np.random.default_rng(7)
    centre = rng.uniform((-1, -1, -5), (1, 1, -2.5), size=(30, 1, 3))
    add("random", (centre + rng.normal(scale=0.4, size=(30, 3, 3))).reshape(-1, 3), np.arange(90).reshape(30, 3))
    return out
