"""Values of options: those of the options that were chosen, and which legal options have the highest ones.

The outputs of a type's actors hold a value for each option of each branch (see `eia_sec.common.actors`). An agent's
value is the sum over its branches of the values of the options that it chooses.
"""

import torch
from torch import Tensor

from eia_sec.common.team import GroupSpec, TeamSpec
from eia_sec.learner.off_policy.inputs import Inputs, action_layout


class OptionValues:
    """Reads the outputs of all actors of a team with discrete actions.

    Args:
        team: the layout of the team.
        batch: rows of a batch, B.
        like: a tensor of the wanted device.
    """

    def __init__(self, team: TeamSpec, batch: int, like: Tensor) -> None:
        self._types = [_Type(group, batch, like.device) for group in team.groups]
        self._actions = action_layout(team)
        self._lengths = [group.count * batch * group.options for group in team.groups]

    def chosen(self, outputs: Tensor, actions: Tensor) -> Tensor:
        """Return each agent's value of its action [agents, B].

        Args:
            outputs: flat, see `Actors.outputs`.
            actions: rows [B, A] of indices.
        """
        parts = zip(self._types, outputs.split(self._lengths), self._actions.by_agent(actions), strict=True)
        return torch.cat([own.chosen(part, action.long()) for own, part, action in parts])

    def highest(self, outputs: Tensor, judge: Tensor, inputs: Inputs) -> Tensor:
        """Return each agent's value [agents, B], as one network judges it, of the best legal action in another's view.

        Args:
            outputs: of the network that chooses, flat, see `Actors.outputs`.
            judge: of the network that says what the choice is worth.
            inputs: whose observations hold the masks.
        """
        each = zip(self._types, *(x.split(self._lengths) for x in (outputs, judge)), inputs.actor, strict=True)
        return torch.cat([own.chosen(second, own.best(first, seen)) for own, first, second, seen in each])


class _Type:
    """The options of one type of agent.

    Args:
        group: the type.
        batch: rows of a batch, B.
        device: torch device.
    """

    def __init__(self, group: GroupSpec, batch: int, device: torch.device) -> None:
        self._shape, self._masked = (group.count, batch, group.options), group.masked
        sizes = torch.tensor(group.choices, device=device)
        self._starts, self._last = sizes.cumsum(0) - sizes, sizes - 1
        # Branches below one another, as wide as the widest; a narrower one repeats its last option.
        column = torch.arange(max(group.choices), device=device)
        self._columns = self._starts[:, None] + column.minimum(self._last[:, None])

    def chosen(self, outputs: Tensor, action: Tensor) -> Tensor:
        """Return the values [n_v, B] of actions, indices [n_v, B, branches]."""
        return outputs.view(self._shape).gather(2, action + self._starts).sum(dim=2)

    def best(self, outputs: Tensor, seen: Tensor) -> Tensor:
        """Return the legal options of highest value, indices [n_v, B, branches], for observations [n_v, B, o_v]."""
        values = outputs.view(self._shape)
        if self._masked:
            values = values.masked_fill(seen[..., -self._shape[2] :] <= 0.5, -torch.inf)
        return values[..., self._columns].argmax(dim=3).minimum(self._last)
