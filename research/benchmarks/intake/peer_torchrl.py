"""TorchRL: its distributed collector (gloo) and its replay buffer: `python -m research.benchmarks.intake.peer_torchrl`.

The environment costs nothing: it hands out recorded observations, a whole chunk of them as one step of a batch, so that
collecting is moving data and nothing else. The player's process is TorchRL's collector node.
"""

import argparse
import os
from pathlib import Path
from typing import Any, ClassVar

import torch
from tensordict import TensorDict, TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torchrl.collectors import Collector
from torchrl.collectors.distributed import DistributedCollector
from torchrl.data import Bounded, Categorical, Composite, LazyTensorStorage, TensorDictReplayBuffer, Unbounded
from torchrl.envs import EnvBase

from research.benchmarks.intake.chunks import CAPACITY, Window, read, steps_in_rows, write_result


class Recorded(EnvBase):
    """As many environments as a chunk has rows; each step returns the recorded arrays.

    Args:
        folder: where the chunk lies.
    """

    def __init__(self, folder: Path) -> None:
        chunk = {name: torch.from_numpy(array) for name, array in read(folder).items()}
        rows = chunk["reward"].shape[0]
        super().__init__(device="cpu", batch_size=[rows])
        self._seen, self._paid = chunk["observation"], chunk["reward"]
        self.observation_spec = Composite({"observation": Unbounded(self._seen.shape)}, shape=(rows,))
        self.action_spec = Bounded(-1, 1, chunk["action"].shape)
        self.reward_spec = Unbounded(self._paid.shape)
        self.done_spec = Composite(
            {key: Categorical(2, (rows, 1), dtype=torch.bool) for key in ("done", "terminated")}, shape=(rows,)
        )
        self._never = torch.zeros(rows, 1, dtype=torch.bool)

    def _reset(self, tensordict: TensorDictBase | None, **_: Any) -> TensorDictBase:
        return self._now()

    def _step(self, tensordict: TensorDictBase) -> TensorDictBase:
        result = self._now()
        result["reward"] = self._paid
        return result

    def _now(self) -> TensorDict:
        values = {"observation": self._seen, "done": self._never, "terminated": self._never.clone()}
        return TensorDict(values, batch_size=self.batch_size)

    def _set_seed(self, seed: int | None) -> None:
        torch.manual_seed(seed or 0)


class Constant(TensorDictModuleBase):
    """A policy that costs nothing.

    Args:
        folder: where the chunk lies.
    """

    in_keys: ClassVar[list[str]] = ["observation"]
    out_keys: ClassVar[list[str]] = ["action"]

    def __init__(self, folder: Path) -> None:
        super().__init__()
        self._action = torch.from_numpy(read(folder)["action"])

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Return the recorded actions."""
        tensordict["action"] = self._action
        return tensordict


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--folder", type=Path, required=True)
    parser.add_argument("--seconds", type=float, default=5.0)
    for unused in ("--workers", "--chunks"):
        parser.add_argument(unused, type=int, default=1, help="not used: one node collects one batch at a time")
    options = parser.parse_args()
    torch.set_num_threads(1)
    folder = options.folder.resolve()
    arrays = read(folder)
    rows = len(arrays["reward"])
    size = sum(array.nbytes for array in arrays.values())
    os.environ.setdefault("GLOO_SOCKET_IFNAME", "lo")
    collector = DistributedCollector(
        [lambda: Recorded(folder)],
        Constant(folder),
        collector_class=Collector,
        frames_per_batch=rows,
        total_frames=2**40,
        backend="gloo",
        launcher="mp",
        sync=False,
    )
    buffer = TensorDictReplayBuffer(storage=LazyTensorStorage(CAPACITY), batch_size=128)
    taken = [0, 0]
    window = Window(lambda: (taken[0], taken[1]), options.seconds)
    for data in collector:
        buffer.extend(data.reshape(-1))
        taken[0] += rows
        taken[1] += size
        if window.over():
            break
    write_result(window.report(steps_in_rows(folder)))
    collector.shutdown()


if __name__ == "__main__":
    main()
