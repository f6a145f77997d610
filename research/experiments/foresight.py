"""How much more a team could earn that knows everything to come: a search from the policy that ships.

    python -m research.experiments.foresight [--farms 2000:2004] [--horizon 25] [--write research/results/inertia]

In every step, copies of the farm try each command for one UAV, while all others, and that UAV in later steps, fly the
trained policy (rollout, Bertsekas 2019; one agent after another would be his multiagent rollout). Copies hold
everything: every counter, position and packet, and every random number to come. Commands that earn the team more within
the horizon are taken together, in the order of what each gains, as long as that pays. So it is no bound, but what a
policy would have to see that nobody sees.
"""

import sys
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
import tyro
from numpy.typing import NDArray

from eia_sec.common.actors import TeamActors
from eia_sec.common.config import FarmConfig
from eia_sec.common.config.presets import preset
from eia_sec.common.farm import farm_team
from eia_sec.common.policy_file import load_policy
from eia_sec.common.team import Float32
from eia_sec.deploy.commands.policies.evaluate import parse_farms
from eia_sec.deploy.reports.provenance import provenance
from eia_sec.rollout.evaluation import evaluate
from eia_sec.rollout.policies import fitted
from eia_sec.rollout.shipped_policies import shipped_file
from eia_sec.rollout.sim.batch import FarmBatch
from research.experiments.heuristics import summarised
from research.experiments.inertia import stored
from research.pages.inertia_table import FORESIGHT

ANGLES: Final = np.arange(8) * (np.pi / 4.0)
COMMANDS: Final[Float32] = np.concatenate(
    [np.zeros((1, 2)), np.clip(np.sqrt(2.0) * np.stack([np.cos(ANGLES), np.sin(ANGLES)], axis=1), -1.0, 1.0)]
).astype(np.float32)
"""What is tried for a UAV: hovering, and full speed in eight directions, as shares of the top speed along x and y."""
LEAST: Final = 1e-3
"""Gain below which the trained policy's command stays."""


class ForesightPolicy:
    """Tries every UAV's commands on copies of its farm.

    Args:
        config: the farm.
        actors: the policy that copies fly otherwise.
        horizon: steps that copies fly.
    """

    def __init__(self, config: FarmConfig, actors: TeamActors, horizon: int) -> None:
        self._actors, self._horizon = actors, horizon
        self._agents = actors.team.agents
        self._singles = FarmBatch(config, 1 + self._agents * len(COMMANDS))
        self._joints = FarmBatch(config, 1 + self._agents)

    def reset(self, farms: FarmBatch, index: int) -> None:
        """Keep nothing from one episode to the next."""

    def act(self, farms: FarmBatch) -> Float32:
        """Return the commands [E, 2 n] of all UAVs."""
        if farms.time[0] % 25 == 0:
            sys.stderr.write(f"step {farms.time[0]} of {farms.config.world.steps}\n")
        return np.concatenate([self._commands(farms, index) for index in range(len(farms.time))])

    def _commands(self, farms: FarmBatch, index: int) -> Float32:
        agents, count = self._agents, len(COMMANDS)
        own: Float32 = self._actors.environment_actions(farms.observation[index : index + 1], None)
        single = np.repeat(own, 1 + agents * count, axis=0)
        for agent in range(agents):
            single[1 + agent * count : 1 + (agent + 1) * count, 2 * agent : 2 * agent + 2] = COMMANDS
        earned = self._earned(self._singles, farms, index, single)
        gain = earned[1:].reshape(agents, count) - earned[0]
        joint = np.repeat(own, 1 + agents, axis=0)
        for place, agent in enumerate(np.argsort(-gain.max(axis=1), kind="stable")):
            if gain[agent].max() > LEAST:
                joint[1 + place :, 2 * agent : 2 * agent + 2] = COMMANDS[gain[agent].argmax()]
        best = int(self._earned(self._joints, farms, index, joint).argmax())
        return joint[best : best + 1]

    def _earned(self, copies: FarmBatch, farms: FarmBatch, index: int, first: Float32) -> NDArray[np.float64]:
        """Return what the team earns, [C], in copies of a farm that begin with these commands, [C, 2 n]."""
        for mine, theirs in zip(copies._state, farms._state, strict=True):  # a batch has no other way to be set
            mine[:] = theirs[index]
        earned = np.zeros(len(first))
        for step in range(min(self._horizon, farms.config.world.steps - int(farms.time[index]))):
            copies.step(self._actors.environment_actions(copies.observation, None) if step else first)
            earned += copies.reward.sum(axis=1)
        return earned


@dataclass(frozen=True)
class Arguments:
    """Fly farms with foresight."""

    farms: str = "2000:2004"
    """Farm seeds A:B, from A to B - 1; one episode on each, which takes minutes."""
    horizon: int = 25
    """Steps that copies fly."""
    write: Path = Path("research/results/inertia")
    """Where the results go."""


def main() -> None:
    """Fly and write."""
    arguments = tyro.cli(Arguments, prog="python -m research.experiments.foresight")
    farm, made = preset("inertial").farm, provenance("research.experiments.foresight")
    actors = fitted(load_policy(shipped_file("trained"))[0], farm_team(farm))
    seeds, began = parse_farms(arguments.farms), time.process_time()
    found = evaluate(farm, ForesightPolicy(farm, actors, arguments.horizon), seeds, 1, name=FORESIGHT)
    scores = summarised(found, time.process_time() - began)
    stored(arguments.write, made, {**scores, "first_farm": seeds.start, "farms": len(seeds)})


if __name__ == "__main__":
    main()
