"""The results in the README, written from the committed data by `python -m deploy.results`; a test keeps them true."""

import json
from pathlib import Path
from typing import Any, Final

BEGIN: Final = "<!-- results:begin -->"
END: Final = "<!-- results:end -->"
RUN: Final = "EIA-SEC (this run)"


def readme(text: str, results: Path) -> str:
    """Return the README with its results block written anew.

    Args:
        text: the README.
        results: docs/results.
    """
    head, _, rest = text.partition(BEGIN)
    _, _, tail = rest.partition(END)
    return f"{head}{BEGIN}\n{_block(json.loads((results / 'default' / 'evaluation.json').read_text()))}{END}{tail}"


def _block(run: dict[str, Any]) -> str:
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
            f"Made by `{run['command']}` (seed {run['seed']}, commit {run['commit']}): {run['episodes']:,} episodes,",
            f"{run['environment_steps']:,} environment steps, {run['updates']:,} update rounds of all twelve agents in",
            f"{run['seconds'] / 60:.0f} minutes on two shared cores without an accelerator. Curves and paths:",
            "[docs/results/default](docs/results/default/curves.png).",
            "",
            "![Paths of all UAVs on an unseen farm](docs/results/default/trajectories.png)",
            "",
        ]
    )


def main() -> None:
    """Write the README's results block anew."""
    path = Path("README.md")
    path.write_text(readme(path.read_text(encoding="utf-8"), Path("docs/results")), encoding="utf-8")


if __name__ == "__main__":
    main()
