"""What experiments have in common: which farms they fly, and how they report their results."""

import argparse
import json
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

from eia_sec.common.errors import UsageError
from eia_sec.deploy.local.run_directory import METRICS
from eia_sec.deploy.reports.run_report import read_metrics


def farm_range(text: str) -> range:
    """Return the farm seeds A to B - 1 of a text "A:B"; raise ArgumentTypeError where it names none."""
    first, _, last = text.partition(":")
    if not (first.isdecimal() and last.isdecimal() and int(first) < int(last)):
        raise argparse.ArgumentTypeError(f"{text!r} is not A:B with whole numbers A < B")
    return range(int(first), int(last))


def write_results(data: dict[str, Any], page: Callable[[dict[str, Any]], str], folder: Path | None) -> None:
    """Print data, and write results.json and README.md into a folder, which is made, unless it is None."""
    if folder:
        store_results(data, page, folder)
    sys.stdout.write(json.dumps(data) + "\n")


def store_results(data: dict[str, Any], page: Callable[[dict[str, Any]], str], folder: Path) -> None:
    """Write results.json and README.md into a folder, which is made."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "results.json").write_text(json.dumps(data, indent=1) + "\n", encoding="utf-8")
    (folder / "README.md").write_text(page(data), encoding="utf-8")


def last_status(run: Path) -> dict[str, Any]:
    """Return the last status that a run has recorded; raise UsageError if there is none."""
    records = read_metrics(run / METRICS) if (run / METRICS).is_file() else []
    found = [record for record in records if record["kind"] == "status"]
    if not found:
        raise UsageError(f"the run {run} has recorded nothing yet.")
    return found[-1]


def filled(template: Path, data: dict[str, Any], **values: Any) -> str:
    """Return a page from its Markdown template.

    Args:
        template: the file; names in braces are filled in.
        data: the results, whose command, commit and farms every template may name ({first} and {last} are farms).
        values: what else the template names.
    """
    farms = data["farms"]
    origin = {"command": data["command"], "commit": data["commit"], "first": farms[0], "last": farms[-1]}
    return template.read_text(encoding="utf-8").format(**origin, **values)
