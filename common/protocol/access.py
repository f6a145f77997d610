"""Who may do what on which keys: declared once, here.

The access lists of all listening processes, the table in docs/reference/security.md and the tests are derived from this
table. Whatever it does not name is denied. A key expression with wildcards passes only when a granted expression covers
all of it.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Final

from eia_sec.common.protocol import keys
from eia_sec.common.protocol.keys import KeyFamily

if TYPE_CHECKING:
    from eia_sec.common.transport.credentials import Identity  # links without TLS do without cryptography

NAME: Final = "{name}"
"""Placeholder for the name in the holder's certificate."""
ANYBODY: Final = "anybody"
"""Every process whose certificate the authority signed, on the list of members or not."""

RIGHTS: Final[dict[str, tuple[tuple[str, ...], tuple[str, ...]]]] = {
    "put": (("put",), ()),
    "read": (("declare_subscriber",), ("put",)),
    "ask": (("query",), ("reply",)),
    "answer": (("declare_queryable", "reply"), ("query",)),
    "appear": (("liveliness_token",), ()),
    "watch": (("declare_liveliness_subscriber", "liveliness_query"), ("liveliness_token",)),
    "see readers": ((), ("declare_subscriber",)),
    "see servers": ((), ("declare_queryable",)),
    "repeat": (("reply",), ()),
    "recall": ((), ("reply",)),
}
"""For each right, the Zenoh messages that a listener accepts from the holder, and those that it may send to it.

No right allows a `delete` in either direction. The last two exist only for states: a late joiner asks on the helper
keys, and the answer arrives on the state's own key."""

_SEES: Final = {"put": "see readers", "ask": "see servers"}
"""The right that comes with another, on all keys of the family: a Zenoh publisher stays silent until it learns that
somebody subscribes, and a reader of the whole run subscribes to all of them at once."""
_HISTORY: Final[dict[str, tuple[str, ...]]] = {"put": ("put", "answer", "appear"), "read": ("read", "ask", "watch")}
"""Rights on a state's helper keys, which Zenoh uses to serve the latest value to late joiners and to detect gaps."""
_LATE: Final = {"put": "repeat", "read": "recall"}


@dataclass(frozen=True)
class Grant:
    """One line of the table.

    Attributes:
        role: the role that holds the right.
        right: a key of RIGHTS.
        family: the keys that it applies to.
        variables: values of the family's variables, NAME for the holder's own name; missing ones may have any value.
    """

    role: str
    right: str
    family: KeyFamily
    variables: dict[str, str] = field(default_factory=dict)

    @property
    def personal(self) -> bool:
        """Whether the keys differ from holder to holder."""
        return NAME in self.variables.values()

    def expressions(self, name: str | None, run: str = "*") -> list[tuple[str, str]]:
        """Return the (right, key expression) pairs of a holder of this name, a state's helper keys included.

        Without a name they are those of all holders.
        """
        named = {key: name if value == NAME else value for key, value in self.variables.items()}
        given = {key: value for key, value in named.items() if value is not None}
        narrow, wide = (
            pattern.replace(f"{keys.ROOT}/run/", f"{keys.ROOT}/{run}/", 1)
            for pattern in (self.family.pattern("run", **given), self.family.pattern("run"))
        )
        found = [(self.right, "")]
        if self.family.delivery == "state":
            found += [(right, "/@adv/**") for right in _HISTORY[self.right]]
            found.append((_LATE[self.right], ""))
        seen = [(_SEES[right], wide + ending) for right, ending in found if right in _SEES]
        return [(right, narrow + ending) for right, ending in found] + seen


def _own(role: str) -> tuple[Grant, ...]:
    return (
        Grant(role, "put", keys.METRIC, {"role": role, "name": NAME}),
        Grant(role, "appear", keys.LIVE, {"role": role, "name": NAME}),
        Grant(role, "watch", keys.LIVE, {"role": role, "name": NAME}),
    )


GRANTS: Final = (
    Grant("learner", "answer", keys.TRANSITION),
    Grant("learner", "put", keys.PARAMETERS),
    Grant("learner", "put", keys.PROGRESS),
    Grant("learner", "read", keys.PROGRESS),
    Grant("learner", "answer", keys.COMMAND),
    Grant("learner", "answer", keys.IMITATION),
    Grant("learner", "answer", keys.POPULATION),
    Grant("learner", "watch", keys.LIVE),
    *_own("learner"),
    Grant("rollout", "ask", keys.TRANSITION, {"worker": NAME}),
    Grant("rollout", "read", keys.PARAMETERS),
    Grant("rollout", "read", keys.PROGRESS),
    Grant("rollout", "read", keys.IMITATION_EVENT),
    Grant("rollout", "ask", keys.COMMAND, {"verb": "configuration"}),
    Grant("rollout", "answer", keys.EVALUATION, {"worker": NAME}),
    Grant("rollout", "answer", keys.WATCH, {"worker": NAME}),
    Grant("rollout", "put", keys.VIEW, {"worker": NAME}),
    *_own("rollout"),
    Grant("elite", "read", keys.PROGRESS),
    Grant("elite", "ask", keys.COMMAND, {"verb": "configuration"}),
    Grant("elite", "ask", keys.COMMAND, {"verb": "lead"}),
    Grant("elite", "ask", keys.EVALUATION),
    Grant("elite", "ask", keys.IMITATION),
    Grant("elite", "ask", keys.POPULATION),
    Grant("elite", "read", keys.PARAMETERS),
    Grant("elite", "put", keys.IMITATION_EVENT),
    Grant("elite", "watch", keys.LIVE, {"role": "rollout"}),
    *_own("elite"),
    Grant("operator", "read", keys.METRIC),
    Grant("operator", "watch", keys.LIVE),
    Grant("operator", "ask", keys.COMMAND, {"verb": "drain"}),
    Grant("operator", "ask", keys.COMMAND, {"verb": "arguments"}),
    Grant("monitor", "read", keys.METRIC),
    Grant("monitor", "watch", keys.LIVE),
    Grant("vehicle", "put", keys.POSE, {"vehicle": NAME}),
    Grant("vehicle", "read", keys.SETPOINT, {"vehicle": NAME}),
    Grant("flight", "read", keys.POSE),
    Grant("flight", "put", keys.SETPOINT),
    Grant("flight", "answer", keys.WATCH, {"worker": NAME}),
    Grant("flight", "put", keys.VIEW, {"worker": NAME}),
    *_own("flight"),
    Grant("environment", "answer", keys.ENVIRONMENT, {"environment": NAME}),
    Grant("environment", "appear", keys.ENVIRONMENT_LIVE, {"environment": NAME}),
    Grant("environment", "watch", keys.ENVIRONMENT_LIVE, {"environment": NAME}),
    *(Grant(role, "ask", keys.ENVIRONMENT) for role in ("learner", "rollout")),
    *(Grant(role, "watch", keys.ENVIRONMENT_LIVE) for role in ("learner", "rollout")),
    Grant("watcher", "watch", keys.LIVE),
    Grant("watcher", "ask", keys.WATCH),
    Grant("watcher", "read", keys.VIEW),
    Grant(ANYBODY, "watch", keys.LIVE, {"role": "learner"}),
)
"""The whole table. Everybody may see whether a learner lives, so a process can report that it is not a member."""


AT_SITES: Final = ("rollout",)
"""Roles for which a site's router speaks to the main one."""


def grants_of(role: str) -> tuple[Grant, ...]:
    """Return what a member of a role may do, including what everybody may do."""
    return tuple(grant for grant in GRANTS if grant.role in (role, ANYBODY))


def access_control(members: "Iterable[Identity]", enabled: bool = True, *, site: bool = False) -> dict[str, Any]:
    """Return Zenoh's `access_control` for a process that listens: default deny, and an allow-list.

    Args:
        members: the processes to admit; other holders of a certificate only see whether a learner lives.
        enabled: False allows everything; tests use it to show that they then fail.
        site: whether it is a site's router, which passes on whatever the main one sends.
    """
    listed = sorted(members)
    rules: list[dict[str, Any]] = []
    policies: list[dict[str, Any]] = []
    subjects: list[dict[str, Any]] = [{"id": ANYBODY, "link_protocols": ["tls"]}]
    subjects += [
        {"id": str(member), "cert_common_names": [str(member)], "link_protocols": ["tls"]} for member in listed
    ]

    def allow(owner: str, grants: Sequence[Grant], name: str | None, holders: list[str]) -> None:
        made = _rules(owner, [pair for grant in grants for pair in grant.expressions(name)])
        if made and holders:
            rules.extend(made)
            policies.append({"rules": [rule["id"] for rule in made], "subjects": holders})

    for role in sorted({grant.role for grant in GRANTS}):
        mine = [grant for grant in GRANTS if grant.role == role]
        holders = [str(member) for member in listed if member.role == role]
        allow(role, [g for g in mine if not g.personal], "", [ANYBODY] if role == ANYBODY else holders)
        for member in listed:
            if member.role == role:
                allow(str(member), [g for g in mine if g.personal], member.name, [str(member)])
    passed = {"site": [grant for grant in GRANTS if grant.role in (*AT_SITES, ANYBODY)]}
    if site:
        passed["router"] = list(GRANTS)
    for relay, grants in passed.items():
        allow(relay, grants, None, [str(member) for member in listed if member.role == relay])
    return _list_of(rules, subjects, policies, enabled)


def px4_access() -> dict[str, Any]:
    """Return Zenoh's `access_control` for the listener of one vehicle's bridge, to which its PX4 connects.

    PX4's Zenoh has no certificate. Whoever connects may tell PX4's topics and read set-points, and nothing else: it can
    neither command the vehicle in the bridge's place, nor reach any key of ours.
    """
    expressions: list[tuple[str, str]] = []
    for topic in keys.PX4_TOPICS:
        rights = ("put", _SEES["put"]) if topic.told else ("read",)
        expressions += [(right, topic.key("*")) for right in rights]
    rules = _rules("px4", expressions)
    subjects = [{"id": "px4", "link_protocols": ["tcp"]}]
    return _list_of(rules, subjects, [{"rules": [rule["id"] for rule in rules], "subjects": ["px4"]}])


def _list_of(
    rules: list[dict[str, Any]], subjects: list[dict[str, Any]], policies: list[dict[str, Any]], enabled: bool = True
) -> dict[str, Any]:
    """Return an allow-list."""
    return {
        "enabled": enabled,
        "default_permission": "deny",
        "rules": rules,
        "subjects": subjects,
        "policies": policies,
    }


def _rules(owner: str, expressions: Sequence[tuple[str, str]]) -> list[dict[str, Any]]:
    """Return one rule for each right and direction that pairs of right and key expression need."""
    rules = []
    for right, (incoming, outgoing) in RIGHTS.items():
        covered = sorted({expression for found, expression in expressions if found == right})
        for flow, messages in (("ingress", incoming), ("egress", outgoing)):
            if covered and messages:
                rules.append(
                    {
                        "id": f"{owner} {right} {flow}",
                        "permission": "allow",
                        "flows": [flow],
                        "messages": list(messages),
                        "key_exprs": covered,
                    }
                )
    return rules
