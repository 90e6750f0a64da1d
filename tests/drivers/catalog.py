"""Vulkan drivers that run without hardware: which Debian packages hold them, and how a program is started on each.

Two kinds. SwiftShader and lavapipe draw on the processor. Mesa's drivers of real GPUs run over `mesa-drm-shim`, a kernel that
does nothing: they load, compile with the vendor's back end, record and submit, and every image stays zero.
Nothing is installed: packages are unpacked in a folder (`fetch.py`), and a program is started with that folder's libraries.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass, field
from pathlib import Path

AMD64, ARM64 = "x86_64-linux-gnu", "aarch64-linux-gnu"
MESA = ("mesa-vulkan-drivers", "mesa-drm-shim", "libvulkan1", "vulkan-validationlayers", "python3-numpy", "python3-msgpack")


@dataclass(frozen=True)
class Packages:
    """One folder of unpacked packages. suites: of Debian, the last is preferred. whole: with all that they depend on, so that the folder
    needs nothing of the system, whatever that is; else the system must be Debian 12. keep: of what is unpacked, all or these files."""

    suites: tuple[str, ...]
    names: tuple[str, ...]
    whole: bool = True
    architecture: str = "amd64"
    keep: tuple[str, ...] = ()


PACKAGES = {
    "swiftshader": Packages(("bookworm", "bookworm-security"), ("chromium-common",), whole=False,
                            keep=("usr/lib/chromium/libvk_swiftshader.so", "usr/lib/chromium/vk_swiftshader_icd.json")),
    "backports": Packages(("bookworm", "bookworm-backports"), ("mesa-vulkan-drivers", "mesa-drm-shim", "libdrm2", "libdrm-amdgpu1"),
                          whole=False),
    "unstable": Packages(("unstable",), MESA),
    "unstable-arm64": Packages(("unstable",), MESA, architecture="arm64"),
    "qemu": Packages(("bookworm",), ("qemu-user",)),
}


@dataclass(frozen=True)
class Driver:
    """One device. packages: a key of PACKAGES. icd: the driver's JSON file. shim: the kernel that does nothing, "" where the driver draws
    itself. group: "quick" (.ci/run), "rest" (make test-drivers), "arm" (an emulated processor: minutes a bundle). profile: what a bundle
    for it is compiled for. spills: by bundle, what a shader of it may have, where to cut it would cost more; 0 in all others."""

    packages: str
    icd: str
    shim: str = ""
    environment: dict[str, str] = field(default_factory=dict, hash=False)
    group: str = "rest"
    profile: str = "vulkan_min"
    spills: dict[str, int] = field(default_factory=dict, hash=False)

    @property
    def executes(self) -> bool:
        return not self.shim


def _amd(packages: str, chip: str, profile: str, group: str = "rest") -> Driver:
    return Driver(packages, "radeon", "amdgpu", {"AMDGPU_GPU_ID": chip}, group, profile)


def _adreno(number: int, profile: str) -> Driver:
    return Driver("unstable", "freedreno", "freedreno", {"FD_GPU_ID": str(number)}, profile=profile)


def _nvidia(chip: int, profile: str) -> Driver:
    return Driver("unstable", "nouveau", "nouveau", {"NOUVEAU_CHIPSET": f"{chip:x}"}, profile=profile)


def _mali(number: str, profile: str) -> Driver:
    environment = {"PAN_GPU_ID": number, "PAN_I_WANT_A_BROKEN_VULKAN_DRIVER": "1"}
    return Driver("unstable-arm64", "panfrost", "panfrost", environment, "arm", profile)


DRIVERS = {
    "swiftshader": Driver("swiftshader", "swiftshader", group="quick", profile="swiftshader"),
    "lavapipe25": Driver("backports", "lvp", group="quick", profile="lavapipe"),
    "polaris10-mesa25": _amd("backports", "polaris10", "polaris10", "quick"),
    "navi21-mesa25": _amd("backports", "navi21", "navi21", "quick"),
    "navi31-mesa25": _amd("backports", "navi31", "navi31", "quick"),
    "lavapipe26": Driver("unstable", "lvp", profile="lavapipe"),
    **{chip: _amd("unstable", chip, profile) for chip, profile in (
        ("polaris10", "polaris10"), ("stoney", "vulkan_min"), ("raven", "vulkan_min"), ("renoir", "vulkan_min"), ("navi10", "radeon"),
        ("navi21", "navi21"), ("navi31", "navi31"), ("gfx1201", "navi31"))},
    **{f"adreno{number}": _adreno(number, profile) for number, profile in (
        (618, "vulkan_min"), (630, "adreno_630"), (660, "vulkan_min"), (740, "adreno_740_turnip"), (750, "adreno_740_turnip"),
        (830, "adreno_830"))},
    "m1": Driver("unstable", "asahi", "asahi", profile="apple_m1_honeykrisp"),
    **{f"nvidia-{chip:x}": _nvidia(chip, profile) for chip, profile in (
        (0x120, "vulkan_min"), (0x164, "nvk_turing"), (0x174, "nvk_turing"), (0x194, "nvk_ada"))},
    "mali-g76": _mali("7211", "mali_g76_panvk"),
    "mali-g610": _mali("a867", "mali_g610"),
    "powervr-bxs": Driver("unstable-arm64", "powervr_mesa", "powervr", {"PVR_I_WANT_A_BROKEN_VULKAN_DRIVER": "1"}, "arm", "powervr_bxs"),
    "videocore7": Driver("unstable-arm64", "broadcom", "v3d", {}, "arm", "videocore7", {"binned": 23}),
}
# Profiles that `capture.py` writes: of which driver, what the device is.
CAPTURED = {
    "swiftshader": ("swiftshader", "SwiftShader, which draws on the processor: 4 bits of a pixel"),
    "adreno_630": ("adreno630", "Qualcomm phone GPU of 2018, tile-based, with Mesa"),
    "adreno_740_turnip": ("adreno740", "Qualcomm phone GPU of 2022, tile-based, with Mesa"),
    "adreno_830": ("adreno830", "Qualcomm phone GPU of 2024, tile-based, with Mesa"),
    "apple_m1_honeykrisp": ("m1", "Apple M1, tile-based, with Mesa"),
    "navi21": ("navi21", "AMD Radeon RX 6800 with Mesa"),
    "navi31": ("navi31", "AMD Radeon RX 7900 with Mesa"),
    "polaris10": ("polaris10", "AMD Radeon RX 580 with Mesa"),
    "nvk_turing": ("nvidia-164", "NVIDIA GPU of 2018 with Mesa"),
    "nvk_ada": ("nvidia-194", "NVIDIA GPU of 2022 with Mesa"),
    "mali_g76_panvk": ("mali-g76", "Arm phone GPU of 2018, tile-based, with Mesa"),
    "mali_g610": ("mali-g610", "Arm phone GPU of 2021, tile-based, with Mesa"),
    "powervr_bxs": ("powervr-bxs", "Imagination GPU, tile-based, with Mesa: 4 bits of a pixel"),
    "videocore7": ("videocore7", "Raspberry Pi 5, tile-based, with Mesa: 6 bits of a pixel"),
}
GROUPS = {"quick": ("quick",), "all": ("quick", "rest"), "everything": ("quick", "rest", "arm")}


def chosen(words: str) -> list[str]:
    """The names of the drivers of a group ("quick", "all", "everything") or list of names. Raises ValueError."""
    if words in GROUPS:
        return [name for name, driver in DRIVERS.items() if driver.group in GROUPS[words]]
    names = words.replace(",", " ").split()
    unknown = [name for name in names if name not in DRIVERS]
    if unknown or not names:
        raise ValueError(f"no driver {' '.join(unknown)!r}; there are the groups {' '.join(GROUPS)}, and {' '.join(DRIVERS)}")
    return names


def command(driver: Driver, folder: Path, *arguments: str) -> tuple[list[str], dict[str, str]]:
    """(arguments, environment) that start Python with these arguments on the driver. folder: where `fetch` keeps its folders."""
    root, whole = folder / driver.packages, PACKAGES[driver.packages].whole
    arm = PACKAGES[driver.packages].architecture == "arm64"
    libraries = root / "usr" / "lib" / (ARM64 if arm else AMD64)
    shim = libraries / f"lib{driver.shim}_noop_drm_shim.so"
    icd = root / "usr" / ("lib/chromium" if driver.packages == "swiftshader" else "share/vulkan/icd.d") / f"{driver.icd}_icd.json"
    if driver.packages == "swiftshader":
        icd = icd.with_name("vk_swiftshader_icd.json")
    environment = {"PATH": "/usr/bin:/bin", "HOME": str(folder), "LANG": "C.UTF-8",
                   "VK_DRIVER_FILES": str(icd), "VK_ICD_FILENAMES": str(icd), "DRESSI_CACHE": "off",
                   "MESA_SHADER_CACHE_DISABLE": "1", "PYTHONDONTWRITEBYTECODE": "1", "PYTHONUNBUFFERED": "1",
                   "NODEVICE_SELECT": "1",  # this layer of Mesa's makes calls that the validation layer complains about
                   **driver.environment}
    if not whole:
        return [sys.executable, *arguments], environment | {"LD_LIBRARY_PATH": str(libraries)} | (
            {"LD_PRELOAD": str(shim)} if driver.shim else {})
    # the folder's own Python, loader and layers, started by its own linker: no chroot, no root
    python = sorted((root / "usr" / "bin").glob("python3.[0-9]*[0-9]"))[-1]
    path = f"{libraries}:{libraries / 'blas'}:{libraries / 'lapack'}"
    environment |= {"PYTHONHOME": str(root / "usr"), "VK_LAYER_PATH": str(root / "usr/share/vulkan/explicit_layer.d"),
                    "XDG_DATA_DIRS": str(root / "usr" / "share")}
    if not arm:
        preload = ["--preload", str(shim)] if driver.shim else []
        return [str(libraries / "ld-linux-x86-64.so.2"), *preload, "--library-path", path, str(python), *arguments], environment
    own = environment | {"LD_LIBRARY_PATH": path} | ({"LD_PRELOAD": str(shim)} if driver.shim else {})
    emulator, given = folder / "qemu", [word for name, value in own.items() for word in ("-E", f"{name}={value}")]
    return [str(emulator / "lib64" / "ld-linux-x86-64.so.2"), "--library-path", f"{emulator}/usr/lib/{AMD64}:{emulator}/lib/{AMD64}",
            str(emulator / "usr/bin/qemu-aarch64"), "-L", str(root), *given, str(python), *arguments], {"PATH": "/usr/bin:/bin"}
