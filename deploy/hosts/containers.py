"""What Compose and Kubernetes share: paths inside a container, key files, the probe, and YAML."""

from collections.abc import Sequence
from typing import Any, Final

import yaml

from eia_sec.common.errors import ConfigError
from eia_sec.common.transport import credentials
from eia_sec.common.transport.credentials import CA, CERTIFICATE, KEY, LISTENING, MEMBERS, Identity
from eia_sec.common.transport.endpoint import Endpoint
from eia_sec.deploy.hosts.fleet_file import FleetSpec
from eia_sec.deploy.hosts.plan import Places, Process
from eia_sec.deploy.local.threads import thread_environment

USER_ID: Final = 10_001
"""The user id in the image; see Dockerfile."""
CONFIG: Final = "/config/config.toml"
KEYS: Final = "/keys"
RUN_DIR: Final = "/data/run"


def inside(fleet: FleetSpec, host: str) -> Places:
    """Return the paths and endpoints inside a container.

    Args:
        fleet: the fleet.
        host: the name that other containers reach the listener by.

    Raises:
        ConfigError: there are no certificates and `insecure` is not set; containers do not share a loopback. Or the
            learner's device and the GPUs that its container requests do not fit, or the fleet has sites.
    """
    if fleet.sites:
        raise ConfigError(f"{fleet.path}: containers are all at one place; remove sites, or use `eia-sec up`.")
    if fleet.keys is None and not fleet.network.insecure:
        raise ConfigError(
            f"{fleet.path}: containers share a network that strangers may reach; set network.keys to the folder of "
            "`eia-sec keys`, or set insecure = true if that is intended."
        )
    device, gpus = fleet.config.learner.device, fleet.learner.gpus
    if (device == "cpu") != (gpus == 0):
        raise ConfigError(
            f"{fleet.path}: the learner trains with learner.device = {device}, but its container requests {gpus} GPUs; "
            + ("set learner.device = cuda in training.set." if gpus else "set gpus = 1 in [learner].")
        )
    protocol, port = ("tls" if fleet.keys is not None else "tcp"), port_of(fleet)
    return Places(RUN_DIR, KEYS, CONFIG, f"{protocol}/{host}:{port}", f"{protocol}/0.0.0.0:{port}")


def port_of(fleet: FleetSpec) -> int:
    """Return the port of the control lane."""
    return Endpoint.parse(fleet.network.endpoint.replace("tls/", "tcp/", 1)).port


def probe(fleet: FleetSpec, places: Places, process: Process, name: str = "") -> list[str]:
    """Return the command that checks a process's liveliness token, or whether the router answers."""
    listens = process.role == fleet.listener[0]
    # The listener is asked inside its container: a network that is down is not mended by its restart.
    endpoint = places.listen.replace("0.0.0.0", "127.0.0.1") if listens else places.endpoint
    words = ["eia-sec", "alive", process.role, name or process.name, "--run", fleet.run, "--connect", endpoint]
    words += ["--tls", KEYS] if fleet.keys is not None else []
    return words if listens else [*words, "--blame"]


def environment(process: Process) -> dict[str, str]:
    """Return the environment of a process: its share of compute threads."""
    return thread_environment(process.threads)


def key_files(fleet: FleetSpec, identity: Identity) -> dict[str, bytes]:
    """Return the checked files of one certificate by name; none without TLS."""
    if fleet.keys is None:
        return {}
    folder = fleet.keys / str(identity)
    credentials.load(folder).require(identity.role, identity.name)
    names = (CA, CERTIFICATE, KEY, *((MEMBERS,) if identity.role in LISTENING else ()))
    return {name: credentials.read_bounded(folder / name, 1024**2) for name in names}


class _Dumper(yaml.SafeDumper):  # type: ignore[misc]  # PyYAML comes without types
    """Writes texts of several lines as blocks, and no aliases."""

    def ignore_aliases(self, data: Any) -> bool:
        """Return True: nothing is written as an alias."""
        return True


def _text(dumper: yaml.SafeDumper, text: str) -> yaml.ScalarNode:
    style = "|" if "\n" in text else None
    return dumper.represent_scalar("tag:yaml.org,2002:str", text, style=style)


_Dumper.add_representer(str, _text)


def as_yaml(documents: Sequence[Any]) -> str:
    """Return documents as YAML; keys keep their order."""
    return str(yaml.dump_all(documents, Dumper=_Dumper, sort_keys=False, width=120, explicit_start=len(documents) > 1))
