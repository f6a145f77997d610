"""The choices of a farm's UAVs, compiled: sampled options, their log-probabilities, and the velocities they become.

It is `TeamActors.sample` followed by `TeamSpec.adapt`, for teams in which every type chooses one of nine moves or one
of the headings. They are so few numbers that numpy's calls take ten times as long as their work.
"""

import math
from dataclasses import dataclass
from typing import Final

import numpy as np

from common.actions.adapters import EDGE, NEAR, Headings, Lattice, MirroredAxes, NineMoves
from common.actors import TeamActors
from common.team import Float32, GroupSpec, TeamSpec
from rollout.sim.kernel.compiler.decorators import compiled, compiled_entry

ONE: Final = np.float32(1)
ZERO: Final = np.float32(0)
HALF: Final = np.float32(0.5)
TWO: Final = np.float32(2)


@dataclass(frozen=True)
class _Kind:
    """What the compiled functions need of a type: see `sample_moves` and `sample_headings`."""

    lattice: bool
    table: Float32
    numbers: Float32
    mirrored: bool


class CompiledChoices:
    """The choices of a team's agents.

    Args:
        team: the layout of the team, which must be supported.
    """

    def __init__(self, team: TeamSpec) -> None:
        self._team = team
        self._kinds = [_kind(group) for group in team.groups]

    @staticmethod
    def supports(team: TeamSpec) -> bool:
        """Return whether every type of the team chooses one of nine moves or one of the headings."""
        return all(_is_supported(group) for group in team.groups)

    def sample(
        self, actors: TeamActors, observations: Float32, uniform: Float32, state: Float32 | None
    ) -> tuple[Float32, Float32, Float32]:
        """Sample the actions of all agents.

        Args:
            actors: the actors.
            observations: rows [E, O] float32.
            uniform: rows [E, A] float32, uniform over [0, 1).
            state: as for `TeamActors.outputs`.

        Returns:
            actions, rows [E, A] float32; log-probabilities [E, agents] float32; the environment's actions.
        """
        rows, agents = len(observations), self._team.agents
        option, log_probability = np.empty((2, rows, agents), np.float32)
        velocity = np.empty((rows, agents, 2), np.float32)
        parts = zip(self._kinds, self._team.agent_slices(), actors.outputs(observations, state), strict=True)
        for kind, own, (_, seen, logits) in parts:
            sample = sample_moves if kind.lattice else sample_headings
            chosen = option[:, own], log_probability[:, own], velocity[:, own]
            sample(logits, uniform[:, own], seen, kind.table, kind.numbers, kind.mirrored, *chosen)
        return option, log_probability, velocity.reshape(rows, -1)


def _is_supported(group: GroupSpec) -> bool:
    kinds = [type(adapter) for adapter in group.adapters]
    known = [NineMoves, Lattice], [Headings]
    if group.masked or kinds not in (*known, *([*some, MirroredAxes] for some in known)):
        return False
    first = group.adapters[0]
    return isinstance(first, NineMoves | Headings) and group.choices == (first.options,)


def _kind(group: GroupSpec) -> _Kind:
    first, second = (*group.adapters, None)[:2]
    mirrored = isinstance(group.adapters[-1], MirroredAxes)
    if isinstance(first, Headings):
        table = np.concatenate([np.zeros((1, 2), np.float32), first.velocities()])
        return _Kind(
            False, table, np.array([first.idle, max(2.0 * first.idle * first.reach, NEAR)], np.float32), mirrored
        )
    assert isinstance(second, Lattice)
    moves = np.array([[option // 3 - 1, option % 3 - 1] for option in range(NineMoves.options)], np.float32)
    counts, reach = (second.columns, second.rows), (second.reach_x, second.reach_y)
    return _Kind(True, moves, np.array([*counts, *reach, second.inset, EDGE], np.float32), mirrored)


@compiled
def _sample_option(logits: Float32, weight: Float32, uniform: np.float32) -> tuple[int, np.float32]:
    """Sample an option; return it and its log-probability, as `common.actions.sampling.sample_options` does."""
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
    count, reach, inset, edge = lattice[axis], lattice[2 + axis], lattice[4], lattice[5]
    share = (position + ONE) * HALF
    here = min(max(np.float32(math.floor(share * count + edge)), ZERO), count - ONE)
    cell = min(max(here + step, ZERO), count - ONE)
    goal = min(max(share, (cell + inset) / count), (cell + (ONE - inset)) / count)
    return min(max((goal - share) / reach, -ONE), ONE)


@compiled_entry
def sample_moves(
    logits: Float32,
    uniform: Float32,
    seen: Float32,
    steps: Float32,
    lattice: Float32,
    mirrored: bool,
    option: Float32,
    log_probability: Float32,
    velocity: Float32,
) -> None:
    """Sample one of nine moves for every agent of a type.

    Args:
        logits: [E, n, 9].
        uniform: [E, n] uniform over [0, 1).
        seen: [E, n, o] the agents' observations.
        steps: [9, 2] steps of each option.
        lattice: [6] columns, rows, reach along x and y, inset and tolerance of the lattice.
        mirrored: whether agents act along axes of their own.
        option: [E, n] out: the options.
        log_probability: [E, n] out: their log-probabilities.
        velocity: [E, n, 2] out: the velocities that lead there.
    """
    weight = np.empty(logits.shape[2], np.float32)
    for e in range(logits.shape[0]):
        for u in range(logits.shape[1]):
            chosen, log_probability[e, u] = _sample_option(logits[e, u], weight, uniform[e, u])
            option[e, u] = chosen
            for axis in range(2):
                found = _along(seen[e, u, axis], steps[chosen, axis], axis, lattice)
                velocity[e, u, axis] = -found if mirrored and seen[e, u, 2 + axis] < ZERO else found


@compiled
def _idle(x: np.float32, speed: np.float32, way: np.float32) -> np.float32:
    """Return the velocity along x of idle flight at a place, as `Headings.adapt` does."""
    cell = np.float32(math.floor(x / way))
    odd = cell - TWO * np.float32(math.floor(HALF * cell)) > HALF
    back = (odd or x > ONE - way) and not x < way - ONE
    return -speed if back else speed


@compiled_entry
def sample_headings(
    logits: Float32,
    uniform: Float32,
    seen: Float32,
    velocities: Float32,
    idle: Float32,
    mirrored: bool,
    option: Float32,
    log_probability: Float32,
    velocity: Float32,
) -> None:
    """Sample a heading, or idle flight, for every agent of a type.

    Args:
        logits: [E, n, options].
        uniform: [E, n] uniform over [0, 1).
        seen: [E, n, o] the agents' observations.
        velocities: [options, 2] of each heading; the first row is that of idle flight and has no meaning.
        idle: [2] speed of idle flight and its way in a step, see `Headings`.
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
            if chosen == 0:
                velocity[e, u, 0], velocity[e, u, 1] = _idle(seen[e, u, 0], idle[0], idle[1]), ZERO
            else:
                velocity[e, u, 0], velocity[e, u, 1] = velocities[chosen, 0], velocities[chosen, 1]
            for axis in range(2):
                if mirrored and seen[e, u, 2 + axis] < ZERO:
                    velocity[e, u, axis] = -velocity[e, u, axis]
