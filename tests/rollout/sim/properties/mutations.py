"""Small errors put into the simulator on purpose, to see which property tests notice.

Each is made in a copy of the sources in a temporary folder. `python -m tests.rollout.sim.properties.mutations` tries
them all, or those named on the command line, and writes docs/reference/simulator_properties.md.
"""

import os
import re
import shutil
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[4]
PAGE = ROOT / "docs" / "reference" / "simulator_properties.md"
EVENTS = ("failures", "links", "stress", "battery", "airspace")
NAMES = ("flight", "counters", "symmetry", "batch", "added", "reference", "hindsight", *EVENTS)
PROPERTIES = [f"test_properties_{name}.py" for name in NAMES]
"""The reference, which notices almost everything, comes after all that need none; hindsight needs it, too."""

TESTS = "tests/rollout/sim"

ABOUT_FARMS = ("-k", "not drawn")
"""Leaves out the tests about what is drawn: they say nothing about the simulator."""

HEAD = """# What the property tests notice

Written by `python -m tests.rollout.sim.properties.mutations`; do not edit. Every row is an error that was put into a
copy of the simulator on purpose, and the first of the property tests (`tests/rollout/sim/properties`) that failed
because of it, with the default dose.

| Error | In | Noticed first by |
| :-- | :-- | :-- |
"""


@dataclass(frozen=True)
class Mutation:
    """One error.

    Attributes:
        name: what is wrong, in words.
        edits: (file in rollout/, what stands there exactly once, what stands there instead).
    """

    name: str
    edits: tuple[tuple[str, str, str], ...]


def one(name: str, file: str, old: str, new: str) -> Mutation:
    return Mutation(name, ((file, old, new),))


CAPACITY = "relay.capacity_for(world)"
MUTATIONS = (
    one(
        "an image is also paid for the rise of its own step",
        "sim/core/camera.py",
        "utility[u] += level[column, row]",
        "utility[u] += level[column, row] + (1.0 if due[column, row] == step else 0.0)",
    ),
    one(
        "a plot in reach is also paid to UAVs that are not the nearest",
        "sim/core/camera.py",
        "                if _succeeds(",
        "                utility[u] += level[column, row]\n                if _succeeds(",
    ),
    one(
        "VDF is due one step later each time",
        "sim/core/camera.py",
        "due[column, row] += cycles[0, column, row] if stress else camera.cycle",
        "due[column, row] += cycles[0, column, row] if stress else camera.cycle + 1",
    ),
    one("AoI has no cap", "sim/core/radio.py", "min(age[j] + 1.0, radio.level_max)", "age[j] + 1.0"),
    one(
        "packets are drawn alike in every step",
        "sim/core/radio.py",
        "(np.uint64(step) <<",
        "(np.uint64(1 + 0 * step) <<",
    ),
    one(
        "sensors at the edge of the reach are missed",
        "sim/core/link.py",
        "return high * (1.0 + 1e-9)",
        "return 0.7 * high",
    ),
    one(
        "of UAVs equally near the last serves",
        "sim/core/neighbours.py",
        "rival == square and other < u",
        "rival == square and other > u",
    ),
    Mutation(
        "relays take one UAV more than their capacity",
        (
            ("sim/core/constants.py", f"capacity={CAPACITY}", f"capacity={CAPACITY} + 1"),
            ("sim/core/arrays.py", "config.relay.capacity_for(world)", "(config.relay.capacity_for(world) + 1)"),
        ),
    ),
    one(
        "the assignment forgets the columns' prices",
        "sim/core/assignment.py",
        "cost[row, column] - u[row] - v[column]",
        "cost[row, column] - u[row]",
    ),
    one(
        "images and packets count without a relay in range",
        "sim/core/relays.py",
        "1.0 if distance <= relay.link_range and not gone[u] else 0.0",
        "0.0 if gone[u] else 1.0",
    ),
    one(
        "a relay that a chain reaches passes it on to nobody",
        "sim/conditions/links.py",
        "    while done < count:",
        "    while done < 0:",
    ),
    one(
        "relays are not paid for what others relay over them",
        "sim/core/rewards.py",
        "own == relay or (c.relay.chained and not s.joined_then[own])",
        "own == relay",
    ),
    one(
        "the relays' centroid keeps what the last environment left",
        "sim/core/relays.py",
        "    centroid[:, :] = 0.0\n",
        "",
    ),
    one(
        "the last part of the reward is not added",
        "sim/core/rewards.py",
        "    for part in range(parts.shape[1]):\n            total",
        "    for part in range(parts.shape[1] - 1):\n            total",
    ),
    one("energy is paid for", "sim/core/constants.py", "energy=-reward.energy", "energy=reward.energy"),
    one(
        "the border along y is not flagged",
        "sim/core/motion.py",
        "if position[u, 0] != x or position[u, 1] != y else",
        "if position[u, 0] != x else",
    ),
    one(
        "y is clipped at the field's width",
        "sim/core/motion.py",
        "min(fleet.depth, max(0.0, y))",
        "min(fleet.width, max(0.0, y))",
    ),
    one(
        "two quadrants are exchanged",
        "sim/core/quadrants.py",
        "length if best in (0, 3)",
        "length if best in (0, 2)",
    ),
    one(
        "offsets along y have the wrong sign",
        "sim/observation/rows.py",
        "sy * dy * fleet.per_depth",
        "-sy * dy * fleet.per_depth",
    ),
    one("a mirrored window is not turned", "sim/observation/rows.py", "row + int(sy) * step_y", "row + step_y"),
    one(
        "a monitor's axis points the wrong way",
        "sim/observation/rows.py",
        "sign_of(what, across), sign_of(what, along)\n        x, y",
        "sign_of(what, -across), sign_of(what, along)\n        x, y",
    ),
    one(
        "a relay's axes stay the field's",
        "sim/observation/rows.py",
        "sx, sy = sign_of(what, x), sign_of(what, y)",
        "sx, sy = 1.0, 1.0",
    ),
    one(
        "a mirrored place in the plot is not turned",
        "sim/observation/rows.py",
        "sx * across, sy * along\n            at += 2",
        "across, along\n            at += 2",
    ),
    one(
        "a mirrored offset of a sensor is not turned",
        "sim/observation/rows.py",
        "sx * (sensor[0, j] - x)",
        "sensor[0, j] - x",
    ),
    one(
        "hindsight forgets that a service may remove a rise",
        "sim/core/hindsight.py",
        "-float(visit[item, REMOVED])",
        "0.0",
    ),
    one(
        "hindsight corrects the later visit",
        "sim/core/hindsight.py",
        "hindsight[earlier - 1, visit[item, AGENT]]",
        "hindsight[step - 1, agent]",
    ),
    one(
        "a patch hides that its area rises faster",
        "sim/conditions/stress.py",
        "(max(area, patch) if covered else area)",
        "(patch if covered else area)",
    ),
    one(
        "landed UAVs are charged twice",
        "sim/conditions/battery.py",
        "- energy[u] + charged",
        "- energy[u] + 2.0 * charged",
    ),
    one(
        "a route suggests moves that zones refuse",
        "sim/observation/routes.py",
        "if stopped[move]:",
        "if stopped[move] and move < 0:",
    ),
    one(
        "plans lead through zones",
        "sim/observation/plans/search.py",
        "if len(barred) > 0 and is_barred(",
        "if len(barred) > len(worth) * columns * rows and is_barred(",
    ),
    one(
        "a route waits for plots that zones shut off",
        "sim/observation/routes.py",
        "passed |= closed[plot[at]]",
        "passed |= closed[plot[at]] and count == 0",
    ),
    one("sums of the last episode stay after a reset", "sim/batch.py", "state.returns, state.sums)", "state.returns)"),
)


def copy_sources(folder: Path) -> None:
    """Copy what the property tests need into a folder."""
    ignore = shutil.ignore_patterns("__pycache__")
    for package in ("common", "rollout"):
        shutil.copytree(ROOT / package, folder / package, ignore=ignore)
    shutil.copytree(ROOT / "src", folder / "src", ignore=ignore, symlinks=True)
    shutil.copytree(ROOT / TESTS, folder / TESTS, ignore=ignore)
    shutil.copy(ROOT / "tests" / "constants.py", folder / "tests" / "constants.py")
    shutil.copy(ROOT / "pyproject.toml", folder / "pyproject.toml")


def apply(mutation: Mutation, folder: Path) -> None:
    """Make an error in the copy; raise ValueError where the line that it changes is not there exactly once."""
    for file, old, new in mutation.edits:
        path = folder / "rollout" / file
        source = path.read_text()
        if source.count(old) != 1:
            raise ValueError(
                f"{file} holds {source.count(old)} times what the error {mutation.name!r} changes: {old!r}"
            )
        path.write_text(source.replace(old, new))


def environment_of(folder: Path) -> dict[str, str]:
    """Return the variables with which a folder's sources are what is imported."""
    environment = os.environ | {"PYTHONPATH": f"{folder / 'src'}{os.pathsep}{folder}"}
    environment.pop("NUMBA_CACHE_DIR", None)
    return environment


def run_properties(folder: Path, dose: str, *arguments: str, **variables: str) -> tuple[int, list[str], str]:
    """Run the property tests of a folder's sources; return the exit code, the tests that failed, and what was said."""
    environment = environment_of(folder) | {"EIA_SEC_PROPERTIES": dose} | variables
    files = [f"{TESTS}/properties/{name}" for name in PROPERTIES]
    command = [
        sys.executable,
        "-m",
        "pytest",
        "-q",
        "-m",
        "not nightly",
        "-o",
        "timeout=7200",
        "-p",
        "no:cacheprovider",
        *arguments,
        *files,
    ]
    result = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, check=False)
    failed = re.findall(r"^FAILED \S+::(\w+)", result.stdout, re.MULTILINE)
    return result.returncode, failed, result.stdout + result.stderr


def noticed(mutation: Mutation | None, folder: Path) -> list[str]:
    """Return the first test that fails on the copy with this error; of the plain copy without one."""
    copy_sources(folder)
    if mutation is not None:
        apply(mutation, folder)
    # Every copy is compiled anew, which takes a third of the time where the compiler optimises nothing.
    code, failed, said = run_properties(folder, "plain", "--tb=no", "--exitfirst", *ABOUT_FARMS, NUMBA_OPT="0")
    if code not in {0, 1} or bool(failed) != bool(code):
        raise RuntimeError(said)
    return failed


def row(mutation: Mutation, failed: list[str]) -> str:
    """Return the page's line about an error."""
    tests = ", ".join(f"`{name.removeprefix('test_')}`" for name in failed) or "**nobody**"
    files = ", ".join(f"`rollout/{file}`" for file, _, _ in mutation.edits)
    return f"| {mutation.name} | {files} | {tests} |\n"


def main(names: list[str]) -> None:
    """Try the errors of these names, or all, and write the page; lines about others stay as they are."""
    lines = PAGE.read_text().splitlines(keepends=True) if PAGE.exists() else []
    rows = {line.split("|")[1].strip(): line for line in lines if line.startswith("| ")}
    for mutation in [None, *MUTATIONS]:
        if mutation is None or mutation.name in names or not names:
            with tempfile.TemporaryDirectory() as folder:
                failed = noticed(mutation, Path(folder))
            if mutation is None:
                assert not failed, f"{failed} fail without any error"
                continue
            rows[mutation.name] = row(mutation, failed)
            sys.stdout.write(rows[mutation.name])
            sys.stdout.flush()
            PAGE.write_text(HEAD + "".join(rows[each.name] for each in MUTATIONS if each.name in rows))


if __name__ == "__main__":
    main(sys.argv[1:])
