"""Refreshes what is generated in README and docs: `python -m research.pages.pages`, or `make docs`."""

import argparse
import sys
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import Final

from eia_sec.deploy.cli import COMMANDS
from research.pages import (
    algorithm_tables,
    environment_protocol_tables,
    environment_tables,
    incidents,
    monitoring_tables,
    protocol_schema,
    reliability_table,
    reproduce_tables,
    security_tables,
)
from research.pages.blocks import Block, replaced, table
from research.pages.configuration_tables import configuration_tables
from research.pages.densities import draw_densities
from research.pages.measurements import measured


def commands_table() -> str:
    """Return one row for each command."""
    return table(["command", "what it does"], [[f"`eia-sec {name}`", c.summary] for name, c in COMMANDS.items()])


def _declared(make: Callable[[], str]) -> Block:
    """Return a block that follows from the code alone."""
    return lambda _: make()


def _measured(*names: str) -> dict[str, Block]:
    return {name: partial(measured, name) for name in names}


def _on_home_page(block: Block) -> Block:
    """Return a block of README.md for docs/index.md, from where its links lead elsewhere."""
    return lambda root: block(root).replace("](docs/", "](")


PAGES: Final[Mapping[str, Mapping[str, Block]]] = {
    "README.md": _measured("inertia-results", "results", "distribution"),
    "docs/index.md": {name: _on_home_page(partial(measured, name)) for name in ("inertia-results", "results")},
    "docs/explanation/capacity.md": _measured("capacity", "sessions"),
    "docs/explanation/method.md": _measured("forms"),
    "docs/explanation/reliability.md": {
        "faults": reliability_table.faults,
        "met": partial(incidents.incidents, incidents.RELIABILITY),
    },
    "docs/explanation/reproduce.md": reproduce_tables.BLOCKS,
    "docs/how-to/debug_training.md": _measured("checkpoint"),
    "docs/how-to/hosts.md": _measured("hosts"),
    "docs/how-to/own_environment.md": _measured("tasks"),
    "docs/how-to/remote_environment.md": _measured("served"),
    "docs/how-to/vehicles.md": _measured("fly"),
    "docs/how-to/watch.md": _measured("watch"),
    "docs/reference/algorithms.md": {
        "off-policy": _declared(algorithm_tables.off_policy),
        "on-policy": _declared(algorithm_tables.on_policy),
    },
    "docs/reference/commands.md": {"commands": _declared(commands_table)},
    "docs/reference/configuration.md": {"configuration": _declared(configuration_tables)},
    "docs/reference/environment.md": environment_tables.BLOCKS,
    "docs/reference/heuristics.md": _measured("heuristics"),
    "docs/reference/monitoring.md": {
        "subscriber": monitoring_tables.subscriber,
        "keys": _declared(monitoring_tables.keys_table),
        "frame": _declared(monitoring_tables.frame_table),
        "messages": _declared(monitoring_tables.messages_tables),
        "metrics": _declared(monitoring_tables.metrics_tables),
        "snapshot": _declared(monitoring_tables.snapshot_tables),
    },
    "docs/reference/remote_protocol.md": {
        "statuses": _declared(environment_protocol_tables.statuses),
        "messages": _declared(environment_protocol_tables.messages),
        "spaces": _declared(environment_protocol_tables.spaces),
    },
    "docs/reference/security.md": {
        "access": _declared(security_tables.access_table),
        "limits": _declared(security_tables.limits_table),
        "met": partial(incidents.incidents, incidents.SECURITY),
    },
    "research/results/README.md": _measured("default-run", "paper-preset"),
}
"""Every page with generated blocks: its path, and what makes each block."""

FILES: Final[Mapping[str, Callable[[Path], None]]] = {
    "docs/images/densities.png": draw_densities,
    "docs/images/farm.png": environment_tables.draw_farm,
    "docs/reference/protocol.json": protocol_schema.write,
}
"""Every picture and file that follows from the code: its path, and the function that makes it."""


def refreshed(page: str, root: Path) -> str:
    """Return a page of a repository with its blocks made anew."""
    text = (root / page).read_text(encoding="utf-8")
    for name, block in PAGES[page].items():
        text = replaced(text, name, block(root))
    return text


def main(arguments: list[str]) -> None:
    """Refresh every page and picture of a repository, and the pages of its studies; exit with 2 when it is none."""
    parser = argparse.ArgumentParser(prog="python -m research.pages.pages", description=__doc__)
    parser.add_argument("root", nargs="?", type=Path, default=Path(), help="folder of the repository, default this one")
    root: Path = parser.parse_args(arguments).root
    if missing := [page for page in PAGES if not (root / page).is_file()]:
        parser.error(f"{root} has no {missing[0]}")
    for page in PAGES:
        (root / page).write_text(refreshed(page, root), encoding="utf-8")
    for folder in reproduce_tables.studies(root):
        (folder / "README.md").write_text(reproduce_tables.written(folder), encoding="utf-8")
    for name, make in FILES.items():
        (root / name).parent.mkdir(parents=True, exist_ok=True)
        make(root / name)


if __name__ == "__main__":
    main(sys.argv[1:])
