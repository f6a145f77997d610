"""Named random streams: every draw follows from integer seeds, in whatever order streams are created."""

import hashlib
import operator

import numpy as np


def derive(*parts: int | str) -> int:
    """Return a 63-bit seed that depends on every part and on their order."""
    texts = (f"str:{part}" if isinstance(part, str) else f"int:{operator.index(part)}" for part in parts)
    digest = hashlib.sha256("\x1f".join(texts).encode()).digest()
    return int.from_bytes(digest[:8], "little") >> 1


def stream(*parts: int | str) -> np.random.Generator:
    """Return a generator (Philox, counter based) for the stream that the parts name."""
    return np.random.Generator(np.random.Philox(key=derive(*parts)))
