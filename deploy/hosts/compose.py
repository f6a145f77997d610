"""A Compose file for a fleet: each process is a service on one Docker host."""

from typing import Any, Final

from eia_sec.common.config.files import to_toml
from eia_sec.deploy.hosts import containers
from eia_sec.deploy.hosts.containers import USER_ID, as_yaml, environment, inside, key_files, probe
from eia_sec.deploy.hosts.fleet_file import FleetSpec
from eia_sec.deploy.hosts.plan import ORDER, SHARING, Places, Process, processes
from eia_sec.deploy.local.run_directory import HISTORY

SHARED: Final = "memory"
"""The volume that replaces /dev/shm in containers that share transitions through memory."""


def compose(fleet: FleetSpec) -> dict[str, bytes]:
    """Return every file by its path: compose.yaml, config.toml, and a folder for each certificate.

    Raises:
        ConfigError: there are no certificates and `insecure` is not set.
        CredentialsError: a certificate is missing or cannot be used.
    """
    places = inside(fleet, fleet.listener[0])
    planned = processes(fleet, places)
    services = {service_of(process): _service(fleet, places, process) for process in planned}
    for process in planned:
        # Compose stops services before those that they depend on: workers deliver before the learner stops.
        later = [service_of(other) for other in planned if ORDER.index(other.role) > ORDER.index(process.role)]
        if later:
            services[service_of(process)]["depends_on"] = later
    document: dict[str, Any] = {"services": services}
    if fleet.network.shared_memory:
        document["volumes"] = {SHARED: _memory()}
    files = {"compose.yaml": as_yaml([document]).encode(), "config.toml": to_toml(fleet.config).encode()}
    for process in planned:
        for name, data in key_files(fleet, process.identity).items():
            files[f"keys/{process.identity}/{name}"] = data
    return files


def service_of(process: Process) -> str:
    """Return the name of a process's service, which is also its host name: learner, router, rollout-farm-2-0."""
    return process.role if process.role in ("learner", "router", "elite") else f"{process.role}-{process.name}"


def _service(fleet: FleetSpec, places: Places, process: Process) -> dict[str, Any]:
    listens = process.role == fleet.listener[0]
    service: dict[str, Any] = {
        "image": fleet.containers.image,
        "command": list(process.arguments),
        "user": f"${{EIA_SEC_UID:-{USER_ID}}}:${{EIA_SEC_GID:-{USER_ID}}}",
        "environment": environment(process),
        "volumes": _volumes(fleet, process),
        "healthcheck": {
            "test": ["CMD", *probe(fleet, places, process)],
            "interval": "60s",
            "timeout": "20s",
            "retries": 3,
            "start_period": "60s",
        },
        "restart": "on-failure",
        # Without it, SIGTERM would not end a process that has not yet installed its handler.
        "init": True,
        "stop_grace_period": "90s",
        "cap_drop": ["ALL"],
        "security_opt": ["no-new-privileges:true"],
    }
    if listens and fleet.keys is not None:
        port = containers.port_of(fleet)
        service["ports"] = [f"{port}:{port}", f"{port + 1}:{port + 1}"]
    if process.role == "learner" and fleet.learner.gpus:
        device = {"driver": "nvidia", "count": fleet.learner.gpus, "capabilities": ["gpu"]}
        service["deploy"] = {"resources": {"reservations": {"devices": [device]}}}
    return service


def _memory() -> dict[str, Any]:
    """Return the shared volume: a separate tmpfs, because a container's own /dev/shm is gone when it restarts.

    It has no size limit, like a host's /dev/shm: each Zenoh session keeps 16 MiB there, and a write beyond the end of
    a tmpfs kills the process.
    """
    options = {"type": "tmpfs", "device": "tmpfs", "o": "mode=1777,nosuid,nodev,noexec"}
    return {"driver": "local", "driver_opts": options}


def _volumes(fleet: FleetSpec, process: Process) -> list[Any]:
    volumes: list[Any] = []
    if process.role == "learner":
        volumes += [f"./run:{containers.RUN_DIR}", f"./config.toml:{containers.CONFIG}:ro"]
    if process.role == "rollout":
        volumes.append(f"./run/{HISTORY}:{containers.RUN_DIR}/{HISTORY}")
    if fleet.keys is not None:
        volumes.append(f"./keys/{process.identity}:{containers.KEYS}:ro")
    if SHARING in process.arguments:
        mount = {"type": "volume", "source": SHARED, "target": "/dev/shm", "volume": {"nocopy": True}}
        volumes.append(mount)
    return volumes
