"""The block of docs/reproduce.md: written by `python -m deploy.studies.comparison_page` from the committed results."""

import json
from collections import Counter
from pathlib import Path
from typing import Any, Final

from deploy.studies.catalogue import STUDIES
from deploy.studies.claims import CLAIMS, heuristics
from deploy.studies.verdicts import NOT_RUN, Row, full, rows_table

PAGE: Final = Path("docs/reproduce.md")
RESULTS: Final = Path("docs/results/reproduce")
HEURISTICS: Final = Path("docs/results/heuristics/results.json")
BEGIN: Final = "<!-- comparison:begin -->"
END: Final = "<!-- comparison:end -->"


def block(root: Path) -> str:
    """Return the comparison with the paper that the results in a repository allow."""
    held = {name: full(_read(root / RESULTS / name / "results.json")) for name in STUDIES}
    groups: dict[str, list[Row]] = {name: CLAIMS[name](held[name]) for name in STUDIES}
    groups["training"] += heuristics(held["training"], _read(root / HEURISTICS))
    count = Counter(row.verdict for rows in groups.values() for row in rows)
    parts = [", ".join(f"{number} {verdict}" for verdict, number in sorted(count.items())) + ".\n"]
    for name, rows in groups.items():
        parts += [f"### {STUDIES[name].title}\n", _origin(name, held[name], root), rows_table(rows)]
    return "\n".join(parts)


def refreshed(text: str, root: Path) -> str:
    """Return the page with its block written anew."""
    head, _, rest = text.partition(BEGIN)
    _, _, tail = rest.partition(END)
    return f"{head}{BEGIN}\n{block(root)}{END}{tail}"


def _origin(name: str, data: Any, root: Path) -> str:
    """Return where a study's numbers come from."""
    if data is not None:
        return f"[{name}](results/reproduce/{name}/README.md): `{data['command']}`, commit {data['commit']}.\n"
    smoke = f"results/reproduce/smoke/{name}/README.md"
    seen = f"; [a smoke run]({smoke}) shows that it works" if (root / "docs" / smoke).is_file() else ""
    return f"`eia-sec reproduce {name}`: {NOT_RUN}{seen}.\n"


def _read(path: Path) -> Any:
    return json.loads(path.read_text(encoding="utf-8")) if path.is_file() else None


def main() -> None:
    """Write the block anew."""
    PAGE.write_text(refreshed(PAGE.read_text(encoding="utf-8"), Path()), encoding="utf-8")


if __name__ == "__main__":
    main()
