"""A run that a program has trained: its policy, and its evaluation."""

from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

from eia_sec.common.actors import TeamActors
from eia_sec.common.config import RunConfig
from eia_sec.common.errors import ConfigError
from eia_sec.rollout.agent_policy import Policy
from eia_sec.rollout.evaluation import Evaluation, evaluate_run
from eia_sec.rollout.policies import ActorPolicy, SampledPolicy

NAME = "trained"
"""Name of the policy in an evaluation."""


def without_timeout(config: RunConfig) -> RunConfig:
    """Return the configuration without `env.step_timeout`, which would end the process of the program."""
    return replace(config, env=replace(config.env, step_timeout=0.0))


@dataclass(frozen=True)
class Run:
    """A run that has ended.

    Attributes:
        config: its whole configuration.
        actors: its actors, with the distribution that they explored by.
        environment_steps: environment steps that it learned from.
        episodes: training episodes finished.
        stopped: why a callback, of the program or of a plug-in, stopped it; empty if it finished.
        directory: its run directory, or None if nothing was saved.
    """

    config: RunConfig
    actors: TeamActors
    environment_steps: int
    episodes: int
    stopped: str
    directory: Path | None

    @cached_property
    def policy(self) -> Policy:
        """The trained policy, without exploration noise."""
        return Policy(self.actors.noise_free(), self.config.env)

    def evaluate(self, scenarios: int = 50, *, episodes: int = 1, sampled: bool = False) -> Evaluation:
        """Run the policy on scenarios that training never saw, without training noise.

        Args:
            scenarios: how many.
            episodes: episodes on each.
            sampled: whether actions are drawn from the policy's distribution, as in training; else they are the
                likeliest ones.

        Returns:
            scores; `interval` is a 95 % interval of the mean reward per agent and episode.

        Raises:
            ConfigError: there is nothing to evaluate on, or the policy has no distribution to draw from.
        """
        if sampled and not self.actors.draws:
            raise ConfigError(f"actors of {self.config.algorithm.name} have no distribution to draw actions from.")
        policy = SampledPolicy(self.actors) if sampled else ActorPolicy(self.actors.noise_free())
        return evaluate_run(without_timeout(self.config), policy, self.config.unseen(scenarios), episodes, name=NAME)
