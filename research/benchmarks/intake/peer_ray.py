"""Ray: an actor that plays for many workers, and one that copies: `python -m research.benchmarks.intake.peer_ray`.

Chunks are arguments of the learner's method, several of them under way for each worker; Ray puts large ones into
its shared object store, from which the learner reads without a copy.
"""

import argparse
from pathlib import Path

import ray

from research.benchmarks.intake.chunks import Arrays, Ring, Window, read, steps_in_rows, write_result


@ray.remote(num_cpus=1)
class Learner:
    """The sink."""

    def __init__(self, folder: str, seconds: float) -> None:
        self._ring, self._share = Ring(read(Path(folder))), steps_in_rows(Path(folder))
        self._window = Window(lambda: (self._ring.rows, self._ring.bytes), seconds)

    def add(self, chunk: Arrays) -> bool:
        """Take a chunk in; return whether more are wanted."""
        self._ring.add(chunk)
        return not self._window.over()

    def report(self) -> dict[str, float]:
        """Return what was taken in."""
        return self._window.report(self._share)


@ray.remote(num_cpus=1)
class Player:
    """All workers."""

    def play(self, learner: "ray.actor.ActorHandle", folder: str, under_way: int) -> None:
        """Play until the learner wants no more, with so many chunks under way."""
        chunk = read(Path(folder))
        waiting = [learner.add.remote(chunk) for _ in range(under_way)]
        while True:
            ready, waiting = ray.wait(waiting, num_returns=1)
            if not all(ray.get(ready)):
                return
            waiting.append(learner.add.remote(chunk))


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--folder", type=Path, required=True)
    parser.add_argument("--seconds", type=float, default=5.0)
    parser.add_argument("--workers", type=int, default=8)
    parser.add_argument("--chunks", type=int, default=1, help="under way at once from each worker")
    options = parser.parse_args()
    ray.init(num_cpus=2, include_dashboard=False, log_to_driver=False, object_store_memory=512 * 2**20)
    learner = Learner.remote(str(options.folder.resolve()), options.seconds)
    under_way = options.workers * options.chunks
    ray.get(Player.remote().play.remote(learner, str(options.folder.resolve()), under_way))
    write_result(ray.get(learner.report.remote()))
    ray.shutdown()


if __name__ == "__main__":
    main()
