"""The results in README.md: the policy that ships, its preset over several seeds, and the paper's methods."""

from typing import Any, Final

from experiments.studies.analysis.evidence import early_farms
from experiments.studies.analysis.verdicts import shown
from experiments.studies.methods import DEFAULT_PRESET, EIA_SEC
from experiments.studies.scales import FIRST_FARM, FIRST_REPORTED

RUN: Final = "EIA-SEC (this run)"


def policies_table(run: dict[str, Any], label: str) -> list[str]:
    """Return a run's policy, by a label, beside those that learn nothing; best reward first."""
    shown = [result for result in run["evaluations"] if result["policy"] != "trained"]
    shown.sort(key=lambda result: -result["reward"]["mean"])
    rows = [
        "| policy | reward per agent | communication | monitoring | data collection | AoI | VDF |",
        "|---|---:|---:|---:|---:|---:|---:|",
    ]
    for result in shown:
        reward = result["reward"]
        name = f"**{label}**" if result["policy"] == RUN else result["policy"]
        numbers = [f"{reward[key]:.0f}" for key in ("mean", "c", "m", "d")]
        rows.append(" | ".join(["", name, *numbers, f"{result['aoi']:.2f}", f"{result['vdf']:.2f}", ""]).strip())
    return rows


def _methods_rows(study: dict[str, Any]) -> list[str]:
    """Return the methods of the study `training`, tuned and trained alike, best reward first."""
    methods = sorted(study["methods"].items(), key=lambda item: -item[1]["reward"][0])
    first, seeds, size = next(iter(study["methods"])), len(methods[0][1]["runs"]), study["sizes"]
    commits = dict.fromkeys(run["commit"] for method in study["methods"].values() for run in method["runs"])
    start = size.get("first_farm", FIRST_FARM)
    early = f", of which the preset was chosen on {FIRST_FARM}..{FIRST_REPORTED - 1}" if early_farms(study) else ""
    rows = [
        "Beside the paper's baselines, every method with the plain views of the preset `study`: equal tuning,",
        f"{size['episodes']} episodes and {seeds} seeds each, flown on",
        f"farms {start}..{start + size['farms'] - 1}{early}; interquartile means, in brackets 95 % of",
        "a bootstrap over the seeds ([what that is worth](docs/explanation/reproduce.md#statistics)), and",
        "normalised: 0 is the random policy, 1 the best heuristic. Made by",
        f"`{study['command']}`, commits {', '.join(commits)}.",
        "",
        f"| method | reward per agent | normalised | AoI | VDF | P({first} is better) |",
        "|---|---:|---:|---:|---:|---:|",
    ]
    for name, method in methods:
        better = study["improvement"].get(name)
        figures = [shown(method["figures"][figure], 2) for figure in ("aoi", "vdf")]
        cells = [shown(method["reward"]), shown(method["normalised"], 2), *figures, shown(better, 2) if better else ""]
        rows.append(" | ".join(["", f"**{name}**" if name == first else name, *cells, ""]).strip())
    return [*rows, "", "[All claims of the paper, one by one](docs/explanation/reproduce.md).", ""]


def _rank(flown: dict[str, Any]) -> list[str]:
    """Return where the policy that ships stands among the heuristics; two with overlapping intervals are level."""
    rewards = {result["policy"]: result["reward"] for result in flown["results"]}
    mean, low, high = rewards.pop("trained")
    named = sorted(rewards.items(), key=lambda item: -item[1][0])
    above = ", ".join(f"{name} {reward[0]:.0f}" for name, reward in named if reward[1] > high)
    level = ", ".join(f"{name} {reward[0]:.0f}" for name, reward in named if reward[1] <= high and reward[2] >= low)
    return [
        f"On farms {flown['first_farm']}..{flown['last_farm']} the policy that ships earns {mean:.0f}"
        f" ({low:.0f}..{high:.0f}). More earn the heuristics",
        f"{above or 'none'}; as much: {level or 'none'}",
        "([all of them](docs/reference/heuristics.md)).",
    ]


def _seeds(study: dict[str, Any]) -> list[str]:
    """Return what the seeds of the default preset came to in the study `default`."""
    own, size = study["methods"][DEFAULT_PRESET], study["sizes"]
    aoi, vdf = (shown(own["figures"][figure], 2) for figure in ("aoi", "vdf"))
    return [
        f"{len(own['runs'])} seeds of the preset earn {shown(own['mean_reward'])} on farms",
        f"{size['first_farm']}..{size['first_farm'] + size['farms'] - 1} (mean; in brackets 95 % over the seeds),",
        f"AoI {aoi}, VDF {vdf}; with the settings of the comparison below it is",
        f"{shown(study['methods'][EIA_SEC.name]['mean_reward'])} ([study](docs/results/reproduce/default/README.md)).",
        "",
    ]


def run_block(run: dict[str, Any], study: dict[str, Any], flown: dict[str, Any], seeds: dict[str, Any]) -> str:
    """Return the block of README.md.

    Args:
        run: the evaluation of the run whose policy ships.
        study: the results of the study `training`.
        flown: every policy that has a name, on all farms that are reported on.
        seeds: the results of the study `default`.
    """
    farms = run["evaluations"][0]["farms"]
    chosen = ",\nbut on which the preset's settings were chosen" if farms[0] < FIRST_REPORTED else ""
    return "\n".join(
        [
            f"Noise-free, farms {farms[0]}..{farms[-1]}, which training never saw (it uses 0..19){chosen}; one seed.",
            "",
            *policies_table(run, "EIA-SEC, default preset"),
            "",
            "AoI is the age of information of the sensors, VDF (visual data freshness) that of the plots' images:",
            "means over the episode of counters that rise until the next visit, so low is good.",
            "",
            *_rank(flown),
            "",
            f"Made by `{run['command']}`, which is what `make train`",
            f"does today (seed {run['seed']}, commit {run['commit']}): {run['episodes']:,} episodes,",
            f"{run['environment_steps']:,} environment steps, {run['updates']:,} update rounds of all twelve agents in",
            f"{run['seconds'] / 60:.0f} minutes on two shared cores without an accelerator. The paper reports 895 for",
            "EIA-SEC, on its own farm. [Curves](docs/results/default/curves.png),",
            "[all results](docs/results/README.md).",
            "",
            *_seeds(seeds),
            *_methods_rows(study),
            "![Paths of all UAVs on an unseen farm](docs/results/default/trajectories.png)",
            "",
        ]
    )
