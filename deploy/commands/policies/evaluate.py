"""`eia-sec evaluate`: the options of `deploy.policies.evaluate` on the command line."""

from collections.abc import Sequence

from deploy.options import parse
from deploy.policies.evaluate import EvaluateArguments, main


def command(arguments: Sequence[str]) -> int:
    """Evaluate a policy and print the result; return the exit code."""
    return main(parse(EvaluateArguments, arguments, "evaluate"))
