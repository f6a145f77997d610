"""Groups of learners in processes of this machine, whose networks may have float64 parameters."""

import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from functools import partial
from pathlib import Path

import torch

from eia_sec.common.errors import GroupError
from eia_sec.learner.group import following, process_group
from eia_sec.learner.group.process_group import Order, ProcessGroup
from eia_sec.learner.group.updates import FollowingUpdates, LeadingUpdates
from eia_sec.learner.networks.adam import Moments
from eia_sec.learner.networks.stack import Stack
from eia_sec.learner.on_policy.updates import Updates

LOOPBACK = {"GLOO_SOCKET_IFNAME": "lo"}


def doubled(updates: Updates) -> Updates:
    """Let parameters, moments and all that minibatches compute have float64 numbers; return the updates."""
    updates.policies.double()
    for value in updates.values:
        value.double()
    for parameter, moments in updates._adam.moments.items():
        updates._adam.moments[parameter] = Moments(moments.step, moments.exp_avg.double(), moments.exp_avg_sq.double())
    updates._dtype = torch.float64
    for networks in (updates.policies, *updates.values):
        for stack in (module for module in networks.modules() if isinstance(module, Stack)):
            stack.rescale_inputs = partial(_rescale_inputs, stack)
    # atanh of a float32 number depends on its place in memory, by one unit in the last place.
    minibatch, log_probability = updates._minibatch, updates._log_probability

    def doubled_minibatch(samples, progress):
        found = minibatch(samples, progress)
        return found._replace(tensors={name: tensor.double() for name, tensor in found.tensors.items()})

    updates._minibatch = doubled_minibatch
    updates._log_probability = lambda kind, places, action, sequences: log_probability(
        kind, places, action.double(), sequences
    ).float()
    return updates


def _rescale_inputs(stack: Stack, shift: torch.Tensor, scale: torch.Tensor, flat: torch.Tensor | None = None) -> None:
    Stack.rescale_inputs(stack, shift.double(), scale.double(), flat)


class DoubledLeader(LeadingUpdates):
    """A leader with float64 numbers."""

    def __init__(self, *arguments):
        super().__init__(*arguments)
        doubled(self)


class DoubledFollower(FollowingUpdates):
    """A follower with float64 numbers."""

    def __init__(self, *arguments):
        super().__init__(*arguments)
        doubled(self)


def member(rank: int, size: int, store: Path, *words: str) -> "subprocess.Popen[bytes]":
    """Start a process that follows one run after another, until the leader is gone.

    Words: `double` for float64 numbers; `impatient` waits a second for others in an exchange, as a leader;
    `impostor` does not know what the store holds.
    """
    command = [sys.executable, "-m", "tests.learner.group.members", str(rank), str(size), str(store), *words]
    return subprocess.Popen(command, env={**os.environ, **LOOPBACK})


@contextmanager
def group_of(size: int, folder: Path, *words: str) -> Iterator[tuple[ProcessGroup, list["subprocess.Popen[bytes]"]]]:
    """Lead a group of this size; its other members end with the block."""
    os.environ |= LOOPBACK
    processes = [member(rank, size, folder / "store", *words) for rank in range(1, size)]
    group = None
    try:
        group = ProcessGroup(0, size, folder / "store")
        yield group, processes
    finally:
        for process in processes:
            process.kill()
            process.wait()
        if group is not None:
            group.close()


def main() -> None:
    """Be a member."""
    if "double" in sys.argv:
        following.FollowingUpdates = DoubledFollower
    if "impatient" in sys.argv:
        process_group.SILENT_SECONDS = 1.0
    if "impostor" in sys.argv:
        proof = process_group._proof
        process_group._proof = lambda secret, sender, receiver: proof(b"guessed", sender, receiver)
    group = ProcessGroup(int(sys.argv[1]), int(sys.argv[2]), Path(sys.argv[3]))
    with suppress(GroupError):
        while True:
            following.follow(group)
    group.close()


def end(group: ProcessGroup) -> None:
    """Let all others await the next run."""
    group.order(Order.END)


if __name__ == "__main__":
    main()
