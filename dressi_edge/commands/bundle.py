"""`inspect`, `verify` and `devices`: what is in a bundle, whether it is sound, and what could run it."""
from __future__ import annotations

import sys

from .files import print_json


def inspect(args) -> None:
    """The command: what a bundle is made of."""
    from ..cache import bundle
    from ..cache.summary import dot, summary, text
    variants = bundle.read(args.bundle, args.pin).variants
    if args.statistics is not None:
        _statistics(args, variants)
    elif args.json:
        print_json({b.profile: summary(b.description) for b in variants})
    else:
        show = dot if args.dot else text
        sys.stdout.write("\n".join(show(b.description) for b in variants))


def _statistics(args, variants) -> None:
    """Of every variant, whether it fits the device or not."""
    from ..cache.errors import DeviceError, InputError
    from ..runtime.device import Device
    from .statistics import NAMES, compiled, image_memory
    if args.dot:
        raise InputError("--statistics is no graph; leave out --dot")
    with Device.open(args.statistics, statistics=True) as device:
        if not device.statistics:
            raise DeviceError(f"{device.name} ({device.driver}) does not tell what it compiles: it has no "
                              "VK_KHR_pipeline_executable_properties")
        told = {b.profile: compiled(device, b) for b in variants}
        memory = {b.profile: image_memory(device, b) for b in variants}
        if args.json:
            print_json({profile: {"pipelines": [one.record() for one in made], "image_bytes": memory[profile][0],
                                  "image_bytes_taken": memory[profile][1]} for profile, made in told.items()})
            return
        for profile, made in told.items():
            rows = [("", *NAMES, "ms"), *((str(one.place or "-"), *("-" if (x := one.told(name)) is None else f"{x:g}" for name in NAMES),
                                           f"{one.ms:.0f}") for one in made)]
            widths = [max(len(row[k]) for row in rows) for k in range(len(rows[0]))]
            raw, taken = memory[profile]
            print(f"profile {profile} on {device.name}, {device.driver}: images of {raw / 1e6:.2f} MB take {taken / 1e6:.2f} MB")
            for first, *rest in rows:
                print(first.ljust(widths[0]), *(x.rjust(width) for x, width in zip(rest, widths[1:])))


def verify(args) -> None:
    """The command: whether a bundle is sound, and fits a profile."""
    from ..cache import bundle
    found = bundle.read(args.bundle, args.pin)
    d, fits = found.description, ""
    if args.profile is not None:
        from ..cache.errors import BundleError
        from ..cache.profile import Profile
        from ..cache.verify import violations
        profile = Profile.load(args.profile)
        lines = {b.profile: violations(b.description, profile, b.interfaces) for b in found.variants}
        if all(lines.values()):
            raise BundleError(f"{args.bundle} does not fit profile {profile.name}: " + "; ".join(
                f"{name} in {len(x)} places, the first: {x[0]}" for name, x in lines.items()))
        fits = f" ({next(name for name, x in lines.items() if not x)} fits {profile.name})"
    print(f"OK {args.bundle}: profile {' '.join(b.profile for b in found.variants)}{fits}, {len(d['plans'])} plans, "
          f"{len(d['blobs'])} blobs, sha256 {found.digest}")


def devices(args) -> None:
    """The command: the Vulkan devices there are."""
    from ..runtime.device import Device
    rows = Device.list()
    if args.json:
        print_json([dict(zip(("index", "name", "kind", "driver"), row)) for row in rows])
        return
    for index, name, kind, driver in rows:
        print(f"{index}: {name} ({kind}), {driver}")
    if not rows:
        from ..cache.errors import DeviceError
        raise DeviceError("no Vulkan device found: install a driver, on Debian mesa-vulkan-drivers")
