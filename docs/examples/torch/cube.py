"""A cube from small pictures: positions of its corners and colours of its sides, from pictures of 24x24 pixels in poses of chance.

    python cube.py [FOLDER]

Sample scripts that import nvdiffrast.torch read like this one; here the import is ours, and a Vulkan device draws.
"""
import sys

import numpy as np
import torch

import dressi_edge.primitives.torch as dr
from dressi_edge.compiler.scene import save_png

CORNERS = torch.tensor([[x, y, z] for x in (-1.0, 1.0) for y in (-1.0, 1.0) for z in (-1.0, 1.0)])
SIDES = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
TRI = torch.tensor([t for a, b, c, d in SIDES for t in ((a, b, c), (a, c, d))], dtype=torch.int32)
COLORS = torch.tensor([[0.9, 0.2, 0.2], [0.2, 0.8, 0.3], [0.2, 0.3, 0.9], [0.9, 0.8, 0.2], [0.2, 0.8, 0.9], [0.8, 0.3, 0.8]])
COLOR_TRI = torch.arange(6, dtype=torch.int32).repeat_interleave(2)[:, None].repeat(1, 3)  # all corners of a side have its colour


def poses(count, rng):
    """(count, 4, 4): clip coordinates of turns of chance, seen from 5 away."""
    near, far, f = 1.0, 10.0, 2.4
    projection = np.array([[f, 0, 0, 0], [0, f, 0, 0], [0, 0, -(far + near) / (far - near), -2 * far * near / (far - near)], [0, 0, -1, 0]])
    out = []
    for _ in range(count):
        turn = np.eye(4)
        turn[:3, :3] = np.linalg.qr(rng.normal(size=(3, 3)))[0]
        turn[:3, :3] *= np.sign(np.linalg.det(turn[:3, :3]))
        turn[2, 3] = -5.0
        out.append(projection @ turn)
    return torch.tensor(np.array(out), dtype=torch.float32)


def draw(context, corners, colors, matrices, size):
    """Pictures (count, size, size, 3) over black."""
    points = torch.nn.functional.pad(corners, (0, 1), value=1.0)
    pos = points @ matrices.transpose(1, 2)
    rast, _ = dr.rasterize(context, pos, TRI, [size, size])
    color, _ = dr.interpolate(colors[None], rast, COLOR_TRI)
    return dr.antialias(color, rast, pos, TRI)


def main(folder=".", size=24, steps=300, batch=6):
    """How far corners (RMS) and colours (RMS) are off, at the start and at the end."""
    rng, context = np.random.default_rng(0), dr.Context()
    corners = (CORNERS + torch.tensor(rng.uniform(-0.4, 0.4, (8, 3)), dtype=torch.float32)).requires_grad_()
    colors = torch.full((6, 3), 0.5, requires_grad=True)
    optimizer = torch.optim.Adam([corners, colors], 0.02)
    schedule = torch.optim.lr_scheduler.ExponentialLR(optimizer, 0.05 ** (1 / steps))
    show = poses(4, np.random.default_rng(1))

    def off():
        pairs = (("corners", corners.detach(), CORNERS), ("colors", colors.detach(), COLORS))
        return {name: float((found - wanted).square().mean().sqrt()) for name, found, wanted in pairs}

    def seen():
        with torch.no_grad():
            return draw(context, corners, colors, show, 96)

    start, pictures = off(), [seen()]
    for _ in range(steps):
        matrices = poses(batch, rng)
        with torch.no_grad():
            target = draw(context, CORNERS, COLORS, matrices, size)
        optimizer.zero_grad()
        (draw(context, corners, colors, matrices, size) - target).square().mean().backward()
        optimizer.step()
        schedule.step()
    with torch.no_grad():
        pictures += [seen(), draw(context, CORNERS, COLORS, show, 96)]
    rows = [np.concatenate(list(p.numpy()[:, ::-1]), 1) for p in pictures]  # row 0 is the lowest one, as in OpenGL
    save_png(f"{folder}/cube.png", np.clip(np.concatenate(rows), 0, 1))
    context.close()
    return {"start": start, "end": off()}


if __name__ == "__main__":
    print(main(*sys.argv[1:2]))
