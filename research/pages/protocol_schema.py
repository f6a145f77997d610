"""docs/reference/protocol.json: every key, message and metric as data, for readers in any language."""

import inspect
import json
from dataclasses import fields
from pathlib import Path
from types import NoneType
from typing import Any, Final, get_args, get_type_hints

from eia_sec.common.protocol import environment_messages, keys, messages
from eia_sec.common.protocol.codec import Message
from eia_sec.common.protocol.frame import PROTOCOL
from eia_sec.common.protocol.metrics import METRICS
from research.pages.monitoring_tables import attribute_docs, frame_rows, type_name

WEIGHTS: Final = {
    "none": [["W1", "o", "h"], ["b1", "h"], ["W2", "h", "h"], ["b2", "h"], ["W3", "h", "a"], ["b3", "a"]],
    "gru": [
        *[["W1", "o", "h"], ["b1", "h"], ["W", "h", "3h"], ["b", "3h"], ["U", "h", "3h"], ["c", "3h"]],
        *[["W3", "h", "a"], ["b3", "a"]],
    ],
}
"""For each kind of memory the parts of an actor's flat parameters in their order, and the sizes of each."""


def schema() -> dict[str, Any]:
    """Return the protocol as plain data."""
    return {
        "about": "The protocol of EIA-SEC, from its declarations. docs/reference/monitoring.md says the same in words.",
        "protocol": PROTOCOL,
        "root": keys.ROOT,
        "frame": [dict(zip(("bytes", "what"), row, strict=True)) for row in frame_rows()],
        "keys": [_family(family) for family in keys.FAMILIES],
        "messages": {kind.__name__: _framed(kind) for kind in _kinds()},
        "environment_messages": {kind.__name__: _described(kind) for kind in environment_messages.MESSAGES},
        "metrics": {
            role: [{"name": m.name, "unit": m.unit, "about": m.meaning} for m in of] for role, of in METRICS.items()
        },
        "actors": {
            "about": "Order of an actor's flat parameters, matrices input-major; o: observation, h: hidden, a: outputs "
            "of the head (a Gaussian one has twice the size of an action, a categorical one a logit for each option).",
            "memory": WEIGHTS,
        },
    }


def write(path: Path) -> None:
    """Write the schema."""
    path.write_text(json.dumps(schema(), indent=1, ensure_ascii=False) + "\n", encoding="utf-8")


def _kinds() -> list[type[Message]]:
    return [
        kind
        for kind in vars(messages).values()
        if isinstance(kind, type) and issubclass(kind, Message) and kind is not Message
    ]


def _family(family: keys.KeyFamily) -> dict[str, Any]:
    root = family.root or f"{keys.ROOT}/{{run}}"
    found: dict[str, Any] = {
        "key": f"{root}/{family.template}",
        "delivery": family.delivery,
        "from": family.sender,
        "to": family.receiver,
        "messages": list(family.messages),
    }
    return found | ({"encoding": family.encoding} if family.encoding else {})


def _framed(kind: type[Message]) -> dict[str, Any]:
    return {"kind": kind.KIND, **_described(kind)}


def _described(kind: type[Any]) -> dict[str, Any]:
    hints, docs = get_type_hints(kind), attribute_docs(kind)
    about = (inspect.getdoc(kind) or "").split("\n\n", maxsplit=1)[0]
    return {
        "about": " ".join(about.split()),
        "fields": [
            {
                "name": item.name,
                "type": type_name(hints[item.name]).removesuffix(" or null"),
                "optional": NoneType in get_args(hints[item.name]),
                "about": docs.get(item.name, ""),
            }
            for item in fields(kind)
        ],
    }
