"""Makes the trainer that a run's algorithm needs."""

from eia_sec.common.config import RunConfig
from eia_sec.common.team import TeamSpec
from eia_sec.learner.group.process_group import ProcessGroup
from eia_sec.learner.off_policy.trainer import OffPolicyTrainer
from eia_sec.learner.on_policy.trainer import OnPolicyTrainer
from eia_sec.learner.trainer import Trainer


def make_trainer(config: RunConfig, team: TeamSpec, group: ProcessGroup | None = None) -> Trainer:
    """Return the trainer of a run.

    Args:
        config: the run.
        team: the layout of the team.
        group: the learners that make the updates together (on policy), which this one leads; None for this one alone.

    Raises:
        ConfigError: when the configured device does not exist, or the algorithm cannot train the team.
    """
    return OnPolicyTrainer(config, team, group) if config.learns_on_policy else OffPolicyTrainer(config, team)
