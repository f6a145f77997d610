"""Which host of a fleet holds the run: it is never begun anew where one of that name exists."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from eia_sec.common.errors import HostError, UsageError
from eia_sec.deploy.hosts.fleet_file import FleetSpec

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
    if not fleet.population:
        found = _by_holding({host: state["holds"] for host, state in states.items()})
        if len(holders := found["run"] or found["leaving"]) > 1:
            raise _several(fleet, holders)
        remedy = (
            f"`eia-sec fleet move-learner {fleet.path}` stops the fleet, moves the run to {fleet.learner.host} and "
            "continues there"
        )
        _require_at(fleet.learner.host, f"run {fleet.run}", "[learner]", found, failed, fleet.path, remedy)
        return
    if older := [host for host, state in states.items() if "members" not in state]:
        raise HostError(
            f"{older[0]} has an older version, which does not say which members of a population it holds; nothing was "
            "started. Install this version there."
        )
    for run in fleet.runs:
        kept = f"run/{run.folder}"
        found = _by_holding({host: state["members"].get(run.member, "nothing") for host, state in states.items()})
        if len(found["run"]) > 1:
            names = " and ".join(found["run"])
            raise UsageError(f"{names} both hold {kept}; remove it from the folder of the older copy.")
        what, table = f"{run.member} of run {fleet.run}", f"[population.{run.member}]"
        remedy = f"stop the fleet and move {kept} from the one host's folder to the other's"
        _require_at(run.learner.host, what, table, found, failed, fleet.path, remedy)


def _require_at(
    target: str,
    what: str,
    table: str,
    found: Mapping[str, Sequence[str]],
    failed: Mapping[str, str],
    path: Path,
    remedy: str,
) -> None:
    """Refuse to start a learner whose run would begin anew; see `require_one_run`.

    Args:
        target: the learner's host.
        what: its run.
        table: the table of the fleet file that names the host.
        found: the reached hosts by what they hold of the run; at most one holds it.
        failed: the reason for each host that was not reached.
        path: the fleet file.
        remedy: what to do when another host holds it.
    """
    holders = found["run"] or found["leaving"]
    if found["run"] == [target] or (target in failed and not holders):
        return
    if holders:
        raise UsageError(f"{holders[0]} holds {what}, and {table} names {target}, where it would begin anew; {remedy}.")
    if failed:
        host, reason = next(iter(failed.items()))
        raise HostError(
            f"{target} does not hold {what} yet, and {host}, which may hold it, was not reached ({reason}); "
            f"nothing was started. To begin it without {host}, remove {host} from {path}."
        )
    if found["histories"]:
        raise UsageError(
            f"{found['histories'][0]} has histories of workers of {what}, and no host of {path} holds it: name the "
            "learner's former host again, or begin anew under another run name."
        )


def source_of_move(fleet: FleetSpec, states: States) -> tuple[str, list[str]]:
    """Return the host that the run has to leave, and the hosts with copies that have left.

    The former is empty if the run is where it should be.

    Raises:
        UsageError: no host holds the run, or several do.
    """
    target = fleet.learner.host
    found = _by_holding({host: state["holds"] for host, state in states.items()})
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


def _by_holding(held: Mapping[str, str]) -> dict[str, list[str]]:
    found: dict[str, list[str]] = {"run": [], "leaving": [], "histories": [], "nothing": []}
    for host, what in held.items():
        found[what].append(host)
    return found


def _several(fleet: FleetSpec, holders: list[str]) -> UsageError:
    folders = " and ".join(f"{host} ({fleet.hosts[host].folder})" for host in holders)
    return UsageError(f"{folders} both hold run {fleet.run}; remove run/ from the folder of the older copy.")
