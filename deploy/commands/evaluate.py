"""`eia-sec evaluate`: the options of `deploy.evaluate` on the command line."""

from collections.abc import Sequence

from deploy.evaluate import EvaluateArguments, main
from deploy.options import parse


def command(arguments: Sequence[str]) -> int:
    """Evaluate and print; return the exit code."""
    return main(parse(EvaluateArguments, arguments, "evaluate"))
