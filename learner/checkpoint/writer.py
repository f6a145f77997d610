"""Writes checkpoints in a separate thread, one at a time, while training continues."""

import time
from collections.abc import Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from typing import Any

from torch import Tensor

from eia_sec.common.log import log
from eia_sec.learner.checkpoint import files
from eia_sec.learner.checkpoint.tensor_snapshot import Frozen

REST_SECONDS = 0.002
"""Pause after each piece of 1 MiB. A low priority would not help: training waits for locks that the thread holds."""


class CheckpointWriter:
    """Hashes and writes checkpoints; a failure is noted in `failure` and does not stop training.

    Args:
        directory: where checkpoints are stored.
        keep: number of checkpoints to keep.

    Attributes:
        written: number of checkpoints written.
        failure: why the newest one could not be written, or empty.
        seconds: time that writing the newest one took.
        bytes: size of its tensors' file.
    """

    def __init__(self, directory: Path, keep: int) -> None:
        self._directory, self._keep = directory, keep
        # Start the thread now: a start blocks until the system schedules the thread, which would delay training later.
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
        """Start writing a checkpoint; no other one may be in progress."""
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
            log(f"checkpoint {path.name}: {self.bytes / 2**20:.1f} MiB in {self.seconds:.1f} s.")
        except Exception as error:
            # Otherwise any exception, such as a device out of memory, would end training at the next checkpoint.
            self.failure = f"no checkpoint could be written ({error}); the previous one is kept."
            log(f"ALARM: {self.failure}")
        finally:
            for tensor in tensors.values():
                if isinstance(tensor, Frozen):
                    tensor.close()
