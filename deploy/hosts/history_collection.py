"""`eia-sec fleet collect`: histories packed on each host and unpacked into one folder here, without trusting the hosts.

A host may write its own files only: its workers' histories, and the learner's files if the fleet file places the
learner there.
"""

import re
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path, PurePosixPath
from typing import IO, Final

from eia_sec.common.errors import ConfigError, HostError
from eia_sec.common.policy_file import POLICY
from eia_sec.deploy.hosts import archive
from eia_sec.deploy.hosts.fleet_file import FleetSpec
from eia_sec.deploy.hosts.remote import Link, everywhere, links
from eia_sec.deploy.local.members import FOLDER
from eia_sec.deploy.local.run_directory import CONFIG, HISTORY, METRICS

OF_THE_LEARNER: Final = (f"{HISTORY}/learner.jsonl", CONFIG, METRICS, POLICY)
"""Files that the learner's host sends besides its workers' histories."""
MAX_ARCHIVE: Final = 2 * 1024**3
"""Largest archive of one host, bytes."""


@dataclass
class Collected:
    """The result of a collection.

    Attributes:
        files: number of files written.
        left_out: "HOST NAME" of files that do not belong to their host.
        strays: hosts whose left-out files are a learner's.
        failed: the reason for each host that failed.
    """

    files: int = 0
    left_out: list[str] = field(default_factory=list)
    strays: list[str] = field(default_factory=list)
    failed: dict[str, str] = field(default_factory=dict)


def pack(folder: Path, out: IO[bytes]) -> None:
    """Write an archive of a host's run: histories, metrics, configuration and policy, whichever exist."""
    run = folder / "run"
    found: list[Path] = []
    for one in (run, *sorted((run / FOLDER).glob("*"))):
        found += [*sorted((one / HISTORY).glob("*.jsonl")), *(one / name for name in (CONFIG, METRICS, POLICY))]
    archive.pack(run, found, out)


def collect(fleet: FleetSpec, target: Path) -> Collected:
    """Copy the histories of all hosts and the learner's metrics and policy into one folder, for `eia-sec audit`.

    Raises:
        ConfigError: the folder cannot be made.
    """
    try:
        for run in fleet.runs:
            (target / run.folder / HISTORY).mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ConfigError(f"{target} cannot be made: {error.strerror}.") from error
    found = Collected()

    def bring(link: Link) -> tuple[int, list[str]]:
        with link.fetch("collect", most=MAX_ARCHIVE) as packed:
            try:
                return archive.unpack(packed, target, own_names(fleet, link.name))
            except HostError as error:
                raise HostError(f"{link.name}: {error}") from error

    with links(fleet) as ways:
        done, found.failed = everywhere(ways, bring)
    for host, (files, left_out) in done.items():
        found.files += files
        found.left_out += [f"{host} {name}" for name in left_out]
        learners = {str(PurePosixPath(run.folder, name)) for run in fleet.runs for name in OF_THE_LEARNER}
        found.strays += [host] if learners.intersection(left_out) else []
    return found


def own_names(fleet: FleetSpec, host: str) -> Callable[[str], bool]:
    """Return a predicate for the file names that belong to a host."""
    folders = "|".join(re.escape(f"{run.folder}/" if run.folder else "") for run in fleet.runs)
    workers = re.compile(rf"({folders}){HISTORY}/rollout-{re.escape(host)}-[0-9]+\.jsonl")
    led = [run.folder for run in fleet.runs if run.learner.host == host]
    learner = {str(PurePosixPath(folder, name)) for folder in led for name in OF_THE_LEARNER}
    return lambda name: name in learner or workers.fullmatch(name) is not None
