"""What the tasks that BenchMARL is given here have in common; it runs with what requirements/benchmarl.txt says."""

from benchmarl.environments import TaskClass
from torchrl.envs import EnvBase


class PlainTask(TaskClass):
    """A task with continuous actions, and without pictures, infos and masks."""

    def supports_continuous_actions(self) -> bool:
        """Say yes."""
        return True

    def supports_discrete_actions(self) -> bool:
        """Say no."""
        return False

    def has_render(self, env: EnvBase) -> bool:
        """Say no."""
        return False

    def info_spec(self, env: EnvBase) -> None:
        """Return nothing."""
        return

    def action_mask_spec(self, env: EnvBase) -> None:
        """Return nothing."""
        return
