"""docs/reference/monitoring.md: what any subscriber can read, from the declarations of keys, messages and figures."""

import inspect
import re
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any, Final, get_args, get_origin, get_type_hints

import numpy as np

from common.protocol import keys, messages
from common.protocol.codec import Message
from common.protocol.frame import PROTOCOL
from common.protocol.messages import Envelope
from common.protocol.metrics import METRICS
from deploy.monitor.snapshot import Imitation, ImitationRow, Ledger, ProcessRow, Snapshot

EXAMPLE: Final = Path(__file__).resolve().parents[2] / "docs" / "examples" / "subscriber.py"

_HEAD: Final = """# Watching a run

Generated from `common/protocol/keys.py`, `common/protocol/messages.py`, `common/protocol/metrics.py` and
`deploy/monitor/snapshot.py` by `make docs`; do not edit.

```sh
eia-sec monitor --run farm --connect tcp/127.0.0.1:7447           # a live view, from 80 x 24 on
eia-sec monitor --run farm --connect tcp/127.0.0.1:7447 --json    # one line of JSON per update
```

`eia-sec train` prints the line to use (with `--tls` it names the place of a certificate of the monitor's own, `eia-sec
keys issue monitor NAME`). A monitor only subscribes: it may come, go and crash as it likes, and any
number may watch. It needs no file of the run and no configuration. What it shows is what the processes tell of
themselves once a second, on keys that any Zenoh client can read; this page lists them.

The higher the terminal, the more it lists: at 80 x 24 the last elites, the ledger, curves and processes; from 33 lines
on (a few more while alarms are shown) also the newest four imitation events, each with theta and every elite's omega.

## Ten lines in place of the monitor

`docs/examples/subscriber.py` needs `eclipse-zenoh` and `msgpack`, and nothing of this project:

```python
{example}```

```sh
python docs/examples/subscriber.py tcp/127.0.0.1:7447
```

## Keys

All begin with `{root}/RUN/`. *state*: the latest value wins, and late joiners get it. *lossy*: may be dropped; a
running counter shows gaps. *token*: Zenoh liveliness, seen by a liveliness subscriber. *request*: acknowledged, and
sent to its receiver alone, so that a subscriber sees nothing of it.

{families}

Without `--tls` whoever reaches the endpoint can subscribe to all of it. With it, the role `monitor` reads metrics and
sees tokens, and nothing else ([security.md](security.md)).

## Frames

Every payload that a subscriber sees, and every attachment, is one frame, little-endian (a request on `transition/` is
several, one after another):

| bytes | what |
|---|---|
| 0..3 | `EIAS` |
| 4 | version of the protocol, {protocol} |
| 5 | kind of the message |
| 6..7 | 0 |
| 8..11 | H, bytes of the header |
| 12..19 | B, bytes of the body |
| 20..23 | low half of the XXH3-64 of header and body |
| 24.. | header: msgpack of `{{"fields": {{...}}, "arrays": [[name, dtype, shape], ...]}}` |
| 24 + H.. | body: the arrays, row-major, one after another |

Reading is safe with any msgpack library; nothing is pickled. `common.protocol.messages` decodes with every check.

## Messages that can be read

"""

_METRICS: Final = """## Figures of each role

`MetricMessage.values`, one message a second. Names of nested maps are joined by a slash here, and `*` is any name.
`metrics.jsonl` in the run directory holds the learner's figures too, without `alarms` and `imitations`, in its records
of kind `status`, and TensorBoard shows a part of them ([debug_training.md](../how-to/debug_training.md)).

"""

_JSON: Final = """## Lines of `eia-sec monitor --json`

One JSON object per line and update (`--refresh` seconds, 1 by default), written out at once. What is not known is null.
The command ends with exit code 0 after Ctrl-C, SIGTERM or `--seconds`, and with 141 when the reader of its output is
gone. `reward` and `freshness` are lists of `{"name", "latest"}`; `latest` is the mean of the newest 20 values.

```sh
eia-sec monitor --json | jq -c '[.episodes, .ledger.lost, [.processes[] | select(.trouble) | .name]]'
```

"""


def monitoring_page() -> str:
    """Return docs/reference/monitoring.md."""
    head = _HEAD.format(
        example=EXAMPLE.read_text(encoding="utf-8"),
        root=keys.ROOT,
        protocol=PROTOCOL,
        families=_table(
            ["key", "delivery", "from", "to", "messages", "how often"],
            [
                [f"`{f.template}`", f.delivery, f.sender, f.receiver, ", ".join(f.messages) or "-", f.pace]
                for f in keys.FAMILIES
            ],
        ),
    )
    readable = [name for family in keys.FAMILIES if family.delivery in ("state", "lossy") for name in family.messages]
    parts = [head]
    parts += [_message(getattr(messages, name)) for name in ("Envelope", *dict.fromkeys(readable))]
    parts.append(_METRICS)
    for role, declared in METRICS.items():
        rows = [[f"`{metric.name}`", metric.unit, metric.meaning] for metric in declared]
        parts.append(f"### {role}\n\n{_table(['name', 'unit', 'meaning'], rows)}\n\n")
    parts.append(_JSON)
    parts += [_kind(kind, f"### {kind.__name__}") for kind in (Snapshot, Ledger, Imitation, ImitationRow, ProcessRow)]
    return "".join(parts).rstrip("\n") + "\n"


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
    return _kind(kind, f"### {kind.__name__}, kind {kind.KIND}: {place}")


def _kind(kind: type[Any], title: str) -> str:
    assert is_dataclass(kind)
    summary = (inspect.getdoc(kind) or "").split("\n\n", maxsplit=1)[0]
    hints, docs = get_type_hints(kind), attribute_docs(kind)
    rows = [[f"`{item.name}`", _type(hints[item.name]), docs.get(item.name, "-")] for item in fields(kind)]
    return f"{title}\n\n{' '.join(summary.split())}\n\n{_table(['field', 'type', 'meaning'], rows)}\n\n"


def _type(hint: Any) -> str:
    if get_origin(hint) is np.ndarray:
        return f"{np.dtype(get_args(get_args(hint)[1])[0])} array"
    if get_origin(hint) is tuple:
        inner = list(dict.fromkeys(_type(part) for part in get_args(hint) if part is not Ellipsis))
        return f"list of {' and '.join(inner)}"
    if get_origin(hint) is dict:
        return "map"
    known = {bool: "boolean", int: "integer", float: "number", str: "text"}
    if hint in known:
        return known[hint]
    choices = [part for part in get_args(hint) if part is not type(None)]
    return f"{_type(choices[0])} or null" if choices else str(hint.__name__)


def _table(head: list[str], rows: list[list[str]]) -> str:
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join("| " + " | ".join(cell.replace("|", "\\|") for cell in line) + " |" for line in lines)
