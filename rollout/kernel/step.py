"""The simulator's entrance: the start of an episode and one step of the whole batch.

Order inside step k, t = k t_step: motivation judges the commanded velocity by the direction seen before the step;
the UAVs move; relays are assigned and D_c(k) is taken at the new positions; sensors send and plots are photographed
there, credited with AoI(t - t_step) and VDF(t - t_step); counters rise or fall; then everybody observes.
"""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from rollout.kernel.arrays import Scratch, State
from rollout.kernel.camera import photograph
from rollout.kernel.compiled import compiled, compiled_entry, sources_digest
from rollout.kernel.constants import Constants
from rollout.kernel.motion import find_nearest, fly
from rollout.kernel.neighbours import gather
from rollout.kernel.observation import see_plots, see_relays, see_sensors
from rollout.kernel.quadrants import point, sum_plots, sum_sensors
from rollout.kernel.radio import collect, interfere
from rollout.kernel.relays import assign_relays, serve
from rollout.kernel.rewards import reward_step

Float32 = NDArray[np.float32]


@compiled
def _survey(c: Constants, state: State, scratch: Scratch, e: int) -> None:
    """Take stock at the present positions: nearest UAVs, relays, and sensors around."""
    position, relays = state.position[e], c.fleet.relays
    served, collectors = len(position) - relays, len(position) - c.fleet.collectors
    find_nearest(c.fleet, position, scratch.whole[0], scratch.uav[2], scratch.uav[3])
    assign_relays(
        c.fleet,
        c.relay,
        position,
        scratch.cost,
        scratch.numbers,
        scratch.indices,
        state.assignment[e],
        scratch.uav[4, :served],
    )
    scratch.uav[5, :relays] = state.service[e]
    serve(c.fleet, c.relay, position, state.assignment[e], state.service[e], scratch.centroid, scratch.whole[1])
    gather(
        c.fleet,
        c.observation,
        position,
        state.sensor[e],
        state.cell_start[e],
        scratch.around,
        scratch.square,
        scratch.whole[2, :collectors],
    )


@compiled
def _serve_tasks(c: Constants, state: State, scratch: Scratch, e: int) -> None:
    """Collect data and photograph plots at the present positions."""
    position, step = state.position[e], state.time[e]
    collectors = len(position) - c.fleet.collectors
    linked, power = scratch.uav[4], scratch.uav[6, :collectors]
    photograph(
        c.fleet,
        c.camera,
        position,
        linked,
        step,
        state.level[e],
        state.level_due[e],
        state.utility[e],
        scratch.item,
    )
    interfere(c.fleet, c.radio, position, state.sensor[e], scratch.whole[3], power)
    collect(
        c.fleet,
        c.radio,
        position,
        linked,
        state.key[e],
        step,
        state.sensor[e],
        scratch.around,
        scratch.square,
        scratch.whole[2, :collectors],
        power,
        state.age[e],
        state.age_due[e],
        state.cycle[e],
        state.utility[e],
        state.served[e],
        scratch.item,
        scratch.share,
    )


@compiled
def _observe(c: Constants, state: State, scratch: Scratch, e: int) -> None:
    """Find the directions and write the row of observations."""
    position, direction, seen = state.position[e], state.direction[e], state.observation[e]
    neighbour = scratch.whole[0]
    sum_plots(c.fleet, c.camera, position, state.level[e], scratch.integral, scratch.quadrant)
    sum_sensors(c.fleet, position, state.sensor[e], state.age[e], scratch.quadrant)
    for u in range(c.fleet.relays, len(position)):
        point(scratch.quadrant[u], direction[u])
    at = see_relays(c.fleet, position, neighbour, scratch.centroid, scratch.whole[1], seen, 0)
    at = see_plots(c.fleet, c.camera, position, neighbour, direction, state.level[e], seen, at)
    see_sensors(
        c.fleet,
        c.observation,
        c.radio.level_max,
        position,
        neighbour,
        direction,
        state.sensor[e],
        scratch.around,
        scratch.square,
        scratch.whole[2, : len(position) - c.fleet.collectors],
        state.age[e],
        scratch.whole[3],
        seen,
        at,
    )


@compiled
def _account(c: Constants, state: State, scratch: Scratch, e: int) -> None:
    """Add the step to the episode's sums; any UAV's four quadrants hold all plots or all sensors."""
    level, age, crowded, outside, energy = 0.0, 0.0, 0.0, 0.0, 0.0
    for quadrant in range(4):
        level += scratch.quadrant[c.fleet.relays, quadrant]
        age += scratch.quadrant[c.fleet.collectors, quadrant]
    for u in range(state.reward.shape[1]):
        crowded += scratch.uav[3, u]
        outside += scratch.uav[0, u]
        energy += state.energy[e, u]
        state.returns[e, u] += state.reward[e, u]
    sums = state.sums[e]
    sums[0] += age / state.age.shape[1]
    sums[1] += level / (state.level.shape[1] * state.level.shape[2])
    sums[2] += crowded
    sums[3] += outside
    sums[4] += energy


@compiled
def _step(c: Constants, state: State, scratch: Scratch, action: Float32, e: int) -> None:
    state.time[e] += 1
    uav = scratch.uav
    fly(
        c.fleet,
        c.flight,
        action,
        state.direction[e],
        state.position[e],
        scratch.place,
        state.energy[e],
        uav[0],
        uav[1],
    )
    _survey(c, state, scratch, e)
    _serve_tasks(c, state, scratch, e)
    reward_step(
        c.fleet,
        c.reward,
        scratch.place,
        scratch.whole[0],
        uav[2],
        state.energy[e],
        uav[0],
        uav[1],
        state.utility[e],
        state.service[e],
        uav[5],
        state.parts[e],
        state.reward[e],
    )
    _observe(c, state, scratch, e)
    _account(c, state, scratch, e)


def _compile_run(digest: str) -> Callable[..., None]:
    @compiled_entry
    def run(c: Constants, state: State, scratch: Scratch, action: Float32, begun: int) -> None:
        """Step every environment with its row of action [E, 2 n]; no environment sees another.

        If `begun` is not negative, nothing is stepped: that environment's episode starts, at the positions and
        levels in its state. It is one function so that the machine code is made once.
        """
        if begun >= 0 and digest != "":
            _survey(c, state, scratch, begun)
            _observe(c, state, scratch, begun)
        else:
            for e in range(len(action)):
                _step(c, state, scratch, action[e], e)

    return run


run = _compile_run(sources_digest())
