"""`eia-sec fleet render`: the files that start a fleet with systemd, Compose or Kubernetes, or watch it."""

import os
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Final

from eia_sec.common.errors import ConfigError
from eia_sec.deploy.hosts.compose import compose
from eia_sec.deploy.hosts.fleet_file import FleetSpec
from eia_sec.deploy.hosts.kubernetes import kubernetes
from eia_sec.deploy.hosts.plan import ORDER
from eia_sec.deploy.hosts.prometheus import command, prometheus
from eia_sec.deploy.hosts.systemd import learner_units, units
from eia_sec.deploy.local import contained_files
from eia_sec.deploy.local.run_directory import HISTORY

_OPEN: Final = (".service", ".target", "prometheus.yml", "alerts.yml", "dashboard.json")
"""Ends of names of files that everybody may read, as systemd requires and Prometheus, a user of its own, needs."""


def render(fleet: FleetSpec, form: str, folder: Path) -> list[Path]:
    """Write the files of one form, see FORMS; return their paths.

    Raises:
        ConfigError: the form cannot express the fleet, or the folder cannot be written.
        CredentialsError: a certificate is missing or cannot be used.
    """
    _require_one_run(fleet)
    written = []
    try:
        files = FORMS[form](fleet, folder)
        for name, data in sorted(files.items()):
            written.append(contained_files.write(folder, name, data, 0o644 if name.endswith(_OPEN) else 0o600))
        if form == "compose":
            # Docker would create them as root, and no container could write into them.
            (folder / "run" / HISTORY).mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ConfigError(f"{folder} cannot be written: {error.strerror}.") from error
    return written


def left_over(fleet: FleetSpec, form: str, folder: Path, written: Sequence[Path]) -> list[Path]:
    """Return units, or Compose's keys, in a folder that an earlier form of the fleet had and this one does not have."""
    found: list[Path] = []
    for role in ORDER:
        if form == "systemd":
            found += folder.glob(f"*/eia-sec-{fleet.run}-{role}.*.service")
        if form == "compose":
            found += folder.glob(f"keys/{role}.*")
    kept = {*written, *(path.parent for path in written)}
    return sorted(path for path in found if path not in kept)


def keeping(fleet: FleetSpec, form: str, folder: Path) -> str:
    """Return what must be done so that a run goes on elsewhere, and does not begin anew; call this before `render`.

    Files for Prometheus start nothing; of them it says where the figures come from.

    Raises:
        ConfigError: the fleet is one of a population.
    """
    _require_one_run(fleet)
    if form == "prometheus":
        return f"the figures are those of: {command(fleet)}"
    if form != "systemd":
        where = "its volume claim" if form == "kubernetes" else str(folder / "run")
        return f"the learner keeps run {fleet.run} in {where}; elsewhere it begins anew, unless you copy that."
    place, target = f"/var/lib/eia-sec/{fleet.run}/run", fleet.learner.host
    former = [path.parent.name for path in learner_units(fleet, folder) if path.parent.name != target]
    if former:
        return (
            f"the learner moves from {former[0]} to {target}: stop the fleet, copy {place} there, and delete the unit "
            f"on {former[0]}; until then the learner on {target} refuses to start."
        )
    return f"the learner keeps run {fleet.run} in {place} on {target}."


def _require_one_run(fleet: FleetSpec) -> None:
    if fleet.population:
        raise ConfigError(
            f"{fleet.path} describes a population, which `eia-sec fleet render` cannot write; use `eia-sec up`."
        )


def _compose(fleet: FleetSpec, folder: Path) -> dict[str, bytes]:
    """Return Compose's files, and .env with the user who may read them."""
    project = f"eia-sec-{fleet.run.lower().replace('.', '-')}"
    settings = f"COMPOSE_PROJECT_NAME={project}\nEIA_SEC_UID={os.getuid()}\nEIA_SEC_GID={os.getgid()}\n"
    return compose(fleet) | {".env": settings.encode()}


def _systemd(fleet: FleetSpec, folder: Path) -> dict[str, bytes]:
    """Return the units; a learner that was rendered for another host before goes on and never begins."""
    known = learner_units(fleet, folder)
    moved = any(path.parent.name != fleet.learner.host or " --resume " in path.read_text() for path in known)
    return {name: text.encode() for name, text in units(fleet, begins=not moved).items()}


def _kubernetes(fleet: FleetSpec, folder: Path) -> dict[str, bytes]:
    return {name: text.encode() for name, text in kubernetes(fleet).items()}


def _prometheus(fleet: FleetSpec, folder: Path) -> dict[str, bytes]:
    return {name: text.encode() for name, text in prometheus(fleet).items()}


FORMS: Final[dict[str, Callable[[FleetSpec, Path], dict[str, bytes]]]] = {
    "systemd": _systemd,
    "compose": _compose,
    "kubernetes": _kubernetes,
    "prometheus": _prometheus,
}
