"""One configuration class for each algorithm; an option without effect is refused where it is given."""

import dataclasses

import pytest

from eia_sec.common.config import ALGORITHM_CONFIGS, EliteConfig, MaddpgConfig, MasacConfig, Matd3Config, RunConfig
from eia_sec.common.config.ablations import ABLATIONS
from eia_sec.common.config.algorithms import (
    OPTIONAL_SECTIONS,
    AlgorithmConfig,
    BaselineConfig,
    EiaPpoConfig,
    EiaSecConfig,
    OffPolicyConfig,
    OnPolicyConfig,
    switched,
)
from eia_sec.common.config.files import differences, digest, flatten, from_toml, to_toml, with_setting, with_values
from eia_sec.common.config.presets import PRESETS, preset
from eia_sec.common.errors import ConfigError, UsageError
from eia_sec.deploy.cli import dispatch
from eia_sec.deploy.commands.training.train import TrainArguments
from eia_sec.deploy.exit_codes import run_command
from eia_sec.deploy.options import base_configuration, parse


@pytest.mark.parametrize("name", ALGORITHM_CONFIGS)
def test_a_class_is_registered_under_its_name(name):
    """A class names its algorithm and sections that exist, and its configuration survives being written and read."""
    config = ALGORITHM_CONFIGS[name]()
    assert config.name == name
    assert set(config.sections) <= set(OPTIONAL_SECTIONS)
    run = RunConfig(algorithm=config)
    assert {key.partition(".")[0] for key in flatten(run)} & set(OPTIONAL_SECTIONS) == set(config.sections)
    for base in PRESETS.values():
        assert from_toml(to_toml(run), base) == run


def test_another_algorithm_keeps_what_both_inherit():
    """Shared options keep their values, and all others take the other algorithm's defaults."""
    eia_sec = dataclasses.replace(preset("eia-sec").algorithm, hidden=32, batch=64)
    assert switched(eia_sec, "eia-sec") is eia_sec
    assert switched(eia_sec, "maddpg") == MaddpgConfig(hidden=32, batch=64)
    assert switched(Matd3Config(others="team"), "masac") == MasacConfig(others="team")
    with pytest.raises(
        ConfigError, match=r"^algorithm.name must be one of eia-sec, .*, not 'ddpg'; did you mean maddpg\?$"
    ):
        switched(eia_sec, "ddpg")


def test_sections_that_nobody_reads_make_no_difference():
    """Two MADDPG runs are equal whatever their bases said about elites."""
    imitating = preset("eia-sec")
    found = [
        with_values(base, {"algorithm.name": "maddpg"})
        for base in (imitating, dataclasses.replace(imitating, elite=EliteConfig(cycle=3)))
    ]
    assert found[0] == found[1]
    assert not found[0].imitates
    assert "algorithm.ensemble: true -> none" in differences(imitating, found[0])
    assert "elite.cycle: 10 -> none" in differences(imitating, found[0])


def named(*families):
    """Return the names of families' algorithms as messages list them."""
    return ", ".join(name for name, config in ALGORITHM_CONFIGS.items() if issubclass(config, families))


REFUSED = [
    (
        "[algorithm]\nepochs = 2",
        f"algorithm.epochs has no effect with eia-sec; it is an option of {named(OnPolicyConfig)}.",
    ),
    (
        '[algorithm]\nname = "maddpg"\nensemble = false',
        f"algorithm.ensemble has no effect with maddpg; it is an option of {named(EiaSecConfig, EiaPpoConfig)}.",
    ),
    (
        '[algorithm]\nname = "vdn"\ncritic_rate = 1e-3',
        "algorithm.critic_rate has no effect with vdn; it is an option of "
        + ", ".join(name for name in ALGORITHM_CONFIGS if name != "vdn")
        + ".",
    ),
    (
        '[algorithm]\nname = "vdn"\nmixing_width = 8',
        "algorithm.mixing_width has no effect with vdn; it is an option of qmix.",
    ),
    (
        '[exploration]\nnoise_std_end = 0.1\n[algorithm]\nname = "qmix"',
        "exploration.noise_std_end has no effect with qmix; it is an option of eia-sec, maddpg, matd3, masac.",
    ),
    (
        "algorithm.others = 'team'",
        f"algorithm.others has no effect with eia-sec; it is an option of {named(BaselineConfig)}.",
    ),
    (
        '[elite]\ncycle = 4\n[algorithm]\nname = "matd3"',
        f"elite.cycle has no effect with matd3; it is an option of {named(EiaSecConfig, EiaPpoConfig)}.",
    ),
]


@pytest.mark.parametrize(("text", "sentence"), REFUSED, ids=[case[0] for case in REFUSED])
def test_a_file_with_an_option_without_effect_is_refused(text, sentence):
    """The sentence names the option, the algorithm, and the algorithms that have it."""
    with pytest.raises(ConfigError) as caught:
        from_toml(text, preset("eia-sec"))
    assert str(caught.value) == sentence


EIA_SEC = ["--preset", "eia-sec"]
LINES = [
    (
        [*EIA_SEC, "--algorithm.epochs", "2"],
        f"algorithm.epochs has no effect with eia-sec; it is an option of {named(OnPolicyConfig)}.",
    ),
    (
        ["--replay.capacity", "5000"],
        f"replay.capacity has no effect with eia-ppo; it is an option of {named(OffPolicyConfig)}.",
    ),
    (
        ["--algorithm=masac", "--algorithm.no-ensemble"],
        f"algorithm.ensemble has no effect with masac; it is an option of {named(EiaSecConfig, EiaPpoConfig)}.",
    ),
    (
        ["--algorithm", "matd3", "--elite.cycle", "4"],
        f"elite.cycle has no effect with matd3; it is an option of {named(EiaSecConfig, EiaPpoConfig)}.",
    ),
    (
        [*EIA_SEC, "--algorithm.no-ensemble", "--algorithm.ensemble-members", "3"],
        "algorithm.ensemble_members has no effect while algorithm.ensemble is false.",
    ),
    (
        ["--algorithm.sequence-steps", "20"],
        "algorithm.sequence_steps has no effect while algorithm.memory is none.",
    ),
    (
        [*EIA_SEC, "--algorithm.memory", "gru"],
        f"algorithm.memory has no effect with eia-sec; it is an option of {named(OnPolicyConfig)}.",
    ),
    (
        ["--farm.battery.failsafe", "0.2"],
        "farm.battery.failsafe has no effect while farm.battery.capacity is 0.0.",
    ),
    (["--farm.battery.stations", "9"], "farm.battery.stations has no effect while farm.battery.capacity is 0.0."),
    (["--env.steps", "30"], "env.steps has no effect while env.name is farm."),
    (["--farm.relay.base", "south"], "farm.relay.base has no effect while farm.relay.require_link is false."),
    (
        ["--farm.relay.require-link", "--farm.relay.hop-range", "100"],
        "farm.relay.hop_range has no effect while farm.relay.base is empty.",
    ),
    ([*EIA_SEC, "--elite.no-enabled", "--elite.cycle", "4"], "elite.cycle has no effect while elite.enabled is false."),
    (
        ["--algorithm", "eia-ppo", "--algorithm.shared-until", "1", "--elite.cycle", "4"],
        "elite.cycle has no effect while algorithm.shared_until is 1.0.",
    ),
    (
        ["--algorithm", "sec"],
        f"algorithm.name must be one of {named(AlgorithmConfig)}, not 'sec'; did you mean eia-sec?",
    ),
]


@pytest.mark.parametrize(("words", "sentence"), LINES, ids=[" ".join(case[0]) for case in LINES])
def test_a_command_line_with_an_option_without_effect_is_refused(words, sentence):
    """Likewise on a command line, where an option of a part that is switched off is refused, too."""
    with pytest.raises(ConfigError) as caught:
        parse(TrainArguments, words, "train", TrainArguments(settings=base_configuration(words)))
    assert str(caught.value) == sentence


IMPOSSIBLE = {
    "rollout.chunk_steps 64 must be a multiple of algorithm.sequence_steps 50": "[rollout]\nchunk_steps = 64",
    "minibatch_steps 40 hold no sequence of sequence_steps 50": "minibatch_steps = 40",
    "sequence_steps must be between 1 and 10000": "sequence_steps = 0",
    "algorithm.memory must be one of": 'memory = "lstm"',
}


@pytest.mark.parametrize("sentence", IMPOSSIBLE)
def test_a_memory_that_cannot_learn_is_refused(sentence, tmp_path, capsys):
    """Sequences have steps, and fit into chunks and minibatches: one sentence and exit code 2 where they do not."""
    text = IMPOSSIBLE[sentence]
    head = "" if text.startswith("memory") else 'memory = "gru"\n'
    toml = f"[algorithm]\n{head}{text}"
    with pytest.raises(ConfigError, match=sentence):
        from_toml(toml, preset("instant"))
    (tmp_path / "run.toml").write_text(toml)
    arguments = ["train", "--config", str(tmp_path / "run.toml"), "--run-dir", str(tmp_path / "run")]
    assert run_command(lambda: dispatch(arguments)) == 2
    assert sentence in " ".join(capsys.readouterr().err.split())
    assert not (tmp_path / "run").exists()


def test_a_run_may_have_memory():
    """Algorithms on policy take it over from each other, and it survives being written and read."""
    config = from_toml('[algorithm]\nmemory = "gru"\nsequence_steps = 100', preset("instant"))
    assert (config.memory, config.memory_size) == ("gru", config.algorithm.hidden)
    assert from_toml(to_toml(config), preset("study")) == config
    other = with_values(config, {"algorithm.name": "eia-ppo"})
    assert (other.memory, other.on_policy.sequence_steps) == ("gru", 100)
    assert 0.0 < other.on_policy.shared_until < 1.0, "elites are imitated by agents that have networks of their own"
    assert (preset("eia-sec").memory, preset("eia-sec").memory_size) == ("none", 0)
    assert preset("instant").memory_size == 0


@pytest.mark.parametrize(
    ("words", "wanted"),
    [
        (["--algorithm", "masac", "--algorithm.others", "team"], MasacConfig(others="team")),
        (["--algorithm.target-rate=0.25", "--algorithm=matd3"], Matd3Config(target_rate=0.25)),
    ],
)
def test_a_command_line_has_the_options_of_its_algorithm(words, wanted):
    """The chosen algorithm's own options are on the command line."""
    defaults = TrainArguments(settings=base_configuration(words))
    assert parse(TrainArguments, words, "train", defaults).settings.algorithm == wanted


def test_a_command_line_adds_entries_to_a_map():
    """KEY=VALUE goes over the preset's entries, no value removes them, and another environment begins without."""
    for words, wanted in (
        (["--algorithm.hindsight", "collection=0.5"], {"collection": 0.5, "monitoring": 1.0}),
        (["--algorithm.hindsight", "a=0.5", "b=1"], {"a": 0.5, "b": 1.0, "collection": 0.75, "monitoring": 1.0}),
        (["--algorithm.hindsight"], {}),
        ([], {"collection": 0.75, "monitoring": 1.0}),
        (["--env", "mpe2:simple_spread_v3", "--algorithm.hindsight", "agent=0.5"], {"agent": 0.5}),
    ):
        defaults = TrainArguments(settings=base_configuration(words))
        assert parse(TrainArguments, words, "train", defaults).settings.on_policy.hindsight == wanted
    for value in ("0.5", "a=b", "=1"):
        with pytest.raises(UsageError, match="hindsight"):
            parse(TrainArguments, ["--algorithm.hindsight", value], "train", TrainArguments())


def test_a_setting_names_an_algorithm():
    """`--set algorithm.name=` takes an algorithm, with that one's defaults."""
    assert with_setting(RunConfig(), "algorithm.name=masac").algorithm == MasacConfig()


@pytest.mark.parametrize("name", ABLATIONS)
def test_an_ablation_is_eia_sec_without_a_part(name):
    """As a preset it differs from `eia-sec` in its switches alone."""
    changes = [f"{key}: true -> false" for key in ABLATIONS[name]]
    assert differences(preset("eia-sec"), preset(name)) == changes


@pytest.mark.parametrize("key", ["farm.battery.power", "algorithm.reward_scale", "learner.checkpoint_seconds"])
def test_every_option_is_part_of_the_digest(key):
    """Runs that differ in one option, even of a part that is off, have different digests."""
    config = preset("instant")
    assert digest(with_values(config, {key: 17.5})) != digest(config) == digest(from_toml(to_toml(config), config))


def test_a_run_keeps_the_sections_that_it_is_given():
    """A section that the algorithm does not read is refused, not overwritten; switching gives it its defaults."""
    study = preset("study")
    with pytest.raises(ConfigError, match=r"^ippo does not read replay; leave that section at its defaults\.$"):
        RunConfig(replay=study.replay)
    found = study.with_algorithm("ippo")
    assert (found.algorithm.name, found.replay, found.farm) == ("ippo", RunConfig().replay, study.farm)
    assert found.with_algorithm("masac").replay == RunConfig().replay
    assert study.with_algorithm("masac").replay == study.replay
