"""Tables of a parsed TOML file, read with care: typed values out, or an InputError that says where, what was found, what is allowed."""
from __future__ import annotations

import difflib
import math
from collections.abc import Iterable, Sequence
from pathlib import Path

from ...cache.errors import InputError
from ..io.text import shown

NEEDED = object()
LONGEST_REASON = 800  # letters of what is wrong, for it may repeat a text of the user's
MAX_NAME_BYTES = 255  # of a file's name on common file systems


class Table:
    """A table of the job: typed reads that know where they are."""

    def __init__(self, value, where: str, keys: Iterable[str], source: str):
        self.where, self.keys, self.source = where, tuple(keys), source
        if not isinstance(value, dict):
            raise self.wrong("", value, "a table is needed")
        self.value = value
        for key in value:
            if key not in self.keys:
                near = difflib.get_close_matches(key[:80], self.keys, 1, 0.5)
                hint = f"did you mean {near[0]}?" if near else f"allowed: {' '.join(self.keys)}"
                raise InputError(f"{source}: {self._at(key)} is an unknown key; {hint}")

    def _at(self, key: str) -> str:
        return ".".join(filter(None, (self.where, shown(key, 60))))

    def wrong(self, key: str, found, allowed: str) -> InputError:
        return InputError(f"{self.source}: {self._at(key)} is {found!r:.60}; {allowed}")

    def conflict(self, text: str) -> InputError:
        return InputError(f"{self.source}: {self.where}: {shown(text, LONGEST_REASON)}")

    def has(self, *keys: str) -> list[str]:
        return [key for key in keys if key in self.value]

    def get(self, key: str, default=NEEDED):
        if key in self.value:
            return self.value[key]
        if default is NEEDED:
            raise InputError(f"{self.source}: {self._at(key)} is missing; it is needed")
        return default

    def number(self, key: str, default=NEEDED, low: float = -math.inf, high: float = math.inf, whole: bool = False,
               above: bool = False):
        x = self.get(key, default)
        if key not in self.value:
            return x
        good = isinstance(x, int if whole else (int, float)) and not isinstance(x, bool)
        good = good and math.isfinite(x) and low <= x <= high
        if not good or above and x == low:
            span = f"{'above' if above else 'from'} {low:g}" if high == math.inf else f"from {low:g} to {high:g}"
            raise self.wrong(key, x, f"a {'whole ' if whole else ''}number{'' if low == -math.inf else ' ' + span} is needed")
        return x

    def word(self, key: str, default=NEEDED, allowed: Sequence[str] = ()):
        x = self.get(key, default)
        if key in self.value and (not isinstance(x, str) or not x or allowed and x not in allowed):
            near = difflib.get_close_matches(x[:80], allowed, 1, 0.5) if isinstance(x, str) else []
            hint = f"did you mean {near[0]}? " if near else ""
            raise self.wrong(key, x, f"{hint}allowed: {' '.join(allowed)}" if allowed else "a text is needed")
        return x

    def file(self, key: str, folder: Path, default=NEEDED):
        """A path, relative to `folder`, by a name that a file can have; or the default."""
        x = self.word(key, default)
        if key not in self.value:
            return x
        return self.path(key, folder, x)

    def path(self, key: str, folder: Path, name: str) -> Path:
        """`name` in `folder`, where a file can have it."""
        if "\0" in name or any(len(part.encode()) > MAX_NAME_BYTES for part in Path(name).parts):
            raise self.wrong(key, name, f"no file can have that name: up to {MAX_NAME_BYTES} bytes between slashes, no NUL")
        return folder / name

    def flag(self, key: str, default: bool) -> bool:
        x = self.get(key, default)
        if not isinstance(x, bool):
            raise self.wrong(key, x, "true or false is needed")
        return x

    def numbers(self, key: str, count: int, default=NEEDED, low=-math.inf, high=math.inf, whole=False):
        x = self.get(key, default)
        if key not in self.value:
            return x
        if not isinstance(x, list) or len(x) != count:
            raise self.wrong(key, x, f"a list of {count} numbers is needed")
        cells = Table({str(k): v for k, v in enumerate(x)}, self._at(key), map(str, range(count)), self.source)
        return tuple(cells.number(str(k), low=low, high=high, whole=whole) for k in range(count))

    def table(self, key: str, keys: Iterable[str]) -> Table:
        return Table(self.get(key), self._at(key), keys, self.source)

    def tables(self, key: str, keys: Iterable[str]) -> list[Table]:
        x = self.get(key, [])
        if not isinstance(x, list):
            raise self.wrong(key, x, f"tables [[{self._at(key)}]] are needed")
        return [Table(item, f"{self._at(key)}[{k}]", keys, self.source) for k, item in enumerate(x)]

    def checked(self, make, *args, **kwargs):
        """make(...), with this table named in its InputError."""
        try:
            return make(*args, **kwargs)
        except InputError as error:
            raise self.conflict(str(error)) from None
