"""How a learner is started."""

from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass
from pathlib import Path

from eia_sec.common.team import Float32
from eia_sec.common.transport.endpoint import Endpoint
from eia_sec.learner.group.process_group import ProcessGroup


@dataclass(frozen=True)
class LearnerOptions:
    """How to start the learner.

    Attributes:
        run: the run's name.
        endpoint: where to listen, or where a router listens.
        listen: whether this process listens itself.
        run_dir: directory for checkpoints, metrics and the configuration, or None to store nothing.
        resume: whether to continue from the newest whole checkpoint.
        lockstep: whether the learner takes turns with its only worker.
        patience: seconds to wait for a router.
        await_elite: whether to wait for late imitation events even before a coordinator has connected.
        start: returns the parameters with which each type's actors begin, None for fresh ones; nothing at all if all
            begin fresh. Not called if a checkpoint is restored.
        group: makes the group of learners that this one leads (on policy), or none; called once the sessions are open.
    """

    run: str
    endpoint: Endpoint
    listen: bool
    run_dir: Path | None
    resume: bool = False
    lockstep: bool = False
    patience: float = 60.0
    await_elite: bool = False
    start: Callable[[], Sequence[Float32 | None]] = tuple
    group: Callable[[], AbstractContextManager[ProcessGroup | None]] = nullcontext
