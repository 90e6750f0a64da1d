"""A starting job from a folder of pictures: what is in it is looked at, and the job says what was found and why it is so.

In: a folder. Out: a `Start`: the text of a job, whose numbers fit the cameras and masks that are there, and what was seen in words. Raises
InputError where something is missing that nobody can guess: cameras, or where the object is.
"""
from __future__ import annotations

import math
import os
import warnings
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from ...cache.errors import InputError, InputWarning
from ...cache.profile import Profile
from ..io.cameras import Camera
from ..io.colmap import MODEL_FOLDERS
from ..io.decode import NEIGHBOURS as MASKS
from ..io.decode import OWN, Masks, images_in, opened
from ..io.formats import FORMATS, read_cameras
from ..io.gltf_cameras import gltf_cameras
from ..io.hull import misses_of
from ..io.materials import Material, Part
from ..io.meshes import load_mesh
from ..io.shapes import sphere
from ..io.text import shown
from ..io.transforms import NAMES
from ..io.views import Views, load_gltf_views, photographs
from ..io.write_obj import encode_obj
from .limits import side
from .targets import large

VERTICES = 2562
LONGER = 400  # pixels of a view's longer side, at most, to begin with
MANY = 16  # views from which one is shown a step
LOOKED = 6  # pictures that are opened to see what they are
UNIFORM = 0.06  # how far a plain backdrop's colours are from each other, in the cube of colours over sqrt 3
MESHES = (".obj", ".ply", ".stl", ".off", ".glb", ".gltf")
NO_CAMERAS = ("no cameras: there is neither {formats}, nor a glTF file with cameras. If nobody knows where the pictures were taken from, "
              "COLMAP finds it (colmap automatic_reconstructor); put its model into the folder")
NO_MASKS = ("where the object is cannot be told: {picture} has no alpha, no folder {masks} is there, and the backdrop is not plain. Make "
            "masks, white on the object and black around it, each called as its picture, in {folder}")


@dataclass(frozen=True)
class Start:
    """text: the job. told: what was seen, sentence by sentence. files: more files that the job names, by name beside it. carved: whether
    it starts from the hull of the masks. apart: the folder of the pictures, where they are so many that its bundle is without them."""

    text: str
    told: tuple[str, ...]
    files: dict[str, bytes] = field(default_factory=dict)
    carved: bool = False
    apart: Path | None = None


def starting_job(folder: str | Path, beside: str | Path, name: str = "job", hull: bool = True) -> Start:
    """A job for the pictures in `folder`, to be written into the folder `beside`; other files begin with `name`. hull: start from the hull
    of the masks where they have one, unless the folder has a mesh; False: from a sphere then. Raises InputError."""
    folder = Path(folder)
    if not folder.is_dir():
        raise InputError(f"{shown(folder)} is no folder; name the one with the pictures")
    found = _cameras(folder)
    keys, told, masks = _masks(found.pictures, folder, beside)
    size = _longer_side(found.pictures)
    views = found.load(size, masks)
    middle, radius = _object(views)
    missing = ["pictures that do not exist are left out"] if found.skip else []
    told = [f"{len(views)} pictures of {_sizes(found.pictures)}, cameras from {shown(found.file.name)}", *missing, *told,
            f"the object is about {radius:.3g} in radius, around ({', '.join(f'{x:.3g}' for x in middle)}), as the masks say"]
    begin = _mesh(folder, found.file, views, middle, radius, Path(beside), f"{name}_start", hull, told)
    near, far = _planes(views.cameras, middle, radius)
    text = _text(_relative(folder, beside), [*found.keys(beside), *keys], size, views, begin, radius, near, far, told)
    apart = found.folder if large(len(views), views.cameras[0].width, views.cameras[0].height) else None
    return Start(text, tuple(told), begin.files, begin.carved, apart)


@dataclass(frozen=True)
class _Found:
    """key: of [views] that names them; file: that of the cameras; pictures: its pictures; skip: others that it names do not exist."""

    key: str
    file: Path
    pictures: list[Path]
    skip: bool = False

    def load(self, size: int, masks: Masks) -> Views:
        if self.key == "gltf":
            return load_gltf_views(self.file, self.pictures[0].parent, size, masks=masks)
        return photographs(read_cameras(self.file, None, self.skip), size, 1e-6, 1e6, masks=masks)

    @property
    def folder(self) -> Path:
        """What `run --views` takes."""
        return self.pictures[0].parent if self.key == "gltf" else self.file if self.file.is_dir() else self.file.parent

    def keys(self, beside) -> list[str]:
        images = [f"images = {_quoted(_relative(self.pictures[0].parent, beside))}"] if self.key == "gltf" else []
        return [f"{self.key} = {_quoted(_relative(self.file, beside))}", *images, *(['missing = "skip"'] if self.skip else [])]


def _cameras(folder: Path) -> _Found:
    """The cameras in the folder, or in one that lies in it."""
    places = [folder, *sorted(p for p in folder.iterdir() if p.is_dir())]
    for place in places:
        for name in NAMES:
            if (place / name).is_file():
                return _read("transforms", place / name)
    for place in places:
        model = [place] if any((place / below / f"cameras{kind}").is_file() for below in MODEL_FOLDERS for kind in (".bin", ".txt")) else []
        for file in [*model, *sorted(place.glob("cameras*.npz")), *sorted(place.glob("*_par*.txt"))]:
            return _read("cameras", file)
    scenes = [p for place in places for p in sorted(place.iterdir()) if p.suffix.lower() in (".glb", ".gltf")]
    for scene in scenes:
        for place in places:
            pictures = images_in(place)
            try:
                count = len(gltf_cameras(scene, 64, 64)[0]) if pictures else 0
            except InputError:
                continue
            if count == len(pictures) > 0:
                return _Found("gltf", scene, pictures)
    pictures = sum(len(images_in(place)) for place in places)
    raise InputError(f"{shown(folder)} has {pictures} pictures and " + NO_CAMERAS.format(formats=FORMATS))


def _read(key: str, path: Path) -> _Found:
    """Of a format of cameras; where pictures are missing, those that are there."""
    try:
        return _Found(key, path, [shot.file for shot in read_cameras(path).shots])
    except InputError:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", InputWarning)  # what is skipped is told here
            shots = read_cameras(path, skip=True).shots  # or what is wrong is something else
        return _Found(key, path, [shot.file for shot in shots], skip=True)


def _masks(pictures: Sequence[Path], folder: Path, beside) -> tuple[list[str], list[str], Masks]:
    """Lines of [views], what was seen, and the masks, of pictures whose object is told by alpha, a folder of masks, or the backdrop."""
    samples = [pictures[k] for k in sorted({k * (len(pictures) - 1) // max(LOOKED - 1, 1) for k in range(LOOKED)})]
    alpha, borders = True, []
    for path in samples:
        with opened(path, "image", "save it again as PNG") as image:
            own = image.has_transparency_data
            rgba = np.asarray(image.convert("RGBA"))
        alpha &= own and bool((rgba[..., 3] < 128).any())
        borders.append(np.concatenate([rgba[0], rgba[-1], rgba[:, 0], rgba[:, -1]])[:, :3] / 255.0)
    if alpha:
        return [], ["their alpha is the mask"], OWN
    for place in dict.fromkeys([folder, *(p.parent for p in pictures), *(p.parent.parent for p in pictures[:1])]):
        for name in MASKS:
            if (place / name).is_dir() and len(images_in(place / name)) >= len(pictures):
                mask = place / name
                return [f"masks = {_quoted(_relative(mask, beside))}"], [f"masks are in {shown(mask.name)}"], Masks(files=mask)
    border = np.concatenate(borders)
    color = np.median(border, axis=0)
    away = np.linalg.norm(border - color, axis=1) / math.sqrt(3.0)
    if np.quantile(away, 0.95) > UNIFORM:
        raise InputError(f"{shown(folder)}: " + NO_MASKS.format(picture=shown(samples[0].name), masks=" or ".join(MASKS[:2]),
                                                               folder=shown(samples[0].parent / MASKS[0])))
    rgb = tuple(round(float(x), 3) for x in color)
    within = round(max(0.1, 2.5 * float(np.quantile(away, 0.99))), 2)
    return ([f"backdrop = {{color = {list(rgb)}, within = {within}}}"],
            [f"they have no masks, but a plain backdrop of about {rgb}: what is unlike it is the object"],
            Masks(backdrop=rgb, within=within))


def _longer_side(pictures: Sequence[Path]) -> int:
    """Pixels of the longer side that a view is to have: of all views together as many as every Vulkan device takes."""
    with opened(pictures[0], "image", "save it again as PNG") as image:
        own = max(image.size)
    return max(16, min(own, LONGER, min(side(Profile.load("vulkan_min"))) // math.ceil(math.sqrt(len(pictures)))))


def _object(views: Views) -> tuple[np.ndarray, float]:
    """Middle and radius of what the masks show: the point nearest to the rays through the middles of their boxes, and half of the boxes'
    larger sides at its distance, the median of all views. Raises InputError."""
    rays, sizes = [], []
    for camera, mask in zip(views.cameras, views.masks):
        if mask.box is None:
            continue
        left, top, right, bottom = mask.box
        at = np.array([((left + right) / 2 - camera.cx) / camera.fx, -((top + bottom) / 2 - camera.cy) / camera.fy, -1.0])
        rays.append((camera.position, camera.camera_to_world[:3, :3] @ (at / np.linalg.norm(at))))
        sizes.append((camera, max((right - left) / camera.fx, (bottom - top) / camera.fy) / 2))
    if not rays:
        raise InputError("the masks of all pictures are empty: nothing is the object; look at their alpha")
    across = [np.eye(3) - np.outer(d, d) for _, d in rays]
    middle = np.linalg.lstsq(sum(across), sum(a @ eye for a, (eye, _) in zip(across, rays)), rcond=1e-6)[0]
    extents = [half * -(camera.world_to_camera @ np.append(middle, 1.0))[2] for camera, half in sizes]
    radius = float(np.median(extents))
    if not radius > 0.0:
        raise InputError("the object that the masks show lies behind the cameras: their poses are of another convention than "
                         "docs/conventions.md (OpenGL's and NeRF's: the camera looks along its -z)")
    return middle, radius


@dataclass(frozen=True)
class _Begin:
    """lines: of [mesh]. painted: on it, "texture" or, without texture coordinates, "colors". carved: it is the
    hull of the masks, which has the object's shape but for hollows. files: that the lines name, by name."""

    lines: tuple[str, ...]
    painted: str = "texture"
    carved: bool = False
    files: dict[str, bytes] = field(default_factory=dict)


def _mesh(folder: Path, cameras: Path, views: Views, middle: np.ndarray, radius: float, beside: Path, name: str,
          hull: bool, told: list[str]) -> _Begin:
    """A mesh file of the folder where there is one, else the hull of the masks where it is wanted and there is one, else a sphere within
    the object."""
    given = [p for p in sorted(folder.iterdir()) if p.suffix.lower() in MESHES and p != cameras]
    if len(given) == 1:
        told.append(f"it starts from {shown(given[0].name)}")
        painted = "colors" if load_mesh(given[0]).uvs is None else "texture"
        return _Begin((f"path = {_quoted(_relative(given[0], beside))}",), painted)
    start = 0.6 * radius
    central = np.linalg.norm(middle) < 0.1 * radius
    ball = f"sphere = {{vertices = {VERTICES}, radius = {start:.3g}}}"
    misses = None
    try:
        misses = misses_of(views) if hull else None
    except InputError as error:
        told.append(f"it starts from a sphere, not from the hull of the masks: {error}")
    if misses is not None:
        lack = f"; they do not agree everywhere, and what {misses} lack{'s' * (misses == 1)} is kept"
        why = lack if misses else ": what all of them allow"
        told.append(f"it starts from the hull of the masks{why}")
        lines = [f"hull = {{vertices = {VERTICES}{f', misses = {misses}' if misses else ''}}}",
                 *([f"# or, with three times the steps: {ball}"] if central else [])]
        return _Begin(tuple(lines), carved=True)
    if central:
        return _Begin((ball,))
    moved = sphere(VERTICES, radius=start)
    moved = replace(moved, positions=moved.positions + middle)
    told.append(f"the sphere is in {name}.obj, for the object is not at the origin")
    return _Begin((f"path = {_quoted(f'{name}.obj')}",), files=encode_obj([Part("start", moved, Material("start"))], name))


def _planes(cameras: Sequence[Camera], middle: np.ndarray, radius: float) -> tuple[float, float]:
    depths = [-(c.world_to_camera @ np.append(middle, 1.0))[2] for c in cameras]
    return max(min(depths) - 3.0 * radius, 0.02 * min(depths)), 2.0 * (max(depths) + 3.0 * radius)


def _sizes(pictures: Sequence[Path]) -> str:
    sizes = []
    for path in pictures:
        with opened(path, "image", "save it again as PNG") as image:
            sizes.append(image.size)
    different = sorted(set(sizes))
    return f"{different[0][0]} x {different[0][1]}" + (f" to {different[-1][0]} x {different[-1][1]}" if len(different) > 1 else "")


def _text(folder: str, keys: Sequence[str], size: int, views: Views, begin: _Begin, radius: float, near: float, far: float,
          told: Sequence[str]) -> str:
    shuffled = len(views) > MANY
    steps = ((500, 300) if shuffled else (200, 100)) if begin.carved else (1500, 800) if shuffled else (600, 200)
    first, last = (0.003, 0.0003) if begin.carved else (0.01, 0.001)  # of the radius, a step
    rate = f"{{start = {first * radius:.2g}, end = {last * radius:.2g}}}"
    smooth = [f"weight = {{start = {20.0 / radius ** 2:.2g}, end = {4.0 / radius ** 2:.2g}}}", "power = 2", "[[phase.loss]]",
              'kind = "normal_consistency"', "weight = 0.02"] if begin.carved else [f"weight = {0.05 / radius:.2g}"]
    texels = 256 if size < 362 else 512
    return "\n".join([
        f"# A starting job for the pictures in {folder}; every key: docs/job.md", *(f"# - {line}" for line in told), "",
        "[mesh]", *begin.lines, "", "[views]", *keys,
        f"size = {size}".ljust(34) + "# of a view's longer side; more shows more and takes longer",
        f"near = {near:.3g}", f"far = {far:.3g}",
        *(['order = "shuffle"'.ljust(34) + "# one view a step, for there are many"] if shuffled else []), "",
        "[render]", "r = 2.0".ljust(34) + "# pixels over which an outline is soft",
        *([f"texture_size = [{texels}, {texels}]"] if begin.carved else []), "",
        "[[phase]]", 'name = "shape"', f"steps = {steps[0]}", f'optimize.vertices = {{optimizer = "adam", rate = {rate}}}',
        '# renderer = "binned"'.ljust(34) + "# every face near a pixel counts, hidden ones too; slower",
        "[[phase.loss]]", 'kind = "silhouette"', "[[phase.loss]]", 'kind = "laplacian"'.ljust(34) + "# smooth; more weight, fewer dents",
        *smooth, "",
        "[[phase]]", f'name = "{begin.painted}"', f"steps = {steps[1]}", "r = 1.0", "delta = 0.0",
        f'optimize.{begin.painted} = {{optimizer = "adam", rate = {{start = 0.05, end = 0.005}}}}',
        "# optimize.gain = {rate = 0.003}".ljust(34) + "# where pictures were not exposed or balanced alike",
        "[[phase.loss]]", 'kind = "color"', "masked = true"]) + "\n"


def _relative(path: Path, beside) -> str:
    return Path(os.path.relpath(path, beside)).as_posix()


def _quoted(text: str) -> str:
    """A TOML string."""
    if "'" not in text and text.isprintable():
        return f"'{text}'" if "\\" in text or '"' in text else f'"{text}"'
    return '"' + "".join(c if c.isprintable() and c not in '"\\' else f"\\u{ord(c):04x}" if ord(c) < 65536 else f"\\U{ord(c):08x}"
                         for c in text) + '"'
