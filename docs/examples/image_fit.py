"""A picture without a mesh: a 64 x 48 image is found from blurred copies of a picture, one for each of two blurs.

    python image_fit.py [FOLDER]
"""
import sys

import numpy as np

from dressi_edge import runtime
from dressi_edge.compiler.scene import Adam, F, Scene, l2, save_png

BLURS = ([1, 4, 6, 4, 1], [1, 2, 1])  # kernels, along rows and columns


def main(folder=".", steps=400):
    """PSNR (dB) of the image that is found."""
    y, x = np.mgrid[:48, :64]
    picture = 0.5 + 0.4 * np.stack([np.sin(x / 5), np.cos(y / 4), np.sin((x + y) / 6)], -1) * (np.hypot(x - 32, y - 24) < 20)[..., None]
    s = Scene()
    guess = s.parameter("image", np.full(picture.shape, 0.5), low=0.0, high=1.0)
    terms = {}
    for k, kernel in enumerate(BLURS):
        kernel = np.array(kernel) / sum(kernel)
        seen = s.input(f"seen{k}", np.zeros(picture.shape))
        terms[f"blur{k}"] = l2(F.convolve(guess, kernel), seen)
        s.output(f"blurred{k}", image=F.convolve(guess, kernel))
    s.phase("fit", steps, {"image": Adam(0.03)}, **terms)
    s.compile("vulkan_min", f"{folder}/image_fit.dressi")
    with runtime.load(f"{folder}/image_fit.dressi") as session:
        session.set("image", picture)
        seen = [session.get(f"blurred{k}.image") for k in range(len(BLURS))]
        session.set("image", np.full(picture.shape, 0.5))
        for k, image in enumerate(seen):
            session.set(f"seen{k}", image)
        session.step(steps)
        found = session.get("image")
    save_png(f"{folder}/image_fit.png", np.concatenate([seen[0], found, picture], 1))
    return {"psnr": -10 * np.log10(np.mean((found - picture) ** 2))}


if __name__ == "__main__":
    print(main(*sys.argv[1:2]))
