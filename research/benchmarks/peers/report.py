"""A session's result as Markdown and as a picture."""

from collections.abc import Callable, Sequence
from typing import Any, Final

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from eia_sec.deploy.reports.plots import TEXT, bare
from research.benchmarks.peers.clock import BURST
from research.benchmarks.peers.summary import OURS, PEER_AIMS, cores, learner_aims
from research.looks import WIDTH, heading, legend_below, program_look

Line = dict[str, Any]
MARKS: Final = ("<!-- peers:begin -->", "<!-- peers:end -->")


def table(head: Sequence[str], rows: Sequence[Sequence[str]], text_columns: int) -> list[str]:
    """Return a Markdown table whose first columns are text and whose others are numbers."""
    rule = ["---" if column < text_columns else "---:" for column in range(len(head))]
    return [f"| {' | '.join(cells)} |" for cells in (head, rule, *rows)]


def place(line: Line) -> str:
    """Return on what a simulator ran, as words."""
    parts = [(line["processes"], "process", "processes"), (line["threads"], "thread", "threads")]
    said = [f"{count} {one if count == 1 else many}" for count, one, many in parts if count > 1]
    return " x ".join(said) or "1 thread"


def simulator_tables(data: dict[str, Any]) -> list[str]:
    """Return the simulators' rates and our ratios to them."""
    rows = [
        [
            line["software"],
            line["case"],
            str(line["agents"]),
            f"{line['environments']:,}",
            place(line),
            f"{line['best']:,.0f}",
            f"{line['median']:,.0f}",
            f"{line['best'] * line['agents']:,.0f}",
        ]
        for line in sorted(data["simulator"], key=cores)
    ]
    head = ["simulator", "world", "agents", "environments", "on", "env steps/s, best", "median", "agent steps/s, best"]
    ratios = [
        [
            str(line["cores"]),
            f"{line['peer']}, {line['peer_agents']} agents, {line['peer_environments']:,} environments",
            f"{line['ratio']:,.1f}",
            f"{line['median_ratio']:,.1f}",
        ]
        for line in data["simulator_ratios"]
    ]
    columns = ["cores", "against, each at its best batch", "ours is times as fast, best", "median"]
    return ["### Simulator", "", *table(head, rows, 3), "", *table(columns, ratios, 2), ""]


def counterpart(line: Line, lines: Sequence[Line]) -> Line | None:
    """Return our line that does the same work as a peer's, or None."""
    same = {
        other["algorithm"].lower(): other
        for other in lines
        if other["software"] == OURS and (other["width"], other["threads"]) == (line["width"], line["threads"])
    }
    return same.get(line["algorithm"].lower())


def learner_tables(data: dict[str, Any]) -> list[str]:
    """Return the learners' times, the limit of ours, and the ratio to our counterpart."""
    rows = []
    for line in sorted(data["learner"], key=lambda line: (line["threads"], line["width"])):
        ours = counterpart(line, data["learner"]) if line["software"] != OURS else None
        rows.append(
            [
                line["software"],
                ", ".join(part for part in (line["algorithm"], line["form"]) if part),
                str(line["threads"]),
                str(line["width"]),
                f"{line['best']:.2f}",
                f"{line['median']:.2f}",
                f"{line['limit_ms']:.2f}" if "limit_ms" in line else "",
                f"{line['best'] / ours['best']:.1f} x {ours['algorithm']}" if ours else "",
            ]
        )
    head = ["learner", "algorithm", "threads", "width", "ms, best", "median", "limit, ms", "against ours"]
    return ["### Learner", "", *burst_note(data["learner"]), *table(head, rows, 2), "", *aims_table(data["learner"])]


def burst_note(lines: Sequence[Line]) -> list[str]:
    """Return what is to be said of results that were made before the bursts of ours were written down."""
    if all("burst" in line for line in lines if line["software"] == OURS):
        return []
    return [
        f"Here EIA-SEC's values are of its fastest single update (MATD3's of {BURST}), the others' of their fastest",
        f"{BURST}, which favours EIA-SEC: this was measured before ours were timed in bursts of {BURST}, too.",
        "",
    ]


def aims_table(lines: list[Line]) -> list[str]:
    """Return what was aimed for beside what was measured, a row for each number of threads and width."""
    cells: dict[tuple[int, int], dict[str, str]] = {}
    for line in sorted(learner_aims(lines), key=lambda line: (line["threads"], line["width"])):
        cells.setdefault((line["threads"], line["width"]), {})[line["against"]] = _aimed(line)
    if not cells:
        return []
    peers = [name for name in PEER_AIMS if any(name in row for row in cells.values())]
    rows = [
        [str(threads), str(width), *(row.get(name, "") for name in (*peers, "limit"))]
        for (threads, width), row in cells.items()
    ]
    head = ["threads", "width", *(f"{name}, at least {PEER_AIMS[name]:g} x" for name in peers), "EIA-SEC by its limit"]
    return [
        "### What we aimed for",
        "",
        "A peer's update, in its fastest form, by ours of the same algorithm, and EIA-SEC's update by its limit, from",
        "the best values above. With several algorithms an aim is met where each of them reaches it.",
        "",
        *table(head, rows, len(head)),
        "",
    ]


def _aimed(line: Line) -> str:
    """Return the verdict on one aim, with what was measured."""
    if line["against"] != "limit":
        ratio = ", ".join(f"{value:.2f} ({name})" for name, value in line["ratios"].items())
    elif line["aim"] is None:
        return f"{line['ratios']['eia-sec']:.2f}, no aim"
    else:
        ratio = f"{line['ratios']['eia-sec']:.2f}, at most {line['aim']:g}"
    return f"{'met' if line['met'] else 'not met'}: {ratio}"


def block(data: dict[str, Any]) -> str:
    """Return the generated part of the page, without its marks."""
    machine = data["machine"]
    versions = ", ".join(f"{name} {number}" for name, number in sorted(data["versions"].items()))
    load = f"{machine['load_before']:.1f} before, {machine['load_after']:.1f} after"
    plan = data["plan"]
    sizes = f"{plan['repeats']} repeats, {plan['seconds']:g} s for each case of a simulator, {plan['updates']} updates"
    lines = [
        f"`{data['command']}`, commit {data['commit']}: {sizes} for each of a learner.",
        f"{machine['processor']}, {machine['cores']} cores, load average {load}; Python {data['python']},",
        f"{versions}.",
        "",
        *(f"Failed: {failure}" for failure in data["failures"]),
    ]
    lines += simulator_tables(data) if data["simulator"] else []
    lines += learner_tables(data) if data["learner"] else []
    return "\n".join(lines) + "\n![Side by side](peers.png)\n"


def refreshed(text: str, data: dict[str, Any]) -> str:
    """Return the page with its generated part written anew."""
    head, _, rest = text.partition(MARKS[0])
    _, _, tail = rest.partition(MARKS[1])
    return f"{head}{MARKS[0]}\n{block(data)}{MARKS[1]}{tail}"


def figure(data: dict[str, Any]) -> Figure:
    """Return the picture of both subjects on one core, as far as they were measured.

    Learners have a panel for each algorithm, in which programs are compared.
    """
    simulators, learners = ([line for line in data[name] if cores(line) == 1] for name in ("simulator", "learner"))
    algorithms = list(dict.fromkeys(_learned(line) for line in learners))
    rows = -(-len(algorithms) // 2)
    drawn = Figure(figsize=(WIDTH, 3.6 * bool(simulators) + 2.4 * rows + 1.2), layout="constrained")
    grid = drawn.add_gridspec(bool(simulators) + rows, 2, height_ratios=[1.2] * bool(simulators) + [1.0] * rows)
    if simulators:
        axes = drawn.add_subplot(grid[0, :])
        _simulators(axes, simulators)
        axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.24), ncols=2, handlelength=3.2, frameon=False, **TEXT)
    panels: list[Axes] = []
    for panel, algorithm in enumerate(algorithms):
        shared = panels[0] if panels else None
        panels.append(drawn.add_subplot(grid[bool(simulators) + panel // 2, panel % 2], sharex=shared, sharey=shared))
        _learners(panels[-1], [line for line in learners if _learned(line) == algorithm])
        panels[-1].set_title(f"learners, {algorithm}: lower is better", fontsize=10)
    for axes in panels[::2]:
        axes.set_ylabel("ms per update,\nlogarithmic")
    for axes in panels[-2:]:
        axes.set_xlabel("width of both hidden layers,\nlogarithmic")
    if panels:
        legend_below(drawn, panels, 3)
    heading(
        drawn,
        f"One thread of {data['machine']['processor']}; best of {data['plan']['repeats']} interleaved repeats.\n"
        "Simulators: a step is one of all agents of one environment, and the worlds differ.\n"
        "Learners: one gradient step of every one of 12 agents, batch 128, replay sampling included.",
    )
    return drawn


def _learned(line: Line) -> str:
    """Return the algorithm in whose panel a learner's line stands."""
    name = line["algorithm"].upper()
    return OURS if name == "BASE" else name


def _simulators(axes: Axes, lines: list[Line]) -> None:
    drawn: set[str] = set()
    for label, points in _by_label(lines, lambda line: f"{line['software']}: {line['case']}, {line['agents']} agents"):
        software = points[0]["software"]
        # The same program in another world has hollow marks.
        hollow = {"markerfacecolor": "white"} if software in drawn else {}
        drawn.add(software)
        _line(axes, points, "environments", label, program_look(software) | hollow)
    _ticks(axes, lines, "environments")
    axes.set_xlabel("environments in the batch, logarithmic")
    axes.set_ylabel("environment steps a second,\nlogarithmic")
    axes.set_title("simulators: higher is better", fontsize=10)


def _learners(axes: Axes, lines: list[Line]) -> None:
    for label, points in _by_label(lines, _program):
        form = "base" if points[0]["algorithm"] == "base" else points[0]["form"]
        _line(axes, points, "width", label, program_look(points[0]["software"], form))
    _ticks(axes, lines, "width")
    axes.yaxis.set_major_formatter("{x:g}")


def _program(line: Line) -> str:
    """Return a learner's program and form, as the legend calls them."""
    form = "base: no ensemble" if line["algorithm"] == "base" else line["form"]
    return ", ".join(part for part in (line["software"], form) if part)


def _by_label(lines: list[Line], label: Callable[[Line], str]) -> list[tuple[str, list[Line]]]:
    curves: dict[str, list[Line]] = {}
    for line in lines:
        curves.setdefault(label(line), []).append(line)
    return list(curves.items())


def _line(axes: Axes, points: list[Line], across: str, label: str, style: dict[str, Any]) -> None:
    points.sort(key=lambda line: line[across])
    axes.plot([p[across] for p in points], [p["best"] for p in points], label=label, markersize=5.5, **style)


def _ticks(axes: Axes, lines: list[Line], across: str) -> None:
    axes.set_xscale("log", base=2)
    axes.set_yscale("log")
    ticks = sorted({line[across] for line in lines})
    axes.set_xticks(ticks, [f"{tick:,}" for tick in ticks])
    bare(axes)
