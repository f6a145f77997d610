"""The rewards r_c, r_m and r_d of a step, part by part.

    relays       r_c = - alpha_1 (D_c(k) - D_c(k-1)) t_step + w sum_u (r_u - r_u')   positioning, relayed
    monitors     r_m = + alpha_5 VMUF t_step - alpha_6 P_M t_step + alpha_7 M_V t_step      utility, idle, motivation
    collectors   r_d = + alpha_8 DCUF t_step - alpha_9 P_C t_step + alpha_10 M_D t_step     utility, idle, motivation
    everybody    ... - alpha_2 (E(k) - E(k-1)) - alpha_3 SR t_step - alpha_4 ACT t_step     energy, risk, boundary

D_c is a relay's distance from where it serves well, and the relay earns the decrease of D_c in the step. `relays.py`
computes it: `service` holds D_c(k), `earlier` holds D_c(k-1). P_M and P_C are 1 in a step that serves nothing. The
energy is already an amount, so t_step does not multiply it (W7).

The sum of `relayed` (ours) is over the UAVs u that the relay serves, and with a base station also over those whose
relay is joined to it only over this one: their utility and idle parts r_u in this step less r_u' without the links of
this relay. It is a difference reward with the weight w, and 0 unless `farm.relay.require_link`. The weights are the
options `farm.reward`, and `RewardConstants` holds them with their signs.

If you change these equations, change the oracle `rollout/sim/reference/farm.py` too. If you change the positioning
part, change `FarmBatch.potential`, which `rollout/worker/reward_shaping.py` uses.
"""

import math
from typing import Final

from eia_sec.rollout.sim.conditions.links import join_relays
from eia_sec.rollout.sim.core.arrays import Farm, Scratch
from eia_sec.rollout.sim.core.compile import inlined
from eia_sec.rollout.sim.core.constants import Constants
from eia_sec.rollout.sim.core.motion import safety_risk

POSITIONING: Final = 0
ENERGY: Final = 1
RISK: Final = 2
BOUNDARY: Final = 3
UTILITY: Final = 4
IDLE: Final = 5
MOTIVATION: Final = 6
RELAYED: Final = 7
"""Columns of `parts`, in the order of `REWARD_PARTS`."""


@inlined
def _relayed(c: Constants, farm: Farm, s: Scratch, relay: int) -> float:
    """Return what UAVs earn in this step and would not without the links of a relay.

    Without its link a UAV has no utility, so it loses its utility's part and is idle. One that has none loses nothing.
    A UAV with utility has a link, so its relay is joined where there is a base station.
    """
    fleet, weight, amount = c.fleet, c.reward, 0.0
    if c.relay.chained:
        join_relays(c.relay, farm.position, farm.gone, relay, math.inf, math.inf, s.joined_then, s.queue)
    for served in range(len(farm.assignment)):
        u, own = fleet.relays + served, farm.assignment[served]
        if farm.utility[u] > 0.0 and (own == relay or (c.relay.chained and not s.joined_then[own])):
            task = 0 if u < fleet.collectors else 1
            amount += (weight.utility[task] * farm.utility[u] - weight.idle[task]) * fleet.seconds
    return amount


@inlined
def reward_step(c: Constants, farm: Farm, s: Scratch) -> None:
    """Write the weighted parts of every UAV's reward into `parts` [n, K], and their sums into `reward` [n].

    A UAV that is gone earns 0.
    """
    fleet, weight, parts, seconds = c.fleet, c.reward, farm.parts, c.fleet.seconds
    for u in range(fleet.uavs):
        for part in range(parts.shape[1]):
            parts[u, part] = 0.0
        if farm.gone[u]:
            farm.reward[u] = 0.0
            continue
        risk = safety_risk(fleet, s.previous, s.neighbour, s.distance, u)
        parts[u, ENERGY] = weight.energy * farm.energy[u]
        parts[u, RISK] = weight.risk * risk * seconds
        parts[u, BOUNDARY] = weight.boundary * s.outside[u] * seconds
        if u < fleet.relays:
            parts[u, POSITIONING] = weight.positioning * (farm.service[u] - s.earlier[u]) * seconds
            if weight.relayed != 0.0:
                parts[u, RELAYED] = weight.relayed * _relayed(c, farm, s, u)
        else:
            task = 0 if u < fleet.collectors else 1
            parts[u, UTILITY] = weight.utility[task] * farm.utility[u] * seconds
            parts[u, IDLE] = weight.idle[task] * seconds if farm.utility[u] == 0.0 else 0.0
            parts[u, MOTIVATION] = weight.motivation[task] * s.motivated[u] * seconds
        total = 0.0
        for part in range(parts.shape[1]):
            total += parts[u, part]
        farm.reward[u] = total
