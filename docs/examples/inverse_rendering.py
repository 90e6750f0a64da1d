"""What a thing is made of, from pictures under a sky: colour, roughness and metal as textures of a known shape under a known panorama; and
then all of it together, shape and sky, too, from a ball under a grey one. Cameras are known.

    python inverse_rendering.py [FOLDER]
"""
import sys

import numpy as np

from dressi_edge import runtime
from dressi_edge.compiler.scene import (
    PBR,
    Adam,
    Channel,
    Environment,
    Mesh,
    Outline,
    Scene,
    Schedule,
    Texture,
    l2,
    octahedral,
    orbit,
    save_png,
    sphere,
    uniform_laplacian,
)

SKY = 32  # texels a side of the environment


def panorama():
    """A blue upper half, a brown lower one, a warm lamp and a cold one."""
    y, x = np.mgrid[:64, :128]
    lamps = [6.0 * np.exp(-((x - u) ** 2 + (y - v) ** 2) / 25.0)[..., None] * color
             for u, v, color in ((30, 22, [1.0, 0.8, 0.5]), (95, 28, [0.5, 0.7, 1.0]))]
    return np.where(y[..., None] < 32, [0.35, 0.5, 0.8], [0.3, 0.22, 0.15]) + sum(lamps)


def lumpy(ball):
    """The ball with four broad dents."""
    d = ball.positions / 0.8
    shape = 1 + 0.12 * np.sin(3 * d[:, 0] + 1) * np.cos(3 * d[:, 1]) + 0.06 * np.sin(4 * d[:, 2])
    return Mesh(ball.positions * shape[:, None], ball.faces, ball.uvs, ball.uv_faces)


def surface(texels):
    """True colours (h, w, 3), and roughness and metal as channels y and z of another (h, w, 3)."""
    w, h = texels
    y, x = np.mgrid[:h, :w] / np.array([h, w])[:, None, None]
    patch = ((np.floor(x * 6) + np.floor(y * 4)) % 2)[..., None]
    color = np.where(patch, [0.85, 0.6, 0.3], [0.25, 0.45, 0.6])
    return color, np.concatenate([0 * patch, 0.25 + 0.45 * y[..., None], patch], 2)


def main(folder=".", size=64, steps=150, rounds=3, texels=(48, 32)):
    """For "known" (shape and sky) and "together": PSNR of the pictures at the start and at the end, mean errors of colour and metal, and of
    roughness where the thing is of metal; of the latter also mean distances of vertices from the true shape along the radius, and PSNR of
    the sky (peak 4)."""
    ball, cameras, sky = sphere(642, 0.8), orbit(8, [25, -25, 5], 2.8, 40, (size, size)), octahedral(panorama(), SKY)
    true, (color, maps), result, rows = lumpy(ball), surface(texels), {}, []
    for case in ("known", "together"):
        s, known = Scene(cameras), case == "known"
        x = s.parameter("vertices", ball.positions)
        base = s.parameter("base", np.full(color.shape, 0.5), 0.02, 1.0, kind="image")
        rest = s.parameter("maps", np.full(maps.shape, 0.5), 0.02, 1.0, kind="image")
        light = s.parameter("sky", np.full(sky.shape, 0.6), low=0.0, kind="image")
        around = Environment(light)
        part = s.add(ball, x, PBR(Texture(base), Channel(Texture(rest), "y"), Channel(Texture(rest), "z"), environment=around))
        s.surroundings = around
        seen = s.frame(Outline(r=2.0))
        photo, mask = s.input("photo", np.zeros((8, size, size, 3))), s.input("mask", np.zeros((8, size, size)))
        count = steps if known else steps * rounds
        falling = {name: Schedule(rate, rate / 10, count, "exponential") for name, rate in (("base", 0.02), ("maps", 0.02), ("sky", 0.03))}
        s.phase("surface", count, {name: Adam(falling[name]) for name in (("base", "maps") if known else ("base", "maps", "sky"))},
                color=l2(seen.color, photo))
        s.phase("shape", count, {"vertices": Adam(Schedule(0.004, 0.001, count, "exponential"))}, color=l2(seen.color, photo),
                mask=l2(seen.alpha, mask), smooth=(0.3, uniform_laplacian(x, part.topology, 2)))
        s.output("look", color=seen.color, alpha=seen.alpha)
        s.compile("vulkan_min", f"{folder}/inverse_rendering.dressi")
        with runtime.load(f"{folder}/inverse_rendering.dressi") as session:
            start = {name: session.get(name) for name in ("vertices", "base", "maps", "sky")}
            for name, value in (("vertices", true.positions), ("base", color), ("maps", maps), ("sky", sky)):
                session.set(name, value)
            wanted = {key: session.get(f"look.{key}") for key in ("color", "alpha")}
            for name in ("base", "maps") if known else start:
                session.set(name, start[name])
            session.set("photo", wanted["color"])
            session.set("mask", wanted["alpha"])
            before = session.get("look.color")
            for _ in range(1 if known else rounds):
                if not known:
                    session.step(steps, "shape")
                session.step(steps, "surface")
            found = {name: session.get(name) for name in start} | {"color": session.get("look.color")}
        inside = wanted["alpha"] > 0.5
        shown = (found["base"] != start["base"]).any(-1)  # texels that some pixel shows
        shiny = shown & (maps[..., 2] > 0.5)
        psnr = [float(-10 * np.log10(((p - wanted["color"])[inside] ** 2).mean())) for p in (before, found["color"])]
        result[case] = {"psnr": psnr, "base": [float(np.abs(at["base"] - color)[shown].mean()) for at in (start, found)],
                        **{name: [float(np.abs(at[..., k] - maps[..., k])[where].mean()) for at in (start["maps"], found["maps"])]
                           for k, name, where in ((1, "roughness", shiny), (2, "metal", shown))}}
        if not known:
            radius = [np.linalg.norm(p, axis=1) for p in (start["vertices"], found["vertices"], true.positions)]
            result[case] |= {"shape": [float(np.abs(r - radius[2]).mean()) for r in radius[:2]],
                             "sky": [float(-10 * np.log10(((e - sky) ** 2).mean() / 16)) for e in (start["sky"], found["sky"])]}
        rows += [np.concatenate(list(p[:4]), 1) for p in (before, found["color"])]
    rows.append(np.concatenate(list(wanted["color"][:4]), 1))
    save_png(f"{folder}/inverse_rendering.png", np.clip(np.concatenate(rows), 0, 1) ** (1 / 2.2))
    return result


if __name__ == "__main__":
    print(main(*sys.argv[1:2]))
