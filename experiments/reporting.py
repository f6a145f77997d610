"""What experiments have in common: which farms they fly, and how they report their results."""

import argparse
import json
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any


def farm_range(text: str) -> range:
    """Return the farm seeds A to B - 1 of a text "A:B"; raise ArgumentTypeError where it names none."""
    first, _, last = text.partition(":")
    if not (first.isdecimal() and last.isdecimal() and int(first) < int(last)):
        raise argparse.ArgumentTypeError(f"{text!r} is not A:B with whole numbers A < B")
    return range(int(first), int(last))


def write_results(data: dict[str, Any], page: Callable[[dict[str, Any]], str], folder: Path | None) -> None:
    """Print data, and write results.json and README.md into a folder, which is made, unless it is None."""
    if folder:
        folder.mkdir(parents=True, exist_ok=True)
        (folder / "results.json").write_text(json.dumps(data, indent=1) + "\n", encoding="utf-8")
        (folder / "README.md").write_text(page(data), encoding="utf-8")
    sys.stdout.write(json.dumps(data) + "\n")
