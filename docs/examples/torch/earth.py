"""The texture of a globe from pictures of it in poses of chance, through mip maps.

    python earth.py [FOLDER]

The texture is made up: continents are where some waves are above the sea.
"""
import sys

import numpy as np
import torch
from cube import poses

import dressi_edge.primitives.torch as dr
from dressi_edge.compiler.scene import save_png


def globe(rows=24, columns=48):
    """Positions (V, 3), texture coordinates (V, 2) and triangles; the seam has its vertices twice."""
    v, u = np.mgrid[:rows + 1, :columns + 1] / [[[rows]], [[columns]]]
    around, down = 2 * np.pi * u, np.pi * v
    x = np.stack([np.sin(down) * np.sin(around), np.cos(down), np.sin(down) * np.cos(around)], -1).reshape(-1, 3)
    first = (np.arange(rows)[:, None] * (columns + 1) + np.arange(columns)).ravel()
    a, b, c, d = first, first + 1, first + columns + 1, first + columns + 2
    tri = np.concatenate([np.stack([a, c, b], 1), np.stack([b, c, d], 1)])
    return (torch.tensor(x * 1.5, dtype=torch.float32), torch.tensor(np.stack([u, v], -1).reshape(1, -1, 2), dtype=torch.float32),
            torch.tensor(tri, dtype=torch.int32))


def earth(height, rng):
    """(height, 2 height, 3): seas, lands, snow."""
    v, u = (np.mgrid[:height, :2 * height] + 0.5) / height * np.pi
    level = sum(rng.normal() / k * np.sin(k * u + rng.uniform(0, 6)) * np.sin(k * v * rng.uniform(0.7, 1.3) + rng.uniform(0, 6))
                for k in range(2, 12))
    land = (level > 0.15)[..., None]
    cold = np.clip((np.abs(v - np.pi / 2) / 1.57 - 0.75) * 6, 0, 1)[..., None]
    ground = np.where(land, [0.25, 0.5, 0.2] + 0.25 * np.clip(level, 0, 1)[..., None], [0.1, 0.2, 0.5])
    return torch.tensor(ground * (1 - cold) + cold * [0.9, 0.92, 0.95], dtype=torch.float32)


def draw(context, mesh, texture, matrices, size):
    """Pictures (count, size, size, 3) over black."""
    x, uv, tri = mesh
    pos = torch.nn.functional.pad(x, (0, 1), value=1.0) @ matrices.transpose(1, 2)
    rast, db = dr.rasterize(context, pos, tri, [size, size])
    at, change = dr.interpolate(uv, rast, tri, rast_db=db, diff_attrs="all")
    color = dr.texture(texture[None], at, change, filter_mode="linear-mipmap-linear")
    return color * rast[..., 3:].clamp(0, 1)


def main(folder=".", size=128, height=64, steps=120, batch=2):
    """PSNR of pictures in poses that were not trained on, at the start and at the end."""
    rng, context, mesh = np.random.default_rng(0), dr.Context(), globe()
    truth = earth(height, rng)
    texture = torch.full(truth.shape, 0.5, requires_grad=True)
    optimizer = torch.optim.Adam([texture], 0.05)
    schedule = torch.optim.lr_scheduler.ExponentialLR(optimizer, 0.1 ** (1 / steps))
    show = poses(4, np.random.default_rng(1))

    def seen(texture):
        with torch.no_grad():
            return draw(context, mesh, texture, show, size)

    wanted, pictures = seen(truth), [seen(texture)]
    for _ in range(steps):
        matrices = poses(batch, rng)
        with torch.no_grad():
            target = draw(context, mesh, truth, matrices, size)
        optimizer.zero_grad()
        (draw(context, mesh, texture, matrices, size) - target).square().mean().backward()
        optimizer.step()
        schedule.step()
    pictures += [seen(texture), wanted]
    save_png(f"{folder}/earth.png", np.clip(np.concatenate([np.concatenate(list(p.numpy()[:, ::-1]), 1) for p in pictures]), 0, 1))
    context.close()
    start, end = (float(-10 * torch.log10((p - wanted).square().mean())) for p in pictures[:2])
    return {"start": start, "end": end}


if __name__ == "__main__":
    print(main(*sys.argv[1:2]))
