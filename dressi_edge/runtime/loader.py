"""Where Vulkan's loader may lie, by system: names that the system itself looks up, then the folders of the usual installers.

Written for macOS and Windows from their documents; Linux and Android are what was run.
"""
from __future__ import annotations

import glob
import os
import sys
from collections.abc import Mapping

ADVICE = {"win32": "install the driver of your graphics card, which brings vulkan-1.dll, or the Vulkan SDK (winget install "
                   "KhronosGroup.VulkanSDK)",
          "darwin": "brew install molten-vk vulkan-loader, or the Vulkan SDK of LunarG"}
LINUX = "install libvulkan1 and a driver, on Debian mesa-vulkan-drivers"


def candidates(system: str = sys.platform, environ: Mapping[str, str] = os.environ) -> list[str]:
    """Libraries to try in this order. On macOS a bare name is looked up in /usr/local/lib and /usr/lib alone; Homebrew on Apple silicon and
    the SDK are elsewhere, and MoltenVK by itself, which is a driver, will do."""
    sdk = environ.get("VULKAN_SDK", "")
    if system == "win32":
        return ["vulkan-1.dll", *([os.path.join(sdk, "Bin", "vulkan-1.dll")] if sdk else [])]
    if system != "darwin":
        return ["libvulkan.so.1", "libvulkan.so"]
    names = ("libvulkan.dylib", "libvulkan.1.dylib", "libMoltenVK.dylib")
    folders = [os.path.join(sdk, "lib")] if sdk else []
    folders += ["/opt/homebrew/lib", "/usr/local/lib"]
    folders += sorted(glob.glob(os.path.join(environ.get("HOME", ""), "VulkanSDK", "*", "macOS", "lib")), reverse=True)
    return [*names, *(os.path.join(folder, name) for folder in folders for name in names)]


def missing(tried: list[str], system: str = sys.platform) -> str:
    """That none of these is there, and what to do."""
    names = list(dict.fromkeys(map(os.path.basename, tried)))
    return f"no Vulkan loader found (tried {', '.join(names)}): {ADVICE.get(system, LINUX)}"
