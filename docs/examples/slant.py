"""A floor that goes to the horizon: its texture drawn bilinearly, between mip levels, and by 4 samples along what a pixel covers of it; and
the texture found from photographs of it, each way.

    python slant.py [FOLDER]
"""
import sys

import numpy as np

from dressi_edge import runtime
from dressi_edge.compiler.scene import Adam, HardSoftRas, Mesh, Scene, Texture, Unlit, l2, look_at, save_png

WAYS = {"bilinear": {}, "mips": {"mips": True}, "anisotropy": {"mips": True, "anisotropy": 4}}
BY = 8  # x 8 samples a pixel are the truth
SHARP = HardSoftRas(r=1.0, delta=0.0)


def floor():
    """A rectangle from before the eye to far away."""
    faces = np.array([[0, 2, 1], [0, 3, 2]])
    return Mesh([[-3.0, 0, -6], [3, 0, -6], [3, 0, 1.5], [-3, 0, 1.5]], faces, [[0.0, 0], [1, 0], [1, 1], [0, 1]], faces)


def carpet(size):
    """(size, size, 3): patches, lines and smooth shades."""
    y, x = np.mgrid[:size, :size] / size
    patches = np.kron(np.random.default_rng(1).random((size // 8, size // 8, 3)), np.ones((8, 8, 1)))
    lines = ((x * size / 8 % 1 < 0.12) | (y * size / 8 % 1 < 0.12))[..., None]
    return np.clip(0.15 + 0.7 * np.where(lines, 0.1, 0.5 * patches + 0.25 * (1 + np.sin(x * 20) * np.sin(y * 14))[..., None]), 0, 1)


def camera(size, angle, height):
    """One that goes around the floor and looks at its middle."""
    eye = [2.6 * np.sin(angle), height, -2.2 + 4.6 * np.cos(angle)]
    return look_at(eye, [0, 0, -2.2], [0, 1, 0], 50, size, size)


def draw(folder, cameras, texture, how):
    """Pictures (views, h, w, 3), and where the floor is."""
    scene = Scene(cameras, background=(0.6, 0.75, 0.9))
    scene.add(floor(), material=Unlit(Texture(texture, **how)))
    seen = scene.frame(SHARP)
    scene.output("look", color=seen.color, mask=seen.mask)
    scene.compile("vulkan_min", f"{folder}/slant.dressi")
    with runtime.load(f"{folder}/slant.dressi") as session:
        return session.get("look.color").astype(float), session.get("look.mask")


def truth(folder, size, places, texture):
    """Means of all samples of a pixel, and where all of them hit the floor."""
    means, hits = [], []
    for place in places:
        big, hit = draw(folder, [camera(size * BY, *place)], texture, {})
        means.append(big.reshape(size, BY, size, BY, 3).mean((1, 3)))
        hits.append(hit.reshape(size, BY, size, BY).min((1, 3)) > 0)
    return np.stack(means), np.stack(hits)


def fit(folder, cameras, photos, inside, texels, steps, how):
    """The texture, found from photographs."""
    scene = Scene(cameras)
    texture = scene.parameter("texture", np.full((texels, texels, 3), 0.5), low=0.0, high=1.0, kind="image")
    scene.add(floor(), material=Unlit(Texture(texture, **how)))
    seen = scene.frame(SHARP)
    photo, mask = scene.input("photo", photos), scene.input("inside", inside.astype(np.float32))
    scene.phase("fit", steps, {"texture": Adam(0.03)}, color=l2(seen.color, photo, mask=mask))
    scene.compile("vulkan_min", f"{folder}/slant.dressi")
    with runtime.load(f"{folder}/slant.dressi") as session:
        session.step(steps)
        return session.get("texture")


def main(folder=".", size=160, texels=256, steps=150):
    """By way of sampling: root mean square difference of a view from the truth; PSNR of a view that was not among the photographs, drawn
    with the texture found."""
    pattern, unseen, places = carpet(texels), (0.5, 1.1), [(k * np.pi / 3, 0.9) for k in range(6)]
    wanted, where = truth(folder, size, [unseen], pattern)
    photos, inside = truth(folder, size, places, pattern)
    rows, numbers = ([], []), {}
    for name, how in WAYS.items():
        seen = draw(folder, [camera(size, *unseen)], pattern, how)[0]
        texture = fit(folder, [camera(size, *place) for place in places], photos, inside, texels, steps, how)
        again = draw(folder, [camera(size, *unseen)], texture, how)[0]
        rms, error = (np.sqrt(((x - wanted)[where] ** 2).mean()) for x in (seen, again))
        numbers[name] = {"rms": float(rms), "psnr": float(-20 * np.log10(error))}
        rows[0].append(seen[0])
        rows[1].append(again[0])
    sheet = np.concatenate([np.concatenate([*row, wanted[0]], 1) for row in rows], 0)
    save_png(f"{folder}/slant.png", np.clip(sheet, 0, 1).repeat(2, 0).repeat(2, 1))
    return numbers


if __name__ == "__main__":
    print(main(*sys.argv[1:2]))
