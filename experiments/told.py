"""How an experiment tells what came out: one line of JSON, and where asked its data and a page."""

import json
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any


def tell(data: dict[str, Any], page: Callable[[dict[str, Any]], str], folder: Path | None) -> None:
    """Print data, and write results.json and README.md into a folder, which is made, unless it is None."""
    if folder:
        folder.mkdir(parents=True, exist_ok=True)
        (folder / "results.json").write_text(json.dumps(data, indent=1) + "\n", encoding="utf-8")
        (folder / "README.md").write_text(page(data), encoding="utf-8")
    sys.stdout.write(json.dumps(data) + "\n")
