"""Named random streams: every draw follows from integer seeds, in whatever order streams are created."""

import hashlib

import numpy as np


def derive(*parts: int | str) -> int:
    """Return a 63-bit seed that depends on every part and on their order."""
    digest = hashlib.sha256("\x1f".join(f"{type(p).__name__}:{p}" for p in parts).encode()).digest()
    return int.from_bytes(digest[:8], "little") >> 1


def stream(*parts: int | str) -> np.random.Generator:
    """Return a generator (Philox, counter based) for the stream that the parts name."""
    return np.random.Generator(np.random.Philox(key=derive(*parts)))
