"""Pictures as cameras and tools write them, with the object's mask wherever it is: files in; RGBA of 8 or 16 bits out.

JPEG, PNG, WebP, TIFF, BMP, ...; RGB, grey, palettes, CMYK; 8 bits, or 16 (all of them of PNG and of grey, else the upper 8); turned as EXIF
says. The mask is the picture's own alpha, a file of its own, or what differs from a plain backdrop.
"""
from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from PIL import Image, ImageOps

from ...cache.errors import InputError, note
from .images import IMAGE_SUFFIXES, names_of, natural, opened
from .lens import Lens, straightened
from .pictures import Pictures
from .text import is_file, is_folder, shown

ORIENTATION = 0x0112  # the EXIF tag: 1 as stored, 3 upside down, 5 to 8 lying on a side
HINT = "save it again as a PNG of 8 bits"
MODES = ("1", "L", "LA", "La", "P", "PA", "RGB", "RGBA", "RGBa", "RGBX", "CMYK", "YCbCr", "I;16", "I;16B", "I;16L", "I;16N", "HSV")
LOWER = {"RGB;16B": ("RGB", "RGB;16L"), "RGBA;16B": ("RGBA", "RGBA;16L"), "LA;16B": ("RGBA", "RGBA")}  # of PNG: what gives the lower bytes
NEIGHBOURS = ("masks", "mask", "segmentation", "silhouettes")  # folders that hold masks by their name
FOLDERS = 4  # of a picture's path, that its mask's may repeat


@dataclass(frozen=True)
class Masks:
    """Where pictures say what is object and what is not.

    files: a folder with a mask for each picture, or one file each; masks are pictures whose brightness is coverage (or alpha, where they
    have some). backdrop: three numbers in [0, 1], the colour as stored of what is behind the object; a pixel nearer than `within` to it is
    not wholly object, nearer than half of that not at all (the distance in the cube of colours, over sqrt 3, so black to white is 1).
    whole: pictures without alpha are object all over. premultiplied: colour is stored multiplied by alpha. Several count together: a pixel
    is object as far as all say so."""

    files: Path | tuple[Path, ...] | None = None
    backdrop: tuple[float, float, float] | None = None
    within: float = 0.1
    whole: bool = False
    premultiplied: bool = False

    def __post_init__(self) -> None:
        if self.backdrop is not None and (len(self.backdrop) != 3 or not all(0.0 <= x <= 1.0 for x in self.backdrop)):
            raise InputError(f"backdrop is {self.backdrop!r:.60}; three numbers from 0 to 1 are needed")
        if not 0.0 < self.within <= 1.0:
            raise InputError(f"within is {self.within!r:.40}; a number above 0, up to 1, is needed")

    def of(self, files: Sequence[Path], own: Sequence[Path | None]) -> list[Path | None]:
        """The mask's file of each picture: its own where it names one, else that of `files`. Raises InputError."""
        if self.files is None:
            return list(own)
        if isinstance(self.files, tuple):
            if len(self.files) != len(files):
                raise InputError(f"{len(self.files)} masks for {len(files)} pictures; give one for each, in their order")
            return list(self.files)
        return _in_folder(self.files, files)


def _in_folder(folder: Path, files: Sequence[Path]) -> list[Path]:
    """Masks of a folder: by the pictures' names, in as many of their folders as there are, or in order where no name is alike."""
    if not is_folder(folder):
        raise InputError(f"mask directory {shown(folder)} does not exist; check the path, or give a list of files")
    found = [_mask_of(folder, file) for file in files]
    if not any(found):
        masks = images_in(folder)
        if len(masks) == len(files):
            note(f"the masks in {shown(folder)} have other names than the pictures, so they were taken in order: "
                 + ", ..., ".join(f"{shown(masks[k].name, 60)} for {shown(files[k].name, 60)}" for k in (0, -1)))
            return masks
        raise InputError(f"no mask in {shown(folder)} has the name of a picture, such as {shown(files[0].stem, 60)}.png, and there are "
                         f"{len(masks)} masks for {len(files)} pictures; name them alike")
    for file, mask in zip(files, found):
        if mask is None:
            raise InputError(f"picture {shown(file)} has no mask in {shown(folder)}, though others have; add {shown(file.stem, 60)}.png")
    return found


def _mask_of(folder: Path, file: Path) -> Path | None:
    """For a/b/c.jpg: b/c.png, b/c.jpg.png (as COLMAP names them), c.png, c.jpg.png, ... in the folder."""
    parents = file.parts[:-1]
    for depth in range(min(len(parents), FOLDERS), -1, -1):
        place = folder.joinpath(*[p for p in parents[len(parents) - depth:] if p not in ("..", "/")])
        for stem in (file.stem, file.name):
            for suffix in IMAGE_SUFFIXES:
                for s in (suffix, suffix.upper()):
                    mask = place / (stem + s)
                    if mask != file and is_file(mask):
                        return mask
    return None


def images_in(folder: Path) -> list[Path]:
    """The pictures of a folder, not of those in it, as people count: 2 before 10."""
    return sorted((f for f in folder.iterdir() if f.suffix.lower() in IMAGE_SUFFIXES and f.is_file()), key=lambda f: natural(f.name))


OWN = Masks()  # each picture's alpha


@dataclass(frozen=True)
class Header:
    """A picture by its header. size: (width, height) as stored. turned: whether EXIF says that it is shown in another position;
    upright: (width, height) as it is shown."""

    size: tuple[int, int]
    turned: bool
    upright: tuple[int, int]


def header(path: Path) -> Header:
    """Raises InputError."""
    with opened(path, "image", HINT) as image:
        turn = image.getexif().get(ORIENTATION, 1)
        return Header(image.size, turn in range(2, 9), image.size[::-1] if turn in range(5, 9) else image.size)


@dataclass(frozen=True)
class Photograph:
    """One picture, as `Pictures` reads it. size: its (width, height). mask: its mask's file. upright: turned as EXIF says. lens: what it
    was taken by, whose bending is taken out."""

    file: Path
    size: tuple[int, int]
    masks: Masks = OWN
    mask: Path | None = None
    upright: bool = True
    lens: Lens | None = None

    @property
    def files(self) -> tuple[Path, ...]:
        return (self.file,) if self.mask is None else (self.file, self.mask)

    def __call__(self, *data: bytes) -> np.ndarray:
        """uint8 or uint16 (h, w, 4) of the files' bytes: straight colour as stored, and coverage. Raises InputError."""
        with opened(data[0], "image", HINT, shown(self.file)) as image:
            mode, has_alpha, raw = image.mode, image.has_transparency_data, _raw(image)
            pixels = _rgba(image, self.file, self.upright, True)
        if raw in LOWER:
            with opened(data[0], "image", HINT, shown(self.file)) as image:
                pixels = _sixteen(pixels, image, raw, self.upright)
        if self.masks.premultiplied:
            if not has_alpha:
                raise InputError(f"image {shown(self.file)} has no alpha channel (mode {mode}), but its colour is to be divided by alpha; "
                                 "drop views.alpha = \"premultiplied\"")
            pixels = _straight(pixels)
        if self.mask is None and self.masks.backdrop is None and not self.masks.whole and not has_alpha:
            raise InputError(f"image {shown(self.file)} has no alpha channel (mode {mode}); alpha is the mask; save it as RGBA, or say "
                             f"where the object is: {_hint(self.file, pixels)}")
        if self.mask is not None or self.masks.backdrop is not None:
            pixels[..., 3] = np.rint(self._coverage(pixels, *data[1:]))  # of 0 to the highest number
        return pixels if self.lens is None or self.lens.straight else straightened(pixels, self.lens)

    def _coverage(self, pixels: np.ndarray, *mask: bytes) -> np.ndarray:
        """(h, w) in [0, 255], or as far as pixels go."""
        coverage = pixels[..., 3].astype(np.float32)
        if mask:
            with opened(mask[0], "mask", HINT, shown(self.mask)) as image:
                own = _brightness(_rgba(image, self.mask, self.upright))
            if own.shape != coverage.shape:
                raise InputError(f"mask {shown(self.mask)} is {own.shape[1]}x{own.shape[0]}, but {shown(self.file)} is "
                                 f"{coverage.shape[1]}x{coverage.shape[0]}; scale one of them")
            coverage = coverage * own
        if self.masks.backdrop is not None:
            coverage = coverage * _unlike(pixels[..., :3] / np.float32(highest(pixels)), self.masks.backdrop, self.masks.within)
        return coverage


def load_images(source: str | Path | Sequence[str | Path], fits: Callable[[int, int, int], None] | None = None,
                size: tuple[int, int] | int | None = None, told: Callable[[int, int], None] | None = None, masks: Masks = OWN
                ) -> tuple[Pictures, tuple[str, ...]]:
    """Images, as good as an array (n, h, w, 4) float32 as stored, and their names (`names_of`), of a list of files or of every image in a
    directory, 2 before 10. All need one size. fits: called with n, width and height before any pixel is read. size: what to average them
    down to (`fitted`). told: called with how many of how many are read. InputError."""
    if isinstance(source, str | Path):
        if not is_folder(Path(source)):
            raise InputError(f"image directory {shown(source)} does not exist; check the path, or give a list of files")
        files = images_in(Path(source))
    else:
        files = [Path(file) for file in source]
    if not files:
        below = sum(file.suffix.lower() in IMAGE_SUFFIXES for file in Path(source).glob("*/*")) if isinstance(source, str | Path) else 0
        hint = f"its folders have {below}: give a list of files" if below else f"give at least one of {', '.join(IMAGE_SUFFIXES)}"
        raise InputError(f"no image in {shown(source)}; {hint}")
    of_masks = masks.of(files, [None] * len(files))
    sizes = [header(file).upright for file in files]
    for file, (w, h) in zip(files, sizes):
        if (w, h) != sizes[0]:
            raise InputError(f"image {shown(file)} is {w}x{h}, but {shown(files[0])} is {sizes[0][0]}x{sizes[0][1]}; "
                             "these views need one size")
    small = fitted(*sizes[0], size)
    if fits is not None:
        fits(len(files), *small)
    readings = [Photograph(file, sizes[0], masks, mask) for file, mask in zip(files, of_masks)]
    return Pictures(readings, [small] * len(files), told), names_of(files)


def fitted(width: int, height: int, size: tuple[int, int] | int | None) -> tuple[int, int]:
    """The size of a picture of width x height that is averaged down: to (width, height), or to a longer side of so many pixels at most."""
    if size is None:
        return width, height
    if not isinstance(size, int):
        return tuple(size)
    scale = min(1.0, size / max(width, height))
    return max(1, round(width * scale)), max(1, round(height * scale))


def highest(pixels: np.ndarray) -> int:
    """What stands for 1 in pixels of 8 or 16 bits."""
    return int(np.iinfo(pixels.dtype).max)


def _raw(image: Image.Image) -> str:
    """How the bytes of a PNG's pixels lie; nothing of another file."""
    return str(image.tile[0][3]) if image.format == "PNG" and image.tile else ""


def _sixteen(upper: np.ndarray, image: Image.Image, raw: str, upright: bool) -> np.ndarray:
    """uint16 (h, w, 4) of a PNG of 16 bits, whose upper 8 were decoded. image: the same, not yet decoded. The library gives the upper bytes
    of each pair alone, but is told here that the lower ones come first, as in other files."""
    mode, other = LOWER[raw]
    image.tile = [(*tile[:3], other) for tile in image.tile]
    image._mode = mode
    if upright and image.getexif().get(ORIENTATION, 1) in range(2, 9):
        image = ImageOps.exif_transpose(image)
    lower = np.asarray(image)
    if raw == "LA;16B":
        lower = lower[..., [1, 1, 1, 3]]
    elif lower.shape[2] == 3:
        lower = np.concatenate([lower, np.full_like(lower[..., :1], 255)], -1)
    pixels = upper.astype(np.uint16) << 8 | lower
    if raw == "RGB;16B":  # a colour may stand for what is transparent
        pixels[..., 3] = np.where((pixels[..., :3] == image.info.get("transparency", (-1, -1, -1))).all(-1), 0, 65535)
    return pixels


def _rgba(image: Image.Image, path: Path, upright: bool, deep: bool = False) -> np.ndarray:
    """uint8 (h, w, 4), its own to be written to; deep: of grey of 16 bits uint16."""
    if image.mode not in MODES:
        raise InputError(f"image {shown(path)} has pixels of mode {image.mode}, which are not read; {HINT}")
    if upright and image.getexif().get(ORIENTATION, 1) in range(2, 9):
        image = ImageOps.exif_transpose(image)
    if image.mode.startswith("I;16"):
        grey, hidden = np.asarray(image), image.info.get("transparency")
        alpha = np.where(grey == hidden, 0, 65535) if isinstance(hidden, int) else np.full(grey.shape, 65535)
        pixels = np.stack([grey, grey, grey, alpha], axis=-1).astype(np.uint16)
        return pixels if deep else (pixels >> 8).astype(np.uint8)  # the upper 8
    if image.mode in ("CMYK", "YCbCr", "HSV"):
        image = image.convert("RGB")
    elif image.mode == "La":
        image = image.convert("LA")
    return np.array(image.convert("RGBA"))


def _straight(pixels: np.ndarray) -> np.ndarray:
    """Colour divided by alpha; none where alpha is 0."""
    alpha = pixels[..., 3:].astype(np.float32)
    most = np.float32(highest(pixels))
    color = np.minimum(pixels[..., :3] * (most / np.maximum(alpha, np.float32(1.0))), most) * (alpha > 0.0)
    return np.concatenate([np.rint(color).astype(pixels.dtype), pixels[..., 3:]], axis=-1)


def _brightness(pixels: np.ndarray) -> np.ndarray:
    """(h, w) float32 in [0, 1] of a mask's pixels: its alpha where it has some, else its brightness; labels 0 and 1 are 0 and 1."""
    if (pixels[..., 3] < 255).any():
        return pixels[..., 3].astype(np.float32) / 255.0
    grey = np.asarray(Image.fromarray(pixels[..., :3]).convert("L"), np.float32)
    return grey if grey.max() == 1.0 else grey / 255.0


def _unlike(color: np.ndarray, backdrop: Sequence[float], within: float) -> np.ndarray:
    """(h, w) in [0, 1]: how far each pixel (of colours in [0, 1]) is something else than the backdrop; see `Masks`."""
    distance = np.linalg.norm(color - np.asarray(backdrop, np.float32), axis=-1) / np.sqrt(np.float32(3.0))
    return np.clip(2.0 * distance / within - 1.0, 0.0, 1.0)


def _hint(path: Path, pixels: np.ndarray) -> str:
    """What the keys of a job could be for this picture."""
    for folder in (path.parent, path.parent.parent):
        for name in NEIGHBOURS:
            if folder / name != path.parent and is_folder(folder / name):
                return f"views.masks = \"...\", for there is a folder {shown(folder / name)}"
    border = np.concatenate([pixels[0], pixels[-1], pixels[:, 0], pixels[:, -1]])[:, :3] / highest(pixels)
    plain = np.median(border, axis=0)
    near = (np.linalg.norm(border - plain, axis=1) < 0.05 * np.sqrt(3.0)).mean()
    seen = f" (about [{', '.join(f'{x:.2f}' for x in plain)}] at the border of this one)" if near > 0.9 else ""
    return f"views.masks = a folder of masks, views.backdrop = a plain background's colour{seen}, or views.masks = false for all of it"
