"""The farm written directly from the equations: the readable oracle for tests of the compiled simulator.

It is plain NumPy, slow, and simulates one environment. It shares only the layout and the start with the kernel. Its
physics is in dB and metres, as in the paper; the kernel uses precomputed linear factors.
"""

import math

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

from eia_sec.common.config import FarmConfig, RadioConfig
from eia_sec.common.team import Float32
from eia_sec.rollout.sim.conditions.failures import failure_steps
from eia_sec.rollout.sim.conditions.stress import patches
from eia_sec.rollout.sim.conditions.wind import wind_series
from eia_sec.rollout.sim.core.relays import NO_LINK
from eia_sec.rollout.sim.layout import Layout
from eia_sec.rollout.sim.reference.airspace import air_velocity, stopped
from eia_sec.rollout.sim.reference.battery import use_charge
from eia_sec.rollout.sim.reference.dynamics import glide, stop
from eia_sec.rollout.sim.reference.links import joined_to_base, relayed
from eia_sec.rollout.sim.reference.power import dbm_to_mw, flight_power, other_power
from eia_sec.rollout.sim.reference.routes import advance, divide_again, first_sweep
from eia_sec.rollout.sim.reference.state import Array, FarmState
from eia_sec.rollout.sim.reference.stress import find, plot_cycles, sensor_cycles
from eia_sec.rollout.sim.reference.views import observe
from eia_sec.rollout.sim.reference.ways import ways_of
from eia_sec.rollout.sim.start import packet_key, start_levels, start_positions

NEGLIGIBLE = 1e-12
"""A packet with a smaller probability of arrival is not sent (ours)."""
DIRECTIONS = np.array([(1, 1), (-1, 1), (-1, -1), (1, -1)]) / math.sqrt(2.0)
"""The four diagonals in the order in which ties are broken (W25)."""


def free_space_loss(radio: RadioConfig, distance: Array | float) -> Array:
    """PL_FS = 20 log10(Dis) + 20 log10(f_c) + 32.44 dB, Dis in km (W12)."""
    return np.asarray(20.0 * np.log10(np.asarray(distance) / 1000.0) + 20.0 * np.log10(radio.carrier_mhz) + 32.44)


def vegetation_loss(radio: RadioConfig, distance: Array | float) -> Array:
    """PL_veg = a_1 f_c^a_2 Dis^a_3 dB, Dis in m (W12)."""
    scale = radio.vegetation_scale * radio.carrier_mhz**radio.vegetation_frequency_exponent
    return np.asarray(scale * np.asarray(distance) ** radio.vegetation_distance_exponent)


def received_mw(radio: RadioConfig, distance: Array | float) -> Array:
    """P_WT + G_WS - PL(i, j, t), in mW."""
    loss = free_space_loss(radio, distance) + vegetation_loss(radio, distance)
    return dbm_to_mw(radio.sensor_power_dbm + radio.sensor_gain_dbi - loss)


def noise_mw(radio: RadioConfig) -> float:
    """P_T = k_B T_K Bw, in mW (W13)."""
    return radio.boltzmann * radio.temperature_k * radio.bandwidth_hz * 1000.0


def packet_loss(radio: RadioConfig, sinr: Array | float) -> Array:
    """PLR = 1 - (1 - BER)^(8 L) with BER = Q(sqrt(2 SINR)) (W15, W16)."""
    sinr = np.asarray(sinr)
    return np.asarray(1.0 - (1.0 - 0.5 * np.exp(-sinr)) ** (8 * radio.packet_bytes))


def packet_draw(key: int, step: int, sensor: int) -> float:
    """Return a packet's uniform random number: splitmix64 of the episode's key at counter (step, sensor)."""
    mask = 2**64 - 1
    z = (key + 0x9E3779B97F4A7C15 * (step * 2**32 + sensor)) & mask
    z = ((z ^ (z >> 30)) * 0xBF58476D1CE4E5B9) & mask
    z = ((z ^ (z >> 27)) * 0x94D049BB133111EB) & mask
    return float((z ^ (z >> 31)) >> 11) / 2.0**53


def safety_risk(safety: float, now: float, before: float) -> float:
    """SR from d_U(t) and d(t - t_step) of the same pair, m (W8)."""
    return 0.0 if now >= safety else max(0.0, before - now)


def densest_direction(own: Array, places: Array, value: Array) -> Array:
    """Return D_VDF or D_AoI: the diagonal of the quadrant with the largest sum, or (0, 0) (W25)."""
    right, upper = places[:, 0] >= own[0], places[:, 1] >= own[1]
    sums = [value[where].sum() for where in (right & upper, ~right & upper, ~right & ~upper, right & ~upper)]
    return DIRECTIONS[int(np.argmax(sums))] if max(sums) > 0 else np.zeros(2)


class ReferenceFarm(FarmState):
    """One simulated farm.

    Args:
        config: the farm.
        layout: the farm's sensors.
        episode_seed: determines where the UAVs start, which packets arrive and when UAVs fail.
    """

    def __init__(self, config: FarmConfig, layout: Layout, episode_seed: int) -> None:
        world = config.world
        self.config, self.layout, self.time = config, layout, 0
        self.kind = np.repeat((0, 1, 2), (world.communication_uavs, world.monitoring_uavs, world.collection_uavs))
        heights = (world.height_communication, world.height_monitoring, world.height_collection)
        self.height = np.array(heights)[self.kind]
        self.key = packet_key(layout.seed, episode_seed)
        self.position = start_positions(world, layout.seed, episode_seed, layout.zones)
        self.before = self.position
        self.velocity, self.acceleration, self.command = np.zeros((3, world.uavs, 2))
        self.wind = wind_series(config, layout.seed, episode_seed)
        self.failure = failure_steps(config, layout.seed, episode_seed)
        self.gone = np.zeros(world.uavs, bool)
        self.aoi, self.vdf = start_levels(world, layout.seed, episode_seed)
        x = (np.arange(world.plots_x) + 0.5) * world.field_x / world.plots_x
        y = (np.arange(world.plots_y) + 0.5) * world.field_y / world.plots_y
        self.plot_xy = np.stack(np.meshgrid(x, y, indexing="ij"), axis=-1).reshape(-1, 2)
        self.patches = patches(config, layout.seed, episode_seed)
        self.charge = np.full(world.uavs, config.battery.capacity)
        self.known = np.zeros(config.stress.patches, bool)
        self.chance = np.zeros(world.sensors)
        self.energy, self.utility, self.reward = np.zeros(world.uavs), np.zeros(world.uavs), np.zeros(world.uavs)
        self.parts = np.zeros((world.uavs, 8))
        self.ways = ways_of(config, layout.zones)
        self.sweep = first_sweep(self)
        self.crowded, self.outside = np.zeros(world.uavs, bool), np.zeros(world.uavs, bool)
        advance(self)
        self._assign()
        self._look()

    def step(self, action: Float32, assignment: NDArray[np.int64] | None = None) -> None:
        """Do one step in the same order as the kernel.

        Args:
            action: [2 n].
            assignment: [n_m + n_d] the assignment to use if several cost the same. The least cost is computed either
                way.
        """
        world = self.config.world
        self.time += 1
        divide_again(self)
        self.gone = self.failure <= self.time
        velocity = np.clip(action.reshape(-1, 2).astype(np.float64), -1.0, 1.0) * (world.speed_x_max, world.speed_y_max)
        velocity[self.gone] = 0.0
        motivated = (velocity * self.direction).sum(axis=1) > 0
        self.before, service_before = self.position, self.service
        payload = np.array([other_power(self.config.energy, k) for k in self.kind])
        way, flight = self._fly(velocity)
        wanted = self.position + np.where(self.gone[:, None], 0.0, way)
        inside = np.clip(wanted, 0.0, (world.field_x, world.field_y))
        refused = stopped(self, inside)
        self.position = np.where(refused[:, None], self.position, inside)
        self.outside = (inside != wanted).any(axis=1) | refused
        stop(self, (inside != wanted) | refused[:, None])
        self.energy = np.where(self.gone, 0.0, flight + payload * world.step_seconds)
        if self.config.battery.some:
            use_charge(self, payload)
        self._assign(assignment)
        self.utility = np.zeros(world.uavs)
        self._photograph()
        self._collect()
        self._reward(service_before, motivated)
        find(self)
        advance(self)
        self._look()

    def _fly(self, velocity: Array) -> tuple[Array, Array]:
        """Return the ways [n, 2] m to which commanded velocities lead, and the energy of the flight [n] J."""
        if self.config.dynamics.inertial:
            return glide(self, velocity)
        air, ground = air_velocity(self, velocity)
        power = np.array([flight_power(self.config.energy, v) for v in np.sqrt((air**2).sum(axis=1))])
        return ground * self.config.world.step_seconds, power * self.config.world.step_seconds

    def assignment_costs(self) -> Array:
        """Return the cost of each pair, [n_m + n_d, n_c] (W3)."""
        relay, radio, world = self.config.relay, self.config.radio, self.config.world
        diagonal, first = math.hypot(world.field_x, world.field_y), world.communication_uavs
        distance = np.array(
            [[self.distance(r, first + s, self.position) for r in range(first)] for s in range(len(self.kind) - first)]
        )
        loss = free_space_loss(radio, np.maximum(distance, 1.0)) / free_space_loss(radio, max(diagonal, 1.0))
        return np.asarray(relay.cost_distance * distance / diagonal + relay.cost_link * loss)

    def _assign(self, chosen: NDArray[np.int64] | None = None) -> None:
        """Protocol 1, step 4: minimum-cost assignment with capacities, and D_c from it (W2)."""
        relay, world = self.config.relay, self.config.world
        first, costs, relays = world.communication_uavs, self.assignment_costs(), self.living(0)
        served = np.flatnonzero(~self.gone[first:])
        self.assignment, self.assignment_cost = np.full(len(costs), -1), 0.0
        if len(relays) and len(served):
            capacity = max(relay.capacity_for(world), math.ceil(len(served) / len(relays)))
            _, columns = linear_sum_assignment(np.repeat(costs[np.ix_(served, relays)], capacity, axis=1))
            self.assignment[served] = relays[columns // capacity]
            self.assignment_cost = float(costs[served, self.assignment[served]].sum())
        if chosen is not None:
            self.assignment = chosen.copy()
        distances = np.array(
            [self.distance(first + k, r, self.position) if r >= 0 else math.inf for k, r in enumerate(self.assignment)]
        )
        in_range = distances <= (relay.link_range if relay.require_link else math.inf)
        self.joined = joined_to_base(self) if relay.chained else np.ones(first, bool)
        self.linked = in_range & ~self.gone[first:] & self.joined[self.assignment]
        loss = free_space_loss(self.config.radio, np.maximum(distances, 1.0))
        quality = self.config.energy.transmit_dbm - loss - 10.0 * math.log10(noise_mw(self.config.radio))
        self.link_quality = np.where(self.assignment >= 0, quality, NO_LINK)
        self.service = np.array([self.relay_service(r) for r in range(first)])

    def _photograph(self) -> None:
        """VMUF and eq. VDF: the UAV closest to a plot's centre takes its image (W18 to W23)."""
        world, camera = self.config.world, self.config.camera
        monitors = self.living(1)
        cycles = plot_cycles(self)
        width, depth = world.field_x / world.plots_x, world.field_y / world.plots_y
        grid_x = (np.arange(camera.grid_x) + 0.5) / camera.grid_x * width
        grid_y = (np.arange(camera.grid_y) + 0.5) / camera.grid_y * depth
        for x in range(world.plots_x):
            for y in range(world.plots_y):
                centre = self.plot_xy[x * world.plots_y + y]
                due = self.time % cycles[x, y] == 0
                if len(monitors) == 0:
                    self._serve(self.vdf, (x, y), 0, False, bool(due), world.vdf_max)
                    continue
                u = monitors[np.argmin(((centre - self.position[monitors]) ** 2).sum(axis=1))]
                dx, dy = x * width + grid_x - self.position[u, 0], y * depth + grid_y - self.position[u, 1]
                distance = np.sqrt(dx[:, None] ** 2 + dy[None] ** 2 + world.height_monitoring**2)
                quality = (distance < camera.image_distance).sum() / (camera.grid_x * camera.grid_y)
                good = quality >= camera.plot_threshold and self.linked[u - world.communication_uavs]
                self._serve(self.vdf, (x, y), int(u), bool(good), bool(due), world.vdf_max)

    def sensor_chances(self) -> tuple[NDArray[np.intp], Array]:
        """Return each sensor's nearest data collection UAV and 1 - PLR there (W13, W14, W17); nobody interferes."""
        radio, collectors = self.config.radio, self.living(2)
        if len(collectors) == 0:
            return np.zeros(self.config.world.sensors, np.intp), np.zeros(self.config.world.sensors)
        offset = self.layout.sensor_xy[:, None] - self.position[collectors]
        flat = (offset**2).sum(axis=2)
        owner = np.argmin(flat, axis=1)
        power = received_mw(radio, np.sqrt(flat + self.config.world.height_collection**2))
        sinr = power[np.arange(len(owner)), owner] / noise_mw(radio)
        chance = 1.0 - packet_loss(radio, sinr)
        return collectors[owner], np.where(chance < NEGLIGIBLE, 0.0, chance)

    def _collect(self) -> None:
        """DCUF and eq. AoI (W17 to W20)."""
        world = self.config.world
        owner, self.chance = self.sensor_chances()
        cycles = sensor_cycles(self)
        for j, u in enumerate(owner):
            arrives = packet_draw(self.key, self.time, j) < self.chance[j] and self.linked[u - world.communication_uavs]
            due = self.time % cycles[j] == 0
            self._serve(self.aoi, (j,), int(u), bool(arrives), bool(due), world.aoi_max)

    def _serve(self, counter: Array, item: tuple[int, ...], u: int, served: bool, due: bool, cap: int) -> None:
        """Credit a UAV with a counter that it serves and reset it; raise the others where a cycle ends."""
        if served:
            self.utility[u] += counter[item]
            counter[item] = 0.0
        elif due:
            counter[item] = min(counter[item] + 1.0, cap)

    def _reward(self, service_before: Array, motivated: NDArray[np.bool_]) -> None:
        """r_c, r_m and r_d; every part except the energy is multiplied by t_step, as printed."""
        weight, world, seconds = self.config.reward, self.config.world, self.config.world.step_seconds
        self.parts = np.zeros((world.uavs, 8))
        for u, kind in enumerate(self.kind):
            if self.gone[u]:
                continue
            other, risk = self.nearest_uav(u), 0.0
            if other >= 0:
                now, then = self.distance(u, other, self.position), self.distance(u, other, self.before)
                risk = safety_risk(world.safety_distance, now, then)
            energy, boundary = -weight.energy * self.energy[u], -weight.boundary * self.outside[u] * seconds
            self.parts[u, 1:4] = energy, -weight.collision_risk * risk * seconds, boundary
            if kind == 0:
                self.parts[u, 0] = -weight.positioning * (self.service[u] - service_before[u]) * seconds
                self.parts[u, 7] = weight.relayed * relayed(self, u) * seconds
                continue
            utility, idle, motivation = (
                (weight.monitoring, weight.monitoring_idle, weight.monitoring_motivation)
                if kind == 1
                else (weight.collection, weight.collection_idle, weight.collection_motivation)
            )
            self.parts[u, 4:7] = (
                utility * self.utility[u],
                -idle * (self.utility[u] == 0.0),
                motivation * motivated[u],
            )
            self.parts[u, 4:7] *= seconds
        self.reward = self.parts.sum(axis=1)

    def _find_directions(self) -> None:
        """Find D_VDF and D_AoI."""
        self.direction = np.zeros((len(self.kind), 2))
        for u in self.living(1):
            self.direction[u] = densest_direction(self.position[u], self.plot_xy, self.vdf.reshape(-1))
        for u in self.living(2):
            self.direction[u] = densest_direction(self.position[u], self.layout.sensor_xy, self.aoi)

    def _look(self) -> None:
        """Find D_VDF and D_AoI, the UAVs that are too close, and all observations."""
        self._find_directions()
        apart = np.linalg.norm(self.position[:, None] - self.position, axis=2)
        apart[(self.kind[:, None] != self.kind) | np.eye(len(self.kind), dtype=bool)] = math.inf
        apart[self.gone], apart[:, self.gone] = math.inf, math.inf
        self.crowded = (apart < self.config.world.collision_distance).any(axis=1)
        self.observation = observe(self)
