"""Runs bundles on the driver at hand; started by `session.py` in a process of its own, with the driver's libraries.

    python replay.py ROOT [--shaders] [--unchecked] FOLDER..    every NAME.dressi with NAME.json of these folders

ROOT: the checkout. --shaders: nothing is stepped; the pipelines of `fit` alone are made, once, and what their compiler tells is asked:
for drivers on an emulated processor, where a step takes minutes. --unchecked: without the validation layer. Imports the runtime, the
standard library and numpy alone, so that any Python will do. Out: on standard output a line of JSON for the device and one for each
bundle, as soon as it is done:

    {"device": .., "driver": .., "subpixel": .., "profile": ..}
    {"name": .., "error": null or text, "messages": of the validation layer, "deviation": the largest, in tolerances,
     "where": of which result, "bytes": [of the texels, that the device takes for them],
     "statistics": [[place, pixels, {registers: .., spills: ..}, ms], ..]}
"""

import json
import sys
import time
from pathlib import Path


def array(np, record):
    return np.array(record["values"], record["type"]).reshape(record["shape"])


def deviation(np, found, wanted, tolerance):
    """By how many tolerances they differ; 0 where they are equal, infinite where there is something other than a number."""
    if found.shape != wanted.shape or found.dtype != wanted.dtype:
        return float("inf")
    worst = float(np.abs(found.astype(float) - wanted).max(initial=0)) / max(1.0, float(np.abs(wanted).max(initial=0)))
    return 0.0 if worst == 0 else float("inf") if not worst < float("inf") else worst / tolerance if tolerance else float("inf")


def main():
    root, *folders = sys.argv[1:]
    shaders, unchecked = "--shaders" in folders, "--unchecked" in folders
    folders = folders[shaders + unchecked:]
    sys.path.insert(0, root)
    import numpy as np

    from dressi_edge import runtime
    from dressi_edge.cache import bundle
    from dressi_edge.cache.summary import image_bytes
    from dressi_edge.commands.statistics import NAMES, compiled, image_memory
    from dressi_edge.runtime.device import Device

    def stepped(device, path, told):
        record = json.loads(path.with_suffix(".json").read_text())
        with runtime.load(path, device) as session:
            for number, step in enumerate(record["steps"]):
                if step["do"] == "set":
                    session.set(step["name"], array(np, step["array"]))
                elif step["do"] == "step":
                    session.step(step["count"], step["name"])
                else:
                    worst = deviation(np, session.get(step["name"]), array(np, step["array"]), record["tolerance"])
                    if worst > told["deviation"]:
                        told["deviation"], told["where"] = worst, f"step {number}, {step['name']}"
            taken = session.bundle
            images = taken.description["images"]
            told["bytes"] = [sum(image_bytes(image) * image["slots"] for image in images), session.report()["image_bytes"]]
        return taken

    def replay(device, path):
        told = {"name": path.stem, "error": None, "messages": [], "deviation": 0.0, "where": "", "bytes": [0, 0], "statistics": [],
                "seconds": 0.0}
        start = time.perf_counter()
        try:
            taken = bundle.read(path).variants[0] if shaders else stepped(device, path, told)
            if shaders:
                told["bytes"] = list(image_memory(device, taken))
            for one in compiled(device, taken, "fit" if shaders else None) if device.statistics or shaders else ():
                numbers = {name: x for name in NAMES if (x := one.told(name)) is not None}
                told["statistics"].append([str(one.place), one.place.pixels if one.place else 0, numbers, round(one.ms, 1)])
        except Exception as error:  # noqa: BLE001  (what went wrong is the result)
            told["error"] = f"{type(error).__name__}: {error}"
        told["messages"], told["seconds"] = sorted(set(device.messages)), round(time.perf_counter() - start, 2)
        device.messages.clear()
        return told

    with Device.open(validation=not unchecked, statistics=True) as device:
        print(json.dumps({"device": device.name, "driver": device.driver, "subpixel": device.limits["subPixelPrecisionBits"],
                          "statistics": device.statistics}), flush=True)
        for folder in folders:
            for path in sorted(Path(folder).glob("*.dressi")):
                print(json.dumps(replay(device, path)), flush=True)
    print(json.dumps({"closed": device.messages}), flush=True)


if __name__ == "__main__":
    main()
