"""`compile`: a job file to a bundle."""
from __future__ import annotations

import os
import sys
import time

from ..cache.profile import Profile
from ..cache.summary import image_bytes, summary
from .files import check_folder, print_json
from .progress import Events, Terminal


def compile_job(args) -> None:
    """The command: a bundle of a job."""
    check_folder(args.output)
    profiles = [Profile.load(name) for name in args.profile]
    from ..compiler.backend.needs import shadowed
    from ..compiler.scene.job import load_job
    from ..compiler.scene.targets import Carried
    start = time.perf_counter()
    with Events(Terminal()) as events:
        events.doing(f"reading {args.job}")
        problem = load_job(args.job, profiles, lambda done, of: events.doing("reading pictures", done, of),
                           Carried(args.embed, args.memory))
        events.doing("checking the start")
        description = problem.compile(profiles, args.output, storage=args.storage, compute=args.compute)
    seconds = time.perf_counter() - start
    variants = description.get("variants", [description])
    plans = {d["profile"]["name"]: summary(d) for d in variants}
    if args.json:
        print_json(plans)
        return
    phases = " ".join(f"{name} ({steps} steps)" for name, steps in variants[0]["meta"]["phases"])
    print(f"{args.output}: {os.path.getsize(args.output) / 1e6:.2f} MB, phases {phases}, made in {seconds:.1f} s")
    meta = variants[0]["meta"]
    if (chosen := meta.get("chosen")) is not None:
        print(f"all views at once would not fit into {chosen['room'] / 1e6:.0f} MB: a step draws one, and a round adds up the gradient of "
              f"all (order {chosen['order']}); --memory SIZE says what they may take")
    fed = meta.get("pictures")
    if fed is not None:
        print(told_of_pictures(fed, variants))
    if fed is not None and not fed["blobs"]:
        print(f"its {fed['views']} pictures are not in it: run it with --views DIR, or compile it with --embed")
    for later, earlier in shadowed(variants).items():
        print(f"note: {later} is never chosen for what a device has: {earlier} comes before it and needs no more")
    for d in variants:
        print(f"for profile {d['profile']['name']}, {len(d['pipelines']) + len(d.get('computes', ()))} pipelines:")
        for name, row in plans[d["profile"]["name"]].items():
            print(f"  {name}: " + ", ".join(f"{row[key]} {key}" for key in ("functions", "substages", "stages", "pipelines")))
    sys.stdout.flush()


def told_of_pictures(fed: dict, variants: list[dict]) -> str:
    """How many pictures are on the device at a time, and what all images take of what they should."""
    slots = next(x["count"] for x in variants[0]["values"] if x["name"] == fed["value"])
    size = max(sum(image_bytes(x) * x["slots"] for x in d["images"]) for d in variants)
    at_once = "all" if fed["order"] is None else f"{slots} at a time"
    of = "" if fed["room"] is None else f" of {fed['room'] / 1e6:.0f}"
    return f"{fed['views']} pictures, {at_once} on the device: images of {size / 1e6:.0f} MB{of}"
