"""`eia-sec farm` and `--farm-file`: what docs/how-to/farms.md promises, run."""

import itertools
import json
import re
import shlex
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from matplotlib.image import imread

from eia_sec.common.config import FarmConfig, RunConfig
from eia_sec.common.config.files import differences, from_toml, to_toml
from eia_sec.common.errors import ConfigError
from eia_sec.deploy.cli import dispatch
from eia_sec.deploy.commands.policies.evaluate import EvaluateArguments, configuration_of, evaluations
from eia_sec.deploy.commands.training.learner import LearnerArguments
from eia_sec.deploy.exit_codes import USAGE, run_command
from eia_sec.deploy.local.run_directory import RunDirectory
from eia_sec.deploy.options import base_configuration, parse, with_settings
from eia_sec.rollout.farm_files import read_farm
from eia_sec.rollout.sim.batch import FarmBatch
from eia_sec.rollout.sim.layout import make_layout
from eia_sec.rollout.sim.reference.farm import ReferenceFarm

DOCS = Path(__file__).resolve().parents[2] / "docs"
PAGE = (DOCS / "how-to" / "farms.md").read_text()
ORCHARD = ["orchard.csv", "orchard.geojson"]
EXAMPLES = [*ORCHARD, "orchard_no_fly.geojson", "orchard_growth.geojson"]


def run(arguments):
    """Return the evaluation of a policy's likeliest actions."""
    return evaluations(arguments)[0]


def blocks(language):
    return re.findall(rf"```{language}\n(.*?)```", PAGE, re.DOTALL)


@pytest.fixture
def here(tmp_path, monkeypatch):
    for name in EXAMPLES:
        shutil.copy(DOCS / "examples" / name, tmp_path)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_the_commands_of_the_page_do_what_it_says(here):
    """Every command runs and leaves the file behind that it names."""
    lines = [line for block in blocks("sh") for line in block.splitlines()]
    assert len(lines) == 10
    for line in lines:
        words = shlex.split(line)
        assert words[0] == "eia-sec"
        assert dispatch(words[1:]) == 0
        assert all((here / word).stat().st_size > 0 for flag, word in itertools.pairwise(words) if flag == "--out")
    assert np.ptp(imread(here / "banded.png")) > 0.5
    assert len(read_farm(here / "hills.geojson").xy) == 400


@pytest.mark.parametrize(("language", "ending"), [("csv", ".csv"), ("json", ".geojson")])
def test_the_examples_of_the_page_are_farms(tmp_path, language, ending):
    """Every example of a format can be read as it stands on the page."""
    texts = blocks(language)
    assert texts
    for text in texts:
        (tmp_path / f"example{ending}").write_text(text)
        farm = read_farm(tmp_path / f"example{ending}")
        assert 2 <= len(farm.xy) <= 3


def test_the_sentences_of_the_page_are_those_of_the_reader(here):
    """The two refusals that the page shows come from the examples with that mistake in them."""
    table = (here / "orchard.csv").read_text().splitlines()
    table[16] = ",".join([*table[16].split(",")[:2], "abc", "40"])
    (here / "orchard.csv").write_text("\n".join(table))
    lines = (here / "orchard.geojson").read_text().splitlines()
    lines[8] = re.sub(r"\[11[^\]]*\]", "[48.4, 211.7]", lines[8])
    (here / "orchard.geojson").write_text("\n".join(lines))
    said = []
    for name in ORCHARD:
        with pytest.raises(Exception, match="orchard") as caught:
            read_farm(Path(name))
        said.append(str(caught.value))
    assert "".join(blocks("text")).splitlines() == said


def test_check_says_what_is_in_a_file(here, capsys):
    """Number, field, distances and cycles."""
    assert dispatch(["farm", "check", "orchard.geojson"]) == 0
    said = capsys.readouterr().out
    assert "45 sensors on 339.905 m x 306.073 m" in said
    assert "24.1 m to 41 m" in said
    assert "19 of 40 s, 13 of 50 s, 13 of 60 s" in said
    (here / "two.csv").write_text("x,y\n1,2\n3,4\n")
    assert dispatch(["farm", "check", "two.csv"]) == 0
    assert "sensor types: drawn from the farm's seed" in capsys.readouterr().out


def test_both_examples_are_one_orchard(here):
    """The CSV and the GeoJSON hold the same sensors, up to where the field begins."""
    first, second = (read_farm(here / name) for name in ORCHARD)
    assert first.survey.marks == second.survey.marks
    offset = np.array(first.xy) - np.array(second.xy)
    np.testing.assert_allclose(offset, np.broadcast_to(offset[0], offset.shape), atol=0.003)


@pytest.mark.slow
@pytest.mark.parametrize("name", EXAMPLES)
def test_the_kernel_equals_the_reference_on_a_loaded_farm(here, name):
    """Every quantity over an episode's first steps on a field of another size, types and plots of its own."""
    config = read_farm(here / name).on(FarmConfig())
    assert (config.world.field_x, config.world.plots_x) != (400.0, 20)
    batch = FarmBatch(config, 1)
    batch.reset(0, 3, 5)
    reference = ReferenceFarm(config, make_layout(config, 3), 5)
    random = np.random.default_rng(0)
    collected = 0.0
    for _ in range(130):
        action = random.uniform(-1.0, 1.0, 2 * config.world.uavs).astype(np.float32)
        batch.step(action[None])
        reference.step(action)
        for quantity in ("position", "aoi", "vdf", "service", "direction", "energy", "utility", "parts"):
            np.testing.assert_allclose(
                getattr(batch, quantity)[0], getattr(reference, quantity), rtol=1e-9, atol=1e-9, err_msg=quantity
            )
        collected += float(batch.served_sensors[0].sum())
    assert collected > 0


def test_evaluation_flies_over_a_loaded_farm(here):
    """The heuristic and the shipped policy fly over it; another seed is another episode over the same places."""
    for policy in ("greedy", "trained:eia-sec"):
        result = run(
            EvaluateArguments(
                policy=policy, farms="5:7", farm_file=here / "orchard.geojson", set=("farm.world.steps=150",)
            )
        )
        assert result.total.reward != 0.0
        assert result.per_farm[0] != result.per_farm[1]


@pytest.mark.parametrize("value", ["farm.world.sensors=12", "farm.world.field_x=200"])
def test_a_value_that_contradicts_the_farm_file_is_refused(here, value):
    """`--set` goes over the farm file in every command, so all of them refuse it with the same sentence."""
    commands = (["farm", "show"], ["evaluate", "--policy", "static"], ["replay", "--policy", "static"])
    said = []
    for words in commands:
        with pytest.raises(ConfigError, match=r"\[farm\.world\]") as caught:
            dispatch([*words, "--farm-file", "orchard.csv", "--set", value])
        said.append(str(caught.value))
    assert len(set(said)) == 1


def test_single_values_go_over_the_farm_file(here):
    """A value that the file holds, too, is the option's; another environment has no use for the file."""
    wanted = EvaluateArguments(policy="static", farm_file=here / "orchard.csv", set=("farm.world.field_x=500",))
    world = configuration_of(wanted).farm.world
    assert (world.field_x, world.sensors, len(world.sites)) == (500.0, 45, 45)
    with pytest.raises(ConfigError, match=r"--farm-file needs the farm, and this run uses some\.module:env\.$"):
        configuration_of(replace(wanted, set=("env.name=some.module:env",)))


def test_the_places_travel_in_the_configuration(here):
    """`--farm-file` fills the run's configuration; file and options go over it, the run directory needs it no more."""
    (here / "mine.toml").write_text("episodes = 5\n[farm.world]\nspeed_x_max = 7.0\n")
    arguments = ["--config", "mine.toml", "--farm-file", "orchard.csv", "--farm.world.steps", "60"]
    defaults = LearnerArguments(settings=base_configuration(arguments))
    config = parse(LearnerArguments, arguments, "learner", defaults).settings
    assert (config.episodes, config.farm.world.speed_x_max, config.farm.world.steps) == (5, 7.0, 60)
    assert config.farm.world.sites == read_farm(here / "orchard.csv").on(FarmConfig()).world.sites
    RunDirectory(here / "run").prepare(config, resume=False)
    (here / "orchard.csv").unlink()
    (here / "mine.toml").unlink()
    resumed = base_configuration(["--run-dir", "run", "--resume"])
    assert resumed == config == from_toml(to_toml(config), RunConfig())
    assert "farm.world.sites: [] -> a list of 45" in differences(RunConfig(), resumed)


def test_a_farm_file_is_for_the_farm(here):
    """A run about another environment has no use for sensors, and says so."""
    (here / "other.toml").write_text('[env]\nname = "mpe2:simple_spread_v3"\n')
    with pytest.raises(ConfigError, match=r"this run uses mpe2:simple_spread_v3\.$"):
        base_configuration(["--config", "other.toml", "--farm-file", "orchard.csv"])


def test_no_place_is_an_option_of_its_own(here, capsys):
    """`--help` of a run with given places is as long as without."""
    pages = []
    for more in ([], ["--farm-file", "orchard.csv"]):
        with pytest.raises(SystemExit):
            dispatch(["train", *more, "--help"])
        pages.append(capsys.readouterr().out)
    assert "world.sites" not in pages[1]
    assert abs(len(pages[1].splitlines()) - len(pages[0].splitlines())) < 10


def test_a_saved_run_can_be_drawn_and_saved(here):
    """`--config` of a run with given places gives its farm back."""
    config = base_configuration(["--farm-file", "orchard.geojson"])
    (here / "config.toml").write_text(to_toml(config))
    assert dispatch(["farm", "save", "--config", "config.toml", "--out", "again.geojson", "--latitude", "48.4"]) == 0
    again = read_farm(here / "again.geojson").on(FarmConfig()).world
    assert sorted(again.sites) == pytest.approx(np.array(sorted(config.farm.world.sites)), abs=0.0015)
    features = json.loads((here / "again.geojson").read_text())["features"]
    assert len(features) == 46


def test_a_density_is_for_sampled_places(here, capsys):
    """A farm whose places are given is refused a density, from a farm file or from a configuration."""
    (here / "config.toml").write_text(to_toml(base_configuration(["--farm-file", "orchard.geojson"])))
    for more in (["show", "--farm-file", "orchard.csv"], ["save", "--config", "config.toml"]):
        assert run_command(lambda more=more: dispatch(["farm", *more, "--density", "uniform"])) == USAGE
        assert "--density has no effect on a farm whose sensors have given places." in capsys.readouterr().err
    assert not list(here.glob("farm.*"))


def test_settings_may_switch_their_part_on(here):
    """The order of `--set` does not matter, and areas need no patches."""
    corners = "[[0, 0], [50, 0], [50, 40.0]]"
    battery = with_settings(RunConfig(), ("farm.battery.power=90", "farm.battery.capacity=5000")).farm.battery
    assert (battery.power, battery.capacity) == (90.0, 5000.0)
    assert with_settings(RunConfig(), [f"farm.stress.areas=[[2, {corners}]]"]).farm.stress.areas[0][0] == 2
