"""Checkpoints on disk: tensors as safetensors beside a manifest, written whole or not at all.

    DIRECTORY/checkpoint-00000007/tensors.safetensors
    DIRECTORY/checkpoint-00000007/manifest.json         {"body", "bytes", "format", "sha256", "tensors"}

`tensors` is the SHA-256 of the tensors' file, and `sha256` that of the manifest without this entry, so a flipped bit
anywhere is noticed. A checkpoint is written under a temporary name, flushed to disk and renamed, and the rename is
flushed as well. So a folder with a checkpoint's name is complete unless the disk damages it later. A damaged checkpoint
is renamed, so that it does not count among the kept ones; it is removed when the next damaged one is found.

Tensors are hashed and written piece by piece. The library's own `save` first copies all of them twice in memory while
it holds the interpreter's lock, which would stop training.
"""

import hashlib
import json
import math
import os
import re
import shutil
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
import safetensors.torch
import torch
from numpy.typing import NDArray
from safetensors import SafetensorError
from torch import Tensor

from eia_sec.common.errors import CheckpointError
from eia_sec.common.protocol import bfloat16
from eia_sec.learner.checkpoint.array_tensors import as_array
from eia_sec.learner.checkpoint.tensor_snapshot import Frozen

FORMAT: Final = 1
MAX_MANIFEST: Final = 64 * 2**20
"""Largest manifest that is read, bytes."""
MAX_TENSORS: Final = 64 * 2**30
"""Largest tensors' file that is read, bytes."""
_NAME = re.compile(r"checkpoint-(\d{8,12})")
_PARTIAL = "partial-"
_DAMAGED = "damaged-"
_DTYPES: Final = {
    torch.float64: "F64",
    torch.int64: "I64",
    torch.float32: "F32",
    torch.int32: "I32",
    torch.bfloat16: "BF16",
    torch.uint8: "U8",
}
_PIECE_BYTES: Final = 2**20
_FAULTS: Final = (OSError, ValueError, KeyError, TypeError, RecursionError, SafetensorError)
"""Exceptions that reading a damaged checkpoint may raise."""


@dataclass(frozen=True)
class Found:
    """A checkpoint that was read and verified.

    Attributes:
        tensors: by name.
        manifest: the body that was saved with them.
        skipped: each newer checkpoint that is damaged, with the reason.
    """

    tensors: dict[str, Tensor]
    manifest: dict[str, Any]
    skipped: tuple[tuple[Path, str], ...]


def save(
    directory: Path, tensors: Mapping[str, Tensor | Frozen], manifest: dict[str, Any], keep: int, rest: float = 0.0
) -> Path:
    """Write a checkpoint and remove all but the newest `keep`.

    Args:
        directory: where checkpoints are stored; created if missing.
        tensors: contiguous tensors by name; frozen ones are read here.
        manifest: plain values that JSON can hold.
        keep: how many checkpoints are kept.
        rest: seconds to sleep after each piece, so that other threads get the processor.

    Returns:
        The checkpoint's folder.

    Raises:
        CheckpointError: when it is larger than `load` accepts, or a number is not finite. Earlier checkpoints stay.
        OSError: when writing fails. Earlier checkpoints stay.
    """
    directory.mkdir(exist_ok=True)
    for leftover in directory.glob(f"{_PARTIAL}*"):
        shutil.rmtree(leftover, ignore_errors=True)
    existing = _checkpoints(directory)
    number = existing[-1][0] + 1 if existing else 1
    final = directory / f"checkpoint-{number:08d}"
    partial = directory / f"{_PARTIAL}{number:08d}"
    try:
        partial.mkdir()
        size, digest = _write_tensors(partial / "tensors.safetensors", tensors, rest)
        described = _manifest(manifest, size, digest)
        if size > MAX_TENSORS or len(described) > MAX_MANIFEST:
            raise CheckpointError(f"{size} and {len(described)} bytes are more than a checkpoint holds.")
        _write(partial / "manifest.json", described)
        _flush_folder(partial)
        partial.rename(final)
    except BaseException:
        shutil.rmtree(partial, ignore_errors=True)
        raise
    _flush_folder(directory)
    for _, path in _checkpoints(directory)[:-keep]:
        shutil.rmtree(path, ignore_errors=True)
    return final


def load_latest(directory: Path, most_bytes: int = MAX_TENSORS) -> Found | None:
    """Read the newest undamaged checkpoint.

    Args:
        directory: where checkpoints are stored.
        most_bytes: largest tensors' file that is read; a larger one counts as damaged.

    Returns:
        The checkpoint, or None when the directory holds none.

    Raises:
        CheckpointError: when there are checkpoints and all are damaged.
    """
    skipped: list[tuple[Path, str]] = []
    for _, path in reversed(_checkpoints(directory)):
        try:
            tensors, manifest = load(path, most_bytes)
        except CheckpointError as error:
            skipped.append((path, str(error)))
        else:
            return Found(tensors, manifest, tuple(skipped))
    if skipped:
        raise CheckpointError(f"all checkpoints in {directory} are damaged:  {' '.join(text for _, text in skipped)}")
    return None


def newest(directory: Path) -> Path | None:
    """Return the newest checkpoint, which is not read, or None."""
    found = _checkpoints(directory)
    return found[-1][1] if found else None


def set_aside(paths: Sequence[Path]) -> None:
    """Rename damaged checkpoints so that they no longer count, and remove those renamed earlier.

    Raises:
        OSError: when a file cannot be renamed or removed.
    """
    for leftover in {old for path in paths for old in path.parent.glob(f"{_DAMAGED}*")}:
        shutil.rmtree(leftover)
    for path in paths:
        path.rename(path.with_name(_DAMAGED + path.name))


def load(path: Path, most_bytes: int = MAX_TENSORS) -> tuple[dict[str, Tensor], dict[str, Any]]:
    """Read and verify one checkpoint folder; return its tensors and its manifest's body.

    If the check fails, the files are read once more from the disk itself, because a read can fail as well as a write.

    Raises:
        CheckpointError: when it cannot be read, is too large, or differs from what was written.
    """
    try:
        return _load(path, most_bytes)
    except _FAULTS:
        _forget(path)
    try:
        return _load(path, most_bytes)
    except _FAULTS as error:
        raise CheckpointError(f"checkpoint {path.name} is damaged: {error}.") from error


def _load(path: Path, most_bytes: int) -> tuple[dict[str, Tensor], dict[str, Any]]:
    text = _read(path / "manifest.json", MAX_MANIFEST)
    data = _read(path / "tensors.safetensors", min(most_bytes, MAX_TENSORS))
    body = _verified(json.loads(text), text, data)
    return safetensors.torch.load(data), body


def _forget(path: Path) -> None:
    """Ask the system to drop a checkpoint's files from its page cache, so that the next read goes to the disk."""
    for file in path.glob("*"):
        with suppress(OSError), file.open("rb") as opened:
            os.posix_fadvise(opened.fileno(), 0, 0, os.POSIX_FADV_DONTNEED)


def _verified(manifest: Any, text: bytes, data: bytes) -> dict[str, Any]:
    if not isinstance(manifest, dict) or manifest.get("format") != FORMAT or not isinstance(manifest["body"], dict):
        raise ValueError("its manifest is of another format")
    if _manifest(manifest["body"], len(data), hashlib.sha256(data).hexdigest()) != text:
        raise ValueError("its contents do not match the checksums in its manifest")
    body: dict[str, Any] = manifest["body"]
    return body


def _manifest(body: dict[str, Any], size: int, digest: str) -> bytes:
    content = {"format": FORMAT, "body": body, "bytes": size, "tensors": digest}
    content["sha256"] = hashlib.sha256(_canonical(content)).hexdigest()
    return _canonical(content)


def _canonical(content: dict[str, Any]) -> bytes:
    return json.dumps(content, sort_keys=True, separators=(",", ":"), allow_nan=False).encode()


def _checkpoints(directory: Path) -> list[tuple[int, Path]]:
    if not directory.is_dir():
        return []
    matches = [(match, path) for path in directory.iterdir() if (match := _NAME.fullmatch(path.name))]
    return sorted((int(match[1]), path) for match, path in matches)


def _read(path: Path, limit: int) -> bytes:
    with path.open("rb") as file:
        size = os.fstat(file.fileno()).st_size
        if size > limit:
            raise ValueError(f"{path.name} is larger than {limit} bytes")
        return file.read(size)


def _header(tensors: Mapping[str, Tensor | Frozen]) -> tuple[list[str], bytes]:
    """Return the names in file order, with the widest types first as the format requires, and the file's header."""
    types = list(_DTYPES)
    names = sorted(tensors, key=lambda name: (types.index(tensors[name].dtype), name))
    header, start = {}, 0
    for name in names:
        shape, dtype = list(tensors[name].shape), tensors[name].dtype
        end = start + math.prod(shape) * dtype.itemsize
        header[name] = {"dtype": _DTYPES[dtype], "shape": shape, "data_offsets": [start, end]}
        start = end
    text = json.dumps(header, separators=(",", ":")).encode()
    text += b" " * (-len(text) % 8)
    return names, len(text).to_bytes(8, "little") + text


def _pieces(name: str, tensor: Tensor | Frozen) -> Iterator[NDArray[np.uint8]]:
    """Yield a tensor's bytes; raise CheckpointError when a number is not finite."""
    parts = tensor.pieces() if isinstance(tensor, Frozen) else [tensor.detach().cpu()]
    for part in parts:
        array = as_array(part).reshape(-1)
        step = _PIECE_BYTES // array.itemsize
        for start in range(0, array.size, step):
            piece = array[start : start + step]
            if not _finite(piece):
                raise CheckpointError(f"{name} holds a number that is not finite.")
            yield piece.view(np.uint8)


def _finite(piece: NDArray[Any]) -> bool:
    """Return whether all numbers are finite; those of type uint16 are bfloat16 numbers."""
    if piece.dtype == np.uint16:
        return bfloat16.are_finite(piece)
    return piece.dtype.kind != "f" or bool(np.isfinite(piece).all())


def _write_tensors(path: Path, tensors: Mapping[str, Tensor | Frozen], rest: float) -> tuple[int, str]:
    """Write a safetensors file; return its size in bytes and its SHA-256."""
    names, header = _header(tensors)
    state, size = hashlib.sha256(header), len(header)
    with path.open("xb") as file:
        file.write(header)
        for name in names:
            for piece in _pieces(name, tensors[name]):
                state.update(piece.data)
                file.write(piece.data)
                size += piece.nbytes
                time.sleep(rest)
        file.flush()
        os.fsync(file.fileno())
    return size, state.hexdigest()


def _write(path: Path, data: bytes) -> None:
    with path.open("xb") as file:
        file.write(data)
        file.flush()
        os.fsync(file.fileno())


def _flush_folder(path: Path) -> None:
    handle = os.open(path, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)
