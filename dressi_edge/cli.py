"""`dressi-edge`: arguments in, a command of dressi_edge/commands, an exit code out.

0 done, 1 a defect of ours, 2 usage, 3 bad input, 4 device, 130 interrupted (143 by SIGTERM). An error is one line on stderr, and so is a
note of an input that looks wrong. A command's module is imported when it runs, so that a device needs no more than the runtime.
"""
from __future__ import annotations

import argparse
import importlib
import os
import sys
import warnings

from .cache.errors import DressiError, InputWarning

USAGE, DEFECT, INTERRUPTED = 2, 1, 130
LONGEST_LINE = 1000


class _Parser(argparse.ArgumentParser):
    """argparse with errors of one line."""

    def error(self, message):
        self.exit(USAGE, f"dressi-edge: {_line(message)}; see {self.prog} --help\n")


def _line(text) -> str:
    """The text on one line, without what would move the cursor, and cut where a name in it is endless."""
    text = " ".join("".join(c if c.isprintable() else " " for c in str(text)).split())
    return text if len(text) <= LONGEST_LINE else text[:LONGEST_LINE] + "..."


def _note(message, category, *_, **__) -> None:
    print(f"dressi-edge: note: {_line(message)}", file=sys.stderr)


class _Version(argparse.Action):
    def __call__(self, parser, *_):
        from importlib.metadata import PackageNotFoundError, version
        try:
            found = version("dressi_edge")
        except PackageNotFoundError:
            found = "(not installed: running from a checkout)"
        parser.exit(0, f"dressi-edge {found}\n")


def _steps(text: str) -> int:
    if not text.isdecimal() or int(text) < 1:
        raise argparse.ArgumentTypeError(f"{text!r} is no whole number above 0")
    return int(text)


def _bytes(text: str) -> int:
    number, unit = text.strip().upper().removesuffix("B").strip(), 1
    if number[-1:] in ("K", "M", "G"):
        number, unit = number[:-1].strip(), 1000 ** ("KMG".index(number[-1]) + 1)
    if not number.isdecimal() or int(number) < 1:
        raise argparse.ArgumentTypeError(f"{text!r} is no size such as 512MB")
    return int(number) * unit


def _positive(text: str) -> float:
    try:
        number = float(text)
    except ValueError:
        number = 0.0
    if not 0.0 < number < 1e9:
        raise argparse.ArgumentTypeError(f"{text!r} is no number above 0")
    return number


def _port(text: str) -> int:
    if not text.isdecimal() or int(text) > 65535:
        raise argparse.ArgumentTypeError(f"{text!r} is no port; 0 to 65535, 0 for a free one")
    return int(text)


def parser() -> argparse.ArgumentParser:
    """All commands and their arguments."""
    top = _Parser(prog="dressi-edge", description="A differentiable renderer on plain Vulkan: images in, mesh and texture out.",
                  epilog="Environment: DRESSI_DEVICE, DRESSI_DEBUG, DRESSI_DUMP, DRESSI_CACHE; see docs/job.md.")
    top.add_argument("--version", nargs=0, action=_Version, help="print the version")
    commands = top.add_subparsers(metavar="COMMAND", required=True)

    def command(name: str, text: str, within=commands, target: str | None = None) -> argparse.ArgumentParser:
        sub = within.add_parser(name, help=text, description=text[0].upper() + text[1:] + ".")
        sub.set_defaults(target=target or f"{name}:{name}")
        return sub

    def json_switch(sub):
        sub.add_argument("--json", action="store_true", help="print JSON")

    def device(sub, more=""):
        sub.add_argument("--device", metavar="NAME", help=f"number or part of the name of a Vulkan device{more}; "
                         "default $DRESSI_DEVICE, else the best there is")

    def emulation(sub):
        sub.add_argument("--emulate", metavar="PROFILE", help="let the device report and enforce this profile's limits, formats "
                         "and features")
        sub.add_argument("--profile", metavar="NAME", help="take the bundle's variant for this profile, not the first that fits")

    def pinned(sub):
        sub.add_argument("--pin", metavar="SHA256", help="refuse any file but the one with this SHA-256 (64 hexadecimal digits)")

    sub = command("new", "write a starting job for a folder of pictures, after looking at what is in it")
    sub.add_argument("folder", help="pictures, with their cameras: transforms.json, a COLMAP model, cameras.npz, *_par.txt or a glTF file")
    sub.add_argument("-o", "--output", metavar="JOB.toml", default="job.toml", help="the job to write (default job.toml)")
    sub.add_argument("--start", choices=("hull", "sphere"), default="hull", help="the mesh to start from, unless the folder has one: the "
                     "hull of the masks (default; a sphere where they have none), or a sphere within the object")
    sub.add_argument("--force", action="store_true", help="replace files that exist")

    sub = command("compile", "make a bundle of a job (docs/job.md)", target="compile:compile_job")
    sub.add_argument("job", help="the job, a TOML file")
    sub.add_argument("-p", "--profile", required=True, action="append",
                     help="device profile: a name of `dressi-edge profiles list`, or a .json file; several times, best first, for "
                     "one bundle with a variant for each")
    sub.add_argument("-o", "--output", required=True, metavar="X.dressi", help="the bundle to write")
    sub.add_argument("--storage", choices=("float", "half"), help="half: targets and gradients of pixels lie in images of 16 bits a "
                     "channel; default float, unless all profiles prefer half")
    sub.add_argument("--compute", choices=("none", "ops", "pixel", "all"), help="what is dispatched to compute shaders instead of being "
                     "drawn, where the profile allows it (docs/packing.md); default as the profile prefers")
    sub.add_argument("--embed", action=argparse.BooleanOptionalAction, default=None, help="have the pictures in the bundle; else `run "
                     "--views` reads them; default: where they are few (a million pixels)")
    sub.add_argument("--memory", type=_bytes, metavar="SIZE", help="what all images may take on the device, such as 512MB; of pictures "
                     "that are seen one a step, as many are there at a time as fit")
    json_switch(sub)

    sub = command("run", "solve a bundle: step its phases and write the mesh, pictures and numbers")
    sub.add_argument("bundle", help="the bundle; or, with --device reference, a job")
    sub.add_argument("--steps", type=_steps, metavar="N", help="iterations of each phase, instead of the job's")
    sub.add_argument("--phase", metavar="P", help="run this phase alone")
    sub.add_argument("-o", "--output", metavar="OUT", action="append", help="OUT.glb, .gltf, .usdz, .obj or .ply: the mesh, with "
                     "OUT_sheet.png, OUT_loss.png and OUT_metrics.json beside it (needs the compiler's packages); OUT.npz: the states as "
                     "arrays; VALUE=OUT.png, .exr or .npy: one value of the bundle, such as render.color; several times")
    sub.add_argument("--checkpoint", metavar="FILE", help="go on from FILE where it exists, and keep it up to date")
    sub.add_argument("--every", type=_positive, default=5.0, metavar="MINUTES", help="how often checkpoint and outputs are written on the "
                     "way (default 5); at the end, at Ctrl-C and at SIGTERM they are in any case")
    sub.add_argument("--report", metavar="DIR", help="DIR/index.html: one page with the result in 3D, pictures, curves, times, stages")
    sub.add_argument("--serve", metavar="PORT", nargs="?", const=0, type=_port, help="show it live in a browser, on this "
                     "machine alone, at the address that is printed (default: a free port)")
    sub.add_argument("--preview", metavar="FILE.png", help="a contact sheet of how it is now, on the way")
    sub.add_argument("--preview-every", type=_positive, default=10.0, metavar="SECONDS", help="how often (default 10)")
    sub.add_argument("--views", metavar="DIR", help="the folder of the pictures, where the bundle was compiled without them")
    device(sub, "; `reference` runs a job's graph in NumPy float64, in memory and slowly")
    emulation(sub)
    pinned(sub)
    sub.add_argument("--scene", action="store_true", help="write lights and cameras into the glTF file, or cameras into the .usdz, too")
    sub.add_argument("--explain", action="store_true", help="print which variant was taken and why, what ran how often, and what "
                     "the session occupies")
    form = sub.add_mutually_exclusive_group()
    json_switch(form)
    form.add_argument("--json-lines", action="store_true", help="tell how it goes as one JSON object a line on stdout, and nothing on "
                      "stderr but errors")

    sub = command("report", "write a page of a bundle: what it draws, its stages with their times, limits", target="report:report")
    sub.add_argument("bundle")
    sub.add_argument("-o", "--output", metavar="X.html", help="the page; default beside the bundle")
    sub.add_argument("--checkpoint", metavar="FILE", help="as it is in this checkpoint of `run`, with its curves")
    sub.add_argument("--no-times", action="store_true", help="do not time the stages")
    sub.add_argument("--views", metavar="DIR", help="the folder of the pictures, where the bundle was compiled without them")
    device(sub)
    emulation(sub)
    pinned(sub)

    sub = command("view", "show a mesh file in a browser", target="report:view")
    sub.add_argument("mesh", help="a .glb, .gltf, .obj, .ply, .stl or .off file")
    sub.add_argument("-o", "--output", metavar="X.html", help="write the page there and open no browser")

    sub = command("inspect", "show what a bundle is made of", target="bundle:inspect")
    sub.add_argument("bundle")
    pinned(sub)
    form = sub.add_mutually_exclusive_group()
    json_switch(form)
    form.add_argument("--dot", action="store_true", help="print the graph of stages for Graphviz")
    sub.add_argument("--statistics", metavar="DEVICE", help="what that device's compiler makes of each shader (a number or a part of its "
                     "name): registers, spills, waves, instructions, cycles, as far as its driver tells")

    sub = command("verify", "check a bundle without a device", target="bundle:verify")
    sub.add_argument("bundle")
    sub.add_argument("-p", "--profile", help="and that a variant keeps every limit of this profile")
    pinned(sub)

    sub = command("bench", "time a bundle: each stage of each plan by device timestamps, and whole steps", target="bench:bench")
    sub.add_argument("bundle")
    sub.add_argument("--runs", type=_steps, default=9, metavar="N",
                     help="how often each plan runs; the median counts (default 9)")
    device(sub)
    emulation(sub)
    pinned(sub)
    json_switch(sub)

    sub = command("profiles", "list, show, check, merge and capture device profiles")
    kinds = sub.add_subparsers(metavar="ACTION", required=True)
    json_switch(command("list", "list the profiles that come with the product", kinds, "profiles:list_all"))
    named = command("show", "print a profile's file", kinds, "profiles:show")
    named.add_argument("profile")
    named = command("check", "say what is wrong with profiles (default: all that come with the product)", kinds,
                    "profiles:check_all")
    named.add_argument("profile", nargs="*")
    named = command("merge", "print the intersection of profiles: what all of them allow", kinds, "profiles:merge_all")
    named.add_argument("profile", nargs="+")
    named.add_argument("-n", "--name", default="merged", help="the name of the new profile (default merged)")
    named.add_argument("-o", "--output", metavar="FILE.json", help="write it there instead")
    named = command("capture", "print the profile of the device at hand", kinds, "profiles:capture")
    named.add_argument("-n", "--name", default="captured", help="the name of the new profile (default captured)")
    named.add_argument("-o", "--output", metavar="FILE.json", help="write it there instead")
    device(named)

    json_switch(command("devices", "list the Vulkan devices", target="bundle:devices"))

    sub = command("demo", "from six pictures of a pear and a sphere to its shape and texture")
    sub.add_argument("-o", "--output", metavar="DIR", default="demo_out",
                     help="folder for the pictures and numbers (default demo_out)")
    device(sub)
    sub.add_argument("--quick", action="store_true", help="a tenth of the steps and small pictures: does it work at all?")
    return top


def main(argv: list[str] | None = None) -> int:
    """Run a command; its exit code."""
    args = parser().parse_args(argv)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of libraries: nothing of ours
        warnings.simplefilter("always", InputWarning)
        warnings.showwarning = _note
        return _run(args)


def _run(args) -> int:
    module, function = args.target.split(":")
    try:
        try:
            run = getattr(importlib.import_module(f"dressi_edge.commands.{module}"), function)
            code = run(args) or 0
            sys.stdout.flush()
            return code
        except ModuleNotFoundError as error:
            if (error.name or "").partition(".")[0] in ("PIL", "tomli"):
                raise DressiError(f"package {error.name} is not installed, and this command needs it; "
                                  "pip install 'dressi_edge[compiler]'") from error
            raise
    except DressiError as error:
        if os.environ.get("DRESSI_DEBUG"):
            import traceback
            traceback.print_exc()
        print(f"dressi-edge: {_line(error)}", file=sys.stderr)
        return error.exit_code
    except KeyboardInterrupt:
        print("dressi-edge: interrupted", file=sys.stderr)
        return INTERRUPTED
    except BrokenPipeError:  # the reader has gone, such as head
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    except Exception as error:  # noqa: BLE001
        if os.environ.get("DRESSI_DEBUG"):
            raise
        print(f"dressi-edge: defect: {type(error).__name__}: {_line(error)}; "
              "set DRESSI_DEBUG=1 for the traceback, and report it", file=sys.stderr)
        return DEFECT


if __name__ == "__main__":
    sys.exit(main())
