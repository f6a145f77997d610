"""Data collection: path loss, SINR, packet loss, and the age of information."""

import math

import numpy as np

from rollout.kernel.compiled import compiled
from rollout.kernel.constants import NEGLIGIBLE, Array, FleetConstants, Indices, RadioConstants
from rollout.kernel.neighbours import is_nearest
from rollout.kernel.planes import height_of

GOLDEN = np.uint64(0x9E3779B97F4A7C15)
MIX_1 = np.uint64(0xBF58476D1CE4E5B9)
MIX_2 = np.uint64(0x94D049BB133111EB)
SHIFT_32 = np.uint64(32)
SHIFT_31 = np.uint64(31)
SHIFT_30 = np.uint64(30)
SHIFT_27 = np.uint64(27)
SHIFT_11 = np.uint64(11)


@compiled
def draw(key: np.uint64, step: int, sensor: int) -> float:
    """Return the uniform number in [0, 1) of a packet: splitmix64 of the episode's key at counter (step, sensor).

    It depends on nothing else, so results do not depend on the batch or on the order of the draws.
    """
    state = key + GOLDEN * ((np.uint64(step) << SHIFT_32) | np.uint64(sensor))
    state = (state ^ (state >> SHIFT_30)) * MIX_1
    state = (state ^ (state >> SHIFT_27)) * MIX_2
    state = state ^ (state >> SHIFT_31)
    uniform: float = np.float64(state >> SHIFT_11) * 2.0**-53
    return uniform


@compiled
def received_power(radio: RadioConstants, square: float) -> float:
    """Return the power received over a distance given by its square, m^2, in mW: free space and vegetation (W12)."""
    return radio.power / square * math.exp(-radio.vegetation * math.exp(radio.half_exponent * math.log(square)))


@compiled
def delivery(radio: RadioConstants, signal: float, interference: float) -> float:
    """Return 1 - PLR = (1 - BER)^(8 L) from the signal's and the interferers' power, mW; 0 below NEGLIGIBLE."""
    sinr = signal / (interference + radio.noise)
    error = 0.5 * (math.erfc(math.sqrt(sinr)) if radio.exact else math.exp(-sinr))
    chance = math.exp(radio.bits * math.log1p(-error))
    return chance if chance >= NEGLIGIBLE else 0.0


@compiled
def _square(position: Array, u: int, sensor: Array, j: int) -> float:
    """Return the square of the horizontal distance from a UAV to a sensor, m^2."""
    dx, dy = sensor[0, j] - position[u, 0], sensor[1, j] - position[u, 1]
    square: float = dx * dx + dy * dy
    return square


@compiled
def interfere(
    fleet: FleetConstants, radio: RadioConstants, position: Array, sensor: Array, woken: Indices, power: Array
) -> None:
    """Sum up what disturbs each data collection UAV (W14).

    Args:
        fleet: the UAVs.
        radio: the link.
        position: [n, 2] m.
        sensor: [2, S] m.
        woken: [n_d] scratch: the nearest sensor that each UAV wakes, -1 if it wakes none.
        power: [n_d] out: power from the strongest woken sensor of each other UAV, mW; 0 without the switch.
    """
    for k in range(len(power)):
        power[k] = 0.0
        woken[k] = -1
    if not radio.interference:
        return
    first, count = fleet.collectors, len(power)
    for j in range(sensor.shape[1]):
        owner, apart = 0, math.inf
        for k in range(count):
            square = _square(position, first + k, sensor, j)
            if square < apart:
                owner, apart = k, square
        if woken[owner] < 0 or apart < _square(position, first + owner, sensor, woken[owner]):
            woken[owner] = j
    height = height_of(fleet, first)
    for k in range(count):
        for other in range(count):
            if other != k and woken[other] >= 0:
                square = _square(position, first + k, sensor, woken[other])
                power[k] += received_power(radio, square + height * height)


@compiled
def _share_delivered(radio: RadioConstants, chance: float, key: np.uint64, step: int, sensor: int) -> float:
    """Return T_S: 1 or 0 by the packet's draw, or its chance itself in expected delivery (W17)."""
    if radio.expected:
        return chance
    return 1.0 if draw(key, step, sensor) < chance else 0.0


@compiled
def send(
    fleet: FleetConstants,
    radio: RadioConstants,
    position: Array,
    linked: Array,
    key: np.uint64,
    step: int,
    sensor: Array,
    around: Indices,
    square: Array,
    number: Indices,
    interference: Array,
    age: Array,
    due: Indices,
    utility: Array,
    served: Array,
    sent: Indices,
    share: Array,
) -> int:
    """Let every sensor send to its nearest data collection UAV, and credit AoI(t - t_step) of what arrives (W17, W19).

    Returns how many sensors delivered. One with AoI 0 that is not due needs no packet: it stays at 0 either way.

    Args:
        fleet: the UAVs.
        radio: the link.
        position: [n, 2] m.
        linked: [n_m + n_d] 1 where deliveries count (W4).
        key: of the episode's packets.
        step: number of this step, from 1.
        sensor: [2, S] m.
        around: [n_d, S] sensors around each UAV.
        square: [n_d, S] squares of their horizontal distances, m^2.
        number: [n_d] how many.
        interference: [n_d] mW.
        age: [S] AoI before the step.
        due: [S] step at which AoI rises next.
        utility: [n] out for these UAVs: DCUF of this step.
        served: [n_d] out: sensors of AoI above 0 that delivered (their shares, in expected delivery).
        sent: [S] out: the sensors that delivered.
        share: [S] out: which share, 1 but in expected delivery.
    """
    delivered, first, limit = 0, fleet.collectors, radio.reach * radio.reach
    height = height_of(fleet, first)
    for k in range(len(number)):
        utility[first + k], served[k] = 0.0, 0.0
        for entry in range(number[k] if linked[first + k - fleet.relays] == 1.0 else 0):
            j, apart = around[k, entry], square[k, entry]
            idle = apart > limit or (age[j] == 0.0 and due[j] != step)
            if idle or not is_nearest(position, first, fleet.uavs, first + k, sensor[0, j], sensor[1, j], apart):
                continue
            chance = delivery(radio, received_power(radio, apart + height * height), interference[k])
            part = _share_delivered(radio, chance, key, step, j)
            if part > 0.0:
                utility[first + k] += age[j] * part
                served[k] += part if age[j] > 0.0 else 0.0
                sent[delivered], share[delivered] = j, part
                delivered += 1
    return delivered


@compiled
def update_age(
    radio: RadioConstants,
    step: int,
    delivered: int,
    sent: Indices,
    share: Array,
    age: Array,
    due: Indices,
    cycle: Indices,
) -> None:
    """Let AoI rise by 1, up to AoI_max, where a cycle ends, and fall to 0 where data arrived (W18).

    Args:
        radio: AoI_max.
        step: number of this step, from 1.
        delivered: how many sensors delivered.
        sent: [S] which they are.
        share: [S] the share that each delivered.
        age: [S] AoI; updated.
        due: [S] step at which it rises next; updated.
        cycle: [S] T_UA, steps.
    """
    for j in range(len(age)):
        if due[j] == step:
            age[j] = min(age[j] + 1.0, radio.level_max)
            due[j] += cycle[j]
    for entry in range(delivered):
        age[sent[entry]] *= 1.0 - share[entry]
