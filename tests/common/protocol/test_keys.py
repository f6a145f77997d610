"""Keys are formatted and parsed by one table, and nothing else is a key."""

import re
import textwrap
from typing import cast

import pytest

from eia_sec.common.errors import ConfigError, KeyExpressionError
from eia_sec.common.protocol import codec, environment_messages, keys, messages
from eia_sec.common.protocol.codec import Message
from eia_sec.common.protocol.messages import ConfigurationMessage
from eia_sec.common.transport.bus import Server
from eia_sec.learner.process.command_server import CommandServer

VARIABLES = {
    "worker": "w-1",
    "role": "rollout",
    "name": "n.2",
    "verb": "drain",
    "vehicle": "uav-7",
    "environment": "site-a",
}


@pytest.mark.parametrize("family", keys.FAMILIES, ids=lambda family: family.template)
def test_parse_reverses_key(family: keys.KeyFamily) -> None:
    """Every family's key is parsed back to the family and its variables."""
    wanted = {name: VARIABLES[name] for name in re.findall(r"{([a-z]+)}", family.template)}
    parsed = keys.parse(family.key("run-1", **wanted))
    assert (parsed.family, parsed.run, parsed.variables) == (family, "" if family.root else "run-1", wanted)


@pytest.mark.parametrize(
    "key",
    [
        "eia-sec/v5/run/transition/*",
        "eia-sec/v5/**",
        "eia-sec/v1/run/transition/w",
        "eia-sec/v5/run/transition",
        "eia-sec/v5/run/transition/w/x",
        "eia-sec/v5/run/params/other",
        "other/v1/run/transition/w",
        "eia-sec/v5/run/transition/$*",
        "eia-sec/v5/run/request/site-a/step",
        "eia-sec/environment/v1/request/site-a",
        "eia-sec/environment/v0/live/site-a",
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
    assert keys.LIVE.pattern("r") == "eia-sec/v5/r/live/*/*"
    assert keys.LIVE.pattern("r", role="rollout") == "eia-sec/v5/r/live/rollout/*"


def test_the_docstrings_table_is_that_of_the_declarations() -> None:
    """Whoever reads the table at the top of the module reads what the families say."""
    rows = []
    for family in keys.FAMILIES:
        who = f"{'everyone' if ',' in family.sender else family.sender} -> {family.receiver}"
        row = f"    {family.template:<30}{family.delivery:<9}{who:<25}{', '.join(family.messages)}"
        rows += textwrap.wrap(row, 120, subsequent_indent=" " * 68, break_on_hyphens=False, drop_whitespace=True)
    lines = (keys.__doc__ or "").splitlines()
    assert [line for line in lines if line.startswith("    ")] == rows


def test_every_family_is_listed_and_named_types_exist() -> None:
    """A declaration that is not in FAMILIES would never be parsed; a type that does not exist never decoded."""
    declared = [value for value in vars(keys).values() if isinstance(value, keys.KeyFamily)]
    assert sorted(map(repr, declared)) == sorted(map(repr, keys.FAMILIES))
    remote = {name for family in keys.FAMILIES if family.root for name in family.messages}
    assert remote == {kind.__name__ for kind in environment_messages.MESSAGES}
    named = {name for family in keys.FAMILIES if not family.root for name in family.messages}
    assert all(issubclass(getattr(messages, name), codec.Message) for name in named)
    kinds = {kind.__name__ for kind in vars(messages).values() if isinstance(kind, type) and issubclass(kind, Message)}
    assert kinds - named == {"Message", "Envelope"}


def test_the_learner_answers_the_declared_commands() -> None:
    """The verbs of the command key are those that the command server knows."""
    configuration = ConfigurationMessage(1, "", {}, lockstep=False)
    server = CommandServer(cast(Server, None), configuration, lambda worker: 0)
    assert set(server._verbs) == set(keys.VERBS)
