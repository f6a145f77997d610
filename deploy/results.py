"""Result blocks of README and docs, written from committed data by `python -m deploy.results`."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final

RUN: Final = "EIA-SEC (this run)"
TAIL_EPISODES: Final = 40
"""Episodes at the end of a training curve whose mean is its final value."""


def refreshed(document: str, text: str, root: Path) -> str:
    """Return a document with its block written anew.

    Args:
        document: its path in the repository, a key of BLOCKS.
        text: its present text, with the block's two marks in it.
        root: the repository.
    """
    name, data, block = BLOCKS[document]
    begin, end = f"<!-- {name}:begin -->", f"<!-- {name}:end -->"
    head, _, rest = text.partition(begin)
    _, _, tail = rest.partition(end)
    return f"{head}{begin}\n{block(json.loads((root / data).read_text(encoding='utf-8')))}{end}{tail}"


def _run_block(run: dict[str, Any]) -> str:
    shown = [result for result in run["evaluations"] if result["policy"] != "trained"]
    shown.sort(key=lambda result: -result["reward"]["mean"])
    farms = shown[0]["farms"]
    rows = [
        "| policy | reward per agent | communication | monitoring | data collection | AoI | VDF |",
        "|---|---:|---:|---:|---:|---:|---:|",
    ]
    for result in shown:
        reward = result["reward"]
        name = "**EIA-SEC, default preset**" if result["policy"] == RUN else result["policy"]
        numbers = [f"{reward[key]:.0f}" for key in ("mean", "c", "m", "d")]
        rows.append(" | ".join(["", name, *numbers, f"{result['aoi']:.2f}", f"{result['vdf']:.2f}", ""]).strip())
    return "\n".join(
        [
            f"Noise-free, farms {farms[0]}..{farms[-1]}, which training never saw (it uses 0..19); one seed.",
            "",
            *rows,
            "",
            f"Made by `{run['command']}`, which is what `make train`",
            f"does today (seed {run['seed']}, commit {run['commit']}): {run['episodes']:,} episodes,",
            f"{run['environment_steps']:,} environment steps, {run['updates']:,} update rounds of all twelve agents in",
            f"{run['seconds'] / 60:.0f} minutes on two shared cores without an accelerator. The paper reports 895 for",
            "EIA-SEC, on its own farm. [Curves](docs/results/default/curves.png),",
            "[all results](docs/results/README.md).",
            "",
            "![Paths of all UAVs on an unseen farm](docs/results/default/trajectories.png)",
            "",
        ]
    )


def _forms_block(data: dict[str, Any]) -> str:
    rows = ["| form | reward per agent, last episodes | largest critic loss | |", "|---|---:|---:|---|"]
    for result in data["results"]:
        curve = result["curve"]
        last = [p["reward"] for p in curve if p["episodes"] > curve[-1]["episodes"] - TAIL_EPISODES]
        final = f"{sum(last) / len(last):.0f}"
        note = f"diverged after {curve[-1]['episodes']} episodes" if result["diverged"] else ""
        rows.append(f"| {result['form']} | {final} | {max(p['loss'] for p in curve):.2g} | {note} |")
    episodes = max(p["episodes"] for result in data["results"] for p in result["curve"])
    seeds = sorted({result["seed"] for result in data["results"]})
    return "\n".join(
        [
            f"`{data['command']}`, commit {data['commit']}, seed {', '.join(map(str, seeds))}; training reward with",
            f"exploration noise, mean of the last {TAIL_EPISODES} of {episodes} episodes:",
            "",
            *rows,
            "",
        ]
    )


BLOCKS: Final[dict[str, tuple[str, str, Callable[[dict[str, Any]], str]]]] = {
    "README.md": ("results", "docs/results/default/evaluation.json", _run_block),
    "docs/method.md": ("forms", "docs/results/critic_forms/forms.json", _forms_block),
}
"""For each document: the block's name, the data that it shows, and the function that writes it."""


def main() -> None:
    """Write every block anew."""
    for document in BLOCKS:
        path = Path(document)
        path.write_text(refreshed(document, path.read_text(encoding="utf-8"), Path()), encoding="utf-8")


if __name__ == "__main__":
    main()
