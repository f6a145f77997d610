"""What each visit turns out to have been worth to the team, once the next visit of the same plot or sensor is known.

A visit that finds a counter at u pays u. Without it the counter would have gone on, and whoever comes next would have
been paid more, unless it reached the cap meanwhile. Say the next visit pays v, and z rises were removed in between: a
counter that is due to rise in the very step that serves it stays at 0 (`test_batch.py` has an example). If v is below
the cap, the counter rose v times; without the visit it would have risen z + v times from u on. So the visit is worth

    u + v - min(cap, u + z + v) = max(u + v - cap, -z)

to the team. If v is the cap, both sides are u, so the equation holds there too. If nobody is paid for the counter again
before the episode ends, the visit is worth u.

A visit begins with a service that pays and lasts until the next one that pays. The services in between, by whatever
UAV, find the counter at 0 and belong to it: to leave out a visit is to leave out these as well. Otherwise a UAV that
stays in range for a second step would make its first image worthless, because the second would be paid in its place.

`hindsight` holds what to add to the reward of the visit's agent in the visit's step, weight (worth - u) t_step. No
counter depends on another, so the corrections of one agent in one step add up. Only the utility is corrected. Leaving
out a visit may also make its own UAV idle in that step, for which its own reward already pays, and nobody else.
"""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from eia_sec.rollout.sim.core.arrays import Farm
from eia_sec.rollout.sim.core.compile import allocation_free, inlined
from eia_sec.rollout.sim.core.constants import Constants
from eia_sec.rollout.sim.core.records import Int32

STEP: Final = 0
"""Step of the last visit; 0 for none."""
AGENT: Final = 1
"""Row index of the UAV that was paid."""
VALUE: Final = 2
"""What it was paid, u."""
REMOVED: Final = 3
"""Rises that services have removed since, z."""


@allocation_free
def _note(
    visit: Int32,
    hindsight: NDArray[np.float32],
    item: int,
    agent: int,
    step: int,
    value: float,
    removed: int,
    cap: float,
    weight: float,
) -> None:
    """Note a service.

    Args:
        visit: [items, 4] the last visit of each plot or sensor; the columns are above.
        hindsight: [T, n] corrections.
        item: the plot or sensor.
        agent: row index of the UAV.
        step: the current step, from 1.
        value: the counter that the service found.
        removed: 1 if the counter was due to rise in this step, else 0.
        cap: the most that the counter reaches.
        weight: reward of one unit.
    """
    if value == 0.0:
        visit[item, REMOVED] += removed
        return
    earlier, paid = visit[item, STEP], float(visit[item, VALUE])
    if earlier > 0:
        worth = max(paid + value - cap, -float(visit[item, REMOVED]))
        hindsight[earlier - 1, visit[item, AGENT]] += weight * (worth - paid)
    visit[item, STEP], visit[item, AGENT] = step, agent
    visit[item, VALUE], visit[item, REMOVED] = int(value), removed


@inlined
def note_image(c: Constants, farm: Farm, u: int, column: int, row: int) -> None:
    """Note a good image of a plot, before its counter changes, if visits are tracked."""
    if len(farm.hindsight) > 0:
        _note(
            farm.plot_visit,
            farm.hindsight,
            column * c.camera.plots_y + row,
            u,
            farm.time[0],
            farm.level[column, row],
            1 if farm.level_due[column, row] == farm.time[0] else 0,
            c.camera.level_max,
            c.reward.utility[0] * c.fleet.seconds,
        )


@inlined
def note_packet(c: Constants, farm: Farm, u: int, j: int) -> None:
    """Note a delivered packet, before the sensor's counter changes, if visits are tracked."""
    if len(farm.hindsight) > 0:
        _note(
            farm.sensor_visit,
            farm.hindsight,
            j,
            u,
            farm.time[0],
            farm.age[j],
            1 if farm.age_due[j] == farm.time[0] else 0,
            c.radio.level_max,
            c.reward.utility[1] * c.fleet.seconds,
        )
