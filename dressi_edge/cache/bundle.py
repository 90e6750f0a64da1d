"""The bundle on disk: docs/bundle-format.md is the authority, this is its writer and reader.

In: a description (plain dict) and blobs, or several variants of one. Out: bytes, the same for the same input; or back, checked
before anything is used.
"""
from __future__ import annotations

import hashlib
import os
import re
import struct
from collections.abc import Callable, Sequence

import msgpack

from . import vulkan as v
from .bundle_check import check_description, check_variants
from .bundle_fields import show
from .errors import BundleError
from .files import read_regular, replace_file
from .shader_check import check_shaders

MAGIC = b"DRESSI\r\n"
# format versions: of a file with one variant, with several, with images of 16 bits or copies of states, with compute, with
# images that start as one texel
VERSION, SEVERAL, MORE, COMPUTE, FILLED = 1, 2, 3, 4, 5
HEADER = struct.Struct("<8sIIQ32s")  # magic, version, reserved 0, description bytes, their SHA-256
ALIGN = 64
MAX_FILE_BYTES = 1 << 32
MAX_DESCRIPTION_BYTES = 1 << 26
MAX_ITEMS_IN_ALL = 1 << 22  # values of a description: what decoding takes is bounded, however small they are
# What MessagePack has between the headers of longer arrays, maps and texts. First scalars: small integers, nil, booleans; the digest
# of a blob; numbers; short texts. Their repeat is bounded because a regular expression remembers each of them. Then headers of
# small arrays and maps, one byte each.
_SHORT = b"|".join(b"%b.{%d}" % (re.escape(bytes([0xa0 + n])), n) for n in range(32))
_SCALARS = (rb"(?:[\x00-\x7f\xc0\xc2\xc3\xe0-\xff]+|\xc4\x20.{32}|[\xcc\xd0].|[\xcd\xd1]..|[\xce\xd2].{4}"
            rb"|[\xcb\xcf\xd3].{8}|" + _SHORT + rb"){0,64}")
_RUN = re.compile(_SCALARS + rb"([\x80-\x9f]*)", re.DOTALL)
_CLAIMS = bytes(128) + bytes(2 * n for n in range(16)) + bytes(range(16)) + bytes(96)  # of such a header


class Bundle:
    """A variant of a file that has passed every check: `description` (dict), `blob(k)` (bytes-like, read-only), `interfaces`,
    what each shader binds, takes and gives, and `digest`, the file's SHA-256."""

    def __init__(self, description: dict, data: memoryview, digest: str):
        self.description, self._data, self.digest = description, data, digest
        self.interfaces = check_shaders(description, self.blob)
        self.after: tuple[Bundle, ...] = ()

    @property
    def variants(self) -> tuple[Bundle, ...]:
        """This variant and those after it in the file, best first; of what `read` gives, all there are."""
        return (self, *self.after)

    @property
    def profile(self) -> str:
        """The name of the profile it was made for, by which a file has one variant."""
        return self.description["profile"]["name"]

    def blob(self, k: int) -> memoryview:
        """The bytes of a blob, read-only."""
        offset, size, _ = self.description["blobs"][k]
        return self._data[offset:offset + size]


def _pad(size: int) -> int:
    return -size % ALIGN


def combine(made: Sequence[tuple[dict, list[bytes]]]) -> tuple[dict, list[bytes]]:
    """The description and blobs of one file for several variants, best first. What more than one holds is there once."""
    numbers: dict[bytes, int] = {}
    variants = []
    if any("computes" in d for d, _ in made):
        made = [({"computes": [], **d}, blobs) for d, blobs in made]
    for d, blobs in made:
        at = {k: numbers.setdefault(blob, len(numbers)) for k, blob in enumerate(blobs)} | {None: None}
        variants.append({**d, "shaders": [at[k] for k in d["shaders"]],
                         "images": [{**image, "data": at[image["data"]]} for image in d["images"]],
                         "values": [{**value, "initial": at.get(value["initial"], value["initial"])} for value in d["values"]]})
    return {"variants": variants}, list(numbers)


def version_of(descriptions: Sequence[dict]) -> int:
    """The format version of a file with these variants."""
    if any(type(value["initial"]) is bytes for d in descriptions for value in d["values"]):
        return FILLED
    if any(d.get("computes") for d in descriptions):
        return COMPUTE
    if any(image["format"] in v.HALF_FORMATS for d in descriptions for image in d["images"]) \
            or any(value["role"] == "copy" for d in descriptions for value in d["values"]):
        return MORE
    return VERSION if len(descriptions) == 1 else SEVERAL


def dumps(description: dict, blobs: list[bytes], version: int | None = None) -> bytes:
    """The file's bytes, of version 1 or 2 unless given. `description` (of one variant, or of
    `combine`) lacks "blobs", which is made here."""
    entries, at = [], 0
    for blob in blobs:
        entries.append([at, len(blob), hashlib.sha256(blob).digest()])
        at += len(blob) + _pad(len(blob))

    def pack(shift: int) -> bytes:
        moved = [[offset + shift, size, digest] for offset, size, digest in entries]
        return msgpack.packb({**description, "blobs": moved}, use_bin_type=True, use_single_float=False)

    start, text = 0, pack(0)
    while HEADER.size + len(text) + _pad(HEADER.size + len(text)) != start:
        start = HEADER.size + len(text) + _pad(HEADER.size + len(text))
        text = pack(start)
    version = version or (SEVERAL if "variants" in description else VERSION)
    head = HEADER.pack(MAGIC, version, 0, len(text), hashlib.sha256(text).digest()) + text
    parts = [head, bytes(_pad(len(head)))]
    for blob in blobs:
        parts += [blob, bytes(_pad(len(blob)))]
    return b"".join(parts)


def write(path: str | os.PathLike, description: dict, blobs: list[bytes], check: Callable[[Bundle], None] | None = None) -> str:
    """Write the bundle atomically; its SHA-256 (hexadecimal). With `check` the very bytes are read back first, and what they hold is
    given to it, which may raise: what a reader would refuse is never put in place, and what was there stays. Raises BundleError."""
    data = dumps(description, blobs, version_of(description.get("variants", [description])))
    if check is not None:
        try:
            check(loads(data))
        except BundleError as e:
            raise BundleError(f"{path}: not written, for every reader would refuse it: {e}") from None
    try:
        replace_file(path, data)
    except OSError as e:
        raise BundleError(f"{path}: cannot be written: {e.strerror}") from None
    return hashlib.sha256(data).hexdigest()


def read(path: str | os.PathLike, pin: str | None = None) -> Bundle:
    """The checked bundle in a file, the first of its `variants`. `pin`: the SHA-256 (64 hexadecimal digits) that the file must
    have, checked on the very bytes that are used. Raises BundleError, with the path in the file of the first thing wrong."""
    shown = text if (text := str(path)).isprintable() and len(text) < 1000 else f"{text!r:.200}"
    try:
        data = read_regular(path, MAX_FILE_BYTES)
    except OSError as e:
        raise BundleError(f"{shown}: cannot be read: {e.strerror}") from None
    try:
        return loads(data, pin)
    except BundleError as e:
        raise BundleError(f"{shown}: {e}") from None


def loads(data: bytes, pin: str | None = None) -> Bundle:
    """The checked bundle in these bytes. Raises BundleError."""
    if pin is not None:
        if type(pin) is not str or not re.fullmatch("[0-9a-fA-F]{64}", pin):
            raise BundleError(f"pin {pin!r:.80} is no SHA-256; 64 hexadecimal digits are needed")
        if (digest := hashlib.sha256(data).hexdigest()) != pin.lower():
            raise BundleError(f"the file's SHA-256 is {digest}; the pin is {pin.lower()}")
    if len(data) < HEADER.size:
        raise BundleError(f"{len(data)} bytes; a bundle has at least {HEADER.size}")
    magic, version, reserved, size, digest = HEADER.unpack_from(data)
    if magic != MAGIC:
        raise BundleError("not a bundle: the file does not begin with DRESSI")
    if not VERSION <= version <= FILLED:
        raise BundleError(f"format version {version}; this reader knows {VERSION} to {FILLED}; compile the bundle again or update "
                          "dressi_edge")
    if reserved != 0:
        raise BundleError(f"reserved field is {reserved}; 0 is allowed")
    if size > len(data) - HEADER.size:
        raise BundleError(f"truncated: the description has {size} bytes, the file holds {len(data) - HEADER.size} of them")
    if size > MAX_DESCRIPTION_BYTES:
        raise BundleError(f"the description has {size} bytes; at most {MAX_DESCRIPTION_BYTES} are allowed")
    text = data[HEADER.size:HEADER.size + size]
    if hashlib.sha256(text).digest() != digest:
        raise BundleError("the description's checksum does not match; the file is damaged")
    _check_claims(text)
    try:
        description = msgpack.unpackb(text, raw=False, strict_map_key=True, object_pairs_hook=_unique)
    except BundleError:
        raise
    except Exception as e:  # msgpack raises many kinds
        raise BundleError(f"the description is no msgpack: {type(e).__name__}") from None
    several = version == SEVERAL or version >= MORE and type(description) is dict and "variants" in description
    for k, d in enumerate(_variants(description) if several else [description]):
        if type(d) is dict and (version >= COMPUTE) != ("computes" in d):
            told = f"variants[{k}]: description" if several else "description"
            raise BundleError(f"{told} {'lacks computes' if version >= COMPUTE else 'has the unknown key ' + show('computes')}")
    if several:
        descriptions = check_variants(description)
    else:
        check_description(description)
        descriptions = [description]
    if version != (needed := version_of(descriptions)):
        raise BundleError(f"format version {version}; what the file holds is written as version {needed}")
    at = HEADER.size + size
    for k, (offset, length, sha) in enumerate(description["blobs"]):
        if any(data[at:offset]) or offset != at + _pad(at):
            raise BundleError(f"blobs[{k}]: at {offset}; {at + _pad(at)} is needed, with zeros before it")
        at = offset + length
        if at > len(data):
            raise BundleError(f"truncated: blobs[{k}] ends at {at}, the file at {len(data)}")
        if hashlib.sha256(data[offset:at]).digest() != sha:
            raise BundleError(f"blobs[{k}]: the checksum does not match; the file is damaged")
    if len(data) != at + _pad(at) or any(data[at:]):
        raise BundleError(f"{len(data)} bytes; {at + _pad(at)} are needed, zeros after the last blob")
    found, digest = [], hashlib.sha256(data).hexdigest()
    for k, d in enumerate(descriptions):
        try:
            check_blobs(d)
            found.append(Bundle(d, memoryview(data), digest))
        except BundleError as e:
            raise BundleError(f"variants[{k}]: {e}" if several else str(e)) from None
    found[0].after = tuple(found[1:])
    return found[0]


def _variants(description) -> list:
    found = description.get("variants") if type(description) is dict else None
    return found if type(found) is list else []


_LENGTHS = {0xc4: 1, 0xc5: 2, 0xc6: 4, 0xd9: 1, 0xda: 2, 0xdb: 4}  # bytes of the length of bin and str
_ITEMS = {0xdc: (2, 1), 0xdd: (4, 1), 0xde: (2, 2), 0xdf: (4, 2)}  # bytes of the count of arrays and maps, values an item


def _check_claims(text: bytes) -> None:
    """Refuse what claims more items than there are bytes, or than anyone needs: a decoder makes room for them before it finds them
    missing."""
    at, end, claimed, seen = 0, len(text), 1, 0
    most = min(end, MAX_ITEMS_IN_ALL)
    while at < end and claimed <= most:
        run = _RUN.match(text, at)
        if run.end() > at:
            at = run.end()
            claimed += sum(run[1].translate(_CLAIMS))
            continue
        seen += 1
        if seen > claimed:
            raise BundleError("the description goes on after its end")
        kind = text[at]
        at += 1
        if kind in _ITEMS:
            size, times = _ITEMS[kind]
            claimed += int.from_bytes(text[at:at + size], "big") * times
            at += size
        elif kind in _LENGTHS:
            at += _LENGTHS[kind] + int.from_bytes(text[at:at + _LENGTHS[kind]], "big")
        else:
            raise BundleError(f"the description has the byte {kind:#x} at {at - 1}; nil, booleans, integers, float 64, text, bytes, "
                              "arrays and maps are allowed")
    if claimed > end:
        raise BundleError(f"the description claims more than its {end} bytes can hold")
    if claimed > most:
        raise BundleError(f"the description has more than {most} items; a bundle has no need of so many")
    if at > end:
        raise BundleError("the description ends within a value")


def _unique(pairs: list) -> dict:
    result = dict(pairs)
    if len(result) != len(pairs):
        raise BundleError("a map of the description names a key twice")
    return result


def check_blobs(d: dict) -> None:
    """Sizes of what blobs stand for."""
    def expect(where: str, k: int, size: int) -> None:
        if d["blobs"][k][1] != size:
            raise BundleError(f"{where}: blobs[{k}] has {d['blobs'][k][1]} bytes; {size} are needed")

    def image_bytes(image: dict) -> int:
        return v.TEXEL_BYTES[image["format"]] * image["width"] * image["height"]

    for k, image in enumerate(d["images"]):
        if image["data"] is not None:
            expect(f"images[{k}].data", image["data"], image_bytes(image))
    for k, value in enumerate(d["values"]):
        if type(value["initial"]) is int:
            expect(f"values[{k}].initial", value["initial"], image_bytes(d["images"][value["image"]]))
    for k, blob in enumerate(d["shaders"]):
        size = d["blobs"][blob][1]
        if size % 4 or size < 20:
            raise BundleError(f"shaders[{k}]: {size} bytes are no SPIR-V module")
