"""The generated blocks of docs/explanation/reproduce.md, from the committed results."""

import re
from collections import Counter
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

from research.pages.blocks import Block, read_json
from research.studies.analysis import coverage, targets
from research.studies.analysis.claims import CLAIMS, heuristics, training
from research.studies.analysis.evidence import early_farms
from research.studies.analysis.verdicts import NOT_RUN, Row, full, rows_table
from research.studies.catalogue import STUDIES
from research.studies.pages.tables import page
from research.studies.scales import FIRST_FARM, FIRST_REPORTED

PAGE: Final = Path("docs/explanation/reproduce.md")
RESULTS: Final = Path("research/results/reproduce")
HEURISTICS: Final = Path("research/results/heuristics/results.json")
REACH: Final = Path("research/results/reach/results.json")
LONGER: Final = Path("research/results/reach/longer/results.json")
COVERAGE: Final = RESULTS / "coverage.json"


def comparison(root: Path) -> str:
    """Return the comparison with the paper, from the results in a repository."""
    held = {name: full(read_json(root / RESULTS / name / "results.json")) for name in CLAIMS}
    groups: dict[str, list[Row]] = {name: claims(held[name]) for name, claims in CLAIMS.items()}
    groups["training"] = training(held["training"], held["ablation"])
    groups["training"] += heuristics(held["training"], read_json(root / HEURISTICS))
    count = Counter(row.verdict for rows in groups.values() for row in rows)
    parts = [", ".join(f"{number} {verdict}" for verdict, number in sorted(count.items())) + ".\n"]
    for name, rows in groups.items():
        parts += [f"### {STUDIES[name].title}\n", _origin(name, held[name]), rows_table(rows)]
    return "\n".join(parts)


def beaten(root: Path) -> str:
    """Return the targets of the project beside the results in a repository."""
    study = full(read_json(root / RESULTS / "default" / "results.json"))
    return targets.block(read_json(root / HEURISTICS), study, *(read_json(root / path) for path in (REACH, LONGER)))


def counted(root: Path) -> str:
    """Return how often the statistics are right, where the truth is known."""
    return coverage.block(read_json(root / COVERAGE))


SHOWN: Final = re.compile(r"!\[.*?\]\((.*?)\)")
"""Pictures on a page."""
BLOCKS: Final[Mapping[str, Block]] = {
    "statistics": counted,
    "targets": beaten,
    "comparison": comparison,
}
"""Every block of the page by its name."""


def _origin(name: str, data: Any) -> str:
    """Return where a study's numbers come from."""
    if data is not None:
        page = f"../../research/results/reproduce/{name}/README.md"
        made = f"[{name}]({page}): `{data['command']}`, commit {data['commit']}."
        farms = f"{FIRST_FARM}..{FIRST_REPORTED - 1}"
        early = f" Its numbers include farms {farms}, on which the preset was chosen." if early_farms(data) else ""
        return f"{made}{early}\n"
    return f"`python -m research.studies {name}`: {NOT_RUN}.\n"


def studies(root: Path) -> list[Path]:
    """Return the folder of every study whose results are in a repository."""
    return sorted(path.parent for path in (root / RESULTS).rglob("results.json"))


def written(folder: Path) -> str:
    """Return a study's page from the results in its folder, with the pictures that it shows today."""
    data = read_json(folder / "results.json")
    pictures = SHOWN.findall((folder / "README.md").read_text(encoding="utf-8"))
    return page(STUDIES[data["study"]].title, data, pictures)
