"""What the updates of the newest iteration measured, by type of agent.

    actor_loss           PPO's surrogate loss with the entropy bonus
    value_loss           sum over the type's value functions of mean((V - R)^2)
    entropy              mean entropy of the policies, nats
    kl                   KL divergence from the behaviour policy to the actors, mean over the newest epoch
    clipped_share        share of samples whose ratio was clipped
    explained_variance   1 - Var(R - V) / Var(R) with the values at the iteration's start
    return_mean          mean R
    actor_gradient       Euclidean norm of the gradient of the type's actors, before any clip
    value_gradient       the same of its value functions

All but the first iteration report means over the updates of the last whole iteration, so that numbers do not jump.
"""

from collections.abc import Sequence
from typing import Final

from torch import Tensor

from common.team import Float32, TeamSpec
from learner.on_policy.policies import ActorLoss

NAMES: Final = (
    "actor_loss",
    "value_loss",
    "entropy",
    "kl",
    "clipped_share",
    "explained_variance",
    "return_mean",
    "actor_gradient",
    "value_gradient",
)


class IterationDiagnostics:
    """Means over an iteration's updates.

    Args:
        team: the layout of the team.
    """

    def __init__(self, team: TeamSpec) -> None:
        self._groups = list(zip(team.groups, team.agent_slices(), strict=True))
        self._sums: list[dict[str, list[float]]] = [{} for _ in self._groups]
        self._epoch: list[list[float]] = [[] for _ in self._groups]
        self.newest: dict[str, float] = {}

    def begin(self, value: Float32, returns: Float32) -> None:
        """Start an iteration with the values and returns [steps, agents] of its steps."""
        self._sums = [{} for _ in self._groups]
        self._epoch = [[] for _ in self._groups]
        for sums, (_, agents) in zip(self._sums, self._groups, strict=True):
            own, error = returns[:, agents], returns[:, agents] - value[:, agents]
            variance = float(own.var())
            sums["explained_variance"] = [1.0 - float(error.var()) / variance if variance > 0.0 else 0.0]
            sums["return_mean"] = [float(own.mean())]

    def add(
        self,
        actors: Sequence[ActorLoss | None],
        values: Sequence[Tensor],
        norms: Sequence[tuple[float, float]],
    ) -> None:
        """Add an update: each type's losses, None for stopped actors, and gradient norms."""
        for kind, sums in enumerate(self._sums):
            measured = {"value_loss": float(values[kind].detach()), "value_gradient": norms[kind][1]}
            if (part := actors[kind]) is not None:
                kl = float(part.kl)
                measured |= {
                    "actor_loss": float(part.loss.detach()),
                    "entropy": float(part.entropy),
                    "kl": kl,
                    "clipped_share": float(part.clipped),
                    "actor_gradient": norms[kind][0],
                }
                self._epoch[kind].append(kl)
            for name, number in measured.items():
                sums.setdefault(name, []).append(number)

    def epoch_kl(self) -> list[float]:
        """Return each type's mean KL divergence over the epoch, and begin another epoch; 0 for stopped actors."""
        means = [sum(kls) / len(kls) if kls else 0.0 for kls in self._epoch]
        self._epoch = [[] for _ in self._groups]
        return means

    def end(self) -> None:
        """Finish the iteration: its means are reported from now on."""
        self.newest = {
            f"{name}/{group.name}": sum(sums[name]) / len(sums[name])
            for name in NAMES
            for sums, (group, _) in zip(self._sums, self._groups, strict=True)
            if sums.get(name)
        }
