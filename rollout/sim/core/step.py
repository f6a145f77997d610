"""The simulator's entry points: the start of an episode, the check of a step and the step itself.

Inside step k, at t = k t_step, the order is:
1. Motivation compares the commanded velocity with the direction observed before the step.
2. UAVs fail, if any does in this step, and the others move. Batteries empty, or charge.
3. Relays are assigned, and D_c(k) is computed at the new positions.
4. Sensors send and plots are photographed, for credit of AoI(t - t_step) and VDF(t - t_step).
5. Counters rise or fall, in patches and areas of stress faster. UAVs find the patches that they are over.
6. All UAVs observe.

Inside a stage every function takes the same three records: `Constants` from the configuration, `Farm` with the state of
one environment, and `Scratch`, which every step overwrites. A stage takes the workspace's address and is compiled by
itself. All stages in one function took the compiler 1.5 times as long.
"""

from typing import Final

import numpy as np

from eia_sec.rollout.sim.conditions.battery import use_charge
from eia_sec.rollout.sim.conditions.failures import lose_uavs, show_places
from eia_sec.rollout.sim.conditions.stress import change_cycles, find_stress
from eia_sec.rollout.sim.conditions.ways import bar_steps, close_plots
from eia_sec.rollout.sim.core.arrays import Farm, Scratch
from eia_sec.rollout.sim.core.camera import photograph
from eia_sec.rollout.sim.core.compile import allocation_free, allocation_free_entry, inlined
from eia_sec.rollout.sim.core.constants import Constants
from eia_sec.rollout.sim.core.motion import find_nearest, fly
from eia_sec.rollout.sim.core.quadrants import point_to_age, point_to_level
from eia_sec.rollout.sim.core.radio import send, update_age
from eia_sec.rollout.sim.core.records import Float32, row_maker
from eia_sec.rollout.sim.core.relays import assign_relays, measure_service
from eia_sec.rollout.sim.core.rewards import reward_step
from eia_sec.rollout.sim.core.tallies import tally_plots, tally_sensors, total
from eia_sec.rollout.sim.core.workspace import unpack
from eia_sec.rollout.sim.observation.added import prepare_views
from eia_sec.rollout.sim.observation.plans.places import list_points
from eia_sec.rollout.sim.observation.rows import see_plots, see_relays, see_sensors

POSSIBLE: Final = 0
"""The step is allowed."""
NOT_FINITE: Final = 1
"""An action is not finite."""
OUT_OF_TIME: Final = 2
"""An environment's episode has not begun, or is over."""
STEP: Final = 0
"""Simulate a step."""
BEGIN: Final = 1
"""Begin an episode at the positions and levels in the state; nobody fails, flies or uses charge."""
FOLLOW: Final = 2
"""Take a step over that real UAVs have flown: positions, motions, charges and levels after it are in the state, and
positions before it in the scratch."""
LARGEST: Final = np.finfo(np.float32).max


_farm: Final = row_maker(Farm)
"""Compiled: returns the views of one environment, `_farm(state, e)`."""


@inlined
def _start(c: Constants, farm: Farm, s: Scratch) -> None:
    """Prepare what an episode needs that begins with this state."""
    if c.plans.steps > 0:
        list_points(c.fleet, c.plans, c.added, farm.sensor, farm.plan_first, farm.plan_point, farm.plan_chance)
    if c.ways.some:
        bar_steps(c.ways, c.fleet.zone_first, farm.zone_side, farm.zone_box, farm.barred)
        if c.seen.route:
            close_plots(c.ways, farm.barred, s.way_steps, s.way_queue, farm.closed)
    for k in range(len(farm.listed)):
        for rank in range(c.seen.sensors):
            farm.listed[k, rank] = rank
    for u in range(c.fleet.uavs):
        s.previous[u, 0], s.previous[u, 1] = farm.position[u, 0], farm.position[u, 1]


@allocation_free
def _move(address: int, e: int, how: int) -> None:
    """Fail, fly, use charge and assign relays; what does not simulate a step counts the levels in the state up."""
    c, state, s, action = unpack(address)
    farm = _farm(state, e)
    if how != STEP:
        tally_plots(farm.level, farm.level_below, farm.level_above)
        tally_sensors(c.observation, farm.cell_start, farm.age, farm.age_below, farm.age_above, farm.waiting)
    anew = how != STEP
    if how == BEGIN:
        _start(c, farm, s)
    elif c.fleet.mortal:
        anew |= lose_uavs(c, farm)
    if how == STEP:
        fly(c, farm, s, action[e])
        if c.battery.some:
            use_charge(c, farm, s)
    if c.fleet.mortal:
        show_places(farm)
    find_nearest(c, farm, s)
    assign_relays(c, farm, s, anew)
    measure_service(c, farm, s)


@allocation_free
def _serve(address: int, e: int) -> None:
    """Photograph plots and collect data at the current positions, and pay for it."""
    c, state, s, _ = unpack(address)
    farm = _farm(state, e)
    if c.stress.some:
        change_cycles(c, farm)
    photograph(c, farm, s)
    delivered = send(c, farm, s)
    update_age(c, farm, s, delivered)
    reward_step(c, farm, s)
    if c.stress.some:
        find_stress(c, farm)
    _add_up(c, farm, s)


@inlined
def _add_up(c: Constants, farm: Farm, s: Scratch) -> None:
    """Add the step to the episode's sums."""
    sums = farm.sums
    sums[0] += total(farm.age_above) / len(farm.age)
    sums[1] += total(farm.level_above) / farm.level.size
    for u in range(c.fleet.uavs):
        sums[2] += s.crowded[u]
        sums[3] += s.outside[u]
        sums[4] += farm.energy[u]
        farm.returns[u] += farm.reward[u]


@allocation_free
def _observe(address: int, e: int) -> None:
    """Find the directions and write the row of observations."""
    c, state, s, _ = unpack(address)
    farm = _farm(state, e)
    point_to_level(c, farm)
    point_to_age(c, farm)
    if c.added.some:
        prepare_views(c, farm, s)
    time = farm.time[0] * c.observation.per_steps
    monitors = see_relays(c, farm, s, time, 0)
    collectors = see_plots(c, farm, s, time, monitors)
    see_sensors(c, farm, s, time, collectors)


@allocation_free
def _objection(state: Farm, action: Float32, steps: int) -> int:
    """Return why the environments cannot be stepped, or POSSIBLE."""
    for e in range(len(action)):
        if state.time[e, 0] < 0 or state.time[e, 0] >= steps:
            return OUT_OF_TIME
    finite = True
    for e in range(len(action)):
        for k in range(action.shape[1]):
            finite &= abs(action[e, k]) <= LARGEST
    return POSSIBLE if finite else NOT_FINITE


@allocation_free_entry
def check_step(address: int) -> int:
    """Return whether the workspace's actions can step all environments: NOT_FINITE, OUT_OF_TIME or POSSIBLE.

    Args:
        address: address of a workspace.
    """
    c, state, _, action = unpack(address)
    return _objection(state, action, c.fleet.steps)


@allocation_free_entry
def step_range(address: int, first: int, last: int, check: bool, how: int) -> int:
    """Step environments `first` to `last` - 1 independently with the workspace's actions.

    Args:
        address: address of a workspace, see `PackedArguments`.
        first: first environment.
        last: one past the last.
        check: whether to run `check_step` first and step nothing if it finds a problem.
        how: STEP, BEGIN or FOLLOW.

    Returns:
        NOT_FINITE, OUT_OF_TIME or POSSIBLE.
    """
    c, state, _, action = unpack(address)
    if check:
        objection = _objection(state, action, c.fleet.steps)
        if objection != POSSIBLE:
            return objection
    for e in range(first, last):
        state.time[e, 0] += 0 if how == BEGIN else 1
        _move(address, e, how)
        if how == STEP:
            _serve(address, e)
        _observe(address, e)
    return POSSIBLE
