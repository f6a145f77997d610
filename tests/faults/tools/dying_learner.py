"""`eia-sec` whose learner is killed between writing a verdict down and sending it: `python -m ... COMMAND...`.

The environment variable EIA_SEC_DIES_AFTER says how many answers it sends before.
"""

import os
import signal
import sys

from eia_sec.deploy.cli import main as command
from eia_sec.learner.intake.receiver import Receiver

AFTER = "EIA_SEC_DIES_AFTER"


def main() -> None:
    """Spoil the answers, then run the command."""
    left, answer = int(os.environ[AFTER]), Receiver._answer

    def answer_or_die(self, incoming, sender, verdicts):
        nonlocal left
        left -= 1
        if left < 0:
            os.kill(os.getpid(), signal.SIGKILL)
        answer(self, incoming, sender, verdicts)

    Receiver._answer = answer_or_die  # type: ignore[method-assign]  # that is the fault
    sys.exit(command())


if __name__ == "__main__":
    main()
