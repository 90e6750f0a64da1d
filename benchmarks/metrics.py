"""How close a reconstruction is: meshes and images in, numbers out. Needs scipy (the extra `bench`).

    python benchmarks/metrics.py OURS TARGET [--fit]      distances of two mesh files; --fit puts OURS into the unit ball

Distances are in the units of the meshes; nothing is moved or scaled here, so both meshes must be in one frame.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.spatial import cKDTree

SURFACE_SAMPLES = 200_000  # on a surface of area 4 in the unit ball: nearest sample 0.002 away
CHAMFER_SAMPLES = 20_000


class Distances(NamedTuple):
    """vertex: mean distance of our vertices to the target surface. chamfer: mean of the two mean distances between surfaces.
    normal: mean angle in degrees between our normal and the target's where they are nearest."""

    vertex: float
    chamfer: float
    normal: float


def sample_surface(positions: np.ndarray, faces: np.ndarray, count: int, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Points (count, 3) spread evenly over the area of a mesh (V, 3), (F, 3), and the unit face normal (count, 3) of each."""
    rng = np.random.default_rng(seed)
    a, b, c = (np.asarray(positions, np.float64)[faces[:, k]] for k in range(3))
    normal = np.cross(b - a, c - a)
    area = np.linalg.norm(normal, axis=1)
    face = rng.choice(len(faces), count, p=area / area.sum())
    u, w = rng.random((2, count))
    root = np.sqrt(u)[:, None]  # even in the triangle (Osada et al. 2002, section 4.2)
    w = w[:, None]
    points = (1.0 - root) * a[face] + root * (1.0 - w) * b[face] + root * w * c[face]
    return points, normal[face] / area[face, None]


class Surface:
    """A target mesh made ready for measuring."""

    def __init__(self, positions: np.ndarray, faces: np.ndarray):
        self.points, self.normals = sample_surface(positions, faces, SURFACE_SAMPLES)
        self.tree = cKDTree(self.points)

    def vertex_distances(self, vertices: np.ndarray) -> np.ndarray:
        """Distance (V,) of each vertex to the target surface, taken as the nearest of `SURFACE_SAMPLES` points."""
        return self.tree.query(vertices)[0]

    def measure(self, vertices: np.ndarray, faces: np.ndarray) -> Distances:
        ours, our_normals = sample_surface(vertices, faces, CHAMFER_SAMPLES, 1)
        dense, dense_normals = sample_surface(vertices, faces, SURFACE_SAMPLES, 2)
        there, nearest = self.tree.query(ours)
        back, nearest_back = cKDTree(dense).query(self.points[:CHAMFER_SAMPLES])
        cosines = np.concatenate([np.einsum("ij,ij->i", our_normals, self.normals[nearest]),
                                  np.einsum("ij,ij->i", self.normals[:CHAMFER_SAMPLES], dense_normals[nearest_back])])
        angle = np.degrees(np.arccos(np.clip(cosines, -1.0, 1.0))).mean()
        chamfer = 0.5 * (there.mean() + back.mean())
        return Distances(float(self.vertex_distances(vertices).mean()), float(chamfer), float(angle))


def silhouette_iou(ours: np.ndarray, target: np.ndarray) -> np.ndarray:
    """Intersection over union (n,) of the masks alpha > 0.5 of two stacks of images (n, h, w)."""
    a, b = np.asarray(ours) > 0.5, np.asarray(target) > 0.5
    union = (a | b).sum(axis=(1, 2))
    return np.where(union > 0, (a & b).sum(axis=(1, 2)) / np.maximum(union, 1), 1.0)


def psnr_in_mask(ours: np.ndarray, target: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """PSNR in dB, twice (n,), of colours (n, h, w, 4) as stored (sRGB, straight) inside the target's mask, alpha > 0.5.

    First over the pixels that our mask has too: how good the colours are. Then over all, our colour being black where we see
    nothing: there a shape one pixel too thin costs more than any error of colour.
    """
    ours, target = np.asarray(ours, np.float64), np.asarray(target, np.float64)
    mask, seen = target[..., 3] > 0.5, ours[..., 3] > 0.5
    error = ((ours[..., :3] * seen[..., None] - target[..., :3]) ** 2).mean(axis=-1)

    def over(pixels: np.ndarray) -> np.ndarray:
        mse = (error * pixels).sum(axis=(1, 2)) / np.maximum(pixels.sum(axis=(1, 2)), 1)
        return -10.0 * np.log10(np.maximum(mse, 1e-12))

    return over(mask & seen), over(mask)


def main() -> None:
    sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
    from dressi_edge.compiler.io.meshes import load_mesh, normalize
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("ours", type=Path)
    parser.add_argument("target", type=Path)
    parser.add_argument("--fit", action="store_true", help="centre and scale OURS into the unit ball, as TARGET always is")
    options = parser.parse_args()
    ours, target = load_mesh(options.ours), normalize(load_mesh(options.target))
    ours = normalize(ours) if options.fit else ours
    d = Surface(target.positions, target.faces).measure(ours.positions, ours.faces)
    print(f"vertex to surface {d.vertex:.5f}  chamfer {d.chamfer:.5f}  normals {d.normal:.1f} degrees apart")


if __name__ == "__main__":
    main()
