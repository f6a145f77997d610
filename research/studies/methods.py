"""What is compared: methods, the settings that are tried for each of them, and equal budgets.

Every method begins from the same configuration, is tried with the same CANDIDATES on the same farms with the same seed,
and trains its reported runs with the candidate that did best. Nothing else is tuned here. A trial is to show where a
candidate leads, so that of a method which converges late is longer; the reported runs have one budget.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any, Final

from eia_sec.common.config import RunConfig, ablations
from eia_sec.common.config.files import Value, with_values
from eia_sec.common.config.presets import preset
from eia_sec.common.imitation import ImitationSchedule

PRINTED_TARGET: Final[dict[str, Value]] = {
    "algorithm.ensemble_loss": "mixture",
    "algorithm.bootstrap": "local",
    "algorithm.actor_objective": "local",
    "algorithm.ensemble_copy_rate": 0.1,
}
"""The printed shared ensemble critic, readings A7, A8 and A9."""


@dataclass(frozen=True)
class Method:
    """One method.

    Attributes:
        name: as tables and pictures call it.
        changes: options that make it, by their keys.
        late: whether it is still learning where EIA-SEC has converged, so that its trials are longer.
    """

    name: str
    changes: Mapping[str, Value] = field(default_factory=dict)
    late: bool = False


EIA_SEC: Final = Method("EIA-SEC", {"algorithm.name": "eia-sec"})
PEERS: Final = (
    Method("MADDPG", {"algorithm.name": "maddpg"}, late=True),
    Method("MATD3", {"algorithm.name": "matd3"}, late=True),
    Method("MASAC", {"algorithm.name": "masac"}, late=True),
)
_PLAIN_PPO: Final[Mapping[str, Value]] = {
    "algorithm.potential_discount": 0.0,
    "algorithm.objective": "ppo",
    "algorithm.hidden": 128,
    "algorithm.iteration_steps": 8000,
    "rollout.environments": 16,
    "rollout.chunk_steps": 500,
    "rollout.spool_chunks": 2,
}
"""PPO as published, without what the preset instant adds, and with as many updates as the budget allows for."""
ON_POLICY_PEERS: Final = (
    Method("MAPPO", {"algorithm.name": "mappo", **_PLAIN_PPO}, late=True),
    Method("IPPO", {"algorithm.name": "ippo", **_PLAIN_PPO}, late=True),
)
"""They are beside the paper's methods, and no claim of the paper is about them."""
TRAINED: Final = (EIA_SEC, *PEERS, *ON_POLICY_PEERS)
"""The methods of the study `training`."""
ABLATIONS: Final = (
    EIA_SEC,
    Method("EIA only", ablations.ABLATIONS["eia"], late=True),
    Method("SEC only", ablations.ABLATIONS["sec"]),
    Method("neither", ablations.ABLATIONS["base"], late=True),
    Method("EIA-SEC, printed target", PRINTED_TARGET),
)

_SEPARATE: Final[dict[str, Any]] = {"algorithm.name": "eia-ppo", "algorithm.shared_until": 0.0, "elite.farms": 4}
"""Actors and local value functions that are separate from the beginning, and elites from noise-free episodes."""
ON_POLICY: Final = (
    Method("IPPO, shared parameters"),
    Method("MAPPO, shared parameters", {"algorithm.name": "mappo"}),
    Method("neither", {"algorithm.shared_until": 0.0}),
    Method("EIA only", {**_SEPARATE, "algorithm.ensemble": False}),
    Method("SEC only", {**_SEPARATE, "elite.enabled": False}),
    Method("EIA-SEC", _SEPARATE),
)
"""Forms of PPO over the preset `quick`, with its settings. From `neither` on, each agent has its own networks."""
_ADDED: Final = ("peers", "last_move", "closing", "units", "fields", "coarse", "phases", "route", "service")
OBSERVATIONS: Final = (
    ON_POLICY[0],
    # The preset of the paper's method has none of them.
    *(
        Method(f"without {name}", {f"farm.observation.{name}": getattr(preset("eia-sec").farm.observation, name)})
        for name in _ADDED
    ),
)
"""IPPO with every observation that the paper does not have, and with one less."""

TUNED_PRESET: Final = "preset eia-sec"
"""What `eia-sec train --preset eia-sec` does; it is tuned further than any method is here."""
MIXTURE: Final = "mixture"
"""Whose value new records compare with realised returns; older ones do not say, and compared the local critic's Q_i."""
CANDIDATES: Final[dict[str, dict[str, float]]] = {
    "as the preset": {},
    "actor rate x 3": {"actor_rate": 3.0},
    "critic rate / 3": {"critic_rate": 1.0 / 3.0},
    "reward scale x 3": {"reward_scale": 3.0},
    "reward scale / 3": {"reward_scale": 1.0 / 3.0},
}
"""Settings that are tried for each method: factors on the preset's values."""


def configuration(base: RunConfig, method: Method, candidate: str, seed: int, episodes: int) -> RunConfig:
    """Return the configuration of one run.

    Args:
        base: what every method begins from.
        method: the method.
        candidate: the key of CANDIDATES that is in force.
        seed: seed of the run.
        episodes: the budget; see `training_episodes`.
    """
    config = with_values(replace(base, seed=seed), method.changes)
    algorithm = config.algorithm
    factors = {name: getattr(algorithm, name) * factor for name, factor in CANDIDATES[candidate].items()}
    config = replace(config, algorithm=replace(algorithm, **factors))
    return replace(config, episodes=training_episodes(config, episodes))


def training_episodes(config: RunConfig, budget: int) -> int:
    """Return the most training episodes with which a run stays inside a budget that counts imitation's evaluations.

    Imitation flies episodes without noise to choose elites (A3). They cost as much experience as others, so a method
    with imitation trains for so many episodes fewer. The farms of a batch end their episodes together, so the number is
    a multiple of theirs; a larger one would be overshot.
    """
    schedule, flown = ImitationSchedule.of(config), min(config.elite.farms, config.rollout.train_farms)
    events = 0
    while (due := schedule.due_episode(events + 1)) is not None and due + flown * (events + 1) <= budget:
        events += 1
    left = budget - flown * events
    whole, batch = left if due is None else min(left, due - 1), config.rollout.environments
    return max(batch, whole // batch * batch)


def with_uavs(config: RunConfig, uavs: int) -> RunConfig:
    """Return the run with so many UAVs, split as evenly as can be, communication UAVs first."""
    relays, monitors, collectors = (uavs // 3 + (uavs % 3 > kind) for kind in range(3))
    world = replace(config.farm.world, communication_uavs=relays, monitoring_uavs=monitors, collection_uavs=collectors)
    return replace(config, farm=replace(config.farm, world=world))
