"""One call of a session after another, from whichever thread; and what a lost device makes of it."""
from __future__ import annotations

import functools

from . import vk


def serial(method):
    """One call of a session after another. Whoever waits is in `_waiting`, for `step` to let in between chunks. A lost device
    closes the session."""
    @functools.wraps(method)
    def call(self, *args, **options):
        self._usable()  # before the lock, which a fork may have left locked
        ticket = object()
        try:
            self._waiting.add(ticket)
            with self._lock:
                self._waiting.discard(ticket)
                self._usable()
                return method(self, *args, **options)
        except vk.VulkanError as error:
            if error.result == vk.VK_ERROR_DEVICE_LOST:
                raise self._lost(error) from error
            raise
        finally:
            self._waiting.discard(ticket)
    return call
