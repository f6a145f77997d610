"""Writes checkpoints in a thread of its own, one at a time, while training goes on."""

import time
from collections.abc import Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from typing import Any

from torch import Tensor

from common.process import log
from learner.checkpoint import files
from learner.data.tensor_snapshot import Frozen

REST_SECONDS = 0.002
"""Rest after each piece of 1 MiB; a thread of low priority would do worse, because training waits for what it holds."""


class CheckpointWriter:
    """Hashes and writes what is handed over; a failure is kept for whoever asks, and training goes on.

    Args:
        directory: where checkpoints live.
        keep: how many stay.

    Attributes:
        written: checkpoints written.
        failure: why the newest one is not there, or empty.
        seconds: time that the newest one took to write.
        bytes: size of its tensors.
    """

    def __init__(self, directory: Path, keep: int) -> None:
        self._directory, self._keep = directory, keep
        # The thread is there before it is needed: starting one waits until the system lets it run.
        self._pool = ThreadPoolExecutor(1, "checkpoint")
        self._job: Future[None] = self._pool.submit(lambda: None)
        self.written = self.bytes = 0
        self.seconds = 0.0
        self.failure = ""

    @property
    def busy(self) -> bool:
        """Whether a checkpoint is being written."""
        return not self._job.done()

    def start(self, tensors: Mapping[str, Tensor | Frozen], manifest: dict[str, Any]) -> None:
        """Begin to write; nothing else may be being written."""
        self._job.result()
        self._job = self._pool.submit(self._run, tensors, manifest)

    def join(self) -> None:
        """Wait until nothing is being written."""
        self._job.result()

    def _run(self, tensors: Mapping[str, Tensor | Frozen], manifest: dict[str, Any]) -> None:
        started = time.perf_counter()
        try:
            path = files.save(self._directory, tensors, manifest, self._keep, REST_SECONDS)
            self.bytes = (path / "tensors.safetensors").stat().st_size
            self.seconds = time.perf_counter() - started
            self.written += 1
            self.failure = ""
        except Exception as error:
            # Whatever it is, such as a device without memory: raised at the next checkpoint it would end the training.
            self.failure = f"no checkpoint could be written ({error}); the one before stands."
            log(f"ALARM: {self.failure}")
        finally:
            for tensor in tensors.values():
                if isinstance(tensor, Frozen):
                    tensor.close()
