"""Names: what may become a key segment and a file's name."""

import pytest

from eia_sec.common.errors import ConfigError
from eia_sec.common.names import check_name

PATHS = ("../../pwn", "/etc/passwd", "..", ".", "", "a/b")
CONTROLS = ("a\0b", "a\x1b[2J", "a\nb", "\u202ea")
OTHERS = ("a*", "$*", "x" * 64, "-a", " a", "a ")


@pytest.mark.parametrize("name", PATHS + CONTROLS + OTHERS)
def test_a_name_is_one_plain_segment(name):
    """Separators, wildcards, control characters and names that are too long are refused, in one printable sentence."""
    with pytest.raises(ConfigError, match="must be 1 to 63 letters") as refused:
        check_name(name, "run")
    assert str(refused.value).isprintable()


def test_a_plain_name_is_taken():
    """Letters, digits, dots, underscores and hyphens, up to 63 of them."""
    for name in ("a", "rollout-farm_2.0", "x" * 63, "0"):
        assert check_name(name, "run") == name
