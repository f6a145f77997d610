"""The page that a study writes beside its data: README.md with its tables, pictures and where each run comes from."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any, Final

import numpy as np

from eia_sec.common.farm import COLLECTION, COMMUNICATION, MONITORING
from eia_sec.deploy.reports.intervals import LEVEL
from research.studies.analysis.evidence import early_farms, mean_unrest
from research.studies.analysis.paper import INFERENCE_BY_METHOD, INFERENCE_BY_UAVS, REWARD_BY_MEMBERS, REWARD_BY_UAVS
from research.studies.analysis.statistics import BAND, TAIL
from research.studies.methods import ABLATIONS, TRAINED
from research.studies.pages.notes import filled, note
from research.studies.pages.plots import caption
from research.studies.scales import FIRST_FARM, FIRST_REPORTED

Results = Mapping[str, Any]
Cells = Sequence[str]

KINDS: Final = (COMMUNICATION, MONITORING, COLLECTION)


def page(title: str, data: Results, pictures: Sequence[str]) -> str:
    """Return the whole page of a study."""
    made = f"`{data['command']}`, commit {data['commit']}.\n"
    notes = [note("smoke")] if data["scale"] == "smoke" else [""]
    notes.append(note("early_farms", first=FIRST_FARM, last=FIRST_REPORTED - 1) if early_farms(data) else "")
    parts = [f"# {title}\n", made, *notes, SECTIONS[data["study"]](data)]
    parts += [f"![{name.removesuffix('.png')}]({name})\n\n{caption(name)}\n" for name in pictures]
    if "choice" in data:
        parts += ["## Settings\n", choices(data)]
    parts += ["## Where it comes from\n", origins(data)]
    return "\n".join(part for part in parts if part)


def headline(data: Results) -> str:
    """Return methods that were tuned, trained and evaluated alike, and those that learn nothing, best reward first."""
    references, methods = data["references"]["policies"], data["methods"]
    head = ("policy", "normalised", "reward", "communication", "monitoring", "data collection", "AoI", "VDF")
    more = ("P(first > it)", "converged", "unrest", "over farms", "seeds")
    rows = []
    for name, method in methods.items():
        better = data["improvement"].get(name) if "improvement" in data else None
        rows.append((method["reward"][0], [f"**{name}**", *_method_cells(method), *_more(method, better)]))
    for name, policy in references.items():
        types = [f"{policy['types'][kind]:.0f}" for kind in KINDS]
        counters = [f"{policy['metrics'][kind]:.2f}" for kind in ("aoi", "vdf")]
        numbers = [f"{policy['normalised']:.2f}", f"{policy['reward']:.0f}", *types, *counters]
        rows.append((policy["reward"], [name, *numbers, *[""] * len(more)]))
    rows.sort(key=lambda row: -row[0])
    return table([*head, *more], [cells for _, cells in rows]) + "\n" + _legend(data)


def beyond(data: Results) -> str:
    """Return the preset `eia-sec` beside EIA-SEC as it is compared with other methods."""
    return headline(data) + "\n" + note("unequal")


def on_policy(data: Results) -> str:
    """Return methods on policy, which nothing has tuned."""
    return headline(data) + "\n" + note("on_policy")


def members(data: Results) -> str:
    """Return the reward by k_s beside the paper's."""
    rows = []
    for name, method in data["methods"].items():
        paper = REWARD_BY_MEMBERS.get(int(name.rpartition(" ")[2]))
        rows.append([name, f"{paper:.2f}" if paper else "", *_method_cells(method), str(len(method["runs"]))])
    head = ("k_s", "paper", "normalised", "reward", "communication", "monitoring", "data collection", "AoI", "VDF")
    return table([*head, "seeds"], rows) + "\n" + _legend(data)


def teams(data: Results) -> str:
    """Return reward and decision time by number of UAVs beside the paper's."""
    rows = []
    for name, team in data["teams"].items():
        uavs, best = int(name), team["references"]["policies"][team["references"]["best"]]
        paper = [f"{source[uavs]:.2f}" if uavs in source else "" for source in (REWARD_BY_UAVS, INFERENCE_BY_UAVS)]
        ours = [_interval(team["reward"], 0), _interval(team["normalised"], 2)]
        known = f"{team['references']['best']} {best['reward']:.0f}"
        rows.append([name, paper[0], *ours, known, paper[1], *_time_cells(team["time"]), str(len(team["runs"]))])
    head = ("UAVs", "paper: reward", "reward", "normalised", "best heuristic", "paper: ms")
    text = table([*head, "decide, ms", "separate, ms", "simulate, ms", "seeds"], rows)
    return "\n".join([text, _legend(data), note("times")])


def inference(data: Results) -> str:
    """Return decision times by number of UAVs and by method beside the paper's."""
    head = ("paper: ms", "decide, ms", "separate, ms", "simulate, ms", "seeds")
    sizes = [
        [name, _known(INFERENCE_BY_UAVS, int(name)), *_time_cells(times), str(len(times["seeds"]))]
        for name, times in data["teams"].items()
    ]
    methods = [
        [name, _known(INFERENCE_BY_METHOD, name), *_time_cells(times), str(len(times["seeds"]))]
        for name, times in data["methods"].items()
    ]
    return "\n".join(
        [
            table(("EIA-SEC, UAVs", *head), sizes),
            table(("12 UAVs, method", *head), methods),
            note("times"),
            note("untrained"),
        ]
    )


def flights(data: Results) -> str:
    """Return what was collected on each farm, and how the paths are."""
    rows = []
    for farm, flown in data["farms"].items():
        for name, flight in flown.items():
            got = [
                f"{sum(flight['collected'][kind]):.0f} of {flight['supplied'][kind]}"
                for kind in (MONITORING, COLLECTION)
            ]
            paths = [f"{flight['visited'][kind]:.0%}, {flight['order'][kind]:.2f}" for kind in KINDS]
            numbers = [f"{flight['reward']:.0f}", f"{flight['aoi']:.2f}", f"{flight['vdf']:.2f}"]
            rows.append([farm, name, *numbers, *got, *paths])
    head = ("farm", "policy", "reward", "AoI", "VDF", "VDF units collected", "AoI units collected")
    return (
        table([*head, "communication paths", "monitoring paths", "data collection paths"], rows) + "\n" + note("paths")
    )


SECTIONS: Final[Mapping[str, Callable[[Results], str]]] = {
    "training": headline,
    "ablation": headline,
    "ensemble": members,
    "scalability": teams,
    "inference": inference,
    "default": beyond,
    "on_policy": on_policy,
    "observations": on_policy,
    "trajectories": flights,
}
"""The table of each study."""


def choices(data: Results) -> str:
    """Return the scores of each method's tuning trials."""
    names = list(next(iter(data["choice"].values()))["trials"])
    rows = [
        [method, *(_chosen(found["trials"][name], name == found["chosen"]) for name in names)]
        for method, found in data["choice"].items()
    ]
    # Results that were made before trials recorded their origin are shown without.
    commits = sorted({commit for found in data["choice"].values() for commit in found.get("commits", [])})
    seeds = sorted({found["seed"] for found in data["choice"].values() if "seed" in found})
    made = f"Trials: seed {', '.join(map(str, seeds))}, commit {', '.join(commits)}.\n" if commits else ""
    text = (
        "Reward per agent of one trial each, on farms that are neither trained on nor reported; the settings of the "
        "bold one are in force. Every method has the same candidates and the same seed, and trials of "
        f"{_lengths(data)}."
    )
    text += " " + note("default_apart") if data["study"] == "default" else ""
    return "\n".join([table(["method", *names], rows), filled(text) + made])


def _lengths(data: Results) -> str:
    """Return the episodes of a tuning trial, which are more of methods that learn for longer."""
    usual = data["sizes"]["trial_episodes"]
    more = data["sizes"].get("long_trial_episodes", usual)
    long = [method.name for method in (*TRAINED, *ABLATIONS) if method.late and method.name in data["choice"]]
    apart = f", of {', '.join(long)} {more}" if long and more != usual else ""
    return f"{usual} episodes{apart}"


def origins(data: Results) -> str:
    """Return one row for each run: command, seed, commit, configuration, budget and time."""
    rows = []
    for run in runs_of(data):
        steps = run.get("environment_steps", 0) + run.get("evaluation_steps", 0)
        budget = f"{steps:,} ({run['evaluation_steps']:,})" if steps else ""
        rows.append([run.get("label", "EIA-SEC, seed 0"), f"`{run['command']}`", str(run["seed"]), run["commit"]])
        rows[-1] += [run["config"], budget, f"{run['seconds'] / 60:.1f}"]
    if not rows:
        commits = sorted(
            {commit for group in ("teams", "methods") for t in data[group].values() for commit in t["commits"]}
        )
        return f"Every time of one thread; commit {', '.join(commits)}.\n"
    return table(("run", "command", "seed", "commit", "configuration", "environment steps", "minutes"), rows) + (
        "\nEnvironment steps include those that elite imitation flew to choose elites, which stand in brackets.\n"
        + versions(data)
    )


def versions(data: Results) -> str:
    """Return which commits made each group of a study's records, where more than one did: finished runs stay."""
    groups = {name: {run["commit"] for run in group.get("runs", ())} for name, group in _groups(data).items()}
    groups |= {f"times of {name} UAVs": set(group["time"]["commits"]) for name, group in data.get("teams", {}).items()}
    groups |= {f"trials of {name}": set(found.get("commits", ())) for name, found in data.get("choice", {}).items()}
    references = [data, *data.get("teams", {}).values()]
    policies = [policy for held in references for policy in held.get("references", {}).get("policies", {}).values()]
    groups["policies that learn nothing"] = {policy["commit"] for policy in policies if "commit" in policy}
    if len(set().union(*groups.values())) < 2:
        return ""
    text = "; ".join(f"{name}: {', '.join(sorted(commits))}" for name, commits in groups.items() if commits)
    return "\n" + note("commits", groups=f"{text[0].upper()}{text[1:]}")


def _groups(data: Results) -> dict[str, Results]:
    """Return methods and teams by the name that a reader knows them by."""
    teams = {f"{uavs} UAVs": team for uavs, team in data.get("teams", {}).items()}
    run = {"the run": {"runs": [data["run"]]}} if "run" in data else {}
    return {**run, **data.get("methods", {}), **teams}


def runs_of(data: Results) -> list[Results]:
    """Return every trained run that the results of a study name."""
    if "run" in data:
        return [data["run"]]
    groups = [*data.get("methods", {}).values(), *data.get("teams", {}).values()]
    return [run for group in groups for run in group.get("runs", ())]


def table(head: Cells, rows: Sequence[Cells]) -> str:
    """Return a Markdown table, numbers to the right."""
    lines = [head, ["---", *["---:"] * (len(head) - 1)], *rows]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines) + "\n"


def _legend(data: Results) -> str:
    text = note("legend", statistic=_statistic(data), level=f"{LEVEL:.0%}")
    if "improvement" in data:
        text += note("converged", band=f"{BAND:.0%}", tail=f"{TAIL:.0%}")
    return filled(" ".join(text.split()))


def _statistic(data: Results) -> str:
    """Return what numbers of policies that learn nothing are over their farms."""
    held = data["references"] if "references" in data else next(iter(data["teams"].values()))["references"]
    same = all("mean_reward" in policy for policy in held["policies"].values())
    return "over farms" if same else "the plain mean over farms, as these results hold no other,"


def _method_cells(method: Results) -> list[str]:
    return [
        _interval(method["normalised"], 2),
        _interval(method["reward"], 0),
        *(f"{method['types'][kind][0]:.0f}" for kind in KINDS),
        *(_interval(method["metrics"][name], 2) for name in ("aoi", "vdf")),
    ]


def _more(method: Results, better: Sequence[float] | None) -> list[str]:
    runs = method["runs"]
    episodes = [run["converged"] for run in runs if run["converged"] is not None and not run["diverged"]]
    lost = sum(run["diverged"] for run in runs)
    converged = f"{np.median(episodes):.0f}" if episodes else "none"
    if len(episodes) < len(runs):
        converged += f" ({len(episodes)} of {len(runs)})"
    restless = mean_unrest(method)
    seeds = f"{len(runs)}" + (f", {lost} diverged" if lost else "")
    improved = _interval(better, 2) if better is not None else ""
    return [improved, converged, f"{restless:.0f}", f"{method['farm_spread']:.0f}", seeds]


def _interval(numbers: Sequence[float], digits: int) -> str:
    value, low, high = (f"{number:.{digits}f}" for number in numbers)
    return value if low == high else f"{value} ({low}..{high})"


def _time_cells(times: Results) -> list[str]:
    cells = []
    for piece in ("decide", "separate", "simulate"):
        medians = [seed[piece]["median"] for seed in times["seeds"]]
        late = max(seed[piece]["q95"] for seed in times["seeds"])
        cells.append(f"{_interval((float(np.median(medians)), min(medians), max(medians)), 3)}; {late:.3f}")
    return cells


def _known(paper: Mapping[Any, float], key: Any) -> str:
    return f"{paper[key]:.2f}" if key in paper else ""


def _chosen(reward: float, chosen: bool) -> str:
    return f"**{reward:.0f}**" if chosen else f"{reward:.0f}"
