"""Allocator settings: freed memory of large messages is kept for the next ones."""

import ctypes
from typing import Final

MMAP_BYTES: Final = 32 * 1024 * 1024
"""Larger blocks are mapped directly; the C library accepts no larger threshold."""
TRIM_BYTES: Final = 48 * 1024 * 1024
"""Free memory at the end of each heap that is kept: what a minibatch needs. Threads have heaps of at most 64 MiB."""
_M_TRIM_THRESHOLD: Final = -1
_M_MMAP_THRESHOLD: Final = -3


def keep_freed_memory() -> bool:
    """Have the C library keep up to TRIM_BYTES of freed memory per heap, for blocks of up to MMAP_BYTES.

    By default it returns the memory of a large message or minibatch to the kernel, and faults it in again for the next
    one, page by page.

    Returns:
        Whether it worked; only the GNU C library supports it.
    """
    try:
        mallopt = ctypes.CDLL(None).mallopt
    except (AttributeError, OSError, TypeError):
        return False
    return bool(mallopt(_M_MMAP_THRESHOLD, MMAP_BYTES)) and bool(mallopt(_M_TRIM_THRESHOLD, TRIM_BYTES))
