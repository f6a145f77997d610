"""Coverage-guided fuzzing of the decoder with atheris (extra `fuzz`); the corpus beside this file grows with it.

python -m tests.faults.tools.fuzz tests/faults/corpus -max_total_time=600 -max_len=4096
"""

import importlib
import sys

atheris = importlib.import_module("atheris")  # an extra; the rest of tests/faults works without it

with atheris.instrument_imports(include=["common", "msgpack"]):
    for module in (
        "eia_sec.common.protocol.frame",
        "eia_sec.common.protocol.messages",
        "eia_sec.common.protocol.chunk_messages",
        "eia_sec.common.policy_store",
    ):
        importlib.import_module(module)
mutants = importlib.import_module("tests.faults.tools.mutants")


def one_input(data: bytes) -> None:
    """Feed bytes as they are, and sealed, so that the checksum is no wall."""
    mutants.feed(data)
    mutants.feed(mutants.sealed(data))


def main() -> None:
    """Fuzz until asked to stop."""
    atheris.Setup(sys.argv, one_input)
    atheris.Fuzz()


if __name__ == "__main__":
    main()
