"""How soon a training on the farm earns what the lawnmower does, and parts of it: ours beside two peers' PPO.

    python -m research.benchmarks.peers.reach [--write research/results/reach [--redraw]] [--seeds 3] [--json]

Ours is `eia-sec train` as a user starts it: the preset instant, with learner, coordinator and worker as processes of
their own. The peers train on the same farm as a PettingZoo environment, with the same observations and discrete moves,
widths, rate, discount, clip range and reward scale; a type's agents share their networks. Because their environments
are slower, they get shorter iterations, smaller minibatches and more passes over them (PEER_SETTINGS), and they may use
all cores. The clock starts with the command and stands while somebody looks at a peer's policy; ours is looked at
afterwards, from the parameters that it publishes. Everybody is ended after a while, or when it earns what the lawnmower
does.
"""

import argparse
import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from statistics import median
from typing import Any, Final

from matplotlib.figure import Figure

from eia_sec.common.actors import TeamActors
from eia_sec.common.config import RunConfig
from eia_sec.common.config.presets import PRESETS
from eia_sec.common.errors import EiaSecError, UsageError
from eia_sec.common.farm import farm_team
from eia_sec.common.protocol import keys
from eia_sec.common.protocol.messages import ParametersMessage
from eia_sec.common.transport.bus import Bus, Sample
from eia_sec.common.transport.endpoint import Endpoint, free_endpoint
from eia_sec.deploy.commands.training.train import RUN
from eia_sec.deploy.exit_codes import run_command
from eia_sec.deploy.local.threads import allowed_cores, thread_environment
from eia_sec.deploy.reports.plots import DPI, bare
from eia_sec.deploy.reports.provenance import provenance
from eia_sec.rollout.policies import ActorPolicy, policy_of
from research.benchmarks.peers.catalogue import ROOT, SOURCES, Program
from research.benchmarks.peers.flights import Point, reward_of
from research.benchmarks.peers.report import table
from research.benchmarks.peers.venvs import interpreter, provide
from research.looks import LEVEL, WIDTH, heading, legend_below, program_look

BAR: Final = "lawnmower"
PRESET: Final = "instant"
FARMS: Final = tuple(range(1000, 1020))
"""Farms that no training sees."""
OURS: Final = "EIA-SEC"
PEERS: Final = (
    Program("learner", "AgileRL IPPO", "research.benchmarks.peers.scripts.reach_agilerl", "agilerl", algorithm="ippo"),
    Program(
        "learner", "BenchMARL IPPO", "research.benchmarks.peers.scripts.reach_benchmarl", "benchmarl", algorithm="ippo"
    ),
    Program(
        "learner",
        "BenchMARL MAPPO",
        "research.benchmarks.peers.scripts.reach_benchmarl",
        "benchmarl",
        algorithm="mappo",
    ),
)
PEER_SETTINGS: Final = {"environments": 8, "iteration": 4000, "epochs": 10, "minibatch": 500}
"""What peers have instead of the preset instant's environments, iteration, epochs and minibatches."""
LOOK_SECONDS: Final = 0.5
"""Least time between two looks at ours; looking costs it nothing."""
LOOK_SHARE: Final = 0.03
"""Time between two looks at ours, as a share of the time since the command: each is flown on all farms afterwards. Our
times are late by that share at most."""
SHARES: Final = (0.5, 0.75, 0.9, 1.0)
"""Parts of the bar's reward for which times are given."""
LEAST_SHARE: Final = -0.2
"""Where the picture ends below, as a part of the bar's reward."""
JOIN_SECONDS: Final = 120.0
Line = dict[str, Any]


def run_ours(seed: int, limit: float) -> Line:
    """Train until the time is up, and return the looks.

    Raises:
        EiaSecError: when the training fails.
    """
    endpoint = free_endpoint()
    with tempfile.TemporaryDirectory() as scratch:
        words = ("train", "--preset", PRESET, "--seed", str(seed), "--endpoint", str(endpoint), "--no-report")
        command = [sys.executable, "-m", "eia_sec.deploy.cli", *words, "--run-dir", str(Path(scratch) / "run")]
        began = time.time()
        with (Path(scratch) / "log").open("wb") as log:
            process = subprocess.Popen(command, cwd=ROOT, stdout=log, stderr=log)
            try:
                published = _published(endpoint, began, limit)
                if process.poll() is not None or not published:
                    raise EiaSecError("our training ended by itself, or published nothing.")
            finally:
                _end(process)
    points: list[Point] = []
    for seconds, message in published:
        actors = TeamActors(farm_team(PRESETS[PRESET].farm), message.hidden, message.flat, message.head)
        reward = reward_of(ActorPolicy(actors), FARMS)
        points.append({"seconds": round(seconds, 2), "steps": message.environment_steps, "reward": reward})
    return {"points": points}


def _end(process: "subprocess.Popen[bytes]") -> None:
    """Stop a training as a user does; one that does not end is killed."""
    process.send_signal(signal.SIGINT)
    try:
        process.wait(JOIN_SECONDS)
    except subprocess.TimeoutExpired:
        process.kill()


def _published(endpoint: Endpoint, began: float, limit: float) -> list[tuple[float, ParametersMessage]]:
    """Return the parameters that are published, the newest at each look, with the seconds since the start."""
    kept: list[tuple[float, Sample]] = []
    with Bus.connect(endpoint, "control", wait=JOIN_SECONDS) as bus:
        state = bus.subscribe_state(keys.PARAMETERS.key(RUN))
        seconds = 0.0
        while seconds < limit:
            time.sleep(min(max(LOOK_SECONDS, LOOK_SHARE * seconds), limit - seconds))
            seconds = time.time() - began
            if (sample := state.poll()) is not None:
                kept.append((seconds, sample))
    return [(seconds, ParametersMessage.decode(sample.payload)) for seconds, sample in kept]


def run_peer(program: Program, seed: int, bar: float, asked: argparse.Namespace) -> Line:
    """Train with a peer in its own environment; raise EiaSecError if it fails."""
    config = PRESETS[PRESET]
    environment = os.environ | thread_environment(1) | {"PYTHONPATH": SOURCES}
    words = {
        "algorithm": program.algorithm,
        **{"seed": seed, "limit": asked.limit, "every": asked.every, "reward": bar, "threads": allowed_cores()},
        **settings(config),
        "began": time.time(),
    }
    command = [str(interpreter(program, asked.venvs)), "-m", program.module, "--farms", *map(str, FARMS)]
    command += [text for name, value in words.items() for text in (f"--{name.replace('_', '-')}", str(value))]
    # Looking takes longer than training where a peer's actors are slow.
    patience = JOIN_SECONDS + 10.0 * asked.limit
    done = subprocess.run(
        command, cwd=ROOT, env=environment, capture_output=True, text=True, check=False, timeout=patience
    )
    if done.returncode:
        raise EiaSecError(f"{program.module} failed: {done.stderr.strip().rpartition(chr(10))[2]}")
    result = json.loads(done.stdout.strip().rpartition("\n")[2])
    return {**result["lines"][0], "versions": result["versions"]}


def settings(config: RunConfig) -> dict[str, Any]:
    """Return the settings that a peer trains with: that of a configuration of ours."""
    algorithm = config.on_policy
    return {
        **PEER_SETTINGS,
        "width": algorithm.hidden,
        "rate": algorithm.actor_rate,
        "discount": algorithm.discount,
        "gae_lambda": algorithm.gae_lambda,
        "clip": algorithm.clip,
        "entropy": algorithm.entropy_end,
        "gradient_clip": algorithm.gradient_clip,
        "reward_scale": algorithm.reward_scale,
    }


def reached(run: Line, wanted: float) -> float | None:
    """Return the seconds after which a run flew well enough, or None."""
    return next((float(point["seconds"]) for point in run["points"] if point["reward"] >= wanted), None)


def summary(data: Line) -> list[Line]:
    """Return for each program and part of the bar how many seeds reached it, when, and how much later than ours."""
    rows = []
    for share in SHARES:
        for software in dict.fromkeys(run["software"] for run in data["runs"]):
            mine = [run for run in data["runs"] if run["software"] == software]
            times = [reached(run, share * data["bar"]) for run in mine]
            # A seed that did not reach it took longer than it was given.
            least = [run["points"][-1]["seconds"] if at is None else at for run, at in zip(mine, times, strict=True)]
            found = {"software": software, "share": share, "seeds": len(mine)}
            found |= {"reached": sum(at is not None for at in times), "seconds": median(least)}
            rows.append(found | {"least": min(least), "most": max(least)})
    ours = {row["share"]: row for row in rows if row["software"] == OURS}
    return [
        {**row, "times": row["seconds"] / own["seconds"] if own["reached"] == own["seeds"] else None}
        for row in rows
        for own in [ours[row["share"]]]
    ]


def steps_per_second(data: Line) -> dict[str, float]:
    """Return the environment steps a second that each program learned from, start included: the median of its seeds."""
    found: dict[str, list[float]] = {}
    for run in data["runs"]:
        last = run["points"][-1]
        found.setdefault(run["software"], []).append(last["steps"] / last["seconds"])
    return {software: median(rates) for software, rates in found.items()}


def fresh_actors(data: Line) -> str:
    """Return what ours has before it learns, and so which times are those of its start."""
    first = [run["points"][0] for run in data["runs"] if run["software"] == OURS]
    before = [point["reward"] / data["bar"] for point in first if point["steps"] == 0]
    prior = (
        "Fresh actors of ours follow the route that monitors observe, and take the moves that they see to be worth\n"
        "most; those of the peers have to learn that."
    )
    if not before:
        return prior
    return (
        f"{prior} So ours has {median(before):.0%} of the {BAR}'s reward before it\n"
        "learns anything, and its times for smaller parts are those of its start."
    )


def page(data: Line) -> str:
    """Return the results as Markdown."""
    rows = []
    for row in summary(data):
        more = "" if row["reached"] == row["seeds"] else "> "
        part = f"{row['share']:.0%} ({row['share'] * data['bar']:.0f})"
        seconds = f"{more}{row['seconds']:.0f} ({row['least']:.0f} to {row['most']:.0f})"
        times = "-" if row["times"] is None else f"{more}{row['times']:.1f}"
        rows.append([part, row["software"], f"{row['reached']} of {row['seeds']}", seconds, times])
    best = {
        software: max(point["reward"] for run in data["runs"] if run["software"] == software for point in run["points"])
        for software in dict.fromkeys(run["software"] for run in data["runs"])
    }
    head = [f"part of the {BAR}'s reward", "program", "seeds that reached it", "seconds: median (range)", "times ours"]
    made = (
        f"`{data['command']}`, commit {data['commit']}: seconds from the command until a policy, flown without\n"
        f"noise on farms {FARMS[0]}..{FARMS[-1]}, earns a part of the {BAR}'s {data['bar']:.0f} per agent.\n"
        f"{data['cores']} cores. Ours is `eia-sec train`, the preset instant; the peers train on the same farm as a\n"
        "PettingZoo environment, with the same observations, discrete moves, widths, rate, discount and clip range;\n"
        f"their iterations are shorter ({PEER_SETTINGS['iteration']:,} steps, {PEER_SETTINGS['epochs']} epochs), "
        f"because their environments are slower.\n{fresh_actors(data)}\n"
        "AgileRL sees each type as one agent in as many environments as there are UAVs of it, because it learns\n"
        "nothing from groups of agents (`research/LOG.md`). Ours is ended after "
        f"{data['seconds']:.0f} s, a peer after {data['limit']:.0f} s\n"
        f"of training. It is looked at after every {data['every']:g} s, and later after every tenth more time, so its\n"
        "times are late by a tenth at most from then on.\n"
    )
    rates = ", ".join(f"{software} {rate:,.0f}" for software, rate in steps_per_second(data).items())
    seen = ", ".join(f"{software} {reward:.0f}" for software, reward in best.items())
    lines = [f"# Time to the {BAR}'s reward", "", made, *table(head, rows, 2), ""]
    lines += [f"Environment steps a second that each learned from, to its last look: {rates}.", ""]
    lines += [f"The best reward that anybody saw of each: {seen}.", "", "![Curves](curves.png)", ""]
    return "\n".join(lines)


def picture(data: Line) -> Figure:
    """Return the reward without noise against the seconds of training: a line for each seed, beside ours."""
    names = list(dict.fromkeys(run["software"] for run in data["runs"]))
    algorithms = list(dict.fromkeys(name.rpartition(" ")[2] for name in names if name != OURS))
    figure = Figure(figsize=(WIDTH, 4.1), layout="constrained")
    panels = figure.subplots(1, len(algorithms), sharex=True, sharey=True, squeeze=False)[0]
    for axes, algorithm in zip(panels, algorithms, strict=True):
        for run in data["runs"]:
            software, _, learned = run["software"].rpartition(" ")
            if run["software"] == OURS or learned == algorithm:
                seconds, reward = zip(*((point["seconds"], point["reward"]) for point in run["points"]), strict=True)
                style = program_look(software or OURS)
                axes.plot(
                    seconds, reward, label=software or f"{OURS}, {PRESET}", markersize=4.5, markevery=0.08, **style
                )
        axes.axhline(data["bar"], label=f"{BAR}, a heuristic", **LEVEL)
        # Fresh policies of some peers fly out of the field and would take most of the picture.
        axes.set(
            xscale="log",
            ylim=(LEAST_SHARE * data["bar"], 1.06 * data["bar"]),
            xlabel="seconds since the command, logarithmic",
        )
        axes.xaxis.set_major_formatter("{x:g}")
        axes.set_title(algorithm, fontsize=10)
        bare(axes)
    panels[0].set_ylabel("reward per agent and episode")
    legend_below(figure, panels, 4)
    heading(
        figure,
        f"Without noise on farms {FARMS[0]}..{FARMS[-1]}; a line for each seed.\n"
        f"{OURS} trains its preset {PRESET}, which is IPPO, and is the same in all panels.",
    )
    return figure


def options(arguments: Sequence[str] | None = None) -> argparse.Namespace:
    """Return the command line."""
    parser = argparse.ArgumentParser(
        prog="python -m research.benchmarks.peers.reach", description=(__doc__ or "").partition("\n")[0]
    )
    parser.add_argument("--json", action="store_true", help="print JSON instead of a table")
    parser.add_argument("--write", type=Path, metavar="FOLDER", help="write data, page and picture here")
    parser.add_argument("--redraw", action="store_true", help="with --write: only page and picture, from results.json")
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--seconds", type=float, default=400.0, help="time that ours gets")
    parser.add_argument("--limit", type=float, default=600.0, help="time that a peer gets")
    parser.add_argument(
        "--every", type=float, default=5.0, help="least seconds of training between two looks at a peer"
    )
    parser.add_argument("--only", nargs="+", metavar="NAME", help="only these peers")
    parser.add_argument("--venvs", type=Path, default=ROOT / "research" / "benchmarks" / ".venvs")
    parser.add_argument("--pip-args", default="", help="added to pip install")
    return parser.parse_args(arguments)


def write(data: Line, folder: Path) -> None:
    """Write data, page and picture."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "results.json").write_text(json.dumps(data, indent=1) + "\n", encoding="utf-8")
    show(data, folder)


def show(data: Line, folder: Path) -> None:
    """Write page and picture."""
    (folder / "README.md").write_text(page(data), encoding="utf-8")
    picture(data).savefig(folder / "curves.png", dpi=DPI)


def measure() -> int:
    """Train everything in turn, seed by seed, and write after each seed what is there; print it and return 0."""
    asked = options()
    if asked.redraw:
        if not asked.write or not (asked.write / "results.json").is_file():
            raise UsageError("--redraw needs --write FOLDER with a results.json in it.")
        show(json.loads((asked.write / "results.json").read_text(encoding="utf-8")), asked.write)
        return 0
    peers = [program for program in PEERS if not asked.only or program.name in asked.only]
    for program in peers:
        provide(program, asked.venvs, asked.pip_args)
    bar = reward_of(policy_of(BAR, PRESETS[PRESET].farm), FARMS)
    runs: list[Line] = []
    data = {
        **provenance("research.benchmarks.peers.reach"),
        **{"cores": allowed_cores(), "bar": bar, "seconds": asked.seconds, "limit": asked.limit, "every": asked.every},
        "runs": runs,
    }
    for seed in range(asked.seeds):
        found: list[Line] = [{"software": OURS, "seed": seed, **run_ours(seed, asked.seconds)}]
        for program in peers:
            found.append({"software": program.name, "seed": seed, **run_peer(program, seed, bar, asked)})
            sys.stderr.write(f"{program.name}, seed {seed}: {found[-1]['points'][-1]}\n")
        runs.extend(found)
        if asked.write:
            write(data, asked.write)
    sys.stdout.write(json.dumps(summary(data), indent=1) + "\n" if asked.json else page(data))
    return 0


if __name__ == "__main__":
    sys.exit(run_command(measure))
