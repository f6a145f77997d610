"""The `trajectories` study: where the trained UAVs fly on unseen farms, and what they collect there."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any, Final

import numpy as np

from eia_sec.common.config import FarmConfig
from eia_sec.common.farm import COLLECTION, MONITORING, farm_team
from eia_sec.common.policy_file import load_policy
from eia_sec.common.team import Float32
from eia_sec.deploy.reports.intervals import Numbers
from eia_sec.rollout.evaluation import Trajectory, record
from eia_sec.rollout.policies import ActorPolicy, Policy, policy_of
from eia_sec.rollout.sim.batch import FarmBatch
from research.studies.analysis.summary import choice_summary, reference_summary
from research.studies.bench import Bench
from research.studies.jobs import POLICY_SUFFIX
from research.studies.methods import EIA_SEC

CELLS: Final = 10
"""Cells along each side of the field, of which a type visits a share."""
HEADINGS: Final = 16
"""Directions that a path's steps are counted in."""
LATTICE_HEADINGS: Final = 8
"""Ways that lead from a place of the lattice to its neighbours, each in the middle of one of HEADINGS."""
DIGITS: Final = 3


def flights(bench: Bench) -> dict[int, dict[str, Trajectory]]:
    """Fly EIA-SEC, the first seed of `training`, and the best heuristic over the first reported farms."""
    (run,) = bench.runs(EIA_SEC, 1)
    config, best = run.config.farm, bench.ends()[2]
    actors, _ = load_policy(bench.records.path(run, POLICY_SUFFIX))
    policies: dict[str, Policy] = {EIA_SEC.name: ActorPolicy(actors), best: policy_of(best, config)}
    farms = bench.scale.reported[: bench.scale.flights]
    return {farm: {name: record(config, policy, farm, 0) for name, policy in policies.items()} for farm in farms}


def flight_summary(bench: Bench) -> dict[str, Any]:
    """Return the result of each flight."""
    (run,) = bench.runs(EIA_SEC, 1)
    held = bench.records.get(run)
    assert held is not None, "asked for before it was done"
    return {
        "references": reference_summary(bench),
        "choice": choice_summary(bench, [EIA_SEC]),
        "run": {name: held[name] for name in ("job", "config", "seed", "commit", "command", "seconds")},
        "monitors_steer_by": run.config.farm.control.monitoring,
        "farms": {
            str(farm): {name: described(trajectory) for name, trajectory in flown.items()}
            for farm, flown in flights(bench).items()
        },
    }


class AlongPaths:
    """Flies UAVs without inertia, steered by velocities, along paths [T + 1, n, 2], m."""

    def __init__(self, paths: Numbers) -> None:
        self._paths, self._step = paths, 0

    def reset(self, farms: FarmBatch, index: int) -> None:
        """Begin anew."""
        self._step = 0

    def act(self, farms: FarmBatch) -> Float32:
        """Return the velocities that lead to the next places."""
        self._step += 1
        world = farms.config.world
        reach = np.array([world.speed_x_max, world.speed_y_max]) * world.step_seconds
        return np.clip((self._paths[self._step] - farms.position) / reach, -1.0, 1.0).reshape(1, -1).astype(np.float32)


def flown_again(config: FarmConfig, farm: int, described: Mapping[str, Any]) -> Trajectory:
    """Return a flight as the study's results describe it: paths are all that sensors and plots depend on."""
    steered = replace(config.control, communication="velocity", monitoring="velocity", collection="velocity")
    paths = np.array(described["paths"])
    episode = replace(config, world=replace(config.world, steps=len(paths) - 1), control=steered)
    flown = record(episode, AlongPaths(paths), farm, 0)
    # Places are rounded, so that who flew along the border may miss it, or bump into it, by centimetres.
    reward = np.full_like(flown.summary.reward, described["reward"])
    return replace(flown, summary=replace(flown.summary, reward=reward))


def described(trajectory: Trajectory) -> dict[str, Any]:
    """Return a flight in numbers: reward, AoI, VDF, units collected by each UAV, coverage and regularity of paths.

    `visited` is the share of the field's cells that a type's UAVs were over; `order` is near 1 for a path whose steps
    have one of few headings, as a lawnmower's do, and 0 for one whose headings are spread evenly.
    """
    config, summary = trajectory.config, trajectory.summary
    types, order, visited = agents_by_type(config), {}, {}
    for name, agents in types.items():
        paths = trajectory.position[:, agents]
        order[name] = round(float(np.mean([heading_order(path) for path in paths.swapaxes(0, 1)])), DIGITS)
        visited[name] = round(visited_share(paths, (config.world.field_x, config.world.field_y)), DIGITS)
    collected = trajectory.collected[-1]
    return {
        "reward": round(float(np.mean(summary.reward)), DIGITS),
        "aoi": round(summary.metrics["aoi"], DIGITS),
        "vdf": round(summary.metrics["vdf"], DIGITS),
        "collected": {name: collected[types[name]].round(1).tolist() for name in (MONITORING, COLLECTION)},
        "supplied": supply(trajectory),
        "visited": visited,
        "order": order,
        "paths": trajectory.position.round(1).tolist(),
    }


def supply(trajectory: Trajectory) -> Mapping[str, int]:
    """Return the units that arise in an episode that begins with empty counters at phase zero: an upper bound."""
    world = trajectory.config.world
    seconds = world.steps * world.step_seconds
    cycles = np.array(world.sensor_cycles)[trajectory.sensor_type]
    plots = trajectory.final_vdf.size
    return {MONITORING: plots * int(seconds // world.vdf_cycle), COLLECTION: int((seconds // cycles).sum())}


def agents_by_type(config: FarmConfig) -> dict[str, slice]:
    """Return the rows of each type in the arrays of a trajectory on such a farm."""
    team = farm_team(config)
    return {group.name: part for group, part in zip(team.groups, team.agent_slices(), strict=True)}


def visited_share(paths: Numbers, field: tuple[float, float]) -> float:
    """Return the share of the CELLS x CELLS cells of a field that paths [T, n, 2] were over."""
    place = np.clip((paths / np.array(field) * CELLS).astype(int), 0, CELLS - 1).reshape(-1, 2)
    return len(np.unique(place, axis=0)) / CELLS**2


def lattice_order() -> float:
    """Return the order of headings that are spread evenly over those of a lattice: what steering by one gives alone."""
    return float(1.0 - np.log(LATTICE_HEADINGS) / np.log(HEADINGS))


def heading_order(path: Numbers) -> float:
    """Return 1 less the normalised entropy of the headings of a path [T, 2], each step weighted by its length."""
    step = np.diff(path, axis=0)
    length = np.hypot(step[:, 0], step[:, 1])
    if length.sum() == 0.0:
        return 1.0
    heading = np.round(np.arctan2(step[:, 1], step[:, 0]) / (2 * np.pi) * HEADINGS).astype(int) % HEADINGS
    share = np.bincount(heading, weights=length, minlength=HEADINGS) / length.sum()
    share = share[share > 0]
    return float(1.0 + (share * np.log(share)).sum() / np.log(HEADINGS))
