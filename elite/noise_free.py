"""What the actors earn without noise, for those who watch a run: a small evaluation every minute."""

from typing import Any, Final

from eia_sec.common.clock import monotonic
from eia_sec.common.config.environment import FARM
from eia_sec.common.config.run import RunConfig
from eia_sec.common.loops import Running
from eia_sec.common.protocol.messages import EvaluationOrder, EvaluationResult, ProgressMessage
from eia_sec.common.seeds import derive
from eia_sec.common.team import TeamSpec
from eia_sec.common.transport.bus import Bus
from eia_sec.elite.evaluations import Order, flown

PERIOD_SECONDS: Final = 60.0
"""Time between two evaluations."""
SHARE: Final = 0.05
"""Most of a worker's time that they take; where they take longer, they come more rarely."""
FARMS: Final = 4
"""Farms of an evaluation, the first ones of the evaluation at the run's end; always the same episodes."""
PATIENCE: Final = 60.0
"""Seconds to wait for an evaluation, which a worker begins between two chunks."""


class NoiseFreeReward:
    """Asks one worker at a time to fly farms without noise. Nothing in the training depends on it.

    Only farms are flown: another environment may be a robot, or hold a port that a second one needs.

    Args:
        config: the run.
        team: its team.
        bus: the control lane.
        run: the run's name.
    """

    def __init__(self, config: RunConfig, team: TeamSpec, bus: Bus, run: str) -> None:
        self._bus, self._run, self._team = bus, run, team
        farms = config.unseen(min(FARMS, config.evaluation.farms)) if config.env.name == FARM else range(0)
        self._farms, self._episodes = tuple(farms), tuple(derive("without noise", farm) for farm in farms)
        self._asked: Running[EvaluationResult | None] | None = None
        self._began = monotonic()
        self._due = self._began + 0.25 * PERIOD_SECONDS
        self._number, self._reward = 0, 0.0

    def begin(self, worker: str, now: ProgressMessage) -> None:
        """Ask a worker for an evaluation of the newest actors, if one is due."""
        if self._asked is None and self._farms and monotonic() >= self._due:
            message = EvaluationOrder(now.epoch, 0, now.version, self._farms, self._episodes)
            order = Order(worker, list(range(len(self._farms))), message)
            self._began = monotonic()
            self._asked = Running(flown(self._bus, self._run, self._team, order, PATIENCE))

    def step(self) -> None:
        """Take the answer if it has come."""
        if self._asked is not None and self._asked.step():
            found, self._asked = self._asked.result, None
            took = monotonic() - self._began
            self._due = self._began + max(PERIOD_SECONDS, took / SHARE)
            if found is not None:
                self._number += 1
                self._reward = float(found.reward.sum(axis=1).mean())

    def report(self) -> dict[str, Any]:
        """Return the newest evaluation as metrics; its number is 0 before the first."""
        return {"noise_free": {"reward": self._reward, "number": self._number}}
