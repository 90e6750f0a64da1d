"""Metallic-roughness shading under a panorama and a lamp, against float64 and Mitsuba 3: part "pbr" of peers.py.

At pixels of a ball (normal and direction to the eye as ours are), for each roughness, metal and none:

split     ours to the split sum in float64, each of its integrals by samples of its own: what fp32, the filter's maps and its table add
own       the split sum to the integral of the very same reflectance, both in float64: what the approximation itself is off by
sampler   Mitsuba's direct light of that reflectance (its rays, panorama and samplers; the reflectance is ours, written as its plug-in) to
          that integral: that both mean the same
mitsuba   ours to Mitsuba's picture of the same reflectance
principled  ours to Mitsuba's own `principled`: other masking (separable), and where it is no metal other Fresnel terms and diffuse light
lamp      ours to the closed form in float64, and to Mitsuba's, under one point light

Errors are relative to each pixel's own value (mean over channels); the median and the 95th of 100.
"""
from __future__ import annotations

import time
from collections.abc import Callable, Iterator

import numpy as np
from error_vs_time import Run
from peers_algebra import area_normals, rounded

from dressi_edge.compiler.io.cameras import orbit
from dressi_edge.compiler.io.shapes import icosphere
from dressi_edge.compiler.render.brdf import diffuse_loss, specular_integrals
from dressi_edge.compiler.scene import PBR, Environment, HardSoftRas, Light, Scene, octahedral

COLOR = np.array([0.9, 0.6, 0.3])
SUN = np.array([0.5, 0.7, 0.51])
LAMP, POWER = np.array([1.5, 2.0, 2.0]), np.array([12.0, 10.0, 8.0])
ROUGHNESSES = (0.1, 0.2, 0.4, 0.6, 0.8, 1.0)
DIELECTRIC = 0.04


def sky(d: np.ndarray) -> np.ndarray:
    """Radiance (..., 3) from directions of length 1: bright above, dark below, a sun some 10 degrees wide."""
    up = 1 / (1 + np.exp(-6 * d[..., 1:2]))
    sun = np.exp(60 * (d @ (SUN / np.linalg.norm(SUN)) - 1))[..., None]
    return (0.15 + 0.7 * up) * [0.7, 0.85, 1.0] + 8 * sun * [1.0, 0.9, 0.7]


def directions(u: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Of a panorama's columns and rows in [0, 1] (docs/conventions.md): the middle column looks along -z, to the right of it is +x."""
    turn, down = 2 * np.pi * (u - 0.5), np.pi * v
    return np.stack([np.sin(down) * np.sin(turn), np.cos(down), -np.sin(down) * np.cos(turn)], -1)


def dots(a, b):
    return (a * b).sum(-1, keepdims=True)


def unit(a):
    return a / np.maximum(np.linalg.norm(a, axis=-1, keepdims=True), 1e-30)


def brdf(n, v, light, metallic: float, roughness: float):
    """The reflectance (glTF 2.0, appendix B) of unit vectors (..., 3)."""
    h, a2 = unit(light + v), roughness ** 4
    nl, nv, nh, vh = (np.maximum(dots(x, y), 1e-9) for x, y in ((n, light), (n, v), (n, h), (v, h)))
    smith = sum((np.sqrt(1 + a2 * (1 / c ** 2 - 1)) - 1) / 2 for c in (nl, nv))
    f0 = DIELECTRIC + (COLOR - DIELECTRIC) * metallic
    f = f0 + (1 - f0) * (1 - vh) ** 5
    shine = a2 / (np.pi * (nh ** 2 * (a2 - 1) + 1) ** 2) / (1 + smith) / (4 * nl * nv)
    return (1 - f) * COLOR * (1 - metallic) / np.pi + f * shine


def around(axis: np.ndarray, cosine: np.ndarray, turn: np.ndarray) -> np.ndarray:
    """Directions (m, s, 3) at these cosines from axes (m, 3), turned about them."""
    t = unit(np.cross(np.where(np.abs(axis[:, :1]) < 0.7, [1.0, 0, 0], [0, 1.0, 0]), axis))
    b, sine = np.cross(axis, t), np.sqrt(np.maximum(1 - cosine ** 2, 0))
    return (sine * np.cos(turn))[..., None] * t[:, None] + (sine * np.sin(turn))[..., None] * b[:, None] + cosine[..., None] * axis[:, None]


def samples(rng, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Two numbers in [0, 1) each (1, count): Hammersley's points, moved by chance; points by chance alone were off by a percent."""
    k, turned = np.arange(count), np.zeros(count)
    for bit in range(int(count).bit_length()):
        turned += (k >> bit & 1) / 2.0 ** (bit + 1)
    return ((k + rng.random()) / count)[None], ((turned + rng.random()) % 1.0)[None]


def lobe_normals(u: np.ndarray, roughness: float) -> np.ndarray:
    """Cosines of microfacets' normals as D n.h has them."""
    return np.sqrt((1 - u) / (1 + (roughness ** 4 - 1) * u))


def split_sum(n, v, metallic: float, roughness: float, rng, count: int) -> np.ndarray:
    """The split sum (docs/conventions.md, Environment) by its definition."""
    u, w = samples(rng, count)
    mirrored = 2 * dots(n, v) * n - v
    h = around(mirrored, lobe_normals(u, roughness), 2 * np.pi * w)
    light = 2 * (h * mirrored[:, None]).sum(-1, keepdims=True) * h - mirrored[:, None]
    weight = np.maximum((light * mirrored[:, None]).sum(-1, keepdims=True), 0)
    lobe = (sky(light) * weight).sum(1) / weight.sum(1)
    diffuse = sky(around(n, np.sqrt(u), 2 * np.pi * w)).mean(1)
    f0, nv = DIELECTRIC + (COLOR - DIELECTRIC) * metallic, dots(n, v)[:, 0]
    a, b = specular_integrals(nv, np.full(len(nv), roughness), (192, 96))
    loss = diffuse_loss(nv, (192, 96))
    return lobe * (f0 * a[:, None] + b[:, None]) + diffuse * COLOR * (1 - metallic) * (1 - f0) * (1 - loss)[:, None]


def integral(n, v, metallic: float, roughness: float, rng, count: int) -> np.ndarray:
    """Of the reflectance itself: half of the directions by the cosine, half by microfacets' normals, weighed by both densities."""
    u, w = samples(rng, count)
    flat = around(n, np.sqrt(u), 2 * np.pi * w)
    h = around(n, lobe_normals(u, roughness), 2 * np.pi * w)
    mirrored = 2 * (h * v[:, None]).sum(-1, keepdims=True) * h - v[:, None]
    light = np.concatenate([flat, mirrored], 1)
    nn, vv = n[:, None], v[:, None]
    half, nl = unit(light + vv), dots(light, nn)
    nh, vh, a2 = np.maximum(dots(half, nn), 1e-9), np.maximum(dots(half, vv), 1e-9), roughness ** 4
    density = (np.maximum(nl, 0) / np.pi + a2 / (np.pi * (nh ** 2 * (a2 - 1) + 1) ** 2) * nh / (4 * vh)) / 2
    value = brdf(nn, vv, light, metallic, roughness) * np.maximum(nl, 0) * sky(light) / np.maximum(density, 1e-12)
    return np.where(nl > 0, value, 0).mean(1)


def lamp_light(position, n, v, metallic: float, roughness: float) -> np.ndarray:
    to = LAMP - position
    light = unit(to)
    return brdf(n, v, light, metallic, roughness) * np.maximum(dots(n, light), 0) * POWER / dots(to, to)


def ours(run: Run, camera, mesh) -> Callable:
    """(roughness, metallic) -> colours under the sky, under the lamp, positions, normals, directions to the eye and mask of all pixels."""
    y, x = (np.mgrid[:256, :512] + 0.5) / [[[256]], [[512]]]
    found = {}
    for name, how in (("sky", {"environment": Environment(octahedral(sky(directions(x, y)), 128))}),
                      ("lamp", {"lights": [Light("point", tuple(POWER), tuple(LAMP))]})):
        scene = Scene([camera])
        values = [scene.input(key, 0.5) for key in ("roughness", "metallic")]
        scene.add(mesh, material=PBR(tuple(COLOR), *values, **how))
        seen = scene.frame(HardSoftRas(1.0, delta=0.0))
        scene.output("look", color=seen.color, position=seen.position, normal=seen.normal, eye=seen.of(lambda s: s.to_eye), mask=seen.mask)
        found[name] = run.open(scene.program)

    def look(roughness: float, metallic: float) -> dict[str, np.ndarray]:
        out = {}
        for name, session in found.items():
            session.set("roughness", roughness)
            session.set("metallic", metallic)
            out[name] = session.get("look.color")[0].astype(float)
            out |= {key: np.asarray(session.get(f"look.{key}")[0], float) for key in ("position", "normal", "eye", "mask")}
        return out

    return look


def theirs(mitsuba_module, mesh, shape_of: Callable, rays, count: int) -> Callable:
    """(kind, light, roughness, metallic) -> colours (m, 3) of rays by Mitsuba; kind "gltf", the plug-in below, or "principled"."""
    import drjit as dr
    mi = mitsuba_module

    class Gltf(mi.BSDF):
        def __init__(self, props):
            mi.BSDF.__init__(self, props)
            self.roughness, self.metallic = props["roughness"], props["metallic"]
            kinds = mi.BSDFFlags.DiffuseReflection | mi.BSDFFlags.FrontSide, mi.BSDFFlags.GlossyReflection | mi.BSDFFlags.FrontSide
            self.m_components, self.m_flags = list(kinds), kinds[0] | kinds[1]
            self.facets = mi.MicrofacetDistribution(mi.MicrofacetType.GGX, self.roughness ** 2, True)

        def eval_pdf(self, context, si, wo, active=True):
            ci, co = mi.Frame3f.cos_theta(si.wi), mi.Frame3f.cos_theta(wo)
            seen = active & (ci > 0) & (co > 0)
            h = dr.normalize(si.wi + wo)
            vh, a2 = dr.maximum(dr.dot(si.wi, h), 1e-6), self.roughness ** 4
            smith = sum((dr.sqrt(1 + a2 * (dr.rcp(dr.square(dr.maximum(c, 1e-4))) - 1)) - 1) * 0.5 for c in (ci, co))
            both = COLOR * (1 - self.metallic), DIELECTRIC + (COLOR - DIELECTRIC) * self.metallic
            body, f0 = (mi.Color3f(*map(float, x)) for x in both)
            f = f0 + (1 - f0) * (1 - vh) ** 5
            d = self.facets.eval(h)
            value = (1 - f) * body * dr.inv_pi * co + f * d / ((1 + smith) * 4 * ci)
            pdf = 0.5 * co * dr.inv_pi + 0.5 * self.facets.pdf(si.wi, h) / (4 * vh)
            return dr.select(seen, value, 0), dr.select(seen, pdf, 0)

        def eval(self, context, si, wo, active=True):
            return self.eval_pdf(context, si, wo, active)[0]

        def pdf(self, context, si, wo, active=True):
            return self.eval_pdf(context, si, wo, active)[1]

        def sample(self, context, si, choice, place, active=True):
            h = self.facets.sample(si.wi, place)[0]
            flat = mi.warp.square_to_cosine_hemisphere(place)
            found = mi.BSDFSample3f()
            found.wo = dr.select(choice < 0.5, flat, mi.reflect(si.wi, h))
            value, found.pdf = self.eval_pdf(context, si, found.wo, active)
            found.eta, found.sampled_component = 1.0, dr.select(choice < 0.5, mi.UInt32(0), mi.UInt32(1))
            kinds = [mi.UInt32(+kind) for kind in (mi.BSDFFlags.DiffuseReflection, mi.BSDFFlags.GlossyReflection)]
            found.sampled_type = dr.select(choice < 0.5, *kinds)
            return found, dr.select(found.pdf > 0, value / found.pdf, 0)

    mi.register_bsdf("gltf", Gltf)
    rows, columns = 256, 512  # rows at the poles too, columns from -z on: Mitsuba's
    v, u = np.mgrid[:rows, :columns]
    panorama = sky(directions((u + 0.5) / columns + 0.5, v / (rows - 1.0)))
    emitters = {"sky": {"type": "envmap", "bitmap": mi.Bitmap(panorama.astype(np.float32)), "to_world": mi.ScalarTransform4f()},
                "lamp": {"type": "point", "position": list(LAMP), "intensity": {"type": "rgb", "value": list(POWER)}}}
    direct = {"sky": mi.load_dict({"type": "direct", "emitter_samples": 1, "bsdf_samples": 1}),
              "lamp": mi.load_dict({"type": "direct", "emitter_samples": 1, "bsdf_samples": 0})}
    origins, towards = rays

    def look(kind: str, light: str, roughness: float, metallic: float) -> np.ndarray:
        how = {"base_color": {"type": "rgb", "value": list(COLOR)}, "specular": 0.5} if kind == "principled" else {}
        surface = mi.load_dict({"type": kind, "roughness": float(roughness), "metallic": float(metallic), **how})
        scene = mi.load_dict({"type": "scene", "mesh": shape_of(surface), "light": emitters[light]})
        each, turns = (count, 4) if light == "sky" else (1, 1)
        total = np.zeros((len(origins), 3))
        for turn in range(turns):
            ray = mi.RayDifferential3f(mi.Ray3f(mi.Point3f(*np.repeat(origins, each, 0).T.astype(np.float32)),
                                                mi.Vector3f(*np.repeat(towards, each, 0).T.astype(np.float32))))
            sampler = mi.load_dict({"type": "independent"})
            sampler.seed(turn, len(origins) * each)
            value = np.array(direct[light].sample(scene, sampler, ray)[0])
            value = value.T if value.shape[0] == 3 else value
            total += value.reshape(len(origins), each, 3).astype(float).mean(1)
        return total / turns

    return look


def part_pbr(run: Run, mitsuba=None, mitsuba_mesh=None, pixel_rays=None) -> Iterator[dict]:
    """Rows of the table; mitsuba: what gives the module, None where it is not installed."""
    quick, rng = run.options.quick, np.random.default_rng(0)
    size, count, many = (32, 2000, 12) if quick else (96, 24000, 48)
    camera, mesh = orbit(1, (20.0,), 2.2, 45.0, (size, size))[0], icosphere(4, 0.8)
    look = ours(run, camera, mesh)
    first = look(0.5, 0.0)
    n, v = unit(first["normal"]).reshape(-1, 3), unit(first["eye"]).reshape(-1, 3)
    inside = np.flatnonzero((first["mask"].ravel() > 0) & (dots(n, v)[:, 0] > 0.1))
    chosen = np.sort(rng.choice(inside, many, replace=False))
    n, v, position = n[chosen], v[chosen], first["position"].reshape(-1, 3)[chosen]
    peer = None
    if mitsuba is not None:
        origins, towards = (a[chosen] for a in pixel_rays(camera))
        towards = unit(towards)
        normals = area_normals(mesh.positions, mesh.faces)[mesh.faces]
        peer = theirs(mitsuba(), mesh, lambda surface: mitsuba_mesh(mesh.positions[mesh.faces], normals, bsdf=surface), (origins, towards),
                      256 if quick else 4096)

    def row(metallic, roughness, what, found, true, start):
        error = np.abs(found - true).mean(-1) / np.maximum(np.abs(true).mean(-1), 1e-6)
        return {"part": "pbr", "case": f"{'metal' if metallic else 'no metal'} {roughness}, {what}", "peer": what, "count": error.size,
                "metallic": metallic, "roughness": roughness, "median": rounded(float(np.median(error))),
                "worst": rounded(float(np.quantile(error, 0.95))), "ms": rounded((time.perf_counter() - start) * 1e3)}

    for metallic in (0.0, 1.0):
        for roughness in ROUGHNESSES[::3] if quick else ROUGHNESSES:
            start, seen = time.perf_counter(), look(roughness, metallic)
            drawn, lit = (seen[key].reshape(-1, 3)[chosen] for key in ("sky", "lamp"))
            split = split_sum(n, v, metallic, roughness, rng, count)
            true, lamp = integral(n, v, metallic, roughness, rng, count), lamp_light(position, n, v, metallic, roughness)
            bright = lamp.mean(-1) > 1e-3 * lamp.max()
            yield row(metallic, roughness, "split", drawn, split, start)
            yield row(metallic, roughness, "own", split, true, start)
            yield row(metallic, roughness, "lamp, float64", lit[bright], lamp[bright], start)
            if peer:
                same = peer("gltf", "sky", roughness, metallic)
                yield row(metallic, roughness, "sampler", same, true, start)
                yield row(metallic, roughness, "mitsuba", drawn, same, start)
                yield row(metallic, roughness, "principled", drawn, peer("principled", "sky", roughness, metallic), start)
                yield row(metallic, roughness, "lamp, mitsuba", lit[bright], peer("gltf", "lamp", roughness, metallic)[bright], start)


def table(rows: list[dict]) -> str:
    """Markdown: a line a surface, median (95th of 100) in percent."""
    kinds = list(dict.fromkeys(x["peer"] for x in rows))
    lines = [f"| pbr | {' | '.join(kinds)} |", "|---|" + "---:|" * len(kinds)]
    for key in dict.fromkeys((x["metallic"], x["roughness"]) for x in rows):
        found = {x["peer"]: x for x in rows if (x["metallic"], x["roughness"]) == key}
        cells = [f"{100 * found[k]['median']:.2g} ({100 * found[k]['worst']:.2g})" for k in kinds]
        lines.append(f"| {'metal' if key[0] else 'no metal'}, {key[1]} | {' | '.join(cells)} |")
    return "\n".join(lines) + "\n"
