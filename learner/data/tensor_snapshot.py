"""A large tensor as it stood at one instant, read by one thread while another goes on writing into it.

The tensor is not copied at that instant. The reader copies it piece by piece; the writer, before it changes rows,
copies those of their pieces that the reader has not reached yet. So each piece is copied once, by whoever comes first,
and the writer never waits longer than one piece takes.
"""

import threading
from collections.abc import Iterator

import torch
from torch import Tensor

PIECE_ROWS = 512
"""Rows that are copied at once."""


class Frozen:
    """The first rows of a tensor at the instant of construction.

    Args:
        live: the tensor [N, ...]; every later change of it must be announced to `protect`.
        rows: how many of its first rows belong to the frozen state.

    Attributes:
        shape: of the frozen state.
        dtype: of the frozen state.
        closed: whether nothing more needs protection.
    """

    def __init__(self, live: Tensor, rows: int) -> None:
        self._live, self._rows = live, rows
        self.shape, self.dtype = (rows, *live.shape[1:]), live.dtype
        self._count = -(-rows // PIECE_ROWS)
        self._taken = bytearray(self._count)
        self._saved: dict[int, Tensor] = {}
        self._lock = threading.Lock()
        self.closed = self._count == 0

    def protect(self, start: int, stop: int) -> None:
        """Save what rows start .. stop - 1 hold, unless it has been read; to be called before they are changed."""
        if self.closed:
            return
        for piece in range(start // PIECE_ROWS, min(self._count, -(-stop // PIECE_ROWS))):
            with self._lock:
                if not self._taken[piece]:
                    self._taken[piece] = 1
                    self._saved[piece] = self._copy(piece)

    def pieces(self) -> Iterator[Tensor]:
        """Yield all rows in order, as tensors on the CPU of up to `PIECE_ROWS` rows; can be called once."""
        try:
            for piece in range(self._count):
                yield self._piece(piece).cpu()
        finally:
            self.close()

    def close(self) -> None:
        """Give the frozen state up."""
        with self._lock:
            self.closed = True
            self._saved.clear()

    def _piece(self, piece: int) -> Tensor:
        with self._lock:
            if self._taken[piece]:
                return self._saved.pop(piece)
            self._taken[piece] = 1
            return self._copy(piece)

    def _copy(self, piece: int) -> Tensor:
        return self._live[piece * PIECE_ROWS : min(self._rows, (piece + 1) * PIECE_ROWS)].clone()


def whole(tensor: Tensor | Frozen) -> Tensor:
    """Return the tensor itself, or all pieces of a frozen one in one."""
    if isinstance(tensor, Tensor):
        return tensor
    pieces = list(tensor.pieces())
    return torch.cat(pieces) if pieces else torch.zeros(tensor.shape, dtype=tensor.dtype)
