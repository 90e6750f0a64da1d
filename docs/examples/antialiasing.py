"""How soft edges look, and how near they are to the picture itself: a ball before a ball and a ring over itself, drawn by several settings
(the paper's Figure 7 in small), beside the mean of 256 samples a pixel.

    python antialiasing.py [FOLDER]
"""
import sys

import numpy as np

from dressi_edge import runtime
from dressi_edge.compiler.graph.functions import constant_table
from dressi_edge.compiler.render.raster.hard import Hard
from dressi_edge.compiler.scene import HardSoftRas, Mesh, Outline, Scene, Unlit, Vertex, icosphere, look_at, save_png

RENDERERS = {
    "sharp": Hard(),
    "outline": Outline(r=1.0, sigma=0.25),  # at outlines alone
    "contours": Outline(r=1.0, sigma=0.25, contours=True),
    "paper_a": HardSoftRas(r=1.0, sigma=0.25, delta=1.0),  # (a): an edge mask of a pixel, K = 1
    "depth": HardSoftRas(r=1.0, layers=3, sigma=0.25, delta=1.0, edges="depth"),
    "paper_b": HardSoftRas(r=3.0, layers=3),  # (b): moderate
    "paper_c": HardSoftRas(r=9.0, layers=5, sigma=2.5, edges="all"),  # (c): blended everywhere, as SoftRas
}


def ring(turns=48, sides=16):
    """A torus."""
    a, b = np.meshgrid(np.arange(turns) / turns * 2 * np.pi, np.arange(sides) / sides * 2 * np.pi, indexing="ij")
    around = 1.0 + 0.32 * np.cos(b)
    points = np.stack([around * np.cos(a), 0.32 * np.sin(b), around * np.sin(a)], -1).reshape(-1, 3)
    k, j = np.meshgrid(np.arange(turns), np.arange(sides), indexing="ij")
    corner = [((k + x) % turns * sides + (j + y) % sides).ravel() for x, y in ((0, 0), (1, 0), (1, 1), (0, 1))]
    return Mesh(points, np.concatenate([np.stack([corner[0], corner[2], corner[1]], 1), np.stack([corner[0], corner[3], corner[2]], 1)]))


def things():
    """(mesh, material): painted by smooth functions of place."""
    front, back, torus = icosphere(3, 0.45), icosphere(4, 1.0), ring()
    for mesh, at, turn in ((front, (-0.75, 0.35, 1.3), 0.0), (back, (-1.0, 0.0, 0.0), 0.0), (torus, (1.15, -0.1, 0.2), 0.5)):
        c, s = np.cos(turn), np.sin(turn)
        moved = mesh.positions * (0.75 if mesh is torus else 1.0) @ np.array([[1, 0, 0], [0, c, s], [0, -s, c]]) + at
        colors = 0.5 + 0.45 * np.sin(2.5 * moved + (0.0 if mesh is back else 2.0) + [0, 1, 2])
        yield Mesh(moved, mesh.faces), Unlit(Vertex(constant_table(colors)))


def picture(folder, size, renderer):
    """The scene, drawn once."""
    s = Scene([look_at((0.2, 0.9, 4.6), (0, 0, 0), (0, 1, 0), 45, *size)], (0.1, 0.1, 0.15))
    for mesh, material in things():
        s.add(mesh, material=material)
    s.output("look", color=s.frame(renderer).color)
    s.compile("vulkan_min", f"{folder}/antialiasing.dressi")
    with runtime.load(f"{folder}/antialiasing.dressi") as session:
        return session.get("look.color")[0]


def main(folder=".", size=(160, 120), samples=16):
    """PSNR of each picture against the mean of samples x samples a pixel, over the pixels near edges: those whose samples differ."""
    (w, h), n = size, samples
    fine = picture(folder, (w * n, h * n), Hard()).reshape(h, n, w, n, 3)
    truth = fine.mean((1, 3))
    edges = fine.std((1, 3)).max(-1) > 0.04
    drawn = {name: picture(folder, size, renderer) for name, renderer in RENDERERS.items()}
    rows = [[truth, drawn["sharp"], drawn["outline"], drawn["contours"]],
            [drawn["paper_a"], drawn["depth"], drawn["paper_b"], drawn["paper_c"]]]
    sheet = np.concatenate([np.concatenate(row, 1) for row in rows], 0)
    save_png(f"{folder}/antialiasing.png", np.clip(sheet, 0, 1).repeat(2, 0).repeat(2, 1))
    return {name: float(-10 * np.log10(np.mean((x - truth)[edges] ** 2))) for name, x in drawn.items()}


if __name__ == "__main__":
    print(main(*sys.argv[1:2]))
