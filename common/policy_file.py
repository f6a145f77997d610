"""A trained policy in one file: all actors of a team, the team's layout, and metadata.

The file is safetensors: eight bytes with the header's length, a JSON header, then the tensors. It has one tensor of
32- or 16-bit floats for each type: [n_v, P_v], or [1, P_v] where the agents of the type share their parameters. All
metadata are strings. Actors that are a plug-in's network name it and its options. Loading compares the header with the
team and the file's size before it creates an array.
"""

import hashlib
import json
import os
import stat
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from safetensors import SafetensorError
from safetensors.numpy import load, save

from eia_sec.common import plugins
from eia_sec.common.actors import Head, TeamActors, actor_parameters, checked_head
from eia_sec.common.config.algorithms.network import NETWORK_CONFIGS, NetworkConfig
from eia_sec.common.config.files import read_network
from eia_sec.common.errors import EiaSecError, PluginError, PolicyError
from eia_sec.common.gru import Memory, checked_memory
from eia_sec.common.team import TeamSpec

FORMAT: Final = "eia-sec policy 1"
POLICY: Final = "policy.safetensors"
UNTRAINED: Final = "untrained.safetensors"
"""In a run directory, the newest actors and those with which the run began."""
MAX_FILE_BYTES: Final = 256 * 2**20
MAX_HEADER_BYTES: Final = 2**20
MAX_HIDDEN: Final = 65_536
RESERVED: Final = ("format", "team", "hidden", "head", "memory", "network", "digest")
"""Metadata keys that this module writes itself."""
_ITEM_BYTES: Final = {"F32": 4, "F16": 2}


def save_policy(path: Path, actors: TeamActors, metadata: Mapping[str, str], *, half: bool = False) -> None:
    """Write a policy atomically.

    Args:
        path: the file; an existing one is replaced.
        actors: the actors.
        metadata: provenance, for instance `command`, `seed` and `commit`.
        half: store 16-bit floats; this halves the file and rounds the parameters to 11 significant bits.

    Raises:
        PolicyError: a metadata key is reserved, a parameter is too large for 16 bits, the team's description is too
            long, or the file cannot be written.
    """
    taken = sorted(set(metadata) & set(RESERVED))
    if taken:
        raise PolicyError(f"the metadata key {taken[0]!r} of a policy is reserved.")
    with np.errstate(over="ignore"):
        stored = [flat.astype(np.float16) if half else flat for flat in actors.flat]
    if not all(np.isfinite(flat).all() for flat in stored):
        raise PolicyError("a parameter of the policy is not finite or too large for 16-bit storage.")
    header = {
        **metadata,
        "format": FORMAT,
        "team": json.dumps(actors.team.to_dict()),
        "hidden": str(actors.hidden),
        "head": actors.head,
        "memory": actors.memory,
        **({} if actors.module is None else {"network": _described(actors.module)}),
        "digest": _digest(stored),
    }
    names = actors.team.types
    data = save(dict(zip(names, stored, strict=True)), metadata=header)
    if int.from_bytes(data[:8], "little") > MAX_HEADER_BYTES:
        raise PolicyError(f"the description of the policy's team takes more than {MAX_HEADER_BYTES // 2**10} KiB.")
    _write(path, data)


def load_policy(path: Path) -> tuple[TeamActors, dict[str, str]]:
    """Read a policy.

    Args:
        path: a file that `save_policy` wrote.

    Returns:
        The actors, and the metadata given when they were saved.

    Raises:
        PolicyError: the file is missing, truncated, altered, oversized or not a policy.
        PluginError: its actors are a network of a plug-in that is not loaded or cannot be used.
    """
    data = _read(path)
    try:
        header, metadata, held = _header(data)
        team, hidden = TeamSpec.from_dict(json.loads(metadata["team"])), int(metadata["hidden"])
        head = checked_head(metadata["head"])
        memory = checked_memory(metadata["memory"])
        module = _network(path, metadata.get("network"))
        _compare(header, team, hidden, (head, memory, module), held)
        tensors = load(data)
        stored = [tensors[group.name] for group in team.groups]
        if _digest(stored) != metadata["digest"]:
            raise PolicyError("its parameters do not match its digest")
        if not all(np.isfinite(flat).all() for flat in stored):
            raise PolicyError("its parameters are not finite numbers, because its training diverged")
        flats = tuple(np.ascontiguousarray(flat, dtype=np.float32) for flat in stored)
        actors = TeamActors(team, hidden, flats, head, memory, module)
    except PluginError:
        raise
    except (EiaSecError, SafetensorError, ValueError, LookupError, TypeError, AttributeError, RecursionError) as error:
        reason = f"{error.args[0]!r} is missing" if isinstance(error, KeyError) else str(error).rstrip(".")
        raise PolicyError(f"{path} is not a valid policy file: {reason}.") from error
    return actors, {key: value for key, value in metadata.items() if key not in RESERVED}


def _read(path: Path) -> bytes:
    """Return the file's bytes; raise PolicyError when there are more than any policy has."""
    try:
        # Opening a pipe waits for a writer, unless told otherwise.
        with open(path, "rb", opener=lambda name, flags: os.open(name, flags | os.O_NONBLOCK)) as file:
            known = os.fstat(file.fileno())
            if not stat.S_ISREG(known.st_mode):
                raise PolicyError(f"the policy file {path} is not a regular file.")
            size = known.st_size
            if size > MAX_FILE_BYTES:
                raise PolicyError(f"{path} holds {size:,} bytes, but a policy has at most {MAX_FILE_BYTES:,}.")
            return file.read(size)
    except OSError as error:
        raise PolicyError(f"the policy file {path} cannot be read: {error.strerror}.") from error


def _header(data: bytes) -> tuple[dict[str, Any], dict[str, str], int]:
    """Return the tensor entries and the metadata in the JSON header, and the number of bytes after it."""
    length = int.from_bytes(data[:8], "little")
    if len(data) < 8 or length > min(MAX_HEADER_BYTES, len(data) - 8):
        raise PolicyError("its header is truncated or oversized")
    header = json.loads(data[8 : 8 + length].decode("utf-8"))
    metadata = header.pop("__metadata__")
    if metadata.get("format") != FORMAT:
        raise PolicyError(f"it is not in the format {FORMAT!r}")
    return header, metadata, len(data) - 8 - length


def _described(module: NetworkConfig) -> str:
    return json.dumps({"plugin": plugins.network(module.name)[0], "options": asdict(module)})


def _network(path: Path, text: str | None) -> NetworkConfig | None:
    """Return the options of the plug-in's network that a file names, or None for perceptrons."""
    if text is None:
        return None
    found = json.loads(text)
    name, plugin = str(found["options"]["name"])[:80], str(found["plugin"])[:80]
    if name not in NETWORK_CONFIGS:
        raise PluginError(
            f"{path} uses the network {name} of the plug-in {plugin}; add --plugin {plugin} to run its code."
        )
    return read_network(found["options"])


def _compare(
    header: dict[str, Any], team: TeamSpec, hidden: int, kind: tuple[Head, Memory, NetworkConfig | None], held: int
) -> None:
    """Raise PolicyError unless the header lists this team's tensors and the file holds their bytes."""
    if not 1 <= hidden <= MAX_HIDDEN or set(header) != {group.name for group in team.groups}:
        raise PolicyError("its tensors are not those of its team")
    expected = 0
    for group in team.groups:
        entry = header[group.name]
        numbers = actor_parameters(group, hidden, *kind)
        shapes = [group.count, numbers], [1, numbers]
        if entry["dtype"] not in _ITEM_BYTES or entry["shape"] not in shapes:
            raise PolicyError(f"its {group.name} actors are {entry['dtype']}{entry['shape']}, not floats {shapes[0]}")
        expected += _ITEM_BYTES[entry["dtype"]] * entry["shape"][0] * numbers
    listed = max(entry["data_offsets"][1] for entry in header.values())
    if listed != expected:
        raise PolicyError(f"it lists {listed:,} bytes of parameters, but its team needs {expected:,}")
    if held < expected:
        raise PolicyError(f"it is truncated: it holds {held:,} of {expected:,} bytes of parameters")


def _digest(stored: Sequence[NDArray[Any]]) -> str:
    """Return the SHA-256 of the parameters as stored."""
    state = hashlib.sha256()
    for flat in stored:
        state.update(np.ascontiguousarray(flat).tobytes())
    return state.hexdigest()


def _write(path: Path, data: bytes) -> None:
    temporary: str | None = None
    try:
        descriptor, temporary = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.")
        with os.fdopen(descriptor, "wb") as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        os.chmod(temporary, 0o644)
        os.replace(temporary, path)
    except OSError as error:
        if temporary is not None:
            Path(temporary).unlink(missing_ok=True)
        raise PolicyError(f"the policy file {path} cannot be written: {error.strerror}.") from error
