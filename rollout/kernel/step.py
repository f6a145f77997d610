"""The simulator's entrance: the start of an episode and one step of the whole batch.

Order inside step k, t = k t_step: motivation judges the commanded velocity by the direction seen before the step;
the UAVs move; relays are assigned and D_c(k) is taken at the new positions; sensors send and plots are photographed
there, credited with AoI(t - t_step) and VDF(t - t_step); counters rise or fall; then everybody observes.
"""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from rollout.kernel.arrays import Farm, Scratch, State
from rollout.kernel.camera import photograph
from rollout.kernel.compiled import compiled, compiled_entry, sources_digest
from rollout.kernel.constants import Constants
from rollout.kernel.motion import find_nearest, fly
from rollout.kernel.neighbours import gather, prefer_waiting
from rollout.kernel.observation import see_plots, see_relays, see_sensors
from rollout.kernel.quadrants import point, sum_plots, sum_sensors
from rollout.kernel.radio import interfere, send, update_age
from rollout.kernel.relays import assign_relays, serve
from rollout.kernel.rewards import reward_step

Float32 = NDArray[np.float32]


@compiled
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
    )


@compiled
def _survey(c: Constants, farm: Farm, s: Scratch) -> None:
    """Take stock at the present positions: nearest UAVs, relays, and sensors around."""
    find_nearest(c.fleet, farm.position, s.neighbour, s.distance, s.crowded)
    assign_relays(c.fleet, c.relay, farm.position, s.cost, s.numbers, s.indices, farm.assignment, s.linked)
    for i in range(c.fleet.relays):
        s.earlier[i] = farm.service[i]
    serve(c.fleet, c.relay, farm.position, farm.assignment, farm.service, s.centroid, s.farthest)
    gather(c.fleet, c.observation, farm.position, farm.sensor, farm.cell_start, s.around, s.square, s.number)


@compiled
def _serve_tasks(c: Constants, farm: Farm, s: Scratch) -> None:
    """Photograph plots and collect data at the present positions."""
    photograph(c.fleet, c.camera, farm.position, s.linked, farm.step, farm.level, farm.level_due, farm.utility, s.item)
    interfere(c.fleet, c.radio, farm.position, farm.sensor, s.woken, s.power)
    delivered = send(
        c.fleet,
        c.radio,
        farm.position,
        s.linked,
        farm.key,
        farm.step,
        farm.sensor,
        s.around,
        s.square,
        s.number,
        s.power,
        farm.age,
        farm.age_due,
        farm.utility,
        farm.served,
        s.item,
        s.share,
    )
    update_age(c.radio, farm.step, delivered, s.item, s.share, farm.age, farm.age_due, farm.cycle)


@compiled
def _observe(c: Constants, farm: Farm, s: Scratch) -> None:
    """Find the directions and write the row of observations."""
    sum_plots(c.fleet, c.camera, farm.position, farm.level, s.plots, s.quadrant)
    sum_sensors(c.fleet, c.observation, farm.position, farm.sensor, farm.cell_start, farm.age, s.cells, s.quadrant)
    point(c.fleet, s.quadrant, farm.direction)
    seen = farm.observation
    at = see_relays(c.fleet, farm.position, s.neighbour, s.centroid, s.farthest, seen, 0)
    at = see_plots(c.fleet, c.camera, farm.position, s.neighbour, farm.direction, farm.level, seen, at)
    if c.observation.waiting:
        prefer_waiting(
            c.fleet, c.observation, farm.position, farm.sensor, farm.cell_start, farm.age, s.around, s.square, s.number
        )
    see_sensors(
        c.fleet,
        c.observation,
        c.radio.level_max,
        farm.position,
        s.neighbour,
        farm.direction,
        farm.sensor,
        s.around,
        s.square,
        s.number,
        farm.age,
        s.nearest,
        seen,
        at,
    )


@compiled
def _account(c: Constants, farm: Farm, s: Scratch) -> None:
    """Add the step to the episode's sums; any UAV's four quadrants hold all plots or all sensors."""
    sums = farm.sums
    for quadrant in range(4):
        sums[0] += s.quadrant[c.fleet.collectors, quadrant] / len(farm.age)
        sums[1] += s.quadrant[c.fleet.relays, quadrant] / farm.level.size
    for u in range(c.fleet.uavs):
        sums[2] += s.crowded[u]
        sums[3] += s.outside[u]
        sums[4] += farm.energy[u]
        farm.returns[u] += farm.reward[u]


@compiled
def _step(c: Constants, farm: Farm, s: Scratch, action: Float32) -> None:
    fly(c.fleet, c.flight, action, farm.direction, farm.position, s.previous, farm.energy, s.outside, s.motivated)
    _survey(c, farm, s)
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


def _compile_run(digest: int) -> Callable[..., None]:
    @compiled_entry
    def run(c: Constants, state: State, scratch: Scratch, action: Float32, begun: int) -> None:
        """Step every environment with its row of action [E, 2 n]; no environment sees another.

        If `begun` is not negative, nothing is stepped: that environment's episode starts, at the positions and
        levels in its state. It is one function so that the machine code is made once.
        """
        if begun >= 0 and digest > 0:
            farm = _farm(state, begun)
            _survey(c, farm, scratch)
            _observe(c, farm, scratch)
        else:
            for e in range(len(action)):
                state.time[e] += 1
                _step(c, _farm(state, e), scratch, action[e])

    return run


run = _compile_run(sources_digest())
