"""Configuration as TOML: round trip, overlay, clear refusals, differences and digest."""

import contextlib
import dataclasses
import json
import re
import tomllib

import pytest
from hypothesis import given
from hypothesis import strategies as st

from eia_sec.common.config import EiaSecConfig, EnvConfig, FarmConfig, IppoConfig, RewardConfig, RunConfig, WorldConfig
from eia_sec.common.config.farm.sites import MAX_SENSORS
from eia_sec.common.config.files import (
    differences,
    digest,
    flatten,
    from_toml,
    read_saved,
    to_toml,
    with_setting,
    with_values,
)
from eia_sec.common.config.presets import PRESETS
from eia_sec.common.errors import ConfigError
from eia_sec.common.protocol.frame import MAX_HEADER
from eia_sec.common.protocol.messages import ConfigurationMessage


@pytest.mark.parametrize("name", PRESETS)
def test_round_trip_gives_back_the_preset(name):
    """Every preset, written and read onto any other preset, is itself again with the types it had."""
    text = to_toml(PRESETS[name])
    for base in PRESETS.values():
        read = from_toml(text, base)
        assert read == PRESETS[name]
        assert {key: type(value) for key, value in flatten(read).items()} == {
            key: type(value) for key, value in flatten(PRESETS[name]).items()
        }


@given(
    seed=st.integers(0, 2**63 - 1),
    weight=st.floats(allow_nan=False, allow_infinity=False),
    text=st.text(st.characters(exclude_categories=["Cs"])),
    cycles=st.lists(st.integers(1, 1000), min_size=1, max_size=5),
    flag=st.booleans(),
    sites=st.sets(st.tuples(st.floats(0.0, 400.0), st.floats(0.0, 400.0)), min_size=30, max_size=40),
)
def test_round_trip_of_any_value(seed, weight, text, cycles, flag, sites):
    """Any integer, number, text, list and truth value survives being written and read."""
    config = RunConfig(
        seed=seed,
        farm=FarmConfig(
            world=WorldConfig(sensor_cycles=tuple(cycles), sites=tuple(sites), sensors=len(sites)),
            reward=RewardConfig(relayed=weight),
        ),
        algorithm=EiaSecConfig(ensemble=flag),
        env=EnvConfig(arguments=json.dumps({"text": text}, ensure_ascii=False)),
    )
    assert from_toml(to_toml(config), RunConfig()) == config


def test_every_key_is_written():
    """The TOML holds every field of the configuration, sections nested as the dataclasses are."""
    table, names = tomllib.loads(to_toml(RunConfig())), {field.name for field in dataclasses.fields(RunConfig)}
    assert table["farm"]["world"]["sensor_cycles"] == [40, 50, 60]
    assert set(table) == {"format", *names} - set(RunConfig().unused_sections)
    everything = tomllib.loads(to_toml(PRESETS["eia-sec"]))
    assert set(everything) == {"format", *names}


def test_what_a_file_leaves_out_is_the_base(tmp_path):
    """A file changes what it names and nothing else."""
    path = tmp_path / "run.toml"
    path.write_text("episodes = 7\n[farm.world]\nfield_x = 300\n")
    read = from_toml(path, PRESETS["quick"])
    assert differences(PRESETS["quick"], read) == [
        f"episodes: {PRESETS['quick'].episodes} -> 7",
        "farm.world.field_x: 400.0 -> 300.0",
    ]
    assert isinstance(read.farm.world.field_x, float)


REFUSED = [
    ("bach = 1", "unknown configuration key bach; the closest known one is algorithm.batch."),
    ("[algorithm]\nbach = 1", "unknown configuration key algorithm.bach; the closest known one is algorithm.batch."),
    ("batch = 64", "unknown configuration key batch; the closest known one is algorithm.batch."),
    ("[algoritm]\nbatch = 1", "unknown configuration key algoritm; the closest known one is algorithm."),
    ("[farm.wrld]\nsteps = 1", "unknown configuration key farm.wrld; the closest known one is farm.world."),
    ("[algorithm]\nbatch = 1.5", "algorithm.batch must be a whole number, not 1.5."),
    ("seed = true", "seed must be a whole number, not true."),
    ("seed = 1979-05-27", "seed must be a whole number, not 1979-05-27."),
    ('episodes = "many"', 'episodes must be a whole number, not "many".'),
    ("[algorithm]\ndiscount = true", "algorithm.discount must be a number, not true."),
    ("[algorithm]\nensemble = 1", "algorithm.ensemble must be true or false, not 1."),
    ("[learner]\ndevice = 0", "learner.device must be a text in quotes, not 0."),
    ("[algorithm]\nbootstrap = 'x'", 'algorithm.bootstrap must be one of "mixture", "local", not "x".'),
    (
        "[farm.world]\nsensor_cycles = [1.5]",
        "farm.world.sensor_cycles must be a list of whole numbers, not [1.5].",
    ),
    (
        '[farm.dynamics]\njerk = [4, "5"]',
        'farm.dynamics.jerk must be a list of numbers, not [4, "5"].',
    ),
    ("[farm.world]\nsites = 3", "farm.world.sites must be a list of at most 10000 places, not 3."),
    (
        "[farm.world]\nsites = [3]",
        "farm.world.sites must be a list of places [x, y] or [x, y, type], not of 3.",
    ),
    (
        '[farm.world]\nsites = [[1, "2"]]',
        'farm.world.sites must be a list of places [x, y] or [x, y, type], not of [1, "2"].',
    ),
    (f"[farm.world]\nsites = [[1, 1{'0' * 400}]]", "farm.world.sites names a number that is too large."),
    (
        f"[farm.world]\nsites = [{'[1, 2], ' * 10_001}]",
        "farm.world.sites must be a list of at most 10000 places, not a list of 10001.",
    ),
    ("[farm.world]\nsites = [[1, 2]]", "in [farm.world], sites names 1 places, but sensors is 400."),
    ("[env]\ntypes = 'a=b'", 'env.types must be a section [env.types], not "a=b".'),
    ("[env.types]\na = 1", "env.types.a must be a text in quotes, not 1."),
    ("[env.types]\na = 'b c'", "in [env], env.types gives 'a' the type 'b c', which is no name."),
    ("format = 1", "this configuration has format 1, and this version reads 2."),
    ("format = true", "this configuration has format true, and this version reads 2."),
    ("algorithm = 3", "algorithm must be a section [algorithm], not 3."),
    ("[[farm]]\nx = 1", "farm must be a section [farm], not [a section]."),
    (f"[elite]\nrate = 1{'0' * 400}", "elite.rate is a number that is too large."),
    (
        "[farm.world]\nstep_seconds = 5e-324",
        "in [farm.world], steps of a cycle of 40 s must be between 0 and 1073741824, not inf.",
    ),
    (
        "[replay]\ncapacity = 256",
        "replay.capacity 256 holds no batch of 128 or no chunk of 8 times 20 steps; it takes up to two rows for each.",
    ),
    ("[replay]\nupdates_per_step = 1e308", "in [replay], updates_per_step must be between 0.0 and 1000.0, not 1e+308."),
    ("[algorithm]\nbatch = 0", "in [algorithm], batch must be between 1 and 65536, not 0."),
    ("[algorithm]\ncritic_rate = nan", "in [algorithm], critic_rate must be above 0, not nan."),
    ("[farm.relay]\ncapacity = 1", "in [farm], relay.capacity 1 times 4 relays cannot serve 8 UAVs."),
    ("[farm.stress]\ngrowth = 5", "farm.stress.growth is no option any more; it is always 3, not 5."),
    ("[farm.reward]\npositioning = true", "farm.reward.positioning is no option any more; it is always 1.0, not true."),
    ("[farm.dynamics]\nairspeed = 9", "farm.dynamics.airspeed is no option any more; it is always [12.0], not 9."),
]


@pytest.mark.parametrize(("text", "sentence"), REFUSED, ids=[case[0] for case in REFUSED])
def test_mistake_is_refused_in_one_sentence(text, sentence):
    """An unknown key, a wrong type and an impossible value are each refused with one sentence that names the key."""
    with pytest.raises(ConfigError) as caught:
        from_toml(text, PRESETS["eia-sec"])
    assert str(caught.value) == sentence


SETTINGS = [
    ("farm.world.density=clustered", "farm.world.density", "clustered"),
    ('farm.world.density = "clustered"', "farm.world.density", "clustered"),
    ("env.name=mpe2:simple_spread_v3", "env.name", "mpe2:simple_spread_v3"),
    ("algorithm.ensemble=false", "algorithm.ensemble", False),
    ("farm.world.sensor_cycles=[30]", "farm.world.sensor_cycles", (30,)),
    ("algorithm.discount=0.5", "algorithm.discount", 0.5),
    ("episodes = 7", "episodes", 7),
    ("learner.device='cuda:1'", "learner.device", "cuda:1"),
    ("learner.device=cuda:1", "learner.device", "cuda:1"),
]


@pytest.mark.parametrize(("setting", "key", "value"), SETTINGS, ids=[case[0] for case in SETTINGS])
def test_a_setting_takes_toml_or_a_bare_word(setting, key, value):
    """`key=value` reads true, numbers, lists and quoted texts as TOML does, and a bare word as a text."""
    config = with_setting(PRESETS["eia-sec"], setting)
    assert flatten(config) == flatten(PRESETS["eia-sec"]) | {key: value}


@pytest.mark.parametrize(
    ("setting", "sentence"),
    [
        ("episodes", "a setting is KEY=VALUE, farm.world.density=clustered for instance, not 'episodes'."),
        ("seed=1\nepisodes=2", "a setting is KEY=VALUE"),
        ("[farm]\nx=2", "a setting is KEY=VALUE"),
        ("episodes=many", 'episodes must be a whole number, not "many".'),
        ("seed=two words", "this is not valid TOML"),
        ("seed=", "this is not valid TOML"),
    ],
)
def test_a_setting_that_is_none_is_refused(setting, sentence):
    """Anything but one key and one value is refused in a sentence."""
    with pytest.raises(ConfigError, match=re.escape(sentence)):
        with_setting(RunConfig(), setting)


def test_file_that_is_no_toml_is_refused(tmp_path):
    """A file that is not TOML is refused with its name and the place of the error."""
    path = tmp_path / "broken.toml"
    path.write_text("seed = \n")
    with pytest.raises(ConfigError, match=r"broken\.toml is not valid TOML: invalid value \(at line 1"):
        from_toml(path, RunConfig())


@pytest.mark.parametrize("text", ["seed = " + "[" * 5000, "seed = 1" + "0" * 5000], ids=["nested", "long"])
def test_text_that_no_parser_takes_is_refused(text):
    """A text that others send may be nested or long beyond what Python reads."""
    with pytest.raises(ConfigError, match="this is not valid TOML"):
        from_toml(text, RunConfig())


@pytest.mark.parametrize("content", [None, b"seed = 1 # \xff"], ids=["missing", "not text"])
def test_file_that_cannot_be_read_is_refused(tmp_path, content):
    """A file that is missing or holds no text is refused with its name."""
    path = tmp_path / "run.toml"
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(ConfigError, match=r"the configuration file .*run\.toml cannot be read: .*\."):
        from_toml(path, RunConfig())


def test_the_largest_given_farm_fits_a_message_and_is_shown_in_short():
    """Ten thousand places travel as every configuration does, and a difference in them is a line, not a book."""
    sites = tuple((1234.567 + 0.001 * i, 2345.678, 1.0) for i in range(MAX_SENSORS))
    world = WorldConfig(field_x=5000.0, field_y=5000.0, sensors=MAX_SENSORS, sites=sites)
    config = RunConfig(farm=FarmConfig(world=world))
    data = ConfigurationMessage(1, to_toml(config), {}, False).encode()
    assert len(data) < MAX_HEADER / 8
    assert from_toml(ConfigurationMessage.decode(data).toml, RunConfig()) == config
    other = dataclasses.replace(config, farm=FarmConfig(world=dataclasses.replace(world, sites=sites[::-1])))
    assert differences(config, other) == ["farm.world.sites: a list of 10000 -> a list of 10000"]
    assert digest(config) != digest(other)


def test_equal_configurations_have_no_differences_and_one_digest():
    """Equal configurations differ in nothing and share their digest; the presets all differ."""
    assert differences(RunConfig(), RunConfig()) == []
    assert digest(RunConfig()) == digest(from_toml(to_toml(RunConfig()), PRESETS["paper"]))
    assert len({digest(config) for config in PRESETS.values()}) == len(PRESETS)


WORDS = (
    "nearest",
    "printed",
    "random",
    "local",
    "member",
    "mixture",
    "joint",
    "independent",
    "any",
)
WORDS += ("cuda", "mpe2:simple_spread_v3", "banded", "maddpg")
WORDS += ("lattice", "velocity", "policy", "separate", "team", "bootstrap", "float32", "gru")
WORDS += ("collection 0 at 9", "decoupled", "ppo", "south", "instant")
BASES = "eia-sec", "instant"
"""Presets that have between them every option of a preset."""
OTHER_VALUES = {
    bool: ["true", "false"],
    str: [*(f'"{word}"' for word in WORDS), "'{\"N\": 5}'"],
    tuple: [
        "[30]",
        str([[float(i % 20), float(i // 20)] for i in range(400)]),
        "[[[0, 0], [9, 0], [4, 4]]]",
        "[[2, [[0, 0], [9, 0], [4, 4]]]]",
    ],
    int: ["1", "2", "3", "5", "100", "2000000"],
    float: ["0.25", "0.75", "2.0", "4.0"],
}


OF_PLUGINS = ("plugins", "algorithm.network.name")
KEYS = {key: name for name in BASES for key in flatten(PRESETS[name]) if key not in OF_PLUGINS}
"""Every option but those whose values are plug-ins, which must be loaded, and the preset in which it is changed; that
of default has routes, which exclude inertia."""


@pytest.mark.parametrize(("key", "name"), (KEYS | {"farm.dynamics.model": "inertial"}).items())
def test_digest_depends_on_every_key(key, name):
    """A change of any single key changes the digest and is the one difference that is reported."""
    base, (section, _, field) = PRESETS[name], key.rpartition(".")
    head = f"[{section}]\n" if section else ""
    changed = base
    for value in OTHER_VALUES[type(flatten(base)[key])]:
        with contextlib.suppress(ConfigError):
            changed = from_toml(f"{head}{field} = {value}", base)
        if changed != base:
            break
    assert digest(changed) != digest(base)
    found = [line.split(":")[0] for line in differences(base, changed)]
    assert (
        found == [key] or key == found[0] in ("algorithm.name", "env.name") or (key, found[0]) == ("steps", "episodes")
    )


def test_entries_of_a_map_are_merged_by_key():
    """A file adds entries to those of the base, an empty table removes them all, and a saved configuration is whole."""
    base = PRESETS["instant"]
    more = from_toml("[algorithm.hindsight]\ncollection = 0.5\n[algorithm.discounts]\nmonitoring = 1", base)
    assert more.on_policy.hindsight == {"collection": 0.5, "monitoring": 1.0}
    assert more.on_policy.discounts == {"communication": 1.0, "monitoring": 1.0}
    assert isinstance(more.on_policy.discounts["monitoring"], float)
    assert with_setting(base, "algorithm.hindsight.collection=0.5").on_policy.hindsight == more.on_policy.hindsight
    none = from_toml("algorithm.hindsight = {}", base)
    assert none.on_policy.hindsight == {}
    assert from_toml(to_toml(none), base) == none
    assert differences(base, none) == [
        "algorithm.hindsight.collection: 0.75 -> none",
        "algorithm.hindsight.monitoring: 1.0 -> none",
    ]
    assert len({digest(config) for config in (base, more, none)}) == 3


def test_a_map_in_a_configuration_cannot_change():
    """It is equal to any map with its entries, has their hash, and its keys are names."""
    given = {"b": 0.5, "a": 1.0}
    held = IppoConfig(discounts=given).discounts
    given["a"] = 0.0
    assert held == {"a": 1.0, "b": 0.5}
    assert list(held) == ["a", "b"]
    assert hash(IppoConfig(discounts={"a": 1.0, "b": 0.5})) == hash(IppoConfig(discounts=held))
    with pytest.raises(TypeError):
        held["a"] = 0.0
    for entries, said in (({"a b": 1.0}, "discounts names 'a b'"), ({"a": 2.0}, r"discounts\.a must be between 0")):
        with pytest.raises(ConfigError, match=said):
            IppoConfig(discounts=entries)


def test_names_with_dots_are_keys_in_quotes():
    """The name of a type may hold dots, which would be sections."""
    config = dataclasses.replace(RunConfig(), algorithm=IppoConfig(discounts={"walker.1": 0.5}))
    assert '[algorithm.discounts]\n"walker.1" = 0.5' in to_toml(config)
    assert from_toml(to_toml(config), RunConfig()) == read_saved(to_toml(config)) == config


def test_a_budget_takes_the_place_of_the_other():
    """Whoever names one budget alone gets runs that end with it; of both, the first that is reached ends them."""
    base = RunConfig()
    steps = with_values(base, {"steps": 9000})
    assert (steps.episodes, steps.steps) == (0, 9000)
    assert steps.progress(10**6, 4500) == 0.5
    again = from_toml("episodes = 7", steps)
    assert (again.episodes, again.steps) == (7, 0)
    both = from_toml("episodes = 7\nsteps = 9000", base)
    assert (both.progress(7, 1), both.progress(1, 9001)) == (1.0, 1.0)
    assert read_saved(to_toml(both)) == both
    with pytest.raises(ConfigError, match="one of them ends the run"):
        from_toml("episodes = 0\nsteps = 0", base)


def test_a_byte_order_mark_is_no_part_of_a_file(tmp_path):
    """Editors on Windows write one at the start of a file."""
    (tmp_path / "run.toml").write_bytes(b"\xef\xbb\xbfepisodes = 7\n")
    assert from_toml(tmp_path / "run.toml", RunConfig()).episodes == 7
