"""The simulator's entrance: the start of an episode and one step of the whole batch.

Order inside step k, t = k t_step: motivation judges the commanded velocity by the direction seen before the step;
the UAVs move; relays are assigned and D_c(k) is taken at the new positions; sensors send and plots are photographed
there, credited with AoI(t - t_step) and VDF(t - t_step); counters rise or fall; then everybody observes.
"""

from collections.abc import Callable
from typing import Final

import numpy as np
from numpy.typing import NDArray

from rollout.sim.kernel.arrays import Farm, Scratch, State
from rollout.sim.kernel.camera import photograph
from rollout.sim.kernel.compiler.argument_pack import thaw
from rollout.sim.kernel.compiler.decorators import merged, sealed, sealed_entry, sources_digest
from rollout.sim.kernel.compiler.prefetch import ask_for
from rollout.sim.kernel.constants import Constants
from rollout.sim.kernel.motion import find_nearest, fly
from rollout.sim.kernel.observation import see_plots, see_relays, see_sensors
from rollout.sim.kernel.radio import interfere, send, update_age
from rollout.sim.kernel.relays import assign_relays, serve
from rollout.sim.kernel.rewards import reward_step
from rollout.sim.kernel.spatial.quadrants import point_to_age, point_to_level
from rollout.sim.kernel.spatial.tallies import tally_plots, tally_sensors, total

Float32 = NDArray[np.float32]

BEGIN: Final = 0
STEP: Final = 1
CHECK: Final = 2
NOTHING: Final = 0
"""Nothing forbids the step."""
NOT_FINITE: Final = 1
"""An action is not finite."""
OUT_OF_TIME: Final = 2
"""An environment's episode has not begun, or is over."""
LARGEST: Final = np.finfo(np.float32).max


@merged
def _farm(state: State, e: int) -> Farm:
    """Return the views of one environment."""
    return Farm(
        state.key[e],
        state.time[e],
        state.position[e],
        state.direction[e],
        state.assignment[e],
        state.service[e],
        state.sensor[e],
        state.cell_start[e],
        state.by_row[e],
        state.row_start[e],
        state.cycle[e],
        state.age[e],
        state.age_due[e],
        state.level[e],
        state.level_due[e],
        state.observation[e],
        state.reward[e],
        state.parts[e],
        state.energy[e],
        state.utility[e],
        state.served[e],
        state.returns[e],
        state.sums[e],
        state.rising[e],
        state.age_below[e],
        state.age_above[e],
        state.waiting[e],
        state.level_below[e],
        state.level_above[e],
        state.listed[e],
        state.quality[e],
    )


@merged
def _survey(c: Constants, farm: Farm, s: Scratch, fresh: bool) -> None:
    """Take stock at the present positions: nearest UAVs and relays."""
    find_nearest(c.fleet, farm.position, s.x, s.y, s.peer, s.apart_square, s.neighbour, s.distance, s.crowded)
    assign_relays(
        c.fleet, c.relay, farm.position, s.x, s.y, fresh, s.assigning, farm.assignment, s.linked, farm.quality
    )
    for i in range(c.fleet.relays):
        s.earlier[i] = farm.service[i]
    serve(c.fleet, c.relay, farm.position, farm.assignment, farm.service, s.centroid, s.farthest, s.number, s.far)


@merged
def _serve_tasks(c: Constants, farm: Farm, s: Scratch) -> None:
    """Photograph plots and collect data at the present positions."""
    photograph(
        c.fleet,
        c.camera,
        farm.position,
        s.apart_square,
        s.linked,
        farm.step,
        farm.rising,
        farm.level,
        farm.level_due,
        farm.level_below,
        farm.level_above,
        farm.utility,
        s.item,
    )
    interfere(c.fleet, c.radio, farm.position, farm.sensor, s.woken, s.power)
    delivered = send(
        c.fleet,
        c.observation,
        c.radio,
        farm.position,
        s.apart_square,
        s.linked,
        farm.key,
        farm.step,
        farm.sensor,
        farm.cell_start,
        s.power,
        farm.rising,
        farm.age,
        farm.age_due,
        farm.utility,
        farm.served,
        s.around,
        s.square,
        s.item,
        s.share,
    )
    update_age(
        c.fleet,
        c.observation,
        c.radio,
        farm.step,
        delivered,
        s.item,
        s.share,
        farm.sensor,
        farm.cell_start,
        farm.rising,
        farm.age,
        farm.age_due,
        farm.cycle,
        farm.age_below,
        farm.age_above,
        farm.waiting,
    )


@merged
def _observe(c: Constants, farm: Farm, s: Scratch) -> None:
    """Find the directions and write the row of observations."""
    point_to_level(c.fleet, c.camera, farm.position, farm.level_below, farm.level_above, farm.direction)
    point_to_age(
        c.fleet,
        c.observation,
        farm.position,
        farm.sensor,
        farm.cell_start,
        farm.by_row,
        farm.row_start,
        farm.age,
        farm.age_below,
        farm.age_above,
        farm.direction,
    )
    seen = farm.observation
    what, time = c.observation, farm.step * c.observation.per_steps
    at = see_relays(c.fleet, what, time, farm.position, s.peer, s.neighbour, s.centroid, s.farthest, seen, 0)
    at = see_plots(c.fleet, what, time, c.camera, farm.position, s.neighbour, farm.direction, farm.level, seen, at)
    see_sensors(
        c.fleet,
        what,
        time,
        c.radio.level_max,
        farm.position,
        s.neighbour,
        farm.direction,
        farm.sensor,
        farm.cell_start,
        farm.age,
        farm.waiting,
        s.around,
        s.square,
        farm.listed,
        s.nearest_square,
        seen,
        at,
    )


@sealed
def _begin(c: Constants, farm: Farm, s: Scratch) -> None:
    """Start an episode at the positions and levels that are in its state."""
    tally_plots(farm.level, farm.level_below, farm.level_above)
    tally_sensors(c.observation, farm.cell_start, farm.age, farm.age_below, farm.age_above, farm.waiting)
    for k in range(len(farm.listed)):
        for rank in range(c.observation.sensors):
            farm.listed[k, rank] = rank
    _survey(c, farm, s, True)
    _observe(c, farm, s)


@merged
def _account(c: Constants, farm: Farm, s: Scratch) -> None:
    """Add the step to the episode's sums."""
    sums = farm.sums
    sums[0] += total(farm.age_above) / len(farm.age)
    sums[1] += total(farm.level_above) / farm.level.size
    for u in range(c.fleet.uavs):
        sums[2] += s.crowded[u]
        sums[3] += s.outside[u]
        sums[4] += farm.energy[u]
        farm.returns[u] += farm.reward[u]


@merged
def _step(c: Constants, farm: Farm, s: Scratch, action: Float32) -> None:
    fly(c.fleet, c.flight, action, farm.direction, farm.position, s.previous, farm.energy, s.outside, s.motivated)
    _survey(c, farm, s, False)
    _serve_tasks(c, farm, s)
    reward_step(
        c.fleet,
        c.reward,
        s.previous,
        s.neighbour,
        s.distance,
        farm.energy,
        s.outside,
        s.motivated,
        farm.utility,
        farm.service,
        s.earlier,
        farm.parts,
        farm.reward,
    )
    _observe(c, farm, s)
    _account(c, farm, s)


@sealed
def _objection(farms: State, action: Float32, steps: int) -> int:
    """Return what forbids a step, or NOTHING."""
    for e in range(len(action)):
        if farms.time[e] < 0 or farms.time[e] >= steps:
            return OUT_OF_TIME
    finite = True
    for e in range(len(action)):
        for k in range(action.shape[1]):
            finite &= abs(action[e, k]) <= LARGEST
    return NOTHING if finite else NOT_FINITE


def _compile_run(digest: int) -> Callable[..., int]:
    @sealed_entry
    def run(address: int, task: int, first: int, last: int) -> int:
        """Work on environments; none sees another.

        It is one function so that the machine code is made once.

        Args:
            address: of a frame stored by `FrozenFrame`.
            task: BEGIN starts their episodes at the positions and levels in their state. STEP steps them with the
                frame's actions, unchecked. CHECK steps nothing, and looks at all environments. STEP + CHECK checks all,
                and steps only if nothing forbids it.
            first: first environment.
            last: one past the last.

        Returns:
            NOTHING, NOT_FINITE or OUT_OF_TIME.
        """
        c, state, scratch, action = thaw(address)
        if task >= CHECK and digest > 0:
            objection = _objection(state, action, c.fleet.steps)
            if objection != NOTHING or task == CHECK:
                return objection
        for e in range(first, last):
            if e + 1 < last:
                ask_for(state, e + 1)
            if task == BEGIN:
                _begin(c, _farm(state, e), scratch)
            else:
                state.time[e] += 1
                _step(c, _farm(state, e), scratch, action[e])
        return NOTHING

    return run


run = _compile_run(sources_digest())
