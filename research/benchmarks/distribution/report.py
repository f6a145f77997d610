"""The results as a page and as a picture."""

from pathlib import Path
from typing import Any, Final

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from eia_sec.deploy.reports.plots import TEXT, bare
from research.benchmarks.distribution.summary import summary
from research.benchmarks.peers.report import table
from research.looks import LEVEL, WIDTH, heading, numbered_looks

Line = dict[str, Any]
TEMPLATE: Final = Path(__file__).with_name("page.md")


def page(data: Line) -> str:
    """Return the results as Markdown."""
    task, lines = data["task"], summary(data["runs"])
    loads = [run["load"] for run in data["runs"]]
    return TEMPLATE.read_text(encoding="utf-8").format(
        **task,
        **{name: data[name] for name in ("command", "commit", "cores")},
        seeds=max(line["seeds"] for line in lines),
        step_ms=f"{1000 * task['period']:.0f}",
        least_load=f"{min(loads):.1f}",
        most_load=f"{max(loads):.1f}",
        nice="" if not data["nice"] else f" Its processes had the priority (nice) {data['nice']}.",
        times="\n".join(times(lines)),
        where="\n".join(where(lines)),
        farm="\n".join(farm(data["farm"])),
    )


def times(lines: list[Line]) -> list[str]:
    """Return the table of times and speed-ups."""
    head = ["workers", "seconds to the reward", "from launch, s", "speed-up", "efficiency", "env steps/s", "env steps"]
    rows = []
    for line in lines:
        bound = "" if line["reached"] == line["seeds"] else "> "
        spread = f" ({line['least']:.0f} to {line['most']:.0f})" if line["seeds"] > 1 else ""
        shares = ["-", "-"] if line["speedup"] is None else [f"{line['speedup']:.1f}", f"{line['efficiency']:.0%}"]
        row = [str(line["workers"]), f"{bound}{line['seconds']:.0f}{spread}", f"{line['seconds_from_launch']:.0f}"]
        rows.append([*row, *shares, f"{line['steps_per_second']:,.0f}", f"{line['environment_steps']:,.0f}"])
    return table(head, rows, 0)


def where(lines: list[Line]) -> list[str]:
    """Return the table of where the time goes."""
    head = ["workers", "learner updates", "an update, ms", "workers wait", "steps discarded as stale"]
    return table(head, [[str(line["workers"]), *_shares(line)] for line in lines], 0)


def farm(lines: list[Line]) -> list[str]:
    """Return the table of the preset instant on the same cores."""
    shares = ["learner updates", "an update, ms", "workers wait", "steps discarded as stale"]
    head = ["workers", "env steps/s", *shares, "load"]
    rows = [
        [str(line["workers"]), f"{line['steps_per_second']:,.0f}", *_shares(line), f"{line['load']:.1f}"]
        for line in lines
    ]
    return table(head, rows, 0)


def _shares(line: Line) -> list[str]:
    updating, waiting, rejected = (
        f"{line[name]:.1%}" for name in ("learner_updating", "workers_waiting", "rejected_share")
    )
    return [updating, f"{line['update_ms']:.1f}", waiting, rejected]


def picture(data: Line) -> Figure:
    """Return speed-up against workers, and the reward of the first seed against time."""
    figure = Figure(figsize=(WIDTH, 4.7), layout="constrained")
    left, right = figure.subplots(1, 2)
    _speedup(left, summary(data["runs"]))
    _curves(right, data)
    for axes, columns in ((left, 1), (right, 2)):
        bare(axes)
        axes.legend(
            loc="upper center", bbox_to_anchor=(0.5, -0.22), ncols=columns, handlelength=3.2, frameon=False, **TEXT
        )
    task = data["task"]
    heading(
        figure,
        f"IPPO on MPE's simple_line, whose steps take {1000 * task['period']:.0f} ms, until the mean reward of "
        f"{task['window']} episodes is {task['reward']:g}.",
    )
    return figure


def _named(workers: int) -> str:
    return f"{workers} worker{'s' if workers > 1 else ''}"


def _speedup(axes: Axes, lines: list[Line]) -> None:
    workers = [line["workers"] for line in lines]
    axes.plot(workers, workers, label="as many times as workers", **LEVEL)
    for name, label, style in (
        ("speedup", "time to the reward", {"color": "0.0", "marker": "o", "linestyle": "-"}),
        ("steps_speedup", "environment steps a second", {"color": "0.45", "marker": "s", "linestyle": ":"}),
    ):
        known = [line for line in lines if line[name] is not None]
        axes.plot([line["workers"] for line in known], [line[name] for line in known], label=label, **style)
    axes.set(
        xscale="log", yscale="log", xlabel="workers, logarithmic", ylabel="times as fast as one worker, logarithmic"
    )
    axes.set_xticks(workers, labels=[str(number) for number in workers])
    axes.set_yticks(workers, labels=[str(number) for number in workers])
    axes.minorticks_off()
    seeds = max(line["seeds"] for line in lines)
    axes.set_title(f"speed-up, {f'median of {seeds} seeds' if seeds > 1 else '1 seed'}", fontsize=10)


def _curves(axes: Axes, data: Line) -> None:
    numbers = sorted({run["workers"] for run in data["runs"]})
    for workers, style in zip(numbers, numbered_looks(len(numbers)), strict=True):
        run = next(run for run in data["runs"] if run["workers"] == workers)
        seconds, _, reward = zip(*run["curve"], strict=True)
        axes.plot(seconds, reward, label=_named(workers), **style)
    axes.axhline(data["task"]["reward"], label="the fixed reward", **LEVEL)
    axes.set(
        xscale="log", xlabel="seconds since the first transition,\nlogarithmic", ylabel="reward per agent and episode"
    )
    axes.xaxis.set_major_formatter("{x:g}")
    axes.set_title(f"while training, seed {data['runs'][0]['seed']}", fontsize=10)
