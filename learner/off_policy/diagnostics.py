"""Running means of the updates' diagnostics for each agent, and a comparison of the critics with realised returns.

    critic_loss         mean of the squared TD errors of the agent's (first) critic; with the mixture loss, of Q_P
    critic_error        mean of their absolute values
    q_mean              mean Q of the batch's own actions, before the update's step; see below
    target_mean         mean Y
    actor_objective     mean of what the actor maximises
    critic_gradient     Euclidean norm of the gradient of the agent's critic (mean over two critics), before any clip
    actor_gradient      Euclidean norm of its actor's gradient, before any clip
    member_loss         mean of (Q_s,k - Y)^2 over the members and the agent's rows
    member_gradient     Euclidean norm of the gradient of a member of the agent's type, mean over them, before any clip
    member_spread       standard deviation over the members of Q_s,k at the actor's own action, mean over the batch
    temperature         alpha, the weight of entropy
    log_probability     mean log pi of the actions that the actor drew for the batch's observations
    realised_return     discounted, scaled rewards of the rows that followed those of the batch (see `newest_returns`)
    overestimation      mean Q of these rows' actions less their realised return

With an ensemble, Q is the mixture Q_P, whatever the losses are; without one, it is the agent's (first) critic. MASAC
has no `overestimation`: its values include entropy, and replay does not hold the entropy that followed a row. All but
norms, temperature and log_probability are in the units of the targets (rewards times `reward_scale`) or their squares.
"""

import math
from collections.abc import Mapping
from typing import Final

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from eia_sec.common.team import TeamSpec
from eia_sec.common.transitions import TERMINATED, TRANSITION
from eia_sec.learner.checkpoint.trainer_state import checked_tensors
from eia_sec.learner.off_policy.engine import Diagnostics
from eia_sec.learner.off_policy.index_set import Places
from eia_sec.learner.off_policy.replay import Replay

NAMES: Final = (
    "critic_loss",
    "actor_objective",
    "target_mean",
    "critic_error",
    "q_mean",
    "critic_gradient",
    "actor_gradient",
    "member_loss",
    "member_gradient",
    "member_spread",
    "temperature",
    "log_probability",
    "realised_return",
    "overestimation",
)
PREFIX: Final = "diagnostics."
"""Prefix of the running means' names in a checkpoint."""
SHARE: Final = 0.05
"""Weight of the newest diagnostics in the running means."""
RETURN_SHARE: Final = 0.2
"""Weight of the newest comparison with realised returns, which is made less often."""
RETURN_PERIOD: Final = 128
"""Every this many updates, Q is compared with realised returns."""
RETURN_ROWS: Final = 0.25
"""Share of the rows with a realised return that are compared; the newest policies' rows are chosen."""
REMAINDER: Final = 0.01
"""A realised return leaves out rewards whose weight gamma^k is below this."""
MAX_HORIZON: Final = 1000


def horizon(discount: float) -> int:
    """Return H, the steps after which gamma^H is below `REMAINDER`, at most `MAX_HORIZON`."""
    if discount <= REMAINDER:
        return 1
    return MAX_HORIZON if discount >= 1.0 else min(MAX_HORIZON, math.ceil(math.log(REMAINDER) / math.log(discount)))


def realised_returns(replay: Replay, places: Places, discount: float) -> tuple[Tensor, NDArray[np.bool_]]:
    """Return the realised returns of rows of replay: sum_{k < H} gamma^k r_{t+k}, under the policies that acted then.

    A return counts only if the ring holds all its rewards: H steps follow, or fewer that end in a terminal state. If a
    time limit or the newest row comes first, the rest of the return is unknown.

    Args:
        replay: the ring.
        places: [R] rows from which a step follows.
        discount: gamma.

    Returns:
        [R, agents] returns, and [R] whether they count.
    """
    last, going = places, np.ones(places.shape[0], np.bool_)
    total = torch.zeros(places.shape[0], replay.reward.shape[1], device=replay.reward.device)
    for k in range(horizon(discount)):
        share = torch.from_numpy(going.astype(np.float32)).to(total.device)[:, None] * discount**k
        total.addcmul_(share, replay.reward.index_select(0, torch.from_numpy(last).to(total.device)))
        following = replay.successor[last]
        beyond = going & ((replay.flag[following] & TRANSITION) != 0)
        last, stopped = np.where(beyond, following, last), going & ~beyond
        going = beyond
        if k == 0:
            cut = np.zeros_like(going)
        cut |= stopped & ((replay.flag[last] & TERMINATED) == 0) & (k + 1 < horizon(discount))
    return total, ~cut


def newest_returns(replay: Replay, places: Places, discount: float) -> tuple[Tensor, Places]:
    """Return realised returns of rows of replay, and which of these rows to compare.

    The more the policy has changed since a row, the less its return says about the present critics. So the quarter of
    the rows with the newest policy versions is chosen among those with a return.

    Returns:
        [R, agents] returns, and the chosen indices into R, empty if no return is known.
    """
    returns, counted = realised_returns(replay, places, discount)
    rows = np.flatnonzero(counted)
    age = np.argsort(-replay.version[places[rows]], kind="stable")
    return returns, rows[age[: math.ceil(RETURN_ROWS * rows.size)]]


class RunningDiagnostics:
    """The running means of a trainer.

    Args:
        team: the layout of the team.
        device: torch device.

    Attributes:
        means: running means [agents] by name.
        updates: number of updates whose diagnostics they include.
        comparisons: comparisons with realised returns.
    """

    def __init__(self, team: TeamSpec, device: str) -> None:
        self._team, self._device = team, device
        self.means: dict[str, Tensor] = {}
        self.updates = self.comparisons = 0

    def note(self, diagnostics: Diagnostics) -> None:
        """Add the diagnostics of one update to the running means."""
        rows = {
            "critic_loss": diagnostics.td_error.square().mean(dim=1),
            "actor_objective": None if diagnostics.objective is None else diagnostics.objective.mean(dim=1),
            "target_mean": diagnostics.target.mean(dim=1),
            "critic_error": diagnostics.td_error.abs().mean(dim=1),
            "q_mean": diagnostics.q_value.mean(dim=1),
            "critic_gradient": diagnostics.critic_gradient_norm,
            "actor_gradient": diagnostics.actor_gradient_norm,
            "member_loss": diagnostics.member_loss,
            "member_gradient": diagnostics.member_gradient_norm,
            "member_spread": None if diagnostics.member_std is None else diagnostics.member_std.mean(dim=1),
            "temperature": diagnostics.temperature,
            "log_probability": diagnostics.log_probability,
        }
        self._take(rows, SHARE)
        self.updates += 1

    def compare(self, diagnostics: Diagnostics, returns: Tensor, chosen: Places) -> None:
        """Compare Q of an update's batch with the realised returns [B, agents] of the chosen rows."""
        if chosen.size == 0:
            return
        rows = torch.from_numpy(chosen).to(returns.device)
        realised = returns.index_select(0, rows).mean(dim=0)
        if diagnostics.of_team:
            realised = realised.mean().expand_as(realised)
        value = diagnostics.q_value.float().index_select(1, rows).mean(dim=1)
        over = None if diagnostics.entropy_regularised else value - realised
        self._take({"realised_return": realised, "overestimation": over}, RETURN_SHARE)
        self.comparisons += 1

    def _take(self, rows: Mapping[str, Tensor | None], share: float) -> None:
        """Move the means [agents] towards newer values; the first value of a name becomes its mean."""
        for name, row in rows.items():
            if row is None:
                continue
            newest = row.float()
            if name in self.means:
                self.means[name].lerp_(newest, share)
            else:
                self.means[name] = newest.clone()

    def tensors(self) -> dict[str, Tensor]:
        """Return a copy of the means by their names in a checkpoint."""
        return {f"{PREFIX}{name}": mean.clone().cpu() for name, mean in self.means.items()}

    def kept(self, tensors: Mapping[str, Tensor]) -> dict[str, Tensor]:
        """Return the means [agents] in a checkpoint, by name; missing ones start anew.

        Checkpoints of early versions hold one tensor for all means. It is ignored, because some had another meaning.

        Raises:
            CheckpointError: when one does not fit the team, or is not finite.
        """
        like = torch.zeros(self._team.agents)
        names = [name for name in NAMES if f"{PREFIX}{name}" in tensors]
        found = checked_tensors({f"{PREFIX}{name}": like for name in names}, tensors)
        return {name: found[f"{PREFIX}{name}"].to(self._device, copy=True) for name in names}

    def by_type(self) -> dict[str, float]:
        """Return the means over each type's agents as NAME/TYPE, for the diagnostics that the algorithm reports."""
        parts = list(zip(self._team.groups, self._team.agent_slices(), strict=True))
        return {f"{name}/{group.name}": float(row[part].mean()) for name, row in self._rows() for group, part in parts}

    def by_agent(self) -> dict[str, float]:
        """Return each agent's means as NAME/TYPE-INDEX, for the diagnostics that the algorithm reports."""
        agents = [f"{group.name}-{index}" for group in self._team.groups for index in range(group.count)]
        return {
            f"{name}/{agent}": value
            for name, row in self._rows()
            for agent, value in zip(agents, row.tolist(), strict=True)
        }

    def _rows(self) -> list[tuple[str, Tensor]]:
        names = [name for name in NAMES if name in self.means]
        if not names:
            return []
        return list(zip(names, torch.stack([self.means[name] for name in names]).cpu(), strict=True))
