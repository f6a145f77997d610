"""Data collection: path loss, SINR, packet loss, and the age of information."""

import math
import sys
from typing import Final

import numpy as np

from eia_sec.rollout.sim.core.arrays import Farm, Scratch
from eia_sec.rollout.sim.core.compile import allocation_free, inlined
from eia_sec.rollout.sim.core.constants import Constants, FleetConstants
from eia_sec.rollout.sim.core.hindsight import note_packet
from eia_sec.rollout.sim.core.link import CHANCES, NEGLIGIBLE, RadioConstants
from eia_sec.rollout.sim.core.neighbours import block_around, gather, is_nearest
from eia_sec.rollout.sim.core.planes import height_of
from eia_sec.rollout.sim.core.records import Array
from eia_sec.rollout.sim.core.tallies import add_sensor, tally_sensors

GOLDEN = np.uint64(0x9E3779B97F4A7C15)
MIX_1 = np.uint64(0xBF58476D1CE4E5B9)
MIX_2 = np.uint64(0x94D049BB133111EB)
SHIFT_32 = np.uint64(32)
SHIFT_31 = np.uint64(31)
SHIFT_30 = np.uint64(30)
SHIFT_27 = np.uint64(27)
SHIFT_11 = np.uint64(11)
LEAST_AGE: Final = sys.float_info.min
"""The least AoI above 0."""


@allocation_free
def draw(key: np.uint64, step: int, sensor: int) -> float:
    """Return a packet's uniform number in [0, 1): splitmix64 of the episode's key at counter (step, sensor).

    The number depends on nothing else, so neither the batch nor the order of draws changes the results.
    """
    state = key + GOLDEN * ((np.uint64(step) << SHIFT_32) | np.uint64(sensor))
    state = (state ^ (state >> SHIFT_30)) * MIX_1
    state = (state ^ (state >> SHIFT_27)) * MIX_2
    state = state ^ (state >> SHIFT_31)
    uniform: float = np.float64(state >> SHIFT_11) * 2.0**-53
    return uniform


@allocation_free
def received_power(radio: RadioConstants, square: float) -> float:
    """Return the power received at a distance whose square is given, m^2, in mW: free space and vegetation (W12)."""
    return radio.power / square * math.exp(-radio.vegetation * math.exp(radio.half_exponent * math.log(square)))


@allocation_free
def delivery(radio: RadioConstants, signal: float) -> float:
    """Return 1 - PLR = (1 - BER)^(8 L) from the signal's power, mW; 0 below NEGLIGIBLE (W13 to W16)."""
    chance = math.exp(radio.bits * math.log1p(-0.5 * math.exp(-signal / radio.noise)))
    return chance if chance >= NEGLIGIBLE else 0.0


@allocation_free
def table_chance(table: Array, scale: float, square: float) -> float:
    """Return from a table how probably a packet arrives over a horizontal distance whose square is given, m^2.

    Args:
        table: see `observation.constants.chance_table`; the square is at most that of its last distance.
        scale: pieces per square metre.
        square: m^2.
    """
    at = square * scale
    piece = int(at)
    chance: float = table[piece] + (at - piece) * (table[piece + 1] - table[piece])
    return chance


@allocation_free
def _square(position: Array, u: int, sensor: Array, j: int) -> float:
    """Return the square of the horizontal distance from a UAV to a sensor, m^2."""
    dx, dy = sensor[0, j] - position[u, 0], sensor[1, j] - position[u, 1]
    square: float = dx * dx + dy * dy
    return square


@allocation_free
def _arrives(radio: RadioConstants, square: float, height: float, key: np.uint64, step: int, sensor: int) -> bool:
    """Return T_S, by the packet's draw (W17).

    Most draws fall outside the probability's bounds at that distance, so the probability is rarely computed.
    """
    uniform = draw(key, step, sensor)
    piece = min(CHANCES - 1, int(square * (CHANCES / (radio.reach * radio.reach))))
    if uniform < radio.chances[piece, 0]:
        return True
    if uniform > radio.chances[piece, 1]:
        return False
    return uniform < delivery(radio, received_power(radio, square + height * height))


@allocation_free
def _belongs(
    fleet: FleetConstants, position: Array, apart_square: Array, u: int, sensor: Array, j: int, square: float
) -> bool:
    """Return whether a sensor sends to this data collection UAV."""
    x, y = sensor[0, j], sensor[1, j]
    nearest: bool = is_nearest(position, apart_square, fleet.collectors, fleet.uavs, u, x, y, square)
    return nearest


@inlined
def send(c: Constants, farm: Farm, s: Scratch) -> int:
    """Let every sensor send to its nearest data collection UAV; credit AoI(t - t_step) of what arrives (W17, W19).

    A sensor with AoI 0 that is not due needs no packet, because it stays at 0 either way. A delivery counts only if the
    UAV's relay is in range (W4).

    Writes `utility` of the data collection UAVs (DCUF) and `served`, the number of sensors with AoI above 0 that
    delivered. Writes to the scratch `item`, the sensors that delivered. Updates `sensor_visit` and `hindsight` if
    visits are tracked.

    Returns:
        the number of sensors that delivered.
    """
    fleet, seen, radio, position, sensor, age, due = (
        c.fleet,
        c.observation,
        c.radio,
        farm.position,
        farm.sensor,
        farm.age,
        farm.age_due,
    )
    apart_square, linked, key, step = s.apart_square, s.linked, farm.key[0], farm.time[0]
    cell_start, rising, around, square, sent = farm.cell_start, farm.rising, s.around, s.square, s.item
    utility, served = farm.utility, farm.served
    delivered, first, limit, due_now = 0, fleet.collectors, radio.reach * radio.reach, rising[0] == step
    height, least = height_of(fleet, first), 0.0 if due_now else LEAST_AGE
    for k in range(len(served)):
        u, credit, number = first + k, 0.0, 0.0
        x, y = position[u, 0], position[u, 1]
        block, found = block_around(fleet, seen, x, y, radio.reach), 0
        if linked[u - fleet.relays] == 1.0:
            found = gather(seen, block, x, y, least, math.inf, limit, sensor, cell_start, age, around, square)
        for entry in range(found):
            j, apart = around[entry], square[entry]
            if not (age[j] > 0.0 or due[j] == step):
                continue
            if not _belongs(fleet, position, apart_square, u, sensor, j, apart):
                continue
            if _arrives(radio, apart, height, key, step, j):
                credit += age[j]
                number += 1.0 if age[j] > 0.0 else 0.0
                sent[delivered] = j
                delivered += 1
                note_packet(c, farm, u, j)
        utility[u], served[k] = credit, number
    return delivered


@inlined
def update_age(c: Constants, farm: Farm, s: Scratch, delivered: int) -> None:
    """Raise AoI by 1, up to AoI_max, where a cycle ends; reset it to 0 where data arrived (W18).

    Updates `age`, `age_due`, `rising`, `waiting` and the tally of AoI.

    Args:
        c: constants.
        farm: the environment.
        s: scratch, with the sensors that delivered.
        delivered: the number of sensors that delivered.
    """
    fleet, seen, radio, sensor, cell_start, step = (
        c.fleet,
        c.observation,
        c.radio,
        farm.sensor,
        farm.cell_start,
        farm.time[0],
    )
    rising, age, due, cycle, sent = farm.rising, farm.age, farm.age_due, farm.cycle, s.item
    below, above, waiting = farm.age_below, farm.age_above, farm.waiting
    due_now = rising[0] == step
    if due_now:
        soonest = due[0] + cycle[0]
        for j in range(len(age)):
            if due[j] == step:
                age[j] = min(age[j] + 1.0, radio.level_max)
                due[j] += cycle[j]
            soonest = min(soonest, due[j])
        rising[0] = soonest
        tally_sensors(seen, cell_start, age, below, above, waiting)
    for entry in range(delivered):
        j = sent[entry]
        if age[j] > 0.0:
            add_sensor(fleet, seen, sensor[0, j], sensor[1, j], -age[j], -1, below, above, waiting)
        age[j] = 0.0
