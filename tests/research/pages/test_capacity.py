"""The capacity model against hand-made measurements, and the command that prints it."""

import json
import re
import subprocess
import sys
from pathlib import Path

import pytest

from eia_sec.common.config.presets import preset
from eia_sec.common.errors import ConfigError
from eia_sec.common.farm import farm_team
from research.pages import capacity
from research.pages.capacity import DIRECT, ROUTED, Measured, Plan

ROOT = Path(__file__).resolve().parents[3]
# A chunk takes 1 ms and 1 us for each KB; a step is 1,000 bytes, 100 us of a worker's core and 50 us of the learner's.
KB, MB = 131_072, 1_048_576
RATE = {size: size / (1e-3 + size / 1e9) / 1e6 for size in (KB, MB)}
CASE = {str(size): {"env_steps_per_second": rate * 1e3, "mb_per_second": rate} for size, rate in RATE.items()}
MEASURED = Measured(100.0, 50.0, 1000.0, dict.fromkeys((*DIRECT.values(), ROUTED), CASE), ())


def test_the_time_of_a_chunk_is_a_line_through_two_sizes():
    """At the measured sizes the measured rates come out, and elsewhere those of the line."""
    for size, rate in RATE.items():
        assert MEASURED.intake_rate(ROUTED, size) == pytest.approx(rate * 1e3)
    assert MEASURED.intake_rate(ROUTED, 200_000) == pytest.approx(200 / 1.2e-3)


def test_each_part_saturates_where_its_arithmetic_says():
    """The learner at its microseconds a step, links at bytes, workers at their number, parameters once an iteration."""
    plan = Plan(workers=3, environments=16, chunk_steps=10, iteration_steps=16_000, link_gbit=0.8, round_trip_ms=1e-6)
    found = capacity.saturation(plan, MEASURED)
    assert found["learner's updates"] == pytest.approx(20_000.0)
    assert found["link, transitions in"] == pytest.approx(1e8 / 1000.0)
    assert found["workers"] == pytest.approx(30_000.0)
    assert found["intake, TCP"] == pytest.approx(160 / 1.16e-3)
    published = capacity.parameter_bytes(preset("instant").on_policy, farm_team(preset("instant").farm))
    assert found["link, parameters out"] == pytest.approx(1e8 / (3 * published) * 16_000)
    faster = capacity.saturation(Plan(update_us=20.0, collect_us=50.0, round_trip_ms=1e-6), MEASURED)
    assert faster["learner's updates"] == pytest.approx(50_000.0)
    assert faster["workers"] == pytest.approx(20_000.0)


def test_steps_and_distance_bound_one_worker():
    """Its environments step one after another in what they compute, and together in the time that their step takes."""
    near = {"environments": 2, "chunk_steps": 10, "round_trip_ms": 1e-6}
    assert capacity.worker_rate(Plan(**near), MEASURED) == pytest.approx(10_000.0)
    assert capacity.worker_rate(Plan(**near, step_ms=20.0), MEASURED) == pytest.approx(20 / (2e-3 + 0.2))
    far = Plan(environments=2, chunk_steps=10, round_trip_ms=18.0)
    assert capacity.worker_rate(far, MEASURED) == pytest.approx(1_000.0)


def command(*arguments: str) -> "subprocess.CompletedProcess[str]":
    line = [sys.executable, "-m", "research.pages.capacity", *arguments]
    return subprocess.run(line, capture_output=True, text=True, check=False)


@pytest.mark.parametrize(("option", "value"), [("--workers", "0"), ("--link-gbit", "-1"), ("--update-us", "nan")])
def test_an_impossible_plan_is_one_sentence(option, value):
    """A value that cannot be ends with exit code 2."""
    done = command(option, value)
    assert (done.returncode, len(done.stderr.splitlines())) == (2, 1)


def test_measurements_of_another_team_are_refused():
    """Bytes of a step and times of an update follow from the team; a result that is older than it is named."""
    sources = [json.loads((ROOT / source).read_text()) for source in capacity.SOURCES[:2]]
    assert Measured.of(*sources).step_bytes > 0
    for number, source in enumerate(sources):
        for of_another in ({**source, "team": "0" * 16}, {name: source[name] for name in source if name != "team"}):
            others = [of_another if n == number else s for n, s in enumerate(sources)]
            with pytest.raises(ConfigError, match=re.escape(source["command"])):
                Measured.of(*others)
