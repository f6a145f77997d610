"""The operations of `eia-sec up`, `down`, `status`, `logs` and `fleet` on all hosts of a fleet."""

import hashlib
import json
from collections.abc import Callable, Collection, Sequence
from functools import partial
from pathlib import Path
from typing import Any, Final

from eia_sec.common.config.files import to_toml
from eia_sec.common.errors import CredentialsError, HostError, UsageError
from eia_sec.common.process import StopSignal
from eia_sec.common.transport import credentials
from eia_sec.common.transport.credentials import CA, CERTIFICATE, KEY, LISTENING, MEMBERS, Identity
from eia_sec.common.transport.endpoint import Endpoint
from eia_sec.deploy.hosts.fleet_file import FleetSpec, Network, Site
from eia_sec.deploy.hosts.learner_move import HOLDINGS, MAX_ARCHIVE
from eia_sec.deploy.hosts.plan import ORDER, Process, here, processes
from eia_sec.deploy.hosts.remote import Link, everywhere, links
from eia_sec.deploy.hosts.run_holders import require_one_run, source_of_move
from eia_sec.deploy.security import authority

Failures = dict[str, str]
"""The reason for each host that failed."""
NAMED: Final = 8
"""Processes that a refusal names; a fleet may have hundreds."""
MOVE_SECONDS: Final = 3600.0
"""Longest time for a learner's files to leave a host, and to come to another."""


def up(fleet: FleetSpec, hosts: Collection[str] | None = None) -> tuple[dict[str, dict[str, Any]], Failures]:
    """Start processes that do not run, restart those that changed, and stop those the fleet file no longer names.

    Args:
        fleet: the fleet.
        hosts: the hosts to do it on; None for all.

    Returns:
        The state of each host that was reached, and the reason for each that failed.

    Raises:
        CredentialsError: a certificate is missing or cannot be used; nothing has been started.
        UsageError: another host holds the run, so that the learner would begin it anew; nothing has been started.
        HostError: a host that may hold the run was not reached; nothing has been started.
    """
    requests = {name: request_of(fleet, name) for name in fleet.hosts if hosts is None or name in hosts}
    with links(fleet) as ways:
        asked = partial(asked_for_runs, fleet)
        states, failed = everywhere(ways, lambda link: state_of(link, "status", {"learners": asked(link.name)}))
        require_one_run(fleet, states, failed)
        again = starting(fleet, {name for state in states.values() for name in state["over"]})
        chosen = {name: link for name, link in ways.items() if name in requests}
        states, failed = everywhere(chosen, lambda link: state_of(link, "up", {**requests[link.name], "again": again}))
    return {name: states[name] for name in fleet.hosts if name in states}, failed


def asked_for_runs(fleet: FleetSpec, host: str) -> dict[str, dict[str, str]]:
    """Return where a host would hold the runs of its learners, and their configurations, by the learner's label."""
    places = here(fleet)
    return {
        f"learner.{run.process}": {"run": places.of(run).run_dir, "config": to_toml(run.config)}
        for run in fleet.runs
        if run.learner.host == host
    }


def starting(fleet: FleetSpec, over: Collection[str]) -> list[str]:
    """Return the processes that are to be started where they do not run: those of a finished run are not.

    Args:
        fleet: the fleet.
        over: labels of the learners whose runs are finished.
    """
    left = [run for run in fleet.runs if f"learner.{run.process}" not in over]
    return [one.label for one in processes(fleet, here(fleet)) if (one.run in left if one.run is not None else left)]


def request_of(fleet: FleetSpec, host: str) -> dict[str, Any]:
    """Return the request for a host: its processes and the files that they need."""
    files: dict[str, str] = {}
    found: dict[str, dict[str, Any]] = {}
    for process in processes(fleet, here(fleet)):
        if process.host != host:
            continue
        own = _key_files(fleet.keys, process) if fleet.keys is not None else {}
        if process.role == "learner" and process.run is not None:
            own[here(fleet).of(process.run).config] = to_toml(process.run.config)
        files |= own
        # A changed certificate restarts its process, a changed list of members only the listener.
        listens = process.role in (fleet.listener[0], "site")
        needed = [item for item in sorted(own.items()) if listens or MEMBERS not in item[0]]
        digest = hashlib.sha256(repr(needed).encode()).hexdigest()[:16]
        found[process.label] = {
            "arguments": list(process.arguments),
            "threads": process.threads,
            "files": digest,
        }
    return {"processes": found, "files": files, "start": fleet.hosts[host].start}


def _key_files(keys: Path, process: Process) -> dict[str, str]:
    folder = keys / str(process.identity)
    credentials.load(folder).require(process.identity.role, process.identity.name)
    names = (CA, CERTIFICATE, KEY, *((MEMBERS,) if process.role in LISTENING else ()))
    far = Path("keys") / folder.name
    return {(far / name).as_posix(): credentials.read_bounded(folder / name, 1024**2).decode() for name in names}


def down(
    fleet: FleetSpec, seconds: float, kill: bool, *, hosts: Collection[str] | None = None, names: Collection[str] = ()
) -> tuple[list[str], list[str], Failures]:
    """Stop a fleet: workers first, then the coordinator, the learner and the routers.

    Args:
        fleet: the fleet.
        seconds: how long to wait for each of these roles.
        kill: whether to kill what is still running then.
        hosts: the hosts to do it on; None for all.
        names: the processes to stop, "ROLE.NAME"; none for all.

    Returns:
        "HOST NAME" of what has stopped and of what has not, and the reason for each host that failed.

    Raises:
        UsageError: there is no process of such a name, neither in the file nor on any host.
    """
    ended: list[str] = []
    left: list[str] = []
    failed: Failures = {}
    with links(fleet) as every:
        ways = {name: link for name, link in every.items() if hosts is None or name in hosts}
        states, failures = everywhere(ways, partial(state_of, verb="status", request={}))
        failed |= failures
        there = {name for state in states.values() for name in state["processes"]}
        places = {one.label: one.host for one in processes(fleet, here(fleet))}
        for name in names:
            if name not in there and name not in places:
                raise no_process(fleet, name, list(places))
        if names:  # of other hosts nothing is asked
            asked = {places.get(name) for name in names}
            failed = {host: reason for host, reason in failed.items() if host in asked}
        kept = {host: {name.split(".")[0] for name in state["processes"]} for host, state in states.items()}
        for role in ORDER:
            reachable = {host: ways[host] for host, roles in kept.items() if role in roles and host not in failed}
            roles = [name for name in names if name.split(".")[0] == role] if names else [role]
            if not roles:
                continue
            ask = partial(Link.call, verb="down", request={"roles": roles, "seconds": seconds, "kill": kill})
            answers, failures = everywhere(reachable, partial(ask, seconds=seconds))
            failed |= failures
            for host, answer in answers.items():
                ended += [f"{host} {name}" for name in _texts(answer.get("ended"))]
                left += [f"{host} {name}" for name in _texts(answer.get("left"))]
        for host, state in states.items():
            for name in names:
                if state["processes"].get(name, {}).get("pid") and f"{host} {name}" not in (*ended, *left):
                    failed.setdefault(host, f"{host} has an older version, which stops no single processes.")
    return ended, left, failed


def no_process(fleet: FleetSpec, name: str, known: Sequence[str]) -> UsageError:
    """Return what is wrong with a name that no process of a fleet has, beside those that there are."""
    more = f" and {len(known) - NAMED} more" if len(known) > NAMED else ""
    return UsageError(f"{fleet.path} has no process {name!r}; it has {', '.join(known[:NAMED])}{more}.")


def move_learner(fleet: FleetSpec, seconds: float) -> list[str]:
    """Stop a fleet and move the run to the host that the fleet file names for the learner; `up` continues it there.

    An interrupted move is completed by the next one.

    Args:
        fleet: the fleet; the host that the run leaves is still one of its hosts.
        seconds: how long to wait for the processes of each role to stop.

    Returns:
        A sentence for each thing that was done.

    Raises:
        UsageError: no host holds the run, or several do; or it is one of a population.
        HostError: a host was not reached or failed, or a process did not stop.
    """
    if fleet.population:
        raise UsageError(
            "fleet move-learner is for a run alone; to move a member, stop the fleet and move its folder, "
            f"run/{fleet.runs[0].folder} for instance, to that of the other host."
        )
    target = fleet.learner.host
    with links(fleet) as ways:
        states, failed = everywhere(ways, partial(state_of, verb="status", request={}))
        require_all(failed)
        source, left = source_of_move(fleet, states)
    done = []
    if source:
        ended, running, failed = down(fleet, seconds, kill=False)
        require_all(failed)
        if running:
            raise HostError(f"{running[0]} is still running after {seconds:g} s; nothing was moved.")
        done += [f"{name} has stopped." for name in ended]
    with links(fleet) as ways:
        if source:
            with ways[source].fetch("release", seconds=MOVE_SECONDS, most=MAX_ARCHIVE) as packed:
                ways[target].fetch("take-in", packed, seconds=MOVE_SECONDS).close()
            done.append(f"run {fleet.run} has moved from {source} to {target}.")
        for host in (*left, *([source] if source else ())):
            kept = ways[host].call("forget", {}).get("kept")
            done.append(f"{host} keeps its copy in {kept}; nothing needs it any more.")
    return done


def require_all(failed: Failures) -> None:
    """Raise HostError for the first host that failed."""
    for reason in failed.values():
        raise HostError(reason)


def status(fleet: FleetSpec) -> tuple[dict[str, dict[str, Any]], Failures]:
    """Return the state of each host that was reached, and the reason for each that was not."""
    with links(fleet) as ways:
        return everywhere(ways, partial(state_of, verb="status", request={}))


def logs(fleet: FleetSpec, names: Sequence[str], lines: int) -> tuple[dict[str, dict[str, str]], Failures]:
    """Return the last log lines of each process by host and name, and the reason for each host that failed."""

    def ask(link: Link) -> dict[str, str]:
        return {name: str(text) for name, text in link.call("logs", {"names": list(names), "lines": lines}).items()}

    with links(fleet) as ways:
        return everywhere(ways, ask)


def state_of(link: Link, verb: str, request: dict[str, Any]) -> dict[str, Any]:
    """Return a host's state as `deploy.hosts.agent.status` gives it; raise HostError when the answer is none."""
    state = link.call(verb, request)
    if request.get("probes") and "alive" not in state:
        raise HostError(f"{link.name} has an older version, which does not say what lives; install this version there.")
    processes, alarms, members = state.get("processes"), state.get("alarms"), state.get("members", {})
    over, alive = state.setdefault("over", []), state.setdefault("alive", [])
    if not (
        type(state.get("keeper")) is int
        and isinstance(alarms, list)
        and all(isinstance(alarm, str) for alarm in alarms)
        and state.get("holds") in HOLDINGS
        and isinstance(members, dict)
        and all(what in HOLDINGS for what in members.values())
        and isinstance(over, list)
        and isinstance(alive, list)
        and all(isinstance(name, str) for name in [*over, *alive])
        and isinstance(processes, dict)
        and all(isinstance(process, dict) and _is_process(process) for process in processes.values())
    ):
        raise HostError(f"{link.name}: its answer is not the state of a host.")
    return state


LATEST: Final = 1e11
"""No process began later than this, s since 1970."""


def _is_process(process: dict[str, Any]) -> bool:
    """Return whether values have the types in which the keeper writes a process's state."""
    return (
        isinstance(process.get("state"), str)
        and all(type(value := process.get(name)) is int and 0 <= value < 2**31 for name in ("pid", "deaths"))
        and isinstance(since := process.get("since"), int | float)
        and 0.0 <= since < LATEST
    )


def _texts(value: Any) -> list[str]:
    """Return a list of texts from a host's answer, empty for anything else."""
    return [str(text) for text in value] if isinstance(value, list) else []


def follow(
    fleet: FleetSpec, names: Sequence[str], lines: int, show: Callable[[str, str, str], None], stop: StopSignal
) -> Failures:
    """Show the last log lines of processes and then each new one, until stopped.

    Args:
        fleet: the fleet.
        names: processes; empty for all.
        lines: number of existing lines that come first.
        show: called with host, process and line, from one thread per host; also when a host is lost.
        stop: ends it.

    Returns:
        The reason for each host that failed.
    """

    def take(link: Link, line: bytes) -> None:
        try:
            name, text = json.loads(line)
        except (ValueError, TypeError, RecursionError) as error:
            raise HostError(f"{link.name}: it sent something that is not a log line: {line[:80]!r}.") from error
        show(link.name, str(name), str(text))

    def stream(link: Link) -> None:
        try:
            link.stream("follow", {"names": list(names), "lines": lines}, partial(take, link), stop)
        except HostError as error:
            show(link.name, "(lost)", str(error))
            raise
        except BaseException:
            stop.event.set()  # otherwise nobody would hear of it before the other streams end
            raise

    with links(fleet) as ways:
        return everywhere(ways, stream, len(ways))[1]


def served_names(fleet: FleetSpec, identity: Identity) -> tuple[str, ...]:
    """Return the names and addresses for a certificate, of the listener also those inside containers."""
    inner: tuple[str, ...] = ()
    if identity.role == fleet.listener[0]:
        place: Network | Site = fleet.network
        inner = (identity.role, service_name(fleet, identity.role))
    elif identity.role == "site":
        place = fleet.sites[identity.name]
    else:  # a learner behind a router does not listen, but its certificate needs a host
        return ("localhost",) if identity.role in LISTENING else ()
    host = Endpoint.parse(place.endpoint.replace("tls/", "tcp/", 1)).host.strip("[]")
    wanted = (host, *place.names, "localhost", "127.0.0.1", *inner)
    return tuple(dict.fromkeys(name for name in wanted if name not in ("0.0.0.0", "::")))


def service_name(fleet: FleetSpec, role: str) -> str:
    """Return the name of a role's service in Kubernetes."""
    return f"{fleet.run.lower().replace('_', '-').replace('.', '-')}-{role}"


def issue_keys(fleet: FleetSpec, days: int) -> list[Identity]:
    """Make the certificates that a fleet lacks, including the authority's, operator's, monitor's and watcher's.

    Those of listeners are renewed when the fleet has given them a new name.

    Returns:
        The identities that got a certificate.

    Raises:
        CredentialsError: the fleet file names no folder for keys, or a certificate cannot be made.
    """
    if fleet.keys is None:
        raise CredentialsError(f'{fleet.path} names no folder for keys; add keys = "keys" to [network].')
    if not (fleet.keys / authority.CA_KEY).exists():
        authority.create(fleet.keys)
    needed = [process.identity for process in processes(fleet, here(fleet))]
    needed += [Identity(role, role) for role in ("operator", "monitor", "watcher")]
    made = []
    lifetime = authority.lasting(days)
    for identity in needed:
        names = served_names(fleet, identity)
        if not (fleet.keys / str(identity) / CERTIFICATE).exists():
            authority.issue(fleet.keys, identity, names, lifetime)
            made.append(identity)
        elif identity.role in (fleet.listener[0], "site") and (
            more := authority.not_served(fleet.keys, identity, names)
        ):
            authority.renew(fleet.keys, identity, lifetime, more)
            made.append(identity)
    return made
