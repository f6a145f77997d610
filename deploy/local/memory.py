"""What a process keeps of the memory that its large messages leave behind."""

import ctypes
from typing import Final

MMAP_BYTES: Final = 32 * 1024 * 1024
"""Blocks from this size on are the kernel's own; the C library takes no larger value."""
TRIM_BYTES: Final = 16 * 1024 * 1024
"""Free memory at a heap's end that is kept instead of being given back; threads that allocate much have heaps apart."""
_M_TRIM_THRESHOLD: Final = -1
_M_MMAP_THRESHOLD: Final = -3


def keep_freed_memory() -> bool:
    """Have the C library keep up to TRIM_BYTES of each heap that become free, for blocks of up to MMAP_BYTES.

    By itself it gives what a large message held back to the kernel, and takes it anew for the next one, page by page.

    Returns:
        whether it does; only the GNU C library can.
    """
    try:
        mallopt = ctypes.CDLL(None).mallopt
    except (AttributeError, OSError, TypeError):
        return False
    return bool(mallopt(_M_MMAP_THRESHOLD, MMAP_BYTES)) and bool(mallopt(_M_TRIM_THRESHOLD, TRIM_BYTES))
