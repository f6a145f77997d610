"""systemd units for a fleet: a folder per host, a unit per process, and a target for all of them."""

from pathlib import Path, PurePosixPath
from typing import Final

from eia_sec.common.config.files import to_toml
from eia_sec.common.errors import ConfigError
from eia_sec.deploy.hosts.fleet_file import FleetSpec
from eia_sec.deploy.hosts.plan import ORDER, Places, Process, processes
from eia_sec.deploy.local.threads import thread_environment

USER: Final = "eia-sec"
"""The user that the processes run as."""

_UNIT: Final = """[Unit]
Description=EIA-SEC run {run}: {identity}
Wants=network-online.target time-sync.target
After={after}
PartOf={target}
StartLimitIntervalSec=0

[Service]
Type=exec
User={user}
StateDirectory=eia-sec/{run}
StateDirectoryMode=0700
CacheDirectory=eia-sec
WorkingDirectory=/var/lib/eia-sec/{run}
Environment={threads}
Environment=NUMBA_CACHE_DIR=/var/cache/eia-sec PYTHONUNBUFFERED=1
ExecStart={command}
Restart=on-failure
RestartSec=5
# Exit code 2 is a mistake in the configuration, which a restart does not fix.
RestartPreventExitStatus=2
# 128 + SIGTERM: it was stopped before it had begun to work.
SuccessExitStatus=143
TimeoutStopSec=90
UMask=0077
NoNewPrivileges=yes
ProtectSystem=strict
ProtectHome=read-only
ProtectKernelTunables=yes
ProtectControlGroups=yes
PrivateTmp=yes
{devices}RestrictAddressFamilies=AF_UNIX AF_INET AF_INET6 AF_NETLINK

[Install]
WantedBy={target}
"""
_TARGET: Final = """[Unit]
Description=EIA-SEC run {run} on {host}

[Install]
WantedBy=multi-user.target
"""


def units(fleet: FleetSpec, *, begins: bool = True) -> dict[str, str]:
    """Return every file by its path, HOST/NAME.

    Args:
        fleet: the fleet.
        begins: whether the learner may begin the run; else it refuses to start before the run was copied to its host.

    Raises:
        ConfigError: a host's command is neither an absolute path nor a bare name.
    """
    folder, settings = f"/var/lib/eia-sec/{fleet.run}", f"/etc/eia-sec/{fleet.run}"
    keys, config = f"{settings}/keys/{{identity}}", f"{settings}/config.toml"
    places = Places(f"{folder}/run", keys, config, fleet.network.endpoint, fleet.network.listen, begins)
    planned = processes(fleet, places)
    files: dict[str, str] = {}
    for process in planned:
        beside = [other for other in planned if other.host == process.host]
        files[f"{process.host}/{unit_name(fleet, process)}"] = _unit(fleet, process, beside)
        files[f"{process.host}/{_target(fleet)}"] = _TARGET.format(run=fleet.run, host=process.host)
        if process.role == "learner":
            files[f"{process.host}/config.toml"] = to_toml(fleet.config)
    return files


def learner_units(fleet: FleetSpec, folder: Path) -> list[Path]:
    """Return the learner's units, of any host, in a folder that was rendered before."""
    return sorted(folder.glob(f"*/eia-sec-{fleet.run}-learner.learner.service"))


def unit_name(fleet: FleetSpec, process: Process) -> str:
    """Return the name of a process's unit."""
    return f"eia-sec-{fleet.run}-{process.identity}.service"


def _target(fleet: FleetSpec) -> str:
    return f"eia-sec-{fleet.run}.target"


def _unit(fleet: FleetSpec, process: Process, beside: list[Process]) -> str:
    command, words = fleet.hosts[process.host].command, fleet.hosts[process.host].words
    if "/" in words[0] and not PurePosixPath(words[0]).is_absolute():
        raise ConfigError(
            f"hosts.{process.host}.command must start with an absolute path for systemd, not {command!r}."
        )
    # Units stop in reverse order of starting: workers deliver before the learner stops.
    before = [other for other in beside if ORDER.index(other.role) > ORDER.index(process.role)]
    return _UNIT.format(
        run=fleet.run,
        identity=process.identity,
        after=" ".join(["network-online.target", "time-sync.target", *(unit_name(fleet, other) for other in before)]),
        target=_target(fleet),
        user=USER,
        threads=" ".join(f"{name}={value}" for name, value in thread_environment(process.threads).items()),
        command=" ".join(_word(word) for word in [*words, *process.arguments]),
        devices="" if process.role == "learner" and fleet.config.learner.device != "cpu" else "PrivateDevices=yes\n",
    )


def _word(word: str) -> str:
    """Return a word quoted for systemd, with specifiers and variables escaped."""
    word = word.replace("\\", "\\\\").replace('"', '\\"').replace("%", "%%").replace("$", "$$")
    return f'"{word}"' if any(sign in word for sign in " \t'\";") else word
