"""The simulator's speed as a page: a table, and a picture of how the cost of a step grows."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

from matplotlib.figure import Figure

from eia_sec.deploy.reports.plots import DPI, OTHER_COLOURS, bare
from eia_sec.deploy.reports.provenance import provenance
from research.looks import LEVEL, WIDTH, heading, legend_below

AXES: Final = {
    "uavs": ("UAVs", "on the default field, a third of each type"),
    "sensors": ("sensors", "denser on the default field"),
    "sensors_on_a_growing_field": ("sensors", "as dense, on a growing field"),
    "plots": ("plots", "smaller on the default field"),
}
"""What each growth measurement varies, and how."""


def rows(found: Mapping[str, Any]) -> list[tuple[str, str]]:
    """Return the lines of the table: what, and how much."""
    machine, farm = found["machine"], found["farm"]
    lines = [
        ("processor", f"{machine['processor']}, {machine['cores']} cores, numba {machine['numba']}"),
        ("farm", f"{farm['uavs']} UAVs, {farm['sensors']} sensors, {farm['plots']} plots"),
    ]
    for size, speed in found["by_batch"].items():
        rate, us, tenth = (speed[key] for key in ("env_steps_per_second_per_core", "cpu_us", "fastest_tenth_us"))
        text = (
            f"{rate:,} steps a second of one core ({us:.2f} us a step; {tenth:.2f} in the fastest tenth of the calls)"
        )
        lines.append((f"batch of {size}", text))
    lines += [
        ("one environment, one call", f"{found['single_step_us']:.1f} us"),
        ("NumPy reference", f"{found['reference_steps_per_second']:,.0f} steps a second"),
        ("fastest batch over the reference", f"{found['reference_ratio']:,.0f} times"),
    ]
    threads = found["threads"]
    for count, us in threads["wall_us"].items():
        lines.append((f"{threads['environments']} environments on {count} threads", f"{us:.2f} us a step, wall time"))
    lines.append(("same results with 1 and 2 threads", "yes" if threads["same_results"] else "NO"))
    if "compile_seconds" in found:
        seconds = found["compile_seconds"]
        lines.append(("first farm in a new process", f"{seconds['first']:.0f} s, cached {seconds['cached']:.1f} s"))
    return lines


def switch_rows(switches: Mapping[str, Any]) -> list[tuple[str, str]]:
    """Return how fast the simulator is by what is switched on."""
    return [
        (name, f"{1e6 / us:,.0f} steps a second of one core ({us:.2f} us a step)")
        for name, us in switches["us_per_step"].items()
    ]


def table(found: Mapping[str, Any]) -> str:
    """Return the results as text."""
    lines = rows(found)
    if "switches" in found:
        lines += [(f"switched on: {name}", text) for name, text in switch_rows(found["switches"])]
    for name, points in found.get("scaling", {}).items():
        what, how = AXES[name]
        text = ", ".join(f"{point['value']}: {point['us_per_step']:.1f}" for point in points)
        lines.append((f"us a step by {what} ({how})", text))
    for name, us in found.get("parts_us", {}).items():
        lines.append((f"stage {name}", f"{us:.2f} us"))
    width = max(len(name) for name, _ in lines)
    return "".join(f"{name:{width}}  {text}\n" for name, text in lines)


def growth_figure(scaling: Mapping[str, Any]) -> Figure:
    """Return the picture: the cost of a step against each size, beside a line that would be proportional."""
    rows = -(-len(scaling) // 2)
    figure = Figure(figsize=(WIDTH, 2.6 * rows + 0.8), layout="constrained")
    panels = figure.subplots(rows, 2, sharey=True, squeeze=False)
    costs = [point["us_per_step"] for points in scaling.values() for point in points]
    for axes, (name, points) in zip(panels.flat, scaling.items(), strict=False):
        value, us = [p["value"] for p in points], [p["us_per_step"] for p in points]
        axes.loglog(value, us, "o-", color=OTHER_COLOURS[0], markersize=5, label="measured")
        axes.loglog(value, [us[0] * v / value[0] for v in value], label="proportional to the size", **LEVEL)
        what, how = AXES[name]
        axes.set_xlabel(f"{what}, logarithmic")
        axes.set_title(f"{what}: {how}", fontsize=9.5)
        axes.set_xticks(value, [f"{v:,}" for v in value], fontsize=8)
        axes.minorticks_off()
        axes.set_ylim(min(costs) / 2, max(costs) * 2)
        axes.yaxis.set_major_formatter("{x:g}")
        bare(axes)
    for axes in panels[:, 0]:
        axes.set_ylabel("microseconds a step,\nlogarithmic")
    for axes in list(panels.flat)[len(scaling) :]:
        axes.remove()
    legend_below(figure, panels.flat, 2)
    heading(figure, "A step of one farm in the compiled simulator, one size growing: time of one core, batches of 8.")
    return figure


def growth_table(scaling: Mapping[str, Any]) -> list[str]:
    """Return the growth as Markdown: microseconds a step at each size."""
    lines = []
    for name, points in scaling.items():
        what, how = AXES[name]
        costs = ["us a step", *(f"{point['us_per_step']:.1f}" for point in points)]
        sizes = [f"{what}, {how}", *(f"{point['value']:,}" for point in points)]
        lines += [f"| {' | '.join(sizes)} |", "|---|" + "---:|" * len(points), f"| {' | '.join(costs)} |", ""]
    return lines


def write(found: Mapping[str, Any], folder: Path) -> None:
    """Write simulator.json, README.md and, if growth was measured, growth.png."""
    folder.mkdir(parents=True, exist_ok=True)
    data = {**provenance("research.benchmarks.simulator"), **found}
    (folder / "simulator.json").write_text(json.dumps(data, indent=2) + "\n")
    show(data, folder)


def show(found: Mapping[str, Any], folder: Path) -> None:
    """Write the page and the picture of what simulator.json holds."""
    page = ["# Speed of the simulator", "", f"`{found['command']}`, commit {found['commit']}", ""]
    page += ["| what | measured |", "|---|---|", *(f"| {name} | {text} |" for name, text in rows(found)), ""]
    if "switches" in found:
        size = found["switches"]["environments"]
        page += [
            f"With conditions of the preset `field` and what UAVs observe of them, in batches of {size}.",
            "No battery runs out, because UAVs that are gone would cost nothing, and no autopilots fly:",
            "",
        ]
        page += ["| switched on | measured |", "|---|---|"]
        page += [f"| {name} | {text} |" for name, text in switch_rows(found["switches"])] + [""]
    if "scaling" in found:
        growth_figure(found["scaling"]).savefig(folder / "growth.png", dpi=DPI)
        page += ["![The cost of a step against UAVs, sensors and plots](growth.png)", ""]
        page += growth_table(found["scaling"])
    if "parts_us" in found:
        page += ["| stage of a step | us |", "|---|---|"]
        page += [f"| {name.replace('_', ' ')} | {us:.2f} |" for name, us in found["parts_us"].items()] + [""]
    (folder / "README.md").write_text("\n".join(page))
