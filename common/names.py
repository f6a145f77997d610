"""Names of runs, processes and types of agent, each of which can be a key segment and a file name."""

import re
from typing import Final

from eia_sec.common.errors import ConfigError

NAME: Final = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.\-]{0,62}")
"""What a name looks like. It holds no separator, wildcard or control character, and is neither "." nor ".."."""
_SHOWN: Final = 80
"""Characters of a refused name that the error message quotes."""


def is_name(value: str) -> bool:
    """Return whether a text can be a name."""
    return NAME.fullmatch(value) is not None


def check_name(value: str, what: str) -> str:
    """Return the value if it is a valid name.

    Args:
        value: the text.
        what: what it names, for the error message.

    Raises:
        ConfigError: it is not a valid name.
    """
    if not is_name(value):
        raise ConfigError(f"{what} {value[:_SHOWN]!r} must be 1 to 63 letters, digits, '.', '_' or '-'.")
    return value
