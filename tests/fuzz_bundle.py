"""Damage test vectors at random and read them: `python tests/fuzz_bundle.py [MUTATIONS [SEED]]`, or `make fuzz`.

Nothing but BundleError may come out, and no read may take longer or more memory than its bytes allow. Kinds: bytes of the file; words,
and whole instructions, of a shader, with checksums repaired; fields of the description (replaced, removed, doubled, moved from elsewhere),
packed again with right checksums; checkpoints, with right checksums or not. What is still accepted also goes through what a session counts
before it calls a driver.
"""

import copy
import hashlib
import random
import struct
import sys
import time
import tracemalloc

import msgpack
from hostile_bundles import FOLDER, packed, vector

from dressi_edge.cache import bundle
from dressi_edge.cache.errors import BundleError
from dressi_edge.cache.profile import Profile, misfit
from dressi_edge.cache.summary import dot, text
from dressi_edge.cache.verify import violations
from dressi_edge.runtime import checkpoint

NAMES = ("ops", "reduction", "states", "silhouette", "texture", "variants", "copies", "lists", "subpasses", "half", "dispatched", "counted",
         "shared")
NUMBERS = (-1, 0, 1, 2, 3, 4, 5, 7, 8, 10, 16, 17, 23, 31, 99, 100, 109, 126, 255, 65535, 65536, 1 << 20, 1 << 31, 1 << 40, 1 << 63,
           (1 << 64) - 1)
ODD = (None, True, False, 0.5, float("nan"), float("inf"), "", "a", "input", b"", b"x" * 32, [], {}, [[]], [0], [0, 0, 0, 0], {"a": 1})
KINDS = ("bytes", "text", "words", *["instructions"] * 2, *["fields"] * 4, "checkpoint")
DIGEST = "d1" * 32  # of the bundle that the checkpoints are of
SECONDS, BYTES_PER_BYTE, BYTES = 5.0, 128, 1 << 20  # what one read may take


def places(x, found: list) -> list:
    """(container, key) of everything in it, outermost first."""
    for key in list(x) if isinstance(x, dict) else range(len(x)):
        found.append((x, key))
        if isinstance(x[key], (dict, list)):
            places(x[key], found)
    return found


def mutate_fields(d: dict, r: random.Random) -> None:
    for _ in range(r.choice((1, 1, 1, 2, 3))):
        found = places(d, [])
        if not found:  # a mutation before took all there was
            return
        x, key = r.choice(found)
        old = x[key]
        kind = r.randrange(8)
        if kind < 2 and type(old) is int:
            x[key] = min(max(old + r.choice((-2, -1, 1, 2)), -2 ** 63), 2 ** 64 - 1)  # what msgpack can write
        elif kind < 4:
            x[key] = r.choice(NUMBERS)
        elif kind == 4:
            x[key] = copy.deepcopy(r.choice(ODD))
        elif kind == 5:
            other, k = r.choice(found)
            x[key] = copy.deepcopy(other[k])
        elif kind == 6:
            del x[key]
        elif isinstance(x, list):
            x.insert(r.randrange(len(x) + 1), copy.deepcopy(old))
        else:
            x[r.choice(("", "pass", "name", key + "s"))] = old


def mutate_words(blob: bytes, r: random.Random) -> bytes:
    words = [blob[k:k + 4] for k in range(0, len(blob), 4)]
    for _ in range(r.choice((1, 1, 2, 4))):
        at = r.randrange(len(words))
        word = int.from_bytes(words[at], "little")
        words[at] = r.choice((r.getrandbits(32), r.getrandbits(6), word ^ 1 << r.randrange(32), word + 1 & 0xFFFFFFFF,
                              int.from_bytes(r.choice(words), "little"))).to_bytes(4, "little")
    return b"".join(words[:r.randrange(len(words))] if r.random() < 0.1 else words)


def instructions_of(words) -> list[list[int]]:
    at, out = 5, []
    while at < len(words):
        out.append(list(words[at:at + (words[at] >> 16)]))
        at += words[at] >> 16
    return out


def damage(r: random.Random, instructions: list[list[int]]) -> None:
    """One of: an operand changed, or exchanged with one of the same opcode; an instruction gone, doubled, moved, or of another opcode; a
    branch to another block."""
    k, kind = r.randrange(len(instructions)), r.randrange(10)
    one = instructions[k]
    labels = [i[1] for i in instructions if i[0] & 0xFFFF == 248]
    branches = [(i, j) for i in instructions for j in {245: (4,), 246: (1, 2), 247: (1,), 249: (1,), 250: (2, 3)}.get(i[0] & 0xFFFF, ())]
    if kind < 3 and branches:
        i, j = r.choice(branches)
        i[j] = r.choice(labels)
    elif kind < 6 and len(one) > 1:
        j, other = r.randrange(1, len(one)), r.choice(instructions)
        one[j] = r.choice([one[j] + 1, max(0, one[j] - 1), r.choice(other[1:] or [1]), r.getrandbits(5)]) & 0xFFFFFFFF
    elif kind == 6:
        one[0] = r.choice([i for i in instructions if len(i) == len(one)])[0]
    elif kind == 7:
        del instructions[k]
    elif kind == 8:
        instructions.insert(r.randrange(len(instructions)), list(one))
    elif len(one) > 1:
        other = r.choice([i for i in instructions if i[0] & 0xFFFF == one[0] & 0xFFFF])
        j = r.randrange(1, len(one))
        one[j] = other[min(j, len(other) - 1)]


def mutate_instructions(blob: bytes, r: random.Random) -> bytes:
    """A module of whole instructions, one or two of which are damaged: what the words alone would not reach."""
    words = struct.unpack(f"<{len(blob) // 4}I", blob)
    instructions = instructions_of(words)
    for _ in range(r.choice((1, 1, 2))):
        damage(r, instructions)
    changed = [*words[:5], *(x for i in instructions for x in i)]
    return struct.pack(f"<{len(changed)}I", *changed)


def mutate_bytes(data: bytes, r: random.Random) -> bytes:
    out = bytearray(data)
    for _ in range(r.choice((1, 2, 4, 16))):
        at = r.randrange(len(out))
        kind = r.randrange(4)
        if kind == 0:
            out[at] ^= 1 << r.randrange(8)
        elif kind == 1:
            out[at] = r.choice((0, 1, 0x7f, 0x80, 0xc1, 0xdc, 0xdd, 0xdf, 0xff))
        elif kind == 2:
            del out[at:at + r.randrange(1, 9)]
        else:
            out[at:at] = out[r.randrange(len(out)):][:r.randrange(1, 9)]
        if not out:
            return b""
    return bytes(out)


def mutate_checkpoint(r: random.Random) -> bytes:
    """A checkpoint whose description or bytes are damaged, most of them under a right checksum."""
    parts = checkpoint.dumps(checkpoint.Checkpoint("walk", {"walk": 3, "rest": 0}, {"a": bytes(range(64)), "t": bytes(4)}), DIGEST)
    text, rest = parts[1], b"".join(parts[2:])
    if r.random() < 0.3:
        return mutate_bytes(b"".join(parts), r)
    if r.random() < 0.5:
        d = msgpack.unpackb(text)
        mutate_fields(d, r)
        text = msgpack.packb(d)
    else:
        text = mutate_bytes(text, r)
    size = r.choice((len(text), len(text), len(text), r.getrandbits(32)))
    return checkpoint.HEADER.pack(checkpoint.MAGIC, 1, size, bytes.fromhex(DIGEST), hashlib.sha256(text + rest).digest()) + text + rest


class Fuzz:
    """`one()` makes a mutation and reads it; `counts` says what came of each kind."""

    def __init__(self, seed: int):
        self.r = random.Random(seed)
        self.sources = [vector(name) for name in NAMES]
        self.files = [(FOLDER / f"{name}.dressi").read_bytes() for name in NAMES]
        self.profiles = [Profile.load("vulkan_min"), Profile.load("lavapipe")]
        self.counts = {kind: [0, 0] for kind in dict.fromkeys(KINDS)}
        self.messages: set[str] = set()

    def make(self, kind: str) -> bytes:
        r = self.r
        if kind == "bytes":
            return mutate_bytes(r.choice(self.files), r)
        d, blobs = r.choice(self.sources)
        version = bundle.version_of(d.get("variants", [d]))
        if kind == "text":
            return packed(mutate_bytes(msgpack.packb(d), r), bytes(64), version)
        if kind == "words":
            blobs = list(blobs)
            k = r.choice(r.choice(d.get("variants", [d]))["shaders"])
            blobs[k] = mutate_words(blobs[k], r)
            return bundle.dumps(d, blobs, version)
        if kind == "instructions":
            blobs = list(blobs)
            k = r.choice(r.choice(d.get("variants", [d]))["shaders"])
            blobs[k] = mutate_instructions(blobs[k], r)
            return bundle.dumps(d, blobs, version)
        d = msgpack.unpackb(msgpack.packb(d))
        mutate_fields(d, r)
        return bundle.dumps(d, blobs, version)

    def one(self) -> None:
        kind = self.r.choice(KINDS)
        data = mutate_checkpoint(self.r) if kind == "checkpoint" else self.make(kind)
        start = time.perf_counter()
        accepted = False
        try:
            found = checkpoint.loads(data, DIGEST) if kind == "checkpoint" else bundle.loads(data)
            accepted = True
        except BundleError as e:
            message = str(e)
            assert 0 < len(message) < 500 and message.isprintable(), ascii(message)
            self.messages.add("".join(c for c in message if not c.isdigit()))
        if accepted and kind != "checkpoint":
            for one in found.variants:
                for profile in self.profiles:
                    violations(one.description, profile, one.interfaces)
                    misfit({**one.description["needs"]["limits"], **one.description["needs"]["formats"]}, profile)
                text(one.description)
                dot(one.description)
        assert time.perf_counter() - start < SECONDS, f"{len(data)} bytes took {time.perf_counter() - start:.1f} s"
        self.counts[kind][accepted] += 1


def run(mutations: int, seed: int, measure: bool = False) -> Fuzz:
    """So many mutations; with `measure` the memory of each too, which is slow."""
    fuzz = Fuzz(seed)
    for n in range(mutations):
        state = fuzz.r.getstate()
        try:
            if measure:
                tracemalloc.start()
            fuzz.one()
            if measure:
                assert tracemalloc.get_traced_memory()[1] < BYTES_PER_BYTE * 50_000 + BYTES
        except Exception:
            print(f"mutation {n} of seed {seed}", file=sys.stderr)
            fuzz.r.setstate(state)
            raise
        finally:
            if measure:
                tracemalloc.stop()
    return fuzz


if __name__ == "__main__":
    count, seed = (int(x) for x in (*sys.argv[1:], *("200000", "0")[len(sys.argv) - 1:]))
    start = time.perf_counter()
    done = run(count, seed)
    print(f"{count} mutations of seed {seed} in {time.perf_counter() - start:.0f} s, {len(done.messages)} different messages")
    for kind, (refused, accepted) in done.counts.items():
        print(f"  {kind}: {refused} refused, {accepted} accepted")
