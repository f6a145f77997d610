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
from eia_sec.rollout.sim.core.records import Array, Indices
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
def delivery(radio: RadioConstants, signal: float, interference: float) -> float:
    """Return 1 - PLR = (1 - BER)^(8 L) from the signal and interference power, mW; 0 below NEGLIGIBLE."""
    sinr = signal / (interference + radio.noise)
    error = 0.5 * (math.erfc(math.sqrt(sinr)) if radio.exact else math.exp(-sinr))
    chance = math.exp(radio.bits * math.log1p(-error))
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


@inlined
def interfere(c: Constants, farm: Farm, s: Scratch) -> None:
    """Sum up the interference at each data collection UAV (W14).

    Writes to `power` the power from the strongest sensor that each other UAV wakes, mW; 0 if interference is off.
    Writes to `woken` the nearest sensor that each UAV wakes, -1 for none.
    """
    fleet, radio, position, sensor, woken, power = c.fleet, c.radio, farm.position, farm.sensor, s.woken, s.power
    for k in range(len(power)):
        power[k] = 0.0
        woken[k] = -1
    if radio.interference:
        _wake(fleet, position, sensor, woken)
        _disturb(fleet, radio, position, sensor, woken, power)


@allocation_free
def _wake(fleet: FleetConstants, position: Array, sensor: Array, woken: Indices) -> None:
    """For each data collection UAV, find the nearest of the sensors that send to it."""
    first, count = fleet.collectors, len(woken)
    for j in range(sensor.shape[1]):
        owner, apart = 0, math.inf
        for k in range(count):
            square = _square(position, first + k, sensor, j)
            if square < apart:
                owner, apart = k, square
        if woken[owner] < 0 or apart < _square(position, first + owner, sensor, woken[owner]):
            woken[owner] = j


@allocation_free
def _disturb(
    fleet: FleetConstants, radio: RadioConstants, position: Array, sensor: Array, woken: Indices, power: Array
) -> None:
    """Add up the power that each UAV receives from the sensors that other UAVs wake, mW."""
    first, count = fleet.collectors, len(power)
    height = height_of(fleet, first)
    for k in range(count):
        for other in range(count):
            if other != k and woken[other] >= 0:
                square = _square(position, first + k, sensor, woken[other])
                power[k] += received_power(radio, square + height * height)


@allocation_free
def _share_delivered(
    radio: RadioConstants, square: float, height: float, interference: float, key: np.uint64, step: int, sensor: int
) -> float:
    """Return T_S: 1 or 0 by the packet's draw, or the probability itself in expected delivery (W17).

    Most draws fall outside the probability's bounds at that distance, so the probability is rarely computed.
    """
    uniform = draw(key, step, sensor)
    piece = min(CHANCES - 1, int(square * (CHANCES / (radio.reach * radio.reach))))
    if uniform < radio.chances[piece, 0]:
        return 1.0
    if uniform > radio.chances[piece, 1]:
        return 0.0
    chance = delivery(radio, received_power(radio, square + height * height), interference)
    if radio.expected:
        return chance
    return 1.0 if uniform < chance else 0.0


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
    delivered (in expected delivery, the sum of their shares). Writes to the scratch `item`, the sensors that delivered,
    and `share`, the share that each delivered. Updates `sensor_visit` and `hindsight` if visits are tracked.

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
    apart_square, linked, interference, key, step = s.apart_square, s.linked, s.power, farm.key[0], farm.time[0]
    cell_start, rising, around, square, sent, share = farm.cell_start, farm.rising, s.around, s.square, s.item, s.share
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
            j, apart, part = around[entry], square[entry], 0.0
            if (age[j] > 0.0 or due[j] == step) and _belongs(fleet, position, apart_square, u, sensor, j, apart):
                part = _share_delivered(radio, apart, height, interference[k], key, step, j)
            if part > 0.0:
                credit += age[j] * part
                number += part if age[j] > 0.0 else 0.0
                sent[delivered], share[delivered] = j, part
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
    rising, age, due, cycle, sent, share = farm.rising, farm.age, farm.age_due, farm.cycle, s.item, s.share
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
    if due_now and not radio.expected:
        tally_sensors(seen, cell_start, age, below, above, waiting)
    for entry in range(delivered):
        j = sent[entry]
        if not radio.expected and age[j] > 0.0:
            add_sensor(fleet, seen, sensor[0, j], sensor[1, j], -age[j], -1, below, above, waiting)
        age[j] *= 1.0 - share[entry]
    if radio.expected and (due_now or delivered > 0):
        tally_sensors(seen, cell_start, age, below, above, waiting)
