"""Plain descriptions of action adapters, for the wire and for files."""

from collections.abc import Mapping
from dataclasses import fields
from typing import Any, Final

from eia_sec.common.actions.adapters import ActionAdapter, Headings, Lattice, MirroredAxes, NineMoves
from eia_sec.common.errors import ConfigError

ADAPTERS: Final[dict[str, type[Lattice] | type[MirroredAxes] | type[NineMoves] | type[Headings]]] = {
    Lattice.kind: Lattice,
    MirroredAxes.kind: MirroredAxes,
    NineMoves.kind: NineMoves,
    Headings.kind: Headings,
}
"""Every kind of adapter by its name."""


def adapter_to_dict(adapter: ActionAdapter) -> dict[str, Any]:
    """Return a plain description for the wire and for files."""
    return {"kind": adapter.kind, **{each.name: getattr(adapter, each.name) for each in fields(ADAPTERS[adapter.kind])}}


def adapter_from_dict(data: Any) -> ActionAdapter:
    """Return the adapter in the output of `adapter_to_dict`.

    Raises:
        ConfigError: when `data` describes no adapter.
    """
    if not isinstance(data, Mapping) or (kind := ADAPTERS.get(str(data.get("kind")))) is None:
        raise ConfigError("the description of an action adapter names an unknown kind.")
    wanted = {each.name: int if each.type is int else float for each in fields(kind)}
    values = {name: value for name, value in data.items() if name != "kind"}
    if values.keys() != wanted.keys():
        raise ConfigError(f"a {kind.kind} takes {', '.join(wanted) or 'no values'}.")
    for name, value in values.items():
        if type(value) is not wanted[name] and not (wanted[name] is float and type(value) is int):
            raise ConfigError(f"{name} of a {kind.kind} must be {wanted[name].__name__}.")
    numbers: dict[str, Any] = {name: wanted[name](value) for name, value in values.items()}
    return kind(**numbers)
