"""Pictures unpacked or read while the device steps: which views will be needed in, their rows out."""
from __future__ import annotations

import os
from collections.abc import Callable, Iterable
from concurrent.futures import Future, ThreadPoolExecutor

import numpy as np


class Ahead:
    """rows: gives a picture's rows; called on other threads, for several pictures at once."""

    def __init__(self, rows: Callable[[int], np.ndarray]):
        self._rows, self._pool = rows, None
        self._coming: dict[int, Future] = {}

    def expect(self, views: Iterable[int]) -> None:
        """These will be needed next; what was expected beside them is let go."""
        views = list(dict.fromkeys(views))
        if views and self._pool is None:
            self._pool = ThreadPoolExecutor(min(4, os.cpu_count() or 1), thread_name_prefix="dressi-pictures")
        for view in self._coming.keys() - set(views):
            self._coming.pop(view).cancel()
        for view in views:
            if view not in self._coming:
                self._coming[view] = self._pool.submit(self._rows, view)

    def rows(self, view: int) -> np.ndarray:
        """A picture's rows, as far as they are not on their way from here and now."""
        coming = self._coming.pop(view, None)
        return self._rows(view) if coming is None else coming.result()

    def forget(self, view: int | None = None) -> None:
        """A picture, or all, are others now."""
        for key in [view] if view is not None else list(self._coming):
            if (coming := self._coming.pop(key, None)) is not None:
                coming.cancel()

    def close(self) -> None:
        """Let go of everything."""
        self.forget()
        if self._pool is not None:
            self._pool.shutdown(wait=True, cancel_futures=True)
            self._pool = None
