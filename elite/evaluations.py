"""Noise-free episodes that a worker flies for the coordinator."""

from dataclasses import dataclass

import numpy as np

from eia_sec.common.errors import BusClosedError, BusError, ProtocolError
from eia_sec.common.log import log
from eia_sec.common.loops import Loop
from eia_sec.common.protocol import keys
from eia_sec.common.protocol.messages import EvaluationOrder, EvaluationResult
from eia_sec.common.team import TeamSpec
from eia_sec.common.transport.bus import Bus


@dataclass(frozen=True)
class Order:
    """What a worker is asked to evaluate: the episodes of its share, by their places in the plan."""

    worker: str
    share: list[int]
    message: EvaluationOrder


def flown(bus: Bus, run: str, team: TeamSpec, order: Order, patience: float) -> Loop[EvaluationResult | None]:
    """Return what a worker answers to an order; None if it does not, or with an evaluation that does not fit.

    Args:
        bus: the control lane.
        run: the run's name.
        team: the run's team.
        order: what it is asked.
        patience: seconds to wait for its answer.
    """
    key = keys.EVALUATION.key(run, worker=order.worker)
    try:
        answer = yield from bus.asking(key, order.message.encode(), patience)
        if answer is None:
            return None
        result = EvaluationResult.decode(answer)
    except BusClosedError:
        raise
    except (BusError, ProtocolError) as error:
        log(f"coordinator: worker {order.worker} did not evaluate: {error}")
        return None
    if result.event != order.message.event or not _fits(result, len(order.share), team):
        log(f"coordinator: worker {order.worker} answered with an evaluation that does not fit.")
        return None
    return result


def _fits(result: EvaluationResult, episodes: int, team: TeamSpec) -> bool:
    """Return whether an evaluation holds this many whole episodes of finite rewards."""
    reward, steps = result.reward, result.steps
    if reward.ndim != 3 or reward.shape[::2] != (episodes, team.agents) or steps.shape != (episodes,):
        return False
    return bool((steps >= 1).all() and (steps <= reward.shape[1]).all() and np.isfinite(reward).all())
