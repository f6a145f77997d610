"""Makes the trainer that a run's algorithm needs."""

from common.config import RunConfig
from common.team import TeamSpec
from learner.off_policy_trainer import OffPolicyTrainer
from learner.on_policy.trainer import OnPolicyTrainer
from learner.trainer import Trainer


def make_trainer(config: RunConfig, team: TeamSpec) -> Trainer:
    """Return the trainer of a run.

    Raises:
        ConfigError: when the configured device does not exist, or the algorithm cannot train the team.
    """
    return OnPolicyTrainer(config, team) if config.learns_on_policy else OffPolicyTrainer(config, team)
