"""`demo`: pictures of a pear, drawn by ourselves, become its shape and texture again."""
from __future__ import annotations

import os
import tempfile
import time

import numpy as np

from .. import runtime
from ..cache.errors import InputError
from ..compiler.io.meshes import Mesh
from ..compiler.io.shapes import pear
from ..compiler.scene import demo as problems
from ..compiler.scene import results
from ..runtime.device import Device
from .progress import Events, Terminal
from .solve import Course, run_course

PROFILE = "vulkan_min"  # what every Vulkan device allows


def demo(args) -> int:
    """The command: pictures of a pear become its shape and texture."""
    began, folder = time.perf_counter(), args.output
    try:
        os.makedirs(folder, exist_ok=True)
    except OSError as error:
        raise InputError(f"output {folder}: cannot be made a folder: {error.strerror}; choose another path") from None
    size, shape_steps, texture_steps = (64, 40, 20) if args.quick else (256, 400, 200)
    cameras, target = problems.cameras(size), pear()
    with Device.open(args.device) as device, tempfile.TemporaryDirectory() as scratch, Events(Terminal()) as events:
        def solved(problem, name: str) -> runtime.Session:
            path = os.path.join(scratch, f"{name}.dressi")
            problem.compile(PROFILE, path)
            return runtime.load(path, device)

        def clay(mesh: Mesh, name: str) -> np.ndarray:
            with solved(problems.clay(mesh, cameras), name) as session:
                return session.get("render.color")

        _say(f"{device.name}, {device.driver}")
        with solved(problems.picture(target, cameras), "target") as session:
            images = session.get("render.color")
        _say(f"the target: a pear of {len(target.faces)} faces in {len(cameras)} views of {size} x {size}, drawn by ourselves")
        session = solved(problems.reconstruction(images, cameras, shape_steps, texture_steps), "demo")
        with session:
            first = results.mesh_of(session)
            _say(f"the start: a grey sphere of {len(first.positions)} vertices; phases {' '.join(session.phases)}")
            before, curves, phases = results.snapshot(session), {}, {}
            distance = {"start": _distance(first, target)}
            for name in session.phases:
                course = run_course(session, Course(name, session.plans[name]["steps"]), events)
                if course.stopped:
                    raise KeyboardInterrupt
                phases[name], curves[name] = course.record(), course.curve
            found = results.mesh_of(session)
            distance["end"] = _distance(found, target)
            rows = [("shape", clay(found, "found")), ("true shape", clay(target, "true"))]
            metrics = {"device": device.name, "driver": device.driver, "profile": PROFILE, "phases": phases,
                       "distance_to_surface": distance}
            metrics = results.write(session, os.path.join(folder, "pear.glb"), curves, before, metrics, rows)
    _say("")
    for name, p in phases.items():
        _say(f"{name}: {p['steps']} steps, loss {p['loss_first']:.5f} -> {p['loss_last']:.5f}, "
             f"{p['ms_per_step']:.1f} ms a step")
    views = metrics["views"]
    _say(f"mean distance of our vertices to the true surface: {distance['start']:.4f} -> {distance['end']:.4f}, "
         "where the pear's radius is 1")
    _say(f"silhouettes overlap (IoU): {views['iou_mean']:.4f}; colours inside them: {views['psnr_mean']:.1f} dB")
    _say(f"in {folder}: {' '.join(metrics['files'].values())}; {time.perf_counter() - began:.0f} s in all")
    return 0


def _distance(mesh: Mesh, target: Mesh) -> float:
    return float(problems.surface_distance(mesh.positions, target).mean())


def _say(text: str) -> None:
    print(text, flush=True)
