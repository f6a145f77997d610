"""Which host of a fleet holds the run: it is never begun anew where one of that name exists."""

from collections.abc import Mapping
from typing import Any

from eia_sec.common.errors import HostError, UsageError
from eia_sec.deploy.hosts.fleet_file import FleetRun, FleetSpec

States = Mapping[str, dict[str, Any]]
"""The state of each host, as `eia_sec.deploy.hosts.agent.status` gives it."""


def require_one_run(fleet: FleetSpec, states: States, failed: Mapping[str, str]) -> None:
    """Refuse to start a fleet whose learner would begin anew, or go on from an old copy.

    Args:
        fleet: the fleet.
        states: the hosts that were reached.
        failed: the reason for each that was not.

    Raises:
        UsageError: another host holds the run, or the hosts have histories of one that none of them holds.
        HostError: no reached host holds it, and one was not reached; or one has a version without populations.
    """
    if fleet.population:
        if older := [host for host, state in states.items() if "members" not in state]:
            raise HostError(
                f"{older[0]} has an older version, which does not say which members of a population it holds; "
                "nothing was started. Install this version there."
            )
        for run in fleet.runs:
            _require_one_member(fleet, run, states, failed)
        return
    found, target = _by_holding(states), fleet.learner.host
    holders = found["run"] or found["leaving"]
    if found["run"] == [target] or (target in failed and not holders):
        return
    if len(holders) > 1:
        raise _several(fleet, holders)
    if holders:
        raise UsageError(
            f"{holders[0]} holds run {fleet.run}, and [learner] names {target}, where it would begin anew; "
            f"`eia-sec fleet move-learner {fleet.path}` stops the fleet, moves the run to {target} and continues there."
        )
    if failed:
        host, reason = next(iter(failed.items()))
        raise HostError(
            f"{target} holds no run {fleet.run} yet, and {host}, which may hold it, was not reached ({reason}); "
            f"nothing was started. To begin the run without {host}, remove it from {fleet.path}."
        )
    if found["histories"]:
        raise UsageError(
            f"{found['histories'][0]} has histories of workers of run {fleet.run}, and no host of {fleet.path} holds "
            "the run: name the learner's former host again, or begin anew under another run name."
        )


def _require_one_member(fleet: FleetSpec, run: FleetRun, states: States, failed: Mapping[str, str]) -> None:
    """Refuse to start a member of a population that would begin anew; see `require_one_run`."""
    target, folder = run.learner.host, f"run/{run.folder}"
    found = {host: state["members"].get(run.member, "nothing") for host, state in states.items()}
    holders = [host for host, what in found.items() if what == "run"]
    if holders == [target] or (target in failed and not holders):
        return
    if len(holders) > 1:
        raise UsageError(f"{' and '.join(holders)} both hold {folder}; remove it from the folder of the older copy.")
    if holders:
        raise UsageError(
            f"{holders[0]} holds {run.member} of run {fleet.run}, and [population.{run.member}] names {target}, where "
            f"it would begin anew; stop the fleet and move {folder} from the one host's folder to the other's."
        )
    if failed:
        host, reason = next(iter(failed.items()))
        raise HostError(
            f"{target} does not hold {run.member} of run {fleet.run} yet, and {host}, which may hold it, was not "
            f"reached ({reason}); nothing was started. To begin it without {host}, remove it from {fleet.path}."
        )
    if histories := [host for host, what in found.items() if what == "histories"]:
        raise UsageError(
            f"{histories[0]} has histories of workers of {run.member}, and no host of {fleet.path} holds it: name its "
            "former host again, or begin anew under another run name."
        )


def source_of_move(fleet: FleetSpec, states: States) -> tuple[str, list[str]]:
    """Return the host that the run has to leave, and the hosts with copies that have left.

    The former is empty if the run is where it should be.

    Raises:
        UsageError: no host holds the run, or several do.
    """
    found, target = _by_holding(states), fleet.learner.host
    holders = found["run"] or found["leaving"]
    if not holders:
        raise UsageError(
            f"no host of {fleet.path} holds run {fleet.run}; the learner's former host must be among its hosts."
        )
    if len(holders) > 1:
        raise _several(fleet, holders)
    if found["run"] == [target]:
        return "", found["leaving"]
    return holders[0], [host for host in found["leaving"] if host not in holders]


def _by_holding(states: States) -> dict[str, list[str]]:
    found: dict[str, list[str]] = {"run": [], "leaving": [], "histories": [], "nothing": []}
    for host, state in states.items():
        found[state["holds"]].append(host)
    return found


def _several(fleet: FleetSpec, holders: list[str]) -> UsageError:
    folders = " and ".join(f"{host} ({fleet.hosts[host].folder})" for host in holders)
    return UsageError(f"{folders} both hold run {fleet.run}; remove run/ from the folder of the older copy.")
