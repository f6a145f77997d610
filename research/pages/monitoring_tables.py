"""The tables of docs/reference/monitoring.md: what any subscriber can read, from the declarations."""

import inspect
import re
from collections.abc import Sequence
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any, Final, get_args, get_origin, get_type_hints

import numpy as np

from eia_sec.common.protocol import keys, messages
from eia_sec.common.protocol.codec import Message
from eia_sec.common.protocol.frame import PROTOCOL
from eia_sec.common.protocol.messages import Envelope
from eia_sec.common.protocol.metrics import EVALUATION, METRICS, Metric
from eia_sec.deploy.monitor.snapshot import Imitation, ImitationRow, LedgerCounts, ProcessRow, Snapshot
from research.pages.blocks import table

EXAMPLE: Final = Path("docs/examples/subscriber.py")


def subscriber(root: Path) -> str:
    """Return the example program."""
    return f"```python\n{(root / EXAMPLE).read_text(encoding='utf-8')}```"


def keys_table() -> str:
    """Return one row for each family of keys."""
    return table(
        ["key", "delivery", "from", "to", "messages", "how often"],
        [
            [f"`{f.shown}`", f.delivery, f.sender, f.receiver, ", ".join(f.messages) or "-", f.pace]
            for f in keys.FAMILIES
        ],
    )


def frame_rows() -> list[list[str]]:
    """Return which bytes of a frame are what."""
    return [
        ["0..3", "`EIAS`"],
        ["4", f"version of the protocol, {PROTOCOL}"],
        ["5", "kind of the message"],
        ["6..7", "0"],
        ["8..11", "H, bytes of the header"],
        ["12..19", "B, bytes of the body"],
        ["20..23", "low half of the XXH3-64 of header and body"],
        ["24..", 'header: msgpack of `{"fields": {...}, "arrays": [[name, dtype, shape], ...]}`'],
        ["24 + H..", "body: the arrays, row-major, one after another"],
    ]


def frame_table() -> str:
    """Return the layout of a frame."""
    return table(["bytes", "what"], frame_rows())


def messages_tables() -> str:
    """Return one table for each message that a subscriber can read."""
    readable = [name for family in keys.FAMILIES if family.delivery in ("state", "lossy") for name in family.messages]
    return "".join(_message(getattr(messages, name)) for name in ("Envelope", *dict.fromkeys(readable)))


def metrics_tables() -> str:
    """Return one table of metrics for each role, and one of the evaluation at a run's end."""
    tables = {**METRICS, "evaluation": EVALUATION}
    return "".join(f"### {role}\n\n{_metrics_table(metrics)}\n\n" for role, metrics in tables.items())


def _metrics_table(metrics: Sequence[Metric]) -> str:
    if not any(metric.scalar for metric in metrics):
        return table(["name", "unit", "meaning"], [[f"`{m.name}`", m.unit, m.meaning] for m in metrics])
    rows = [[f"`{m.name}`", m.scalar and f"`{m.scalar}`", m.unit, m.meaning] for m in metrics]
    return table(["name", "in TensorBoard", "unit", "meaning"], rows)


def snapshot_tables() -> str:
    """Return one table for each record in a line of `eia-sec monitor --json`."""
    kinds = (Snapshot, LedgerCounts, Imitation, ImitationRow, ProcessRow)
    return "".join(kind_table(kind, f"### {kind.__name__}") for kind in kinds)


def attribute_docs(kind: type[Any]) -> dict[str, str]:
    """Return what the docstring of a dataclass says about its fields, each on one line."""
    text = inspect.getdoc(kind) or ""
    found: dict[str, str] = {}
    _, _, section = text.partition("Attributes:\n")
    for entry in re.split(r"\n(?=    \w)", "\n" + section):
        names, colon, meaning = entry.strip().partition(":")
        if colon and all(name.strip().isidentifier() for name in names.split(",")):
            found |= {name.strip(): " ".join(meaning.split()) for name in names.split(",")}
    return found


def _message(kind: type[Message]) -> str:
    where = [f"`{family.template}`" for family in keys.FAMILIES if kind.__name__ in family.messages]
    place = (
        "attachment of metrics, views, observations and set-points, and of requests whose sender matters"
        if kind is Envelope
        else ", ".join(where)
    )
    return kind_table(kind, f"### {kind.__name__}, kind {kind.KIND}: {place}")


def kind_table(kind: type[Any], title: str) -> str:
    """Return a title, what a dataclass says of itself, and one row for each of its fields."""
    assert is_dataclass(kind)
    summary = (inspect.getdoc(kind) or "").split("\n\n", maxsplit=1)[0]
    hints, docs = get_type_hints(kind), attribute_docs(kind)
    rows = [[f"`{item.name}`", type_name(hints[item.name]), docs.get(item.name, "-")] for item in fields(kind)]
    return f"{title}\n\n{' '.join(summary.split())}\n\n{table(['field', 'type', 'meaning'], rows)}\n\n"


def type_name(hint: Any) -> str:
    """Return the name of a field's type, as pages write it."""
    if get_origin(hint) is np.ndarray:
        return f"{np.dtype(get_args(get_args(hint)[1])[0])} array"
    if get_origin(hint) is tuple:
        inner = list(dict.fromkeys(type_name(part) for part in get_args(hint) if part is not Ellipsis))
        return f"list of {' and '.join(inner)}"
    if get_origin(hint) is list:
        return "list"
    if get_origin(hint) is dict:
        return "map"
    known = {bool: "boolean", int: "integer", float: "number", str: "text"}
    if hint in known:
        return known[hint]
    choices = [part for part in get_args(hint) if part is not type(None)]
    return f"{type_name(choices[0])} or null" if choices else str(hint.__name__)
