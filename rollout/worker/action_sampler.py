"""How a worker samples actions on policy: `TeamActors.sample`, and then `TeamSpec.adapt`.

Teams in which every type chooses one of nine moves or one of the headings, as a farm's UAVs do, have compiled code for
both. They are so few numbers that numpy's calls take ten times as long as their work.
"""

import math
from dataclasses import dataclass
from typing import Final

import numpy as np

from eia_sec.common.actions.adapters import Headings, Lattice, MirroredAxes, NineMoves
from eia_sec.common.actors import TeamActors
from eia_sec.common.team import Float32, GroupSpec, TeamSpec
from eia_sec.rollout.sim.core.compile import compiled, compiled_entry
from eia_sec.rollout.sim.core.lattice import cell_at, cell_beside, share_of, velocity_to

ONE: Final = np.float32(1)
ZERO: Final = np.float32(0)
HALF: Final = np.float32(0.5)
TWO: Final = np.float32(2)


@dataclass(frozen=True)
class _Compiled:
    """What `sample_choices` needs of a type, see there."""

    table: Float32
    lattice: Float32
    idle: Float32
    mirrored: bool


class ActionSampler:
    """Samples the actions of a team's agents.

    Args:
        team: the layout of the team.

    Attributes:
        compiled: whether compiled code does it.
    """

    def __init__(self, team: TeamSpec) -> None:
        self._team = team
        self.compiled = all(_has_compiled_code(group) for group in team.groups)
        self._types = [_compiled(group) for group in team.groups] if self.compiled else []

    def sample(
        self, actors: TeamActors, observations: Float32, normal: Float32, uniform: Float32, state: Float32 | None
    ) -> tuple[Float32, Float32, Float32]:
        """Sample the actions of all agents.

        Args:
            actors: the actors.
            observations: rows [E, O] float32.
            normal: as for `TeamActors.sample`.
            uniform: likewise.
            state: likewise.

        Returns:
            actions, rows [E, A] float32; log-probabilities [E, agents] float32; the environment's actions.
        """
        if not self.compiled:
            action, log_probability = actors.sample(observations, normal, uniform, state)
            return action, log_probability, self._team.adapt(observations, action)
        rows, agents = len(observations), self._team.agents
        option, log_probability = np.empty((2, rows, agents), np.float32)
        velocity = np.empty((rows, agents, 2), np.float32)
        parts = zip(self._types, self._team.agent_slices(), actors.outputs(observations, state), strict=True)
        for kind, own, (_, seen, logits) in parts:
            found = option[:, own], log_probability[:, own], velocity[:, own]
            sample_choices(logits, uniform[:, own], seen, kind.table, kind.lattice, kind.idle, kind.mirrored, *found)
        return option, log_probability, velocity.reshape(rows, -1)


def _has_compiled_code(group: GroupSpec) -> bool:
    kinds = [type(adapter) for adapter in group.adapters]
    known = [NineMoves, Lattice], [Headings]
    if group.masked or kinds not in (*known, *([*some, MirroredAxes] for some in known)):
        return False
    first = group.adapters[0]
    return isinstance(first, NineMoves | Headings) and group.choices == (first.options,)


def _compiled(group: GroupSpec) -> _Compiled:
    first, second = (*group.adapters, None)[:2]
    mirrored, nothing = isinstance(group.adapters[-1], MirroredAxes), np.zeros(0, np.float32)
    if isinstance(first, Headings):
        table = np.concatenate([np.zeros((1, 2), np.float32), first.velocities()])
        return _Compiled(table, nothing, np.array([first.idle, first.way], np.float32), mirrored)
    assert isinstance(first, NineMoves)
    assert isinstance(second, Lattice)
    steps = first.adapt(nothing, np.arange(first.options, dtype=np.float32)[:, None])
    counts, reach = (second.columns, second.rows), (second.reach_x, second.reach_y)
    return _Compiled(steps, np.array([*counts, *reach, second.inset], np.float32), nothing, mirrored)


@compiled
def _sample_option(logits: Float32, weight: Float32, uniform: np.float32) -> tuple[int, np.float32]:
    """Sample an option; return it and its log-probability, as `eia_sec.common.actions.sampling.sample_options` does."""
    top = logits[0]
    for option in range(1, len(logits)):
        top = max(top, logits[option])
    total = ZERO
    for option in range(len(logits)):
        weight[option] = math.exp(logits[option] - top)
        total += weight[option]
    threshold, cumulated, chosen = uniform * total, ZERO, 0
    for option in range(len(logits)):
        cumulated += weight[option]
        chosen += cumulated <= threshold
    if chosen == len(logits):  # rounding put the threshold behind the last option with a positive weight
        chosen -= 1
        while weight[chosen] == ZERO:
            chosen -= 1
    return chosen, np.float32(math.log(weight[chosen] / total))


@compiled
def _along(position: np.float32, step: np.float32, axis: int, lattice: Float32) -> np.float32:
    """Return the velocity along an axis that a step on the lattice becomes, as `Lattice.velocity` does."""
    count, share = lattice[axis], share_of(position)
    return velocity_to(cell_beside(cell_at(share, count), step, count), share, count, lattice[2 + axis], lattice[4])


@compiled
def _idle(x: np.float32, speed: np.float32, way: np.float32) -> np.float32:
    """Return the velocity along x of idle flight at a place, as `Headings.adapt` does."""
    cell = np.float32(math.floor(x / way))
    odd = cell - TWO * np.float32(math.floor(HALF * cell)) > HALF
    back = (odd or x > ONE - way) and not x < way - ONE
    return -speed if back else speed


@compiled_entry
def sample_choices(
    logits: Float32,
    uniform: Float32,
    seen: Float32,
    table: Float32,
    lattice: Float32,
    idle: Float32,
    mirrored: bool,
    option: Float32,
    log_probability: Float32,
    velocity: Float32,
) -> None:
    """Sample an option for every agent of a type, and find the velocity that it becomes.

    Args:
        logits: [E, n, options].
        uniform: [E, n] uniform over [0, 1).
        seen: [E, n, o] the agents' observations.
        table: [options, 2] steps of the nine moves, or velocities of the headings after idle flight.
        lattice: [5] columns, rows, reach along x and y, and inset of the moves' lattice; [0] for headings.
        idle: [2] speed of idle flight and its way in a step, see `Headings`; [0] for moves.
        mirrored: whether agents act along axes of their own.
        option: [E, n] out: the options.
        log_probability: [E, n] out: their log-probabilities.
        velocity: [E, n, 2] out: the velocities.
    """
    weight = np.empty(logits.shape[2], np.float32)
    for e in range(logits.shape[0]):
        for u in range(logits.shape[1]):
            chosen, log_probability[e, u] = _sample_option(logits[e, u], weight, uniform[e, u])
            option[e, u] = chosen
            for axis in range(2):
                found = table[chosen, axis]
                if len(lattice) > 0:
                    found = _along(seen[e, u, axis], found, axis, lattice)
                elif chosen == 0 and axis == 0:
                    found = _idle(seen[e, u, 0], idle[0], idle[1])
                velocity[e, u, axis] = -found if mirrored and seen[e, u, 2 + axis] < ZERO else found
