"""What an update frees is what the next one asks for: it need not go back to the kernel between."""

import ctypes
import sys

_TRIM_THRESHOLD, _MMAP_THRESHOLD = -1, -3  # from glibc's malloc.h
_KEPT = 2**30
_LARGEST = 32 * 2**20


def keep_freed_memory() -> bool:
    """Let this process keep up to 1 GiB that it has freed, instead of asking for it anew.

    An update allocates and frees hundreds of arrays of a megabyte. By default glibc gives these
    back at once, and every page of the next ones is a fault that the kernel answers with zeros:
    thousands an update, and two threads wait for each other in them.

    Returns:
        Whether it is kept; False with another C library than glibc, where nothing changes.
    """
    if sys.platform != "linux":
        return False
    mallopt = getattr(ctypes.CDLL(None), "mallopt", None)
    if mallopt is None:
        return False
    return bool(mallopt(_MMAP_THRESHOLD, _LARGEST) and mallopt(_TRIM_THRESHOLD, _KEPT))
