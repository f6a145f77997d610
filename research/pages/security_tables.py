"""The tables of docs/reference/security.md: who may do what, and the limits on what arrives."""

from typing import Final

from eia_sec.common.protocol import access, keys
from eia_sec.common.protocol.frame import MAX_FRAME
from eia_sec.common.transport.admission import MOST_WAITING
from eia_sec.common.transport.credentials import ROLES
from eia_sec.common.transport.zenoh_config import ACCEPT_MS, HANDSHAKE_MS
from eia_sec.learner.intake.peer_penalties import BLOCK_SECONDS, LIMIT
from eia_sec.learner.intake.throttle import HOLD_SECONDS, MOST_BYTES, MOST_HELD
from research.pages.blocks import table

_WORDS: Final = ("put", "answer", "ask", "read", "appear", "watch")


def limits_table() -> str:
    """Return the limits that the learner applies to what arrives."""
    rows = [
        ["one frame", f"{MAX_FRAME // 2**20} MiB"],
        ["invalid requests in a row before a worker is blocked", f"{LIMIT}"],
        ["time for which it is blocked", f"{BLOCK_SECONDS:.0f} s"],
        ["time for which each refusal is held back", f"{HOLD_SECONDS:.0f} s"],
        ["time for a TLS handshake", f"{HANDSHAKE_MS // 1000} s"],
        ["time for a connection without TLS to say something", f"{ACCEPT_MS // 1000} s"],
        ["connections waiting for admission at which an alarm is raised", f"{MOST_WAITING + 1}"],
        ["refusals held back at once", f"{MOST_HELD} requests or {MOST_BYTES // 2**20} MiB"],
    ]
    return table(["limit", "value"], rows)


def access_table() -> str:
    """Return the access table: one row for each shape of key, one column for each role."""
    shown = [role for role in ROLES if role not in ("router", "site")]
    rows: dict[str, dict[str, list[str]]] = {}
    for grant in access.GRANTS:
        for role in shown if grant.role == access.ANYBODY else [grant.role]:
            given = {key: "own" if value == access.NAME else value for key, value in grant.variables.items()}
            scope = ", ".join(given[name] for name in given if f"{{{name}}}" in grant.family.template)
            word = f"{grant.right} ({scope})" if scope else grant.right
            found = rows.setdefault(grant.family.template, {}).setdefault(role, [])
            if grant.right not in found:  # what everybody may adds nothing to the same right on all keys
                found.append(word)
    lines = [f"| key | {' | '.join(shown)} |", "|---" * (len(shown) + 1) + "|"]
    for family in keys.FAMILIES:
        cells = [", ".join(sorted(rows[family.template].get(role, ["-"]), key=_order)) for role in shown]
        lines.append(f"| `{family.shown}` | {' | '.join(cells)} |")
    return "\n".join(lines)


def _order(word: str) -> int:
    return _WORDS.index(word.split(" ", maxsplit=1)[0]) if word != "-" else 0
