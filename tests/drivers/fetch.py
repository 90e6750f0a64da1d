"""Debian packages by name, unpacked in folders of their own; nothing is installed, root is not needed.

    python -m tests.drivers.fetch [GROUP or names of drivers]

In: `catalog.PACKAGES`. Out: a folder for each, in $DRESSI_DRIVERS or ~/.cache/dressi_edge/drivers, with a file `.complete` once all of
it is there; an interrupted fetch is begun again. apt does the work, with settings, lists and a cache in that folder, from where the
system has its own Debian packages, and checks signatures as it always does. Delete a folder to have it made anew, from newer packages.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

from .catalog import DRIVERS, PACKAGES, Packages, chosen

KEYRING = Path("/usr/share/keyrings/debian-archive-keyring.gpg")
SETTINGS = """
Dir::State "{at}/state"; Dir::State::status "{at}/state/status"; Dir::Cache "{at}/cache";
Dir::Etc::SourceList "{at}/sources.list"; Dir::Etc::SourceParts "/dev/null"; Dir::Etc::Preferences "/dev/null";
Dir::Etc::PreferencesParts "/dev/null";
APT::Architecture "{architecture}"; APT::Architectures {{ "{architecture}"; }};
APT::Install-Recommends "false"; APT::Sandbox::User "";
Acquire::Languages "none"; Acquire::Retries "2"; Acquire::http::Timeout "20"; Acquire::https::Timeout "20";
"""
# The Release file of unstable may be past its date on a mirror; its signature is checked all the same.
STALE = 'Acquire::Check-Valid-Until "false";\n'


class Missing(Exception):
    """Why a folder could not be made: no network, no apt, another system."""


def folder() -> Path:
    """Where the folders are."""
    own = os.environ.get("DRESSI_DRIVERS")
    return Path(own) if own else Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "dressi_edge" / "drivers"


def _run(*words: str, **more) -> str:
    try:
        done = subprocess.run(words, capture_output=True, text=True, timeout=600, **more)
    except FileNotFoundError:
        raise Missing(f"there is no {words[0]} here") from None
    except subprocess.TimeoutExpired:
        raise Missing(f"{' '.join(words[:2])} took more than ten minutes") from None
    if done.returncode:
        lines = [line for line in (done.stderr + done.stdout).splitlines() if line.startswith("E:")]
        raise Missing(f"{' '.join(words[:2])} failed: {(lines or done.stderr.splitlines() or ['no word'])[0]}")
    return done.stdout


def _mirrors() -> dict[str, str]:
    """Where this system has Debian's packages: {"debian": .., "debian-security": ..}; one may be missing."""
    found = {}
    for place in _run("apt-get", "indextargets", "--format", "$(REPO_URI)").split():
        found.setdefault(place.rstrip("/").rpartition("/")[2], place)
    if "debian" not in found:
        raise Missing("apt here is not told where Debian's packages are")
    return found


def _release() -> str:
    try:
        text = Path("/etc/os-release").read_text()
    except OSError:
        return ""
    return next((line.partition("=")[2].strip('"') for line in text.splitlines() if line.startswith("VERSION_CODENAME=")), "")


def make(name: str) -> Path:
    """The folder of these packages, made if it is not there. Raises Missing."""
    wanted, root = PACKAGES[name], folder() / name
    if (root / ".complete").is_file():
        return root
    if not wanted.whole and _release() not in wanted.suites:
        raise Missing(f"{' '.join(wanted.names)} of {wanted.suites[-1]} need that system's libraries; this is {_release() or 'another'}")
    if not KEYRING.is_file():
        raise Missing(f"{KEYRING} is missing: nothing to check signatures with")
    part, work = root.with_name(f".{name}.part"), root.with_name(f".{name}.apt")
    for path in (part, work, root):
        shutil.rmtree(path, ignore_errors=True)
    try:
        for path in (part, work / "state/lists/partial", work / "cache/archives/partial"):
            path.mkdir(parents=True)
        for package in _download(wanted, work):
            _run("dpkg-deb", "-x", str(package), str(part))
        for path in [p for p in part.rglob("*") if wanted.keep and not p.is_dir() and str(p.relative_to(part)) not in wanted.keep]:
            path.unlink()
        for link in ("lib", "lib64"):  # which Debian's base system has, and its programs expect
            if wanted.whole and not (part / link).exists() and (part / "usr" / link).is_dir():
                (part / link).symlink_to(f"usr/{link}")
        (part / ".complete").write_text(" ".join(wanted.names) + "\n")
        part.rename(root)
    except OSError as error:
        raise Missing(f"{folder()}: {error}") from None
    finally:
        for path in (part, work):
            shutil.rmtree(path, ignore_errors=True)
    return root


def _download(wanted: Packages, work: Path) -> list[Path]:
    mirrors = _mirrors()
    (work / "state/status").touch()  # as if nothing were installed: all that they depend on comes along
    (work / "apt.conf").write_text(SETTINGS.format(at=work, architecture=wanted.architecture) + STALE * ("unstable" in wanted.suites))
    (work / "sources.list").write_text("".join(
        f"deb [signed-by={KEYRING}] {mirrors.get('debian-security' if 'security' in suite else 'debian', mirrors['debian'])} {suite} main\n"
        for suite in wanted.suites if "security" not in suite or "debian-security" in mirrors))
    own = {"env": {**os.environ, "APT_CONFIG": str(work / "apt.conf")}, "cwd": work}
    _run("apt-get", "-q", "update", **own)
    if wanted.whole:
        _run("apt-get", "-q", "-y", "--download-only", "install", *wanted.names, **own)
        return sorted((work / "cache/archives").glob("*.deb"))
    suite = f"/{wanted.suites[-1]}" if "backports" in wanted.suites[-1] else ""
    _run("apt-get", "-q", "download", *(name + suite for name in wanted.names), **own)
    return sorted(work.glob("*.deb"))


def ready(name: str) -> Path:
    """All that the driver of this name needs, fetched; the folder of folders. Raises Missing."""
    packages = DRIVERS[name].packages
    if PACKAGES[packages].architecture == "arm64":
        make("qemu")
    make(packages)
    return folder()


def main() -> int:
    for packages in dict.fromkeys(DRIVERS[name].packages for name in chosen(" ".join(sys.argv[1:]) or "all")):
        try:
            ready(next(name for name, driver in DRIVERS.items() if driver.packages == packages))
            print(f"{packages}: {folder() / packages}")
        except Missing as why:
            print(f"{packages}: left out: {why}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
