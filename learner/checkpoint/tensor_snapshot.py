"""A snapshot of a large tensor that one thread reads while another keeps writing into the tensor (copy on write).

Taking the snapshot copies nothing. The reader copies the tensor piece by piece. Before the writer changes rows, it
copies their pieces, unless the reader has done so already. So each piece is copied once, by whichever thread is first,
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
        live: the tensor [N, ...]; `protect` must be called before every later change of it.
        rows: number of its first rows that belong to the frozen state.

    Attributes:
        shape: shape of the frozen state.
        dtype: dtype of the frozen state.
        closed: whether no row needs protection any more.
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
        """Save rows start .. stop - 1 unless they have been read; call this before they are changed."""
        if self.closed:
            return
        for piece in range(start // PIECE_ROWS, min(self._count, -(-stop // PIECE_ROWS))):
            with self._lock:
                if not self._taken[piece]:
                    self._taken[piece] = 1
                    self._saved[piece] = self._copy(piece)

    def pieces(self) -> Iterator[Tensor]:
        """Yield all rows in order, as CPU tensors of up to `PIECE_ROWS` rows; can be called once."""
        try:
            for piece in range(self._count):
                yield self._piece(piece).cpu()
        finally:
            self.close()

    def close(self) -> None:
        """Discard the frozen state."""
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
    """Return the tensor itself, or the pieces of a frozen one as one tensor."""
    if isinstance(tensor, Tensor):
        return tensor
    pieces = list(tensor.pieces())
    return torch.cat(pieces) if pieces else torch.zeros(tensor.shape, dtype=tensor.dtype)
