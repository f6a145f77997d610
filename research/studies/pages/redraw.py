"""Writes a study's data, pictures and page again without a single run (`python -m research.studies STUDY --redraw`)."""

import json
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from eia_sec.common.errors import RunDirError, UsageError
from research.studies.analysis.summary import DIGITS, reference_summary, times_summary
from research.studies.bench import Bench
from research.studies.pages.plots import RESULTS
from research.studies.reproduce import Plan, save, write
from research.studies.scales import FIRST_FARM

Results = dict[str, Any]


def redraw(plan: Plan) -> None:
    """Write a study's files again without doing any run.

    From its records where all are there. Otherwise its results stay what they are, but for what they or the records
    allow to sum up anew: times, of which results hold every seed's, and policies that learn nothing.

    Raises:
        UsageError: there are neither all records nor results.
        RunDirError: the results cannot be read or written.
    """
    missing, path = plan.missing(), plan.folder / RESULTS
    if not missing:
        write(plan)
        return
    if not path.is_file():
        raise UsageError(f"{plan.study}: {len(missing)} runs are missing, and there is no {path} to write from.")
    try:
        data = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise RunDirError(f"{path} cannot be read: {error}.") from None
    plan.report(f"{plan.study}: {len(missing)} runs are missing; written again from {path} alone.")
    summed_anew(data, plan.bench)
    save(plan, data)


def summed_anew(data: Results, bench: Bench) -> None:
    """Sum up anew what the results of a study hold of each seed, and what the records still hold of it."""
    for team in data.get("teams", {}).values():
        team.update({"time": _times(team["time"])} if "time" in team else _times(team))
    if data["study"] == "inference":
        data["methods"] = {name: _times(times) for name, times in data["methods"].items()}
    elif "methods" in data:
        _references(data, bench)


def _times(times: Mapping[str, Any]) -> Results:
    return times_summary(times["seeds"], times["commits"])


def _references(data: Results, bench: Bench) -> None:
    """Put policies that learn nothing into results by the statistic of the methods, over the very farms of these.

    Their records have to be those of the results, by their jobs. The scale's ends move with them; as an interquartile
    mean and the ends of its interval follow every change of scale, the methods' normalised scores follow from rewards.
    """
    farms = replace(bench.scale, left_out=data["sizes"].get("first_farm", FIRST_FARM) - FIRST_FARM)
    whole = Bench(farms, bench.records)
    if bench.records.missing(whole.references()):
        return
    found, held = reference_summary(whole), data["references"]["policies"]
    if {name: policy["job"] for name, policy in found["policies"].items()} != {n: p["job"] for n, p in held.items()}:
        return
    data["references"] = found
    low, high = (found["policies"][name]["reward"] for name in ("random", found["best"]))
    for method in data["methods"].values():
        method["normalised"] = [round((reward - low) / (high - low), DIGITS) for reward in method["reward"]]
