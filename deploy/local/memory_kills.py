"""Whether the kernel has killed processes because memory ran out, and how much memory there is."""

from collections.abc import Iterator
from pathlib import Path
from typing import Final

PROC: Final = Path("/proc")
GROUPS: Final = Path("/sys/fs/cgroup")
_COUNTERS: Final = ("memory.events", "memory.oom_control")
"""Files of a control group with a line `oom_kill N`, in its second and first version."""
_LIMITS: Final = ("memory.max", "memory.limit_in_bytes")
_USES: Final = ("memory.current", "memory.usage_in_bytes")
GIB: Final = 2**30


def memory_kills() -> dict[str, int]:
    """Return how many processes were killed for lack of memory, by who keeps count; what cannot be read is left out."""
    places = [("control group", path) for path in _files(_COUNTERS)] + [("host", PROC / "vmstat")]
    counts = ((name, _field(path, "oom_kill")) for name, path in places)
    return {name: count for name, count in counts if count is not None}


def kill_sentence(before: dict[str, int]) -> str:
    """Return what is known about a process that was killed by signal 9.

    Args:
        before: `memory_kills` at its start.
    """
    grown = [name for name, count in memory_kills().items() if count > before.get(name, count)]
    if "control group" in grown:
        what = "the kernel killed it, because the memory of its control group ran out"
    elif grown:
        what = "the kernel killed processes of this host while it ran, because memory ran out, probably this one, too"
    else:
        what = "the kernel or somebody else killed it; nothing shows that memory ran out"
    room = _room()
    return f"{what} ({room})" if room else what


def _room() -> str:
    """Return how much memory there is now, or an empty text where it cannot be read."""
    parts = []
    limit, used = _number(_LIMITS), _number(_USES)
    total, free = _field(PROC / "meminfo", "MemTotal:"), _field(PROC / "meminfo", "MemAvailable:")
    if limit is not None and used is not None and (total is None or limit < total * 1024):
        parts.append(f"the control group uses {used / GIB:.1f} of {limit / GIB:.1f} GiB")
    if total is not None and free is not None:
        parts.append(f"{free * 1024 / GIB:.1f} of the host's {total * 1024 / GIB:.1f} GiB are available")
    return ", ".join(parts)


def _files(names: tuple[str, ...]) -> Iterator[Path]:
    """Yield the first of these files of this process's control group; inside a container the group is the root."""
    try:
        lines = (PROC / "self/cgroup").read_text().splitlines()
    except OSError:
        lines = []
    own = [line.split(":", 2)[2].lstrip("/") for line in lines if line.startswith("0::") or ":memory:" in line]
    for root in (GROUPS / "memory", GROUPS):
        for group in (*own, ""):
            for name in names:
                if (path := root / group / name).is_file():
                    yield path
                    return


def _number(names: tuple[str, ...]) -> int | None:
    """Return the number in the first of these files, or None: there is none, or no limit."""
    for path in _files(names):
        try:
            return int(path.read_text())
        except (OSError, ValueError):
            return None
    return None


def _field(path: Path, name: str) -> int | None:
    """Return the number after a name at the beginning of a line."""
    try:
        for line in path.read_text().splitlines():
            words = line.split()
            if len(words) >= 2 and words[0] == name:
                return int(words[1])
    except (OSError, ValueError):
        return None
    return None
