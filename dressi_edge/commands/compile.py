"""`compile`: a job file to a bundle."""
from __future__ import annotations

import os
import sys
import time

from ..cache.profile import Profile
from ..cache.summary import summary
from .files import check_folder, print_json


def compile_job(args) -> None:
    check_folder(args.output)
    profile = Profile.load(args.profile)
    from ..compiler.job import load_job
    start = time.perf_counter()
    description = load_job(args.job).compile(profile, args.output)
    seconds = time.perf_counter() - start
    plans = summary(description)
    if args.json:
        print_json({profile.name: plans})
        return
    phases = " ".join(f"{name} ({steps} steps)" for name, steps in description["meta"]["phases"])
    print(f"{args.output}: {os.path.getsize(args.output) / 1e6:.2f} MB for profile {profile.name}, phases {phases}, "
          f"{len(description['pipelines'])} pipelines, made in {seconds:.1f} s")
    for name, row in plans.items():
        print(f"  {name}: " + ", ".join(f"{row[key]} {key}" for key in ("functions", "substages", "stages", "pipelines")))
    sys.stdout.flush()
