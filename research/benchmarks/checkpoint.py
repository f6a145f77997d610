"""How long a checkpoint stops the training, how long it takes to write, and how large it is.

    python -m research.benchmarks.checkpoint [--json] [--checkpoints 5] [--width 64] [--folder DIR] [--write FILE]

With `--write research/results/checkpoint.json`, `make docs` then brings the result into docs/how-to/debug_training.md.

The default team and replay buffer, full; training takes one thread. While each checkpoint is being written, training
goes on: one chunk of the default size comes in and one update is done, again and again. Beside the pause itself
stand the longest of these turns during writing and the longest without, because the thread that writes also takes the
processor's and the interpreter's time. `copy_ms` is what copying the whole replay buffer at once would take instead.
"""

import argparse
import json
import os
import sys
import tempfile
import time
from dataclasses import replace
from pathlib import Path

for _variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
    os.environ.setdefault(_variable, "1")

import numpy as np  # noqa: E402  (the variables above count only before numpy is loaded)
import torch  # noqa: E402  (as above)

from eia_sec.common.config import EiaSecConfig, ReplayConfig  # noqa: E402  (as above)
from eia_sec.common.config.presets import preset  # noqa: E402  (as above)
from eia_sec.common.errors import EiaSecError  # noqa: E402  (as above)
from eia_sec.common.transitions import TRANSITION, Chunk, Rows  # noqa: E402  (as above)
from eia_sec.deploy.exit_codes import run_command  # noqa: E402  (as above)
from eia_sec.deploy.reports.provenance import provenance  # noqa: E402  (as above)
from eia_sec.learner.checkpoint.storage import RunStorage  # noqa: E402  (as above)
from eia_sec.learner.intake.ledger import Ledger  # noqa: E402  (as above)
from eia_sec.learner.trainer import Trainer  # noqa: E402  (as above)
from research.benchmarks.learner import filled_trainer  # noqa: E402  (as above)

SETTLE_TURNS = 20


def one_chunk(trainer: Trainer) -> Chunk:
    """Return a chunk of the default size, of noise."""
    shape = trainer.config.rollout.environments, trainer.config.rollout.chunk_steps + 1
    count, team, draw = shape[0] * shape[1], trainer.team, np.random.default_rng(1)
    flag = np.full(shape, TRANSITION, np.uint8)
    flag[:, -1] = 0
    return Chunk(
        Rows(
            draw.uniform(-1, 1, (count, team.observation_size)).astype(np.float32),
            draw.uniform(-1, 1, (count, team.action_size)).astype(np.float32),
            draw.normal(size=(count, team.agents)).astype(np.float32),
            flag.reshape(count),
        )
    )


def turn(trainer: Trainer, chunk: Chunk) -> float:
    """Take a chunk in and do one update; return the seconds."""
    started = time.perf_counter()
    trainer.absorb(chunk)
    trainer.train(1)
    return time.perf_counter() - started


def measure(width: int, checkpoints: int, capacity: int, folder: Path) -> dict[str, float | int]:
    """Write several checkpoints of a trainer with so many rows in replay into a folder; return the result.

    Raises:
        EiaSecError: a checkpoint could not be written.
    """
    trainer = filled_trainer(EiaSecConfig(hidden=width), capacity=capacity)
    chunk = one_chunk(trainer)
    storage = RunStorage(folder, replace(preset("eia-sec"), algorithm=trainer.config.algorithm))
    quiet = [turn(trainer, chunk) for _ in range(3 * SETTLE_TURNS)][SETTLE_TURNS:]
    pauses, turns, seconds = [], [], []
    for number in range(1, checkpoints + 1):
        storage.save(trainer, Ledger(), 0.0, 0)
        pauses.append(storage.pause)
        turns.append(turn(trainer, chunk))
        while storage.statistics()["checkpoints"] < number and not storage.alarm:
            turns.append(turn(trainer, chunk))
        storage.close()  # its thread still tidies up behind the last byte, and the next one would be skipped
        if storage.alarm:
            raise EiaSecError(storage.alarm)
        seconds.append(storage.statistics()["checkpoint_write_seconds"])
    started = time.perf_counter()
    copies = [tensor.clone() for tensor in (trainer.replay.observation, trainer.replay.action, trainer.replay.reward)]
    copied = time.perf_counter() - started
    return {
        "width": width,
        "agents": trainer.team.agents,
        "rows": trainer.replay.rows,
        "row_numbers": sum(tensor.shape[1] for tensor in copies),
        "bytes": int(storage.statistics()["checkpoint_bytes"]),
        "checkpoints": checkpoints,
        "pause_ms_most": round(1e3 * max(pauses), 2),
        "pause_ms_median": round(1e3 * float(np.median(pauses)), 2),
        "write_seconds_median": round(float(np.median(seconds)), 3),
        "turn_ms_median_writing": round(1e3 * float(np.median(turns)), 2),
        "turn_ms_most_writing": round(1e3 * max(turns), 2),
        "turn_ms_median_else": round(1e3 * float(np.median(quiet)), 2),
        "turn_ms_most_else": round(1e3 * max(quiet), 2),
        "copy_ms": round(1e3 * copied, 2),
    }


def main() -> int:
    """Measure, write and print; return 0."""
    parser = argparse.ArgumentParser(description="Pause, time and size of a checkpoint.")
    parser.add_argument("--json", action="store_true", help="print JSON")
    parser.add_argument("--checkpoints", type=int, default=5)
    parser.add_argument("--width", type=int, default=64)
    parser.add_argument("--capacity", type=int, default=ReplayConfig().capacity, help="rows of the replay buffer")
    parser.add_argument("--folder", type=Path, default=None, help="where checkpoints go; default: a temporary folder")
    parser.add_argument("--write", type=Path, metavar="FILE", help="write the result with where it comes from")
    options = parser.parse_args()
    torch.set_num_threads(1)
    with tempfile.TemporaryDirectory(dir=options.folder) as folder:
        result = measure(options.width, options.checkpoints, options.capacity, Path(folder))
    if options.write:
        record = {**provenance("research.benchmarks.checkpoint"), "cores": os.cpu_count(), **result}
        options.write.write_text(json.dumps(record, indent=2) + "\n", encoding="utf-8")
    if options.json:
        sys.stdout.write(json.dumps(result) + "\n")
        return 0
    for name, value in result.items():
        sys.stdout.write(f"{name:24}{value:>14}\n")
    return 0


if __name__ == "__main__":
    sys.exit(run_command(main))
