"""Checkpoints on disk: tensors as safetensors beside a manifest, written whole or not at all.

    DIRECTORY/checkpoint-00000007/tensors.safetensors
    DIRECTORY/checkpoint-00000007/manifest.json         {"body", "bytes", "format", "sha256", "tensors"}

`tensors` is the SHA-256 of the tensors' file and `sha256` that of the manifest without this entry, so a flipped bit is
noticed wherever it is. A checkpoint is written under a temporary name, flushed to the disk, renamed, and the rename is
flushed too: what bears a checkpoint's name is complete, unless the disk itself damages it later.
"""

import hashlib
import json
import os
import re
import shutil
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import safetensors.torch
from safetensors import SafetensorError
from torch import Tensor

from common.errors import CheckpointError

FORMAT: Final = 1
MAX_MANIFEST: Final = 64 * 2**20
"""Largest manifest that is read, bytes."""
MAX_TENSORS: Final = 64 * 2**30
"""Largest tensors' file that is read, bytes."""
_NAME = re.compile(r"checkpoint-(\d{8,12})")
_PARTIAL = "partial-"


@dataclass(frozen=True)
class Found:
    """A checkpoint that was read and verified.

    Attributes:
        tensors: by name.
        manifest: the body that was saved with them.
        skipped: one sentence for each newer checkpoint that is damaged.
    """

    tensors: dict[str, Tensor]
    manifest: dict[str, Any]
    skipped: tuple[str, ...]


def save(directory: Path, tensors: dict[str, Tensor], manifest: dict[str, Any], keep: int) -> Path:
    """Write a checkpoint and remove all but the newest `keep`.

    Args:
        directory: where checkpoints live; made if missing.
        tensors: contiguous tensors by name.
        manifest: what JSON can hold.
        keep: how many checkpoints stay.

    Returns:
        the checkpoint's folder.

    Raises:
        OSError: when the disk does not take it; the checkpoints before it are untouched.
    """
    directory.mkdir(parents=True, exist_ok=True)
    for leftover in directory.glob(f"{_PARTIAL}*"):
        shutil.rmtree(leftover, ignore_errors=True)
    existing = _checkpoints(directory)
    number = existing[-1][0] + 1 if existing else 1
    final = directory / f"checkpoint-{number:08d}"
    partial = directory / f"{_PARTIAL}{number:08d}"
    data = safetensors.torch.save(tensors)
    try:
        partial.mkdir()
        _write(partial / "tensors.safetensors", data)
        _write(partial / "manifest.json", _manifest(manifest, data))
        _flush_folder(partial)
        partial.rename(final)
    except OSError:
        shutil.rmtree(partial, ignore_errors=True)
        raise
    _flush_folder(directory)
    for _, path in _checkpoints(directory)[:-keep]:
        shutil.rmtree(path, ignore_errors=True)
    return final


def load_latest(directory: Path) -> Found | None:
    """Read the newest checkpoint that is whole.

    Returns:
        the checkpoint, or None when there is none at all.

    Raises:
        CheckpointError: when there are checkpoints and every one is damaged.
    """
    skipped: list[str] = []
    for _, path in reversed(_checkpoints(directory)):
        try:
            tensors, manifest = load(path)
        except CheckpointError as error:
            skipped.append(str(error))
        else:
            return Found(tensors, manifest, tuple(skipped))
    if skipped:
        raise CheckpointError(f"no checkpoint in {directory} is whole: {' '.join(skipped)}")
    return None


def load(path: Path) -> tuple[dict[str, Tensor], dict[str, Any]]:
    """Read and verify one checkpoint folder; return its tensors and its manifest's body.

    Raises:
        CheckpointError: when it cannot be read, or anything in it differs from what was written.
    """
    try:
        text = _read(path / "manifest.json", MAX_MANIFEST)
        data = _read(path / "tensors.safetensors", MAX_TENSORS)
        manifest = json.loads(text)
        body = _verified(manifest, text, data)
        return safetensors.torch.load(data), body
    except (OSError, ValueError, KeyError, TypeError, RecursionError, SafetensorError) as error:
        raise CheckpointError(f"checkpoint {path.name} is damaged: {error}.") from error


def _verified(manifest: Any, text: bytes, data: bytes) -> dict[str, Any]:
    if not isinstance(manifest, dict) or manifest.get("format") != FORMAT or not isinstance(manifest["body"], dict):
        raise ValueError("its manifest is of another format")
    if _manifest(manifest["body"], data) != text:
        raise ValueError("its contents do not have the checksums in its manifest")
    body: dict[str, Any] = manifest["body"]
    return body


def _manifest(body: dict[str, Any], data: bytes) -> bytes:
    content = {"format": FORMAT, "body": body, "bytes": len(data), "tensors": hashlib.sha256(data).hexdigest()}
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
    if path.stat().st_size > limit:
        raise ValueError(f"{path.name} is larger than {limit} bytes")
    return path.read_bytes()


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
