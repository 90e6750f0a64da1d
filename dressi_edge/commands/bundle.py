"""`inspect`, `verify` and `devices`: what is in a bundle, whether it is sound, and what could run it."""
from __future__ import annotations

import sys

from .files import print_json


def inspect(args) -> None:
    from ..cache import bundle
    from ..cache.summary import dot, summary, text
    description = bundle.read(args.bundle).description
    if args.json:
        print_json({description["profile"]["name"]: summary(description)})
    else:
        sys.stdout.write(dot(description) if args.dot else text(description))


def verify(args) -> None:
    from ..cache import bundle
    found = bundle.read(args.bundle, pin=args.pin)
    d = found.description
    if args.profile is not None:
        from ..cache.errors import BundleError
        from ..cache.profile import Profile
        from ..cache.verify import violations
        profile = Profile.load(args.profile)
        if lines := violations(d, profile, found.interfaces):
            raise BundleError(f"{args.bundle} does not fit profile {profile.name} in {len(lines)} places; "
                              f"the first: {lines[0]}")
    print(f"OK {args.bundle}: profile {d['profile']['name']}, {len(d['plans'])} plans, {len(d['blobs'])} blobs, "
          f"sha256 {found.digest}")


def devices(args) -> None:
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
