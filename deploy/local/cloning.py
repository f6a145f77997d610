"""Actors that a run begins as, cloned from demonstrations before any process starts."""

from pathlib import Path
from typing import Final

from eia_sec.common.config import RunConfig
from eia_sec.common.config.files import with_values
from eia_sec.common.errors import ConfigError, UsageError
from eia_sec.common.policy_file import save_policy
from eia_sec.common.team import TeamSpec
from eia_sec.learner.on_policy.cloning import cloned
from eia_sec.rollout.demonstrations import load_demonstrations, require_team
from eia_sec.rollout.start_policy import ALL

FILE: Final = "cloned.safetensors"
"""The cloned policy in the run directory."""


class Clones:
    """The actors that demonstrations give.

    Args:
        config: the run.
        team: the layout of the team.
        path: the demonstrations.
        resume: whether the run goes on from a checkpoint.

    Raises:
        UsageError: the run resumes, begins as another policy or learns off policy, or the file cannot be used.
    """

    def __init__(self, config: RunConfig, team: TeamSpec, path: Path, *, resume: bool) -> None:
        if resume:
            raise UsageError("--demonstrations begin a run; one that resumes goes on with what it has learned.")
        if not config.learns_on_policy:
            raise ConfigError(f"--demonstrations need an algorithm on policy, and {config.algorithm.name} is none.")
        if config.on_policy.start_policy:
            raise UsageError("--demonstrations and --algorithm.start-policy both say what actors begin as; give one.")
        self._config, self._path = config, path
        self._found = load_demonstrations(path)
        require_team(self._found, team, path)
        self._actors, self._probability = cloned(config, team, self._found.observation, self._found.action)

    def settings(self, run_dir: Path) -> RunConfig:
        """Return the run's configuration, in which it begins as the clones.

        From the first iteration value functions alone learn, unless `value_steps` says something else: PPO whose value
        functions know nothing might spoil what was cloned, and every further iteration only takes steps.
        """
        algorithm = self._config.on_policy
        steps = algorithm.value_steps or algorithm.iteration_steps
        place = str((run_dir / FILE).absolute())
        return with_values(self._config, {f"algorithm.start_policy.{ALL}": place, "algorithm.value_steps": steps})

    def save(self, run_dir: Path) -> str:
        """Write the clones into the run directory; return a sentence about them."""
        save_policy(run_dir / FILE, self._actors, {**self._found.metadata, "demonstrations": str(self._path)})
        return (
            f"cloned from {len(self._found.action):,} steps of {self._path}, whose episodes earned "
            f"{self._found.metadata.get('reward', '?')}: each agent's actions have a mean probability (of numbers a "
            f"density) of {self._probability:.2f}."
        )
