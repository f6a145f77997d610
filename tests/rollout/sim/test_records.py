"""Records that compiled code takes, and what recompiles it."""

import subprocess
import sys
from typing import Annotated, NamedTuple

import numpy as np
import pytest

from eia_sec.common import farm_observation
from eia_sec.common.actions import lattice as formula
from eia_sec.common.config.farm import BatteryConfig, StressConfig
from eia_sec.rollout.sim.core import lattice
from eia_sec.rollout.sim.core.compile import allocation_free, sources_digest
from eia_sec.rollout.sim.core.records import Array, Int32, make_record, numbers, row_maker
from tests.constants import with_constants

SCRIPT = """
from eia_sec.common.config.farm import StressConfig
from eia_sec.rollout.sim.core.compile import compiled_entry
from eia_sec.rollout.sim.core.records import numbers

@compiled_entry
def radius(stress):
    return stress.radius

print(radius(numbers(StressConfig())), sum(radius.stats.cache_hits.values()))
"""


class Example(NamedTuple):
    """Two arrays."""

    place: Annotated[Array, "n 2", "m"]
    first: Annotated[Int32, "cells+1", "first of each cell"]


def test_arrays_have_the_declared_type_and_axes():
    """Names, numbers and sums of both are axes, after those that lead."""
    made = make_record(Example, {"n": 3, "cells": 4}, (7,))
    assert (made.place.shape, made.place.dtype) == ((7, 3, 2), np.float64)
    assert (made.first.shape, made.first.dtype) == ((7, 5), np.int32)


def test_a_row_holds_views():
    """A compiled function that writes to a row of a record writes to the record."""
    row = row_maker(Example)

    @allocation_free
    def write(rows: Example, index: int) -> None:
        row(rows, index).place[1, 0] = 5.0

    made = make_record(Example, {"n": 2, "cells": 1}, (3,))
    write(made, 2)
    assert made.place[2, 1, 0] == 5.0
    assert made.place.sum() == 5.0


def test_numbers_of_a_section_have_their_declared_types():
    """An integer for a float becomes one, constants and properties count, and what is no number is left out."""
    stress, battery = numbers(with_constants(StressConfig(patches=2), radius=50)), numbers(BatteryConfig(capacity=5))
    assert isinstance(stress.radius, float)
    assert type(stress) is type(numbers(StressConfig()))
    assert stress.some is True
    assert battery.capacity == 5.0
    assert not hasattr(stress, "areas")


@pytest.mark.slow
def test_code_that_takes_a_section_s_numbers_is_found_on_disk(tmp_path):
    """A second process does not compile anew what takes the numbers of a section."""
    script = tmp_path / "radius.py"
    script.write_text(SCRIPT)
    command = [sys.executable, str(script)]
    found = [subprocess.run(command, capture_output=True, text=True, check=True).stdout for _ in range(2)]
    assert found == ["60.0 0\n", "60.0 1\n"]


def test_the_lattice_s_formula_is_the_same_compiled():
    """Compiled for single numbers, it gives the bits that it gives on arrays."""

    @allocation_free
    def velocity(position: np.float32, step: np.float32, count: np.float32, inset: np.float32) -> np.float32:
        share = lattice.share_of(position)
        cell = lattice.cell_beside(lattice.cell_at(share, count), step, count)
        return lattice.velocity_to(cell, share, count, np.float32(0.025), inset)

    random = np.random.default_rng(0)
    places = random.uniform(-1.0, 1.0, 500).astype(np.float32)
    steps = random.integers(-1, 2, 500).astype(np.float32)
    for inset in (np.float32(0.5), np.float32(0.2)):
        count = np.float32(40)
        share = formula.share_of(places)
        cells = formula.cell_beside(formula.cell_at(share, count), steps, count)
        expected = formula.velocity_to(cells, share, count, np.float32(0.025), inset)
        found = [velocity(place, step, count, inset) for place, step in zip(places, steps, strict=True)]
        np.testing.assert_array_equal(np.array(found, np.float32), expected)


def test_other_constants_of_observations_are_compiled_anew(monkeypatch, tmp_path):
    """The digest of the sources covers the modules of common whose constants and code the simulator compiles."""
    before, other = sources_digest(), tmp_path / "other.py"
    other.write_text("FIELD_SCALE = 0.3\n")
    for module in (farm_observation, formula):
        with monkeypatch.context() as patch:
            patch.setattr(module, "__file__", str(other))
            assert sources_digest.__wrapped__() != before
