"""The tables of docs/reference/remote_protocol.md, from the declarations."""

from eia_sec.common.protocol import environment_values
from eia_sec.common.protocol.environment_messages import MESSAGES, STATUSES
from research.pages.blocks import table
from research.pages.monitoring_tables import kind_table


def statuses() -> str:
    """Return one row for each status of an answer."""
    return table(["status", "meaning"], [[f"`{status}`", meaning] for status, meaning in STATUSES.items()])


def messages() -> str:
    """Return one table for each message."""
    return "".join(kind_table(kind, f"### {kind.__name__}") for kind in MESSAGES)


def spaces() -> str:
    """Return the table of spaces, which the module that reads them holds."""
    return "\n".join(line for line in (environment_values.__doc__ or "").splitlines() if line.startswith("|"))
