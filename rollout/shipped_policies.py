"""The trained policies that ship with this package, by name."""

from pathlib import Path
from typing import Final

from eia_sec.common.errors import PolicyError

_SHIPPED: Final = Path(__file__).parent / "trained"
TRAINED: Final = _SHIPPED / "inertial.safetensors"
"""The policy of the preset `inertial`, which `eia-sec train` takes."""
_OTHERS: Final = ("instant", "long", "connected", "failing", "uneven", "battery", "field", "eia-sec")
SHIPPED: Final = {
    "trained": ("inertial", TRAINED),
    **{f"trained:{preset}": (preset, _SHIPPED / f"{preset}.safetensors") for preset in _OTHERS},
}
"""Every policy that ships: its preset and its file by its name."""


def shipped_file(name: str) -> Path:
    """Return the file of a policy that ships; raise PolicyError when this installation lacks it."""
    preset, path = SHIPPED[name]
    if not path.exists():
        raise PolicyError(
            f"no trained policy of the preset {preset} is part of this installation; train one, or name another policy."
        )
    return path


def policy_path(name: str) -> Path:
    """Return the file of a policy that ships, or the path that the name is; raise PolicyError as `shipped_file`."""
    return shipped_file(name) if name in SHIPPED else Path(name)


def is_file(path: Path) -> bool:
    """Return whether a path leads to a file; False if it leads nowhere or where this user may not look."""
    try:
        return path.is_file()
    except OSError:  # a name that is too long, or a folder that cannot be searched
        return False


def preset_of(policy: str | None) -> str:
    """Return the preset on whose farm a policy flies unless a configuration is given."""
    return SHIPPED[policy][0] if policy in SHIPPED else "inertial"
