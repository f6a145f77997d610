"""Blocks that show one committed measurement each."""

from collections.abc import Callable
from pathlib import Path
from typing import Any, Final

from research.benchmarks.distribution.summary import summary
from research.pages import capacity
from research.pages.blocks import read_json
from research.pages.inertia_table import inertia_block, readme_block
from research.pages.interval_tables import interval_table
from research.pages.readme_results import default_block, policies_table, results_block
from research.pages.sessions_table import sessions_block

TRAINING: Final = "research/results/reproduce/training/results.json"
PRESET: Final = "research/results/reproduce/default/results.json"
HEURISTICS: Final = "research/results/heuristics/results.json"
SEEDS: Final = "research/results/instant/seeds.json"
UNTRAINED: Final = "research/results/instant/untrained.json"
LONG: Final = "research/results/long/seeds.json"
DISTRIBUTION: Final = "research/results/distribution/results.json"
NOT_MEASURED: Final = "Not measured yet.\n"
"""A block whose data is not there."""
PAUSE_AIM: Final = 50.0
"""Milliseconds for which a checkpoint may stop the training at the default sizes."""
SERVED_AIM: Final = 1000.0
"""Steps a second that a served environment should make over loopback, at least."""
EXTRA_AIM: Final = 0.05
"""Share of extra time that it may take at 20 ms a step."""
TAIL_EPISODES: Final = 40
"""Episodes at the end of a training curve whose mean is its final value."""


def paper_block(run: dict[str, Any]) -> str:
    """Return the block on the run of the paper preset."""
    minutes = run["seconds"] / 60
    return "\n".join(
        [
            f"`{run['command']}`, commit {run['commit']}, seed {run['seed']}: {run['episodes']} episodes,",
            f"{run['environment_steps']:,} environment steps, {run['updates']:,} updates, {minutes:.0f} minutes.",
            "",
            *policies_table(run, "EIA-SEC, paper preset"),
            "",
        ]
    )


def distribution_block(data: dict[str, Any]) -> str:
    """Return the block of README.md on what more workers bring where a step takes time."""
    lines, seeds = summary(data["runs"]), len({run["seed"] for run in data["runs"]})
    return "\n".join(
        [
            f"Speed-up where steps take {1000 * data['task']['period']:.0f} ms"
            f" ({'one seed' if seeds == 1 else f'{seeds} seeds'}, [details](research/results/distribution/README.md)):",
            "",
            "| workers | " + " | ".join(str(line["workers"]) for line in lines) + " |",
            "|---" + "|---:" * len(lines) + "|",
            "| speed-up | " + " | ".join(f"{s:.1f}" if s else "-" for s in (line["speedup"] for line in lines)) + " |",
            "",
            "![Speed-up by workers, and reward against time](research/results/distribution/speedup.png)",
            "",
        ]
    )


def forms_block(data: dict[str, Any]) -> str:
    """Return the block on the forms of the shared ensemble critic."""
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


def tasks_block(*tasks: dict[str, Any]) -> str:
    """Return the block on two tasks of other people's."""
    rows = [
        "| task | trained | random actions | seeds | environment steps | minutes a seed |",
        "|---|---:|---:|---:|---:|---:|",
    ]
    for task in tasks:
        results = task["results"]
        scores = [[evaluation["reward"]["mean"] for evaluation in result["evaluations"]] for result in results]
        trained, chance = zip(*scores, strict=True)
        steps = results[0]["curve"]["environment_steps"][-1]
        minutes = sum(result["seconds"] for result in results) / len(results) / 60
        spread = f"{sum(trained) / len(trained):.1f} ({min(trained):.1f} to {max(trained):.1f})"
        random = f"{sum(chance) / len(chance):.1f}"
        cells = (task["task"], spread, random, str(len(results)), f"{steps:,}", f"{minutes:.0f}")
        rows.append("| " + " | ".join(cells) + " |")
    commands = ", ".join(f"`{task['command']}` (commit {task['commit']})" for task in tasks)
    pictures = [f"![{task['task']}](../../research/results/tasks/{task['task']}/curves.png)" for task in tasks]
    return "\n".join(
        [
            "Reward per agent and episode without noise, on scenarios that training never saw: mean over the seeds",
            f"and their range. Made by {commands}, on cores shared with other work.",
            "",
            *rows,
            "",
            *pictures,
            "",
        ]
    )


def heuristics_block(data: dict[str, Any]) -> str:
    """Return the block on every heuristic on the reported farms."""
    return "\n".join(
        [
            f"`{data['command']}`, commit {data['commit']}: farms {data['first_farm']}..{data['last_farm']}, one",
            f"episode each; mean over the farms and, in brackets, its {data['level']:.0%} bootstrap interval.",
            "",
            interval_table(data),
        ]
    )


def hosts_block(data: dict[str, Any]) -> str:
    """Return the block on the run on six hosts."""
    ledger, reward = data["ledger"], data["reward_per_agent"]
    workers = ", ".join(f"{name} {steps:,}" for name, steps in data["accepted_by_worker"].items())
    rows = [
        ("`eia-sec up` on five hosts, until every host runs its processes", f"{data['seconds_to_start']} s"),
        (
            "until the learner has the first chunk; with an empty cache the simulator is compiled first",
            f"{data['seconds_to_first_chunk']} s",
        ),
        ("`eia-sec up` with a sixth host, until its first chunk", f"{data['seconds_to_join']} s"),
        (
            f"a host cut off for {data['seconds_cut_off']:.0f} s (link down), after healing until its next chunk",
            f"{data['seconds_to_recover']} s",
        ),
        ("chunks of that host while it was cut off", f"{data['chunks_while_cut_off']}"),
        ("environment steps produced", f"{ledger['produced']:,}"),
        ("accepted, by worker", workers),
        ("lost in workers' spools at the end", f"{ledger['lost']:,}"),
        ("unexplained, counted twice", f"{ledger['unexplained']}, {ledger['counted_twice']}"),
        ("reward per agent, trained", f"{reward['trained']}"),
        ("reward per agent, static and random policies", f"{reward['static']}, {reward['random']}"),
    ]
    return "\n".join(
        [
            f"`{data['command']}`, commit {data['commit']}, seed {data['seed']}: the {data['preset']} preset with",
            f"{data['episodes']} episodes ({data['environment_steps']:,} environment steps, {data['updates']:,}",
            f"updates, {data['minutes']} minutes), evaluated without noise on farms {data['farms']}, which training",
            f"never saw. {data['hosts']} hosts are network namespaces of one machine with two cores, shared with other",
            f"work; links are mutual TLS through a router, {1000 * data['delay_seconds']:.0f} ms from each host",
            "to the router, each way.",
            "",
            "| | |",
            "|---|---:|",
            *(f"| {what} | {value} |" for what, value in rows),
            "",
        ]
    )


def watch_block(data: dict[str, Any]) -> str:
    """Return the block on what watching costs a worker."""
    bare, *others = data["watchers"]
    rows = [
        "| watchers | processor time for watching | frames a second | extra time of a step | processor it had |",
        "|---:|---:|---:|---:|---:|",
        f"| {bare['watchers']} | {bare['watching_percent']:.2f} % | - | - | {bare['processor_share']:.2f} cores |",
    ]
    control = [data["control"]] if "control" in data else []
    for line in (*others, *control):
        extra = (
            f"{line['extra_percent']:+.1f} % ({line['extra_percent_least']:+.1f} to {line['extra_percent_most']:+.1f})"
        )
        share, frames = f"{line['watching_percent']:.2f} %", f"{line['frames_per_second']:.0f}"
        busy = f"0, control: the other process loops idly for {100 * line.get('other_share', 0.0):.0f} % of its time"
        who = busy if line in control else str(line["watchers"])
        rows.append(f"| {who} | {share} | {frames} | {extra} | {line['processor_share']:.2f} cores |")
    # The kept file may be older than the note of its commit.
    commit = f", commit {data['commit']}" if "commit" in data else ""
    numbers = ", ".join(str(line["watchers"]) for line in data["watchers"])
    return "\n".join(
        [
            f"`{data['command']}`{commit} ([results/watch.json](../../research/results/watch.json)):",
            f"{numbers} watchers take turns of {data['seconds']:.0f} s, {data['repeats']} times each, with one worker",
            "that simulates as fast as it can.",
            "",
            *rows,
            "",
        ]
    )


def fly_block(data: dict[str, Any]) -> str:
    """Return the block on the latency of a flight node."""
    rows = [
        "| rate | set-points | latency, ms: median, 99 %, most | round trip, ms: median, 99 %, most | left out |",
        "|---:|---:|---:|---:|---:|",
    ]
    for line in data["flights"]:
        node, flown = line["node"], line["flight"]
        latency, trip = (
            ", ".join(f"{spread[name]:.{digits}f}" for name, digits in (("median", 2), ("p99", 1), ("most", 1)))
            for spread in (node["latency"], flown["round_trip_ms"])
        )
        left_out = f"{node['overruns']:,} of {node['periods'] + node['overruns']:,} periods"
        rows.append(f"| {line['rate']:g} | {node['decisions']:,} | {latency} | {trip} | {left_out} |")
    return "\n".join(
        [
            f"`{data['command']}`, commit {data['commit']} ([results/fly.json](../../research/results/fly.json)):",
            f"{data['vehicles']} UAVs, `eia-sec fly --policy trained --lockstep --rate R` and `eia-sec simulator`",
            f"on one machine with {data['cores']} cores. Latencies are of the newest 1,000 set-points, round trips",
            "of all.",
            "",
            *rows,
            "",
        ]
    )


def checkpoint_block(data: dict[str, Any]) -> str:
    """Return the block on how long a checkpoint stops training."""
    longest, size = data["pause_ms_most"], data["bytes"] / 2**20
    verdict = "met" if longest <= PAUSE_AIM else "not met"
    rows = [
        ("training stopped", f"{data['pause_ms_median']:.1f}", f"{longest:.1f}"),
        ("a turn while one is written", f"{data['turn_ms_median_writing']:.1f}", f"{data['turn_ms_most_writing']:.1f}"),
        ("a turn otherwise", f"{data['turn_ms_median_else']:.1f}", f"{data['turn_ms_most_else']:.1f}"),
    ]
    return "\n".join(
        [
            f"`{data['command']}`, commit {data['commit']}",
            "([results/checkpoint.json](../../research/results/checkpoint.json)):",
            f"{data['checkpoints']} checkpoints of {size:.0f} MiB, {data['agents']} agents of width {data['width']}",
            f"and {data['rows']:,} rows of replay; one thread trains on a machine with {data['cores']} cores.",
            f"Another writes, {data['write_seconds_median']:.1f} s (median). A turn takes in one chunk and does",
            f"one update. To copy all rows at once would take {data['copy_ms']:.0f} ms.",
            "",
            "| milliseconds | median | most |",
            "|---|---:|---:|",
            *(f"| {' | '.join(row)} |" for row in rows),
            "",
            f"Target: at the default sizes training stops for {PAUSE_AIM:.0f} ms at most; {verdict}: {longest:.1f} ms.",
            "",
        ]
    )


def served_block(data: dict[str, Any]) -> str:
    """Return the block on what it costs to step an environment over Zenoh."""
    best = {name: max(rates) for name, rates in data["steps_per_second"].items()}
    extra = best["here_slow"] / best["served_slow"] - 1.0
    aims = ["met" if met else "not met" for met in (best["served"] >= SERVED_AIM, extra < EXTRA_AIM)]
    slow, stretches = f"{1000 * data['period']:.0f} ms", len(data["steps_per_second"]["served"])
    rows = [
        ("no time", f"{best['here']:,.0f}", f"{best['served']:,.0f}"),
        (f"no time, {data['copies']} copies", "-", f"{best['served_copies']:,.0f}"),
        (slow, f"{best['here_slow']:.1f}", f"{best['served_slow']:.1f}"),
    ]
    return "\n".join(
        [
            f"`{data['command']}`, commit {data['commit']}: environment steps a second over loopback,",
            f"through a listener; the best of {stretches} stretches of {data['seconds']:.0f} s,"
            f" {data['cores']} cores at a load of {data['load']}",
            "([results/served.json](../../research/results/served.json)).",
            "",
            "| a step takes | in the worker's process | served |",
            "|---|---:|---:|",
            *(f"| {' | '.join(row)} |" for row in rows),
            "",
            f"Targets: at least {SERVED_AIM:,.0f} steps a second, {aims[0]}; less than {100 * EXTRA_AIM:.0f} % of",
            f"extra time at {slow} a step, {aims[1]}: {100 * extra:.1f} %.",
            "",
        ]
    )


MEASUREMENTS: Final[dict[str, tuple[tuple[str, ...], Callable[..., str]]]] = {
    "capacity": (capacity.SOURCES, capacity.block),
    "checkpoint": (("research/results/checkpoint.json",), checkpoint_block),
    "default-run": (("research/results/instant/evaluation.json", TRAINING, HEURISTICS, PRESET, SEEDS), default_block),
    "distribution": ((DISTRIBUTION,), distribution_block),
    "fly": (("research/results/fly.json",), fly_block),
    "forms": (("research/results/critic_forms/forms.json",), forms_block),
    "heuristics": ((HEURISTICS,), heuristics_block),
    "hosts": (("research/results/hosts/results.json",), hosts_block),
    "inertia": (("research/results/inertia/results.json",), inertia_block),
    "inertia-results": (("research/results/inertia/results.json",), readme_block),
    "paper-preset": (("research/results/paper/evaluation.json",), paper_block),
    "results": ((TRAINING, PRESET, SEEDS, LONG, UNTRAINED), results_block),
    "tasks": (
        ("research/results/tasks/simple_spread/results.json", "research/results/tasks/half_cheetah/results.json"),
        tasks_block,
    ),
    "served": (("research/results/served.json",), served_block),
    "sessions": (("research/results/sessions/results.json",), sessions_block),
    "watch": (("research/results/watch.json",), watch_block),
}
"""For each block: the data that it shows, and the function that writes it."""


def measured(name: str, root: Path) -> str:
    """Return the block of a measurement; it says so where its data is missing."""
    sources, block = MEASUREMENTS[name]
    data = [read_json(root / source) for source in sources]
    return NOT_MEASURED if None in data else block(*data)
