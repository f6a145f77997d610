"""`eia-sec audit RUN_DIR`: check from the processes' histories that every chunk is accounted for."""

import json
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import tyro
from rich.console import Console
from rich.table import Table

from eia_sec.deploy.monitor.audit import FATES, NAMED, Audit, audit
from eia_sec.deploy.options import parse


@dataclass(frozen=True)
class AuditArguments:
    """Check that every chunk of a run is accounted for and none was counted twice."""

    run_dir: tyro.conf.Positional[Path]
    """Run directory; copy histories of workers on other hosts into its folder history/."""
    json: bool = False
    """Print one JSON object instead of the table."""


def command(arguments: Sequence[str]) -> int:
    """Audit; return 0 if everything is accounted for, 1 if not."""
    options = parse(AuditArguments, arguments, "audit")
    found = audit(options.run_dir)
    if options.json:
        sys.stdout.write(json.dumps(found.to_dict()) + "\n")
    else:
        _show(found)
    return 0 if found.clean else 1


def _show(found: Audit) -> None:
    table = Table(title="environment steps")
    names = ("worker", "produced", *(fate.replace("_", " ") for fate in FATES))
    for name in names:
        table.add_column(name, justify="left" if name == "worker" else "right")
    for worker, counts in sorted(found.workers.items()):
        table.add_row(worker, f"{sum(counts.values()):,}", *(f"{counts[fate]:,}" for fate in FATES))
    table.add_section()
    table.add_row("all", f"{found.produced:,}", *(f"{found.steps[fate]:,}" for fate in FATES))
    console = Console(markup=False)
    console.print(table)
    lost = ", ".join(f"{steps:,} with a {who}" for who, steps in sorted(found.lost_with.items())) or "none"
    console.print(f"lost: {lost}; {found.duplicates:,} duplicate chunks; {found.starts} starts of the learner")
    if found.damaged:
        console.print(f"{found.damaged} lines of the histories are unreadable")
    if found.torn:
        console.print(f"{found.torn} histories end with a torn line, which a killed process leaves", highlight=False)
    named = found.named()
    for sentence in named[:NAMED]:
        console.print(sentence, highlight=False, soft_wrap=True)
    if len(named) > NAMED:
        console.print(f"and {len(named) - NAMED} more; --json lists them", highlight=False)
    console.print(f"unexplained: {len(found.unexplained)}, counted twice: {len(found.doubled)}", highlight=False)
