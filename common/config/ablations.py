"""The ablations of EIA-SEC: the algorithm with one of its two parts, or both, switched off."""

from typing import Final

ABLATIONS: Final[dict[str, dict[str, bool]]] = {
    "eia": {"algorithm.ensemble": False},
    "sec": {"elite.enabled": False},
    "base": {"algorithm.ensemble": False, "elite.enabled": False},
}
"""What each changes: elite imitation alone, the shared ensemble critic alone, neither.

Each is also a preset: `eia-sec` with these changes.
"""
