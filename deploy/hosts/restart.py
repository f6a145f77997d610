"""`eia-sec restart`: stop the processes of a fleet and start them again, all at once or host after host."""

import time
from collections.abc import Callable, Sequence
from typing import Any, Final

from eia_sec.common.errors import HostError, UsageError
from eia_sec.common.transport.credentials import LISTENING
from eia_sec.deploy.hosts.fleet_file import FleetSpec
from eia_sec.deploy.hosts.operations import asked_for_runs, down, request_of, require_all, starting, state_of, up
from eia_sec.deploy.hosts.plan import Process, here, processes
from eia_sec.deploy.hosts.remote import everywhere, links
from eia_sec.deploy.hosts.run_holders import require_one_run

ALIVE_SECONDS: Final = 300.0
"""Longest wait until the processes of a restarted host live: some compile first."""
LOOK_SECONDS: Final = 3.0


def restart(fleet: FleetSpec, seconds: float, *, rolling: bool, tell: Callable[[str], None]) -> None:
    """Stop all processes of a fleet and start them again; those of a finished run are left alone.

    Args:
        fleet: the fleet.
        seconds: how long to wait for the processes of each role to stop.
        rolling: whether one host after another is restarted, in the order of the file, each when all of the last one
            live again; else all are at once.
        tell: hears a sentence when processes live again, and what is left to do where the restart ends early.

    Raises:
        HostError: a host is not reached, and nothing was done; or a process does not stop or come back, and the hosts
            after it were left as they were.
        UsageError, CredentialsError: as in `up`; or processes do not run that others wait for. Nothing was done.
    """
    wanted = _startable(fleet, rolling=rolling)
    if not wanted:
        tell("the run has finished; there is nothing to restart.")
        return
    named = [name for name in fleet.hosts if any(one.host == name for one in wanted)]
    groups = [[name] for name in named] if rolling else [named]
    for place, hosts in enumerate(groups):
        try:
            _restart(fleet, hosts, [one for one in wanted if one.host in hosts], seconds)
        except (HostError, KeyboardInterrupt):
            rest = [name for later in groups[place + 1 :] for name in later]
            more = f" Not restarted: {', '.join(rest)}." if rest else ""
            tell(f"processes of {', '.join(hosts)} may be stopped; `eia-sec up {fleet.path}` starts them.{more}")
            raise
        count = sum(one.host in hosts for one in wanted)
        tell(f"{', '.join(hosts)}: {count} process{'es' if count > 1 else ''} restarted.")


def _startable(fleet: FleetSpec, *, rolling: bool) -> list[Process]:
    """Return the processes that would be started again, after all was checked that could keep them away."""
    for host in fleet.hosts:
        request_of(fleet, host)
    with links(fleet) as ways:
        states, failed = everywhere(
            ways, lambda link: state_of(link, "status", {"learners": asked_for_runs(fleet, link.name)})
        )
    require_all(failed)
    require_one_run(fleet, states, failed)
    labels = starting(fleet, {name for state in states.values() for name in state["over"]})
    found = [one for one in processes(fleet, here(fleet)) if one.label in labels]
    for one in found if rolling else ():
        state = states[one.host]["processes"].get(one.label, {}).get("state", "down")
        if state != "running":
            first = f"others may wait for it; run `eia-sec up {fleet.path}` first"
            raise UsageError(f"{one.label} on {one.host} is {state}, and {first}.")
    return found


def _restart(fleet: FleetSpec, hosts: Sequence[str], wanted: Sequence[Process], seconds: float) -> None:
    """Stop the processes of hosts, start them again, and wait until they live."""
    _, running, failed = down(fleet, seconds, kill=False, hosts=hosts, names=[one.label for one in wanted])
    require_all(failed)
    if running:
        raise HostError(f"{running[0]} is still running after {seconds:g} s.")
    _, failed = up(fleet, hosts)
    require_all(failed)
    end, away = time.monotonic() + ALIVE_SECONDS, list(wanted)
    while away := _still_away(fleet, away):
        if time.monotonic() > end:
            raise _lost(away[0])
        time.sleep(LOOK_SECONDS)


def _still_away(fleet: FleetSpec, away: Sequence[Process]) -> list[Process]:
    """Return which of some processes do not live yet; raise HostError where one was given up."""
    probes: dict[str, dict[str, Any]] = {one.host: {} for one in away}
    for one in away:
        probes[one.host][one.label] = _probe(fleet, one)
    with links(fleet) as every:
        ways = {name: every[name] for name in probes}
        states, failed = everywhere(ways, lambda link: state_of(link, "status", {"probes": probes[link.name]}))
    require_all(failed)
    left = [one for one in away if one.label not in states[one.host]["alive"]]
    for one in left:
        if states[one.host]["processes"].get(one.label, {}).get("state") == "given up":
            raise _lost(one)
    return [one for one in left if states[one.host]["processes"].get(one.label, {}).get("state") != "finished"]


def _lost(process: Process) -> HostError:
    why = f"`eia-sec logs --process {process.label}` says why"
    return HostError(f"{process.label} on {process.host} does not come back; {why}.")


def _probe(fleet: FleetSpec, process: Process) -> dict[str, Any]:
    """Return where a host is to ask whether one of its processes lives."""
    words = dict(zip(process.arguments, process.arguments[1:], strict=False))
    own = fleet.sites[process.name].endpoint if process.role == "site" else fleet.network.endpoint
    where = words.get("--connect", own) if process.role not in LISTENING else own
    runs = [run.name for run in ([process.run] if process.run is not None else fleet.runs)]
    return {"connect": where, "runs": runs, "name": process.identity.name, "tls": words.get("--tls", "")}
