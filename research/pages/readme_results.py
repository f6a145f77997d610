"""The table of results in README.md, and what stands behind it in research/results/README.md."""

from typing import Any, Final

from research.pages.blocks import wrapped
from research.studies.analysis.verdicts import shown
from research.studies.methods import EIA_SEC, TUNED_PRESET
from research.studies.scales import FIRST_FARM, FIRST_REPORTED

RUN: Final = "this run"
DEFAULT: Final = "IPPO, preset `instant`"
LONG: Final = "IPPO, preset `long`"
OURS: Final = ("`long`", "the preset instant")
"""What the README calls the two."""


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


def results_block(
    study: dict[str, Any],
    seeds: dict[str, Any],
    default: dict[str, Any],
    long: dict[str, Any],
    untrained: dict[str, Any],
) -> str:
    """Return the block of README.md: learned methods and heuristics in one table, and one line on how they compare.

    Args:
        study: the results of the study `training`.
        seeds: the results of the study `default`.
        default: several seeds of the preset instant, see `research.experiments.seeds`.
        long: the same of the preset `long`.
        untrained: what a team of the preset instant earns before it learns, see `research.experiments.untrained`.
    """
    size, own = seeds["sizes"], seeds["methods"][TUNED_PRESET]
    ours = {f"**{LONG}**": _several(long), f"**{DEFAULT}**": _several(default)}
    learned = {"EIA-SEC, preset `eia-sec`": own, **ours}
    learned |= {_compared(name): method for name, method in study["methods"].items()}
    rows = [(name, "learned", method["mean_reward"], method["metrics"]) for name, method in learned.items()]
    for name, policy in seeds["references"]["policies"].items():
        if name == "static":  # says no more than `random`
            continue
        freshness = {name: [policy["metrics"][name]] * 3 for name in ("aoi", "vdf")}
        rows.append((name, "heuristic", [policy["mean_reward"]] * 3, freshness))
    rows.sort(key=lambda row: -row[2][0])
    lines = ["| policy | reward per agent | AoI | VDF |", "|---|---:|---:|---:|"]
    for name, kind, reward, freshness in rows:
        score = shown(reward) if reward[1] < reward[2] else f"{reward[0]:.0f}"
        label = f"{name}, heuristic" if kind == "heuristic" else name
        lines.append(f"| {label} | {score} | {freshness['aoi'][0]:.2f} | {freshness['vdf'][0]:.2f} |")
    scores = [(name, round(reward[0])) for name, kind, reward, _ in rows if kind == "heuristic"]
    ahead, level = zip(*(_beside(scores, method) for method in ours.values()), strict=True)
    counts = " or ".join(str(count) for count in sorted({len(own["runs"]), len(default["runs"])}))
    conditions = f"""Mean reward without noise over {size["farms"]} farms that training never saw; that of learned
        methods over {counts} seeds (`long`: {len(long["runs"])}), with a 95 % interval. All methods had the same tuning
        budget; our presets were tuned [beyond it](docs/explanation/method.md#the-preset-instant). AoI is the mean age
        of sensor data, VDF that of plot images; lower is better."""
    tied = "".join(f"Level with {what}: {names}. " for what, names in zip(OURS, level, strict=True) if names)
    beaten = "; ".join(f"{_beats(names)} {what}" for what, names in zip(OURS, ahead, strict=True))
    reading = f"""**{beaten[0].upper()}{beaten[1:]}.** {tied}Heuristics see the whole farm and plan with its dynamics; a
        trained UAV acts on what it observes. That includes sweep routes and, with `long`,
        [plans](docs/reference/environment.md#added-observations), which its collectors favour from the start. So an
        untrained team of the preset instant earns {untrained["reward"]:.0f} already; learning adds the rest."""
    return "\n".join([wrapped(conditions), "", *lines, "", wrapped(reading)])


def _beside(scores: list[tuple[str, int]], method: dict[str, Any]) -> tuple[str, str]:
    """Return which heuristics score higher than a learned method, and which are level with it."""
    _, low, high = (round(number) for number in method["mean_reward"])
    ahead = [name for name, score in scores if score > high]
    level = [name for name, score in scores if low <= score <= high]
    return ", ".join(ahead), ", ".join(level)


def _beats(names: str) -> str:
    """Return the beginning of a sentence on those heuristics that beat something."""
    count = len(names.split(", ")) if names else 0
    if count < 2:
        return f"one heuristic, {names}, beats" if count else "no heuristic beats"
    return f"{count} heuristics ({names}) beat"


def _several(default: dict[str, Any]) -> dict[str, Any]:
    """Return the seeds of the preset instant as the studies' methods are given."""
    return {"mean_reward": default["reward"], "metrics": {name: default[name] for name in ("aoi", "vdf")}}


def _compared(name: str) -> str:
    return f"{name}, preset `study`" if name == EIA_SEC.name else name


def _unclean(methods: dict[str, Any]) -> str:
    """Return whose runs were made by sources that no commit holds, or nothing."""
    counted = {name: sum(run["commit"].endswith("-dirty") for run in found["runs"]) for name, found in methods.items()}
    named = [f"{count} of {name}" for name, count in counted.items() if count]
    return f" No commit holds the sources of runs marked -dirty: {', '.join(named)}." if named else ""


def _methods_rows(study: dict[str, Any]) -> list[str]:
    """Return the methods of the study `training`, tuned and trained alike, best reward first."""
    methods = sorted(study["methods"].items(), key=lambda item: -item[1]["reward"][0])
    first, size = next(iter(study["methods"])), study["sizes"]
    commits = dict.fromkeys(run["commit"] for method in study["methods"].values() for run in method["runs"])
    conditions = f"""The methods of the paper, and PPO for many agents, each with equal tuning,
        {size["episodes"]} episodes and {len(methods[0][1]["runs"])} seeds, all with the plain observations of the
        preset `study`, on farms
        {_farms(size)}. Numbers are interquartile means with a 95 % bootstrap interval over the seeds ([how far to trust
        it](../../docs/explanation/reproduce.md#statistics)). Normalised: 0 is the random policy, 1 the best heuristic.
        Made by
        `{study["command"]}`, commits {", ".join(commits)}.{_unclean(study["methods"])}"""
    rows = [
        wrapped(conditions),
        "",
        f"| method | reward per agent | normalised | AoI | VDF | P({first} is better) |",
        "|---|---:|---:|---:|---:|---:|",
    ]
    for name, method in methods:
        better = study["improvement"].get(name)
        freshness = [shown(method["metrics"][name], 2) for name in ("aoi", "vdf")]
        cells = [
            shown(method["reward"]),
            shown(method["normalised"], 2),
            *freshness,
            shown(better, 2) if better else "",
        ]
        rows.append(" | ".join(["", f"**{name}**" if name == first else name, *cells, ""]).strip())
    return [*rows, ""]


def _farms(size: dict[str, Any]) -> str:
    first = size.get("first_farm", FIRST_FARM)
    return f"{first}..{first + size['farms'] - 1}"


def _rank(flown: dict[str, Any]) -> str:
    """Return where the policy that ships stands among the heuristics; two with overlapping intervals are level."""
    rewards = {result["policy"]: result["reward"] for result in flown["results"]}
    mean, low, high = rewards.pop("trained:instant")
    named = sorted(rewards.items(), key=lambda item: -item[1][0])
    above = ", ".join(f"{name} {reward[0]:.0f}" for name, reward in named if reward[1] > high)
    level = ", ".join(f"{name} {reward[0]:.0f}" for name, reward in named if reward[1] <= high and reward[2] >= low)
    return (
        f"The policy that ships scores {mean:.0f} ({low:.0f}..{high:.0f}) on farms {flown['first_farm']}.."
        f"{flown['last_farm']}. Heuristics that score higher: {above or 'none'}. Level with it: {level or 'none'}."
    )


def _relays(runs: list[dict[str, Any]]) -> str:
    """Return what runs' relays earn beside scripted ones, if all runs say it."""
    if not all("script" in run for run in runs):
        return ""
    own, scripted = sum(run["reward"]["c"] for run in runs), sum(run["script"] for run in runs)
    return f""" Learned relays earn {own / len(runs):.1f} each; the heuristic `search` in their place
        earns {scripted / len(runs):.1f} (means over the seeds)."""


def _seeds_line(default: dict[str, Any]) -> str:
    """Return what several seeds of the preset instant come to, and how soon."""
    runs, first = default["runs"], default["first_farm"]
    aoi, vdf = (shown(default[name], 3) for name in ("aoi", "vdf"))
    each = ", ".join(f"{run['reward']['mean']:.0f}" for run in runs)
    minutes = [run["seconds"] / 60 for run in runs]
    at_once = max(run.get("at_once", 1) for run in runs)
    beside = f", up to {at_once} at a time" if at_once > 1 else ""
    soon = [[run["reached"][share] for run in runs] for share in ("0.5", "0.75", "0.9", "1")]
    times = ", ".join("never" if None in times else f"{max(times):.0f}" for times in soon)
    fresh = "; the first two before it learns anything" if soon[0] == soon[1] else ""
    return f"""{len(runs)} seeds score {shown(default["reward"])} on farms {first}..{first + default["farms"] - 1}
        (each: {each}; the lawnmower {default["lawnmower"]:.0f}), AoI {aoi}, VDF {vdf}, after {min(minutes):.0f} to
        {max(minutes):.0f} minutes each{beside}. The slowest needs {times} seconds to 50, 75, 90 and 100 % of the
        lawnmower's reward in training, noise included{fresh}.{_relays(runs)} Made by `{default["command"]}`, commit
        {default["commit"]}."""


def default_block(
    run: dict[str, Any], study: dict[str, Any], flown: dict[str, Any], seeds: dict[str, Any], default: dict[str, Any]
) -> str:
    """Return the block of research/results/README.md: what the results in the README rest on.

    Args:
        run: the evaluation of the run whose policy ships.
        study: the results of the study `training`.
        flown: every policy that has a name, on all farms that are reported on.
        seeds: the results of the study `default`.
        default: several seeds of the preset instant, see `research.experiments.seeds`.
    """
    farms, own = run["evaluations"][0]["farms"], seeds["methods"][TUNED_PRESET]
    beside = f", {run['at_once']} such runs at a time," if run.get("at_once", 1) > 1 else ""
    chosen = " but on which the preset's settings were chosen" if farms[0] < FIRST_REPORTED else ""
    aoi, vdf = (shown(own["metrics"][name], 2) for name in ("aoi", "vdf"))
    first = f"""The run whose policy ships, without noise on farms {farms[0]}..{farms[-1]}, which training never saw (it
        uses 0..19){chosen}; one seed:"""
    origin = f"""Made by `{run["command"]}` (seed {run["seed"]}, commit {run["commit"]}), which is what
        `make train ARGS="--preset instant"` does: {run["episodes"]:,} episodes, {run["environment_steps"]:,}
        environment steps and {run["updates"]:,} updates of all
        twelve agents in {run["seconds"] / 60:.0f} minutes on two shared cores{beside} without an
        accelerator. The paper reports 895 for EIA-SEC, on its own farm. [Curves](instant/curves.png),
        [paths](instant/trajectories.png)."""
    several = f"""{len(own["runs"])} seeds of the preset `eia-sec` score {shown(own["mean_reward"])} on farms
        {_farms(seeds["sizes"])} (mean, with a 95 % interval over the seeds), AoI {aoi}, VDF {vdf}
        ([study](reproduce/default/README.md))."""
    rank = f"{_rank(flown)} [All of them](../../docs/reference/heuristics.md)."
    table = policies_table(run, DEFAULT)
    parts = [wrapped(first), "", *table, "", wrapped(origin), "", wrapped(rank), ""]
    parts += [wrapped(_seeds_line(default)), "", wrapped(several), ""]
    return "\n".join([*parts, *_methods_rows(study)])
