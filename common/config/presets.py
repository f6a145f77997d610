"""The presets.

Every preset is an overlay in TOML, as a user could have written it, on the dataclasses' own defaults (in `algorithms/`,
`farm/`, `optional_sections.py` and `run.py` of this folder) or on another preset. docs/reference/configuration.md lists
each option's value in each preset.
"""

from typing import Final

from eia_sec.common.config.ablations import ABLATIONS
from eia_sec.common.config.environment import FARM
from eia_sec.common.config.files import from_toml, with_values
from eia_sec.common.config.run import RunConfig
from eia_sec.common.errors import ConfigError
from eia_sec.common.spelling import did_you_mean

INSTANT: Final = """
[algorithm.discounts]
communication = 1.0
[algorithm.entropy_scales]
communication = 0.05
[algorithm.hindsight]
monitoring = 1.0
collection = 0.75
"""
"""The paper's farm, whose UAVs reach any velocity at once; nothing that we tried trains better there
(docs/explanation/method.md). What names no type of the farm is a default of the dataclasses."""

INERTIAL: Final = """
episodes = 6000
[farm.dynamics]
model = "inertial"
[farm.observation]
route = false
[algorithm]
name = "eia-ppo"
hidden = 128
discount = 0.98
iteration_steps = 8000
epochs = 4
"""
"""The farm as `make train` learns it, with EIA-SEC on policy, over INSTANT: UAVs need time to change their velocity, by
PX4's limits, and actors learn from nothing."""

QUICK: Final = """
episodes = 1200
[learner]
checkpoint_seconds = 15.0
[evaluation]
farms = 4
"""
"""A short run that uses every process and ends within about four minutes on two cores."""

GENERIC: Final = """
steps = 1_000_000
[algorithm]
actor_rate = 5e-4
reward_scale = 1.0
gradient_clip = 1.0
iteration_steps = 2000
minibatch_steps = 500
epochs = 10
entropy_start = 0.01
entropy_end = 0.001
time_limit = "bootstrap"
precision = "float32"
normalise_observations = true
normalise_returns = true
[rollout]
environments = 8
chunk_steps = 125
train_farms = 1000
"""
"""Every environment but the farm where no preset is named: small iterations, measured scales, a budget in steps."""

PLANS: Final = """
[farm.control]
monitoring_inset = 0.36
[farm.observation]
plan = 12
[algorithm]
value_steps = 96000
entropy_start = 0.005
entropy_end = 0.0005
[algorithm.suggestion_logits]
collection = 8.0
[algorithm.hindsight]
collection = 0.8
[algorithm.entropy_scales]
collection = 0.1
"""
"""Monitors and collectors see what their next moves are worth twelve steps ahead, and at first favour the best. A step
takes several times as long to simulate as with the preset instant. No preset of its own; others are over it."""

LONG: Final = """
episodes = 1000
[algorithm.start_policy]
communication = "trained:instant"
monitoring = "trained:instant"
[algorithm.entropy_scales]
monitoring = 0.1
"""
"""The paper's farm with plans, over PLANS; relays and monitors begin as those of the policy `trained:instant`."""

CONNECTED: Final = """
episodes = 8000
[farm.relay]
require_link = true
link_range = 100.0
[farm.control]
monitoring_inset = 0.36
collection_inset = 0.36
[farm.observation]
link = true
[farm.reward]
relayed = 0.2
[algorithm.hindsight]
monitoring = 1.0
collection = 0.8
"""
"""A farm on which images and data count only while the UAV's relay is near; see docs/reference/environment.md."""

FAILING: Final = """
episodes = 2000
[farm.failures]
per_hour = 6.0
[farm.observation]
route = false
"""
"""A farm on which more than half of the UAVs fail during an episode, over PLANS; monitors follow no route there."""

UNEVEN: Final = """
episodes = 2000
[farm.stress]
patches = 6
[farm.control]
collection_inset = 0.36
[farm.observation]
route = false
stress = true
[algorithm.start_policy]
all = "trained:instant"
"""
"""A farm on which patches of stress come and go, where everything needs three times as many visits, over PLANS.
Relays begin as those of the policy `trained:instant`."""

BATTERY: Final = """
episodes = 1500
[farm.battery]
capacity = 8000.0
failsafe = 0.2
[farm.control]
collection_inset = 0.36
[farm.observation]
charge = true
[algorithm.start_policy]
communication = "trained:instant"
monitoring = "trained:instant"
"""
"""A farm whose batteries last about three minutes, over PLANS; autopilots fly UAVs to stations, where they charge for
some 15 s. Relays and monitors begin as those of the policy `trained:instant`."""

FIELD: Final = """
episodes = 8000
[farm.relay]
require_link = true
link_range = 100.0
[farm.failures]
per_hour = 1.0
[farm.stress]
patches = 6
[farm.battery]
capacity = 8000.0
failsafe = 0.2
[farm.wind]
speed = 2.0
gusts = 1.0
[farm.zones]
random = 2
[farm.observation]
route = false
link = true
stress = true
charge = true
wind = true
zones = true
[farm.reward]
relayed = 0.2
[algorithm.hindsight]
monitoring = 1.0
collection = 0.8
"""
"""A farm with all of them: links that count, failures, stress, batteries, wind and no-fly zones."""

EIA_SEC: Final = """
episodes = 400
[farm.observation]
window = 5
peers = 0
last_move = false
closing = false
units = 0
fields = false
coarse = false
phases = false
route = false
service = false
[farm.control]
communication = "velocity"
monitoring = "lattice"
collection = "velocity"
[algorithm]
name = "eia-sec"
[elite]
farms = 4
[rollout]
environments = 8
chunk_steps = 20
spool_chunks = 8
"""
"""The paper's method, which learns from a replay buffer, with the settings that train it best."""

STUDY: Final = """
episodes = 1200
[farm.observation]
mirrored = false
[algorithm]
potential_discount = 0.0
[replay]
updates_per_step = 0.125
"""
"""The configuration in which studies compare methods, over `eia-sec`; PettingZoo and Gymnasium users get its farm.

It lists every field that departs from `eia-sec`. When a default changes, the old value moves there or here, because the
studies' records depend on it.
"""

PAPER: Final = """
episodes = 2000
[farm.observation]
form = "printed"
choice = "nearest"
window = 3
lattice = false
mirrored = false
identity = false
clock = false
[farm.control]
communication = "velocity"
monitoring = "velocity"
collection = "velocity"
[algorithm]
discount = 0.99
batch = 128
actor_rate = 1e-4
critic_rate = 1e-5
target_rate = 0.005
reward_scale = 1.0
potential_discount = 0.0
ensemble = true
ensemble_members = 2
ensemble_loss = "mixture"
ensemble_gradient = true
ensemble_copy_rate = 0.1
bootstrap = "local"
actor_objective = "local"
[elite]
enabled = true
rate = 0.1
cycle = 10
rate_decay = 0.5
cycle_growth = 2.0
farms = 1
[replay]
capacity = 65536
updates_per_step = 1.0
[exploration]
noise_std_start = 0.2
noise_std_end = 0.05
"""
"""The paper's Table 2 with the printed forms of W5, W24, A7, A8, A9 and A10, over `eia-sec`.

It lists every printed value of the method, so that tuning the defaults does not change it. Where the printed form
cannot work at all, it keeps our correction: the signs of W1 and W8, the rule of A1, and evaluation on farms that
training never saw (W26). Values that the paper does not give (marked "(ours)" in the dataclasses) are the defaults.
"""

_EIA_SEC: Final = from_toml(EIA_SEC, RunConfig())
_INSTANT: Final = from_toml(INSTANT, RunConfig())
_INERTIAL: Final = from_toml(INERTIAL, _INSTANT)
_PLANS: Final = from_toml(PLANS, _INSTANT)

PRESETS: Final[dict[str, RunConfig]] = {
    "inertial": _INERTIAL,
    "quick": from_toml(QUICK, _INERTIAL),
    "instant": _INSTANT,
    "generic": from_toml(GENERIC, RunConfig()),
    "long": from_toml(LONG, _PLANS),
    "connected": from_toml(CONNECTED, RunConfig()),
    "failing": from_toml(FAILING, _PLANS),
    "uneven": from_toml(UNEVEN, _PLANS),
    "battery": from_toml(BATTERY, _PLANS),
    "field": from_toml(FIELD, RunConfig()),
    "eia-sec": _EIA_SEC,
    "study": from_toml(STUDY, _EIA_SEC),
    "paper": from_toml(PAPER, _EIA_SEC),
    **{name: with_values(_EIA_SEC, changes) for name, changes in ABLATIONS.items()},
}
"""Every preset by name; those of `eia_sec.common.config.ablations` are `eia-sec` with a part switched off."""


def preset_for(environment: str) -> str:
    """Return the name of the preset with which an environment is trained where nobody names one."""
    return "inertial" if environment == FARM else "generic"


def preset(name: str) -> RunConfig:
    """Return the preset of this name; raise ConfigError when there is none."""
    if name not in PRESETS:
        meant = did_you_mean(name, PRESETS)
        raise ConfigError(f"there is no preset {name!r}{meant or '.'} The presets are {', '.join(PRESETS)}.")
    return PRESETS[name]
