"""How a learner is started."""

from dataclasses import dataclass
from pathlib import Path

from common.transport.endpoint import Endpoint


@dataclass(frozen=True)
class LearnerOptions:
    """How to start the learner.

    Attributes:
        run: the run's name.
        endpoint: where to listen, or where a router listens.
        listen: whether this process listens itself.
        run_dir: where checkpoints, metrics and the configuration go, or None to keep nothing.
        resume: whether to go on from the newest whole checkpoint.
        lockstep: whether one worker and the learner take turns.
        patience: seconds to wait for a router.
        await_elite: whether late imitation events are waited for even before a coordinator has come.
    """

    run: str
    endpoint: Endpoint
    listen: bool
    run_dir: Path | None
    resume: bool = False
    lockstep: bool = False
    patience: float = 60.0
    await_elite: bool = False
