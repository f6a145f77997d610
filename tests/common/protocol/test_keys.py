"""Keys are formatted and parsed by one table, and nothing else is a key."""

import re

import pytest

from common.errors import ConfigError, KeyExpressionError
from common.protocol import keys

VARIABLES = {"worker": "w-1", "role": "rollout", "name": "n.2", "verb": "drain", "vehicle": "uav-7"}


@pytest.mark.parametrize("family", keys.FAMILIES, ids=lambda family: family.template)
def test_parse_reverses_key(family: keys.KeyFamily) -> None:
    """Every family's key is parsed back to the family and its variables."""
    wanted = {name: VARIABLES[name] for name in re.findall(r"{([a-z]+)}", family.template)}
    parsed = keys.parse(family.key("run-1", **wanted))
    assert (parsed.family, parsed.run, parsed.variables) == (family, "run-1", wanted)


@pytest.mark.parametrize(
    "key",
    [
        "eia-sec/v3/run/transition/*",
        "eia-sec/v3/**",
        "eia-sec/v1/run/transition/w",
        "eia-sec/v3/run/transition",
        "eia-sec/v3/run/transition/w/x",
        "eia-sec/v3/run/params/other",
        "other/v1/run/transition/w",
        "eia-sec/v3/run/transition/$*",
        "",
    ],
)
def test_other_keys_are_refused(key: str) -> None:
    """Wildcards, other roots and undeclared shapes are KeyExpressionErrors."""
    with pytest.raises(KeyExpressionError):
        keys.parse(key)


@pytest.mark.parametrize("name", ["", "a/b", "*", "a b", "-x", "x" * 64, "ü"])
def test_names_that_cannot_be_segments_are_refused(name: str) -> None:
    """A name with a slash, a wildcard or a space is a ConfigError."""
    with pytest.raises(ConfigError):
        keys.TRANSITION.key("run", worker=name)


def test_pattern_covers_the_family_or_the_named_part() -> None:
    """Variables that are not given become a one-segment wildcard."""
    assert keys.LIVE.pattern("r") == "eia-sec/v3/r/live/*/*"
    assert keys.LIVE.pattern("r", role="rollout") == "eia-sec/v3/r/live/rollout/*"
