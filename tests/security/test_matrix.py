"""Every role, every key family, every kind of message, and wildcards: what is observed is what is declared."""

from typing import Any

import pytest

from eia_sec.common.protocol import access, keys
from eia_sec.common.transport.credentials import Identity
from tests.security.matrix import compare, observe_egress, observe_ingress

NAMES = (
    "rollout.a",
    "elite.coordinator",
    "monitor.m",
    "operator.o",
    "learner.learner",
    "router.main",
    "rollout.unlisted",
    "watcher.w",
    "vehicle.uav",
    "flight.main",
    "environment.site",
)


def without_list(acl: dict[str, Any]) -> dict[str, Any]:
    """Return the access list switched off."""
    return {**acl, "enabled": False}


def opened(flow: str, messages: tuple[str, ...]) -> Any:
    """Return what opens an access list in one direction, so that the other has to hold alone."""

    def alter(acl: dict[str, Any]) -> dict[str, Any]:
        rule = {"id": "open", "permission": "allow", "flows": [flow], "messages": list(messages), "key_exprs": ["**"]}
        adv = {**rule, "id": "open helpers", "key_exprs": [f"{keys.ROOT}/**/@adv/**"]}
        policy = {"rules": ["open", "open helpers"], "subjects": [access.ANYBODY]}
        return {**acl, "rules": [*acl["rules"], rule, adv], "policies": [*acl["policies"], policy]}

    return alter


def test_what_processes_send_is_what_the_table_grants(keys_folder):
    """Puts, deletes, requests and tokens of every role pass exactly where the table says so."""
    assert compare(keys_folder, NAMES, (observe_ingress,)) == (set(), set())


def test_what_reaches_processes_is_what_the_table_grants(keys_folder):
    """Subscriptions, queryables and liveliness views of every role get exactly what the table says."""
    assert compare(keys_folder, NAMES, (observe_egress,)) == (set(), set())


def test_without_the_access_list_the_comparison_fails(keys_folder):
    """With the list taken away, a worker's forbidden puts, deletes, requests and tokens are all reported."""
    undeclared, missing = compare(keys_folder, ("rollout.a",), (observe_ingress,), without_list)
    assert missing == set()
    foreign = f"{keys.ROOT}/matrix/metric/rollout/b"
    for kind in ("put", "delete", "ask"):
        assert {("rollout.a", kind, foreign), ("rollout.a", kind, "**")} <= undeclared
    assert ("rollout.a", "appear", f"{keys.ROOT}/matrix/live/rollout/b") in undeclared


@pytest.mark.nightly
def test_without_the_access_list_reading_fails_the_comparison(keys_folder):
    """With the list taken away, a monitor reads parameters and answers requests, and that is reported."""
    undeclared, missing = compare(keys_folder, ("monitor.m",), (observe_egress,), without_list)
    assert missing == set()
    for kind, key in (("read", "params/actors"), ("answer", "transition/b"), ("read", "transition/b")):
        assert ("monitor.m", kind, f"{keys.ROOT}/matrix/{key}") in undeclared


@pytest.mark.nightly
def test_the_incoming_half_holds_alone(keys_folder):
    """A process that learns of every subscriber and queryable still cannot send what the table does not grant."""
    verbs = ("declare_subscriber", "declare_queryable", "put", "delete", "reply")
    assert compare(keys_folder, NAMES, (observe_ingress,), opened("egress", verbs)) == (set(), set())


def test_the_table_says_what_was_asked_for():
    """A worker writes only what is its own, the learner parameters, monitors nothing."""
    sends = {"put", "ask", "answer", "appear"}
    held = {role: {(g.right, g.family, tuple(g.variables.items())) for g in access.grants_of(role)} for role in ROLES}
    writers = {role for role in ROLES if any((r, f) == ("put", keys.PARAMETERS) for r, f, _ in held[role])}
    assert writers == {"learner"}
    assert {r for r, _, _ in held["monitor"]} & sends == set()
    for family in (keys.EVALUATION, keys.IMITATION):
        assert {role for role in ROLES if any((r, f) == ("ask", family) for r, f, _ in held[role])} == {"elite"}
    allowed = {str(family.pattern("run", **v)) for r, family, v in own_sends("a") if r in sends}
    root = f"{keys.ROOT}/run"
    assert allowed == {
        f"{root}/transition/a",
        f"{root}/ctl/learner/configuration",
        f"{root}/eval/a",
        f"{root}/watch/a",
        f"{root}/view/a",
        f"{root}/metric/rollout/a",
        f"{root}/live/rollout/a",
        f"{keys.ENVIRONMENT_ROOT}/request/*/*",
    }


ROLES = ("learner", "router", "flight", "rollout", "elite", "operator", "monitor", "watcher", "vehicle", "environment")


def test_a_vehicle_writes_its_own_poses_alone_and_nobody_but_the_flight_node_set_points():
    """Of all that the table lets a vehicle send there is one key, and set-points come from one role."""
    sends = {"put", "ask", "answer", "appear"}
    held = {role: [g for g in access.grants_of(role) if g.right in sends] for role in ROLES}
    (only,) = held["vehicle"]
    sent = [pair for pair in only.expressions("uav-7", "run") if pair[0] in sends]
    assert sent == [("put", f"{keys.ROOT}/run/flight/uav-7/pose")]
    assert {role for role in ROLES if any(g.family == keys.SETPOINT for g in held[role])} == {"flight"}
    assert {g.family for g in held["flight"]} == {keys.SETPOINT, keys.METRIC, keys.LIVE, keys.WATCH, keys.VIEW}


def test_an_environment_answers_and_appears_under_its_own_name_and_workers_and_learner_alone_ask_it():
    """No environment can pose as another one, and no other role can move a robot."""
    sends = {"put", "ask", "answer", "appear"}
    held = {role: [g for g in access.grants_of(role) if g.right in sends] for role in ROLES}
    sent = {pair for g in held["environment"] for pair in g.expressions("site-a", "run") if pair[0] in sends}
    root = keys.ENVIRONMENT_ROOT
    assert sent == {("answer", f"{root}/request/site-a/*"), ("appear", f"{root}/live/site-a")}
    asking = {role for role in ROLES if any((g.right, g.family) == ("ask", keys.ENVIRONMENT) for g in held[role])}
    assert asking == {"rollout", "learner"}


def own_sends(name: str) -> list[tuple[str, keys.KeyFamily, dict[str, str]]]:
    """Return what a worker of this name may do, its name filled in."""
    found = []
    for grant in access.grants_of("rollout"):
        given = {key: name if value == access.NAME else value for key, value in grant.variables.items()}
        found.append((grant.right, grant.family, given))
    return found


def test_nobody_is_let_in_without_being_listed():
    """An empty list of members grants nothing but the sight of a living learner."""
    acl = access.access_control([])
    assert acl["default_permission"] == "deny"
    expressions = {key for rule in acl["rules"] for key in rule["key_exprs"]}
    assert expressions == {f"{keys.ROOT}/*/live/learner/*"}
    listed = access.access_control([Identity("rollout", "a")])
    assert {subject["id"] for subject in listed["subjects"]} == {access.ANYBODY, "rollout.a"}
