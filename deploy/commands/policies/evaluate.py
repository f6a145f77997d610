"""`eia-sec evaluate`: fly a policy without noise on farms and print the result."""

import json
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Final

import tyro
from rich.console import Console

from eia_sec.common.config import RunConfig
from eia_sec.common.config.files import from_toml
from eia_sec.common.config.presets import PRESETS
from eia_sec.common.errors import PolicyError, RunDirError, UsageError
from eia_sec.common.farm import require_farm
from eia_sec.common.policy_file import POLICY, load_policy
from eia_sec.common.transport.endpoint import DEFAULT, Endpoint
from eia_sec.deploy.exit_codes import DONE
from eia_sec.deploy.local.run_directory import RunDirectory
from eia_sec.deploy.local.served_environments import reached, when_served
from eia_sec.deploy.options import NO_FARM, parse, require_env, with_farm_file, with_settings
from eia_sec.deploy.progress import part, progress
from eia_sec.deploy.reports.comparison_tables import comparison_table, scenario_word
from eia_sec.rollout.envs.base import Reach
from eia_sec.rollout.evaluation import Evaluation, evaluate_run
from eia_sec.rollout.heuristics.registry import RELAYS, TASKS
from eia_sec.rollout.policies import POLICIES, SampledPolicy, run_policy
from eia_sec.rollout.shipped_policies import is_file, preset_of

POLICY_HELP: Final = (
    f"{', '.join(POLICIES)}, a plug-in's heuristic, module:name of one, or a policy file; with --run-dir, instead of "
    f"the run's policy. TASK+RELAYS, a task being {', '.join(TASKS)} and relays {', '.join(RELAYS)}, names the relays "
    "too (docs/reference/heuristics.md). A policy of a preset flies that preset's farm, trained and heuristics that of "
    "inertial."
)
MAX_FARMS: Final = 100_000
DIGITS: Final = 19
"""Most digits of a farm's seed."""
MAX_EPISODES: Final = 1_000_000
"""Most episodes on all farms together; the score of each is held in memory."""


@dataclass(frozen=True)
class EvaluateArguments:
    """Fly a policy without noise on farms given by their seeds."""

    run_dir: Path | None = None
    """Run directory: its configuration and its newest policy."""
    policy: Annotated[str | None, tyro.conf.arg(help=POLICY_HELP)] = None
    against: Path | None = None
    """Run directory whose policy is evaluated as well, on the same episodes; without --run-dir in its environment."""
    farms: str = "1000:1020"
    """Farm seeds A:B, from A to B - 1; scenario seeds in other environments."""
    episodes: int = 1
    """Episodes on each farm."""
    env: str | None = None
    """Environment other than the farm, module:name; needed for runs that use one, because loading it runs its code."""
    endpoint: str = DEFAULT
    """Where environments connect to that others serve (--env zenoh:NAME); this command listens there meanwhile."""
    tls: Path | None = None
    """Folder with the learner's certificate, if those environments have certificates."""
    json: bool = False
    """Print JSON instead of a table."""
    config: Path | None = None
    """TOML file whose values override those of the run or the preset inertial."""
    farm_file: Path | None = None
    """CSV or GeoJSON file with the sensor positions; the seeds then determine starts, packets and phases."""
    set: tuple[str, ...] = ()
    """Single values that override everything else, for example farm.world.steps=100."""


def command(arguments: Sequence[str]) -> int:
    """Evaluate a policy and print the result; return 0."""
    options = parse(EvaluateArguments, arguments, "evaluate")
    found = evaluations(options)
    if options.json:
        first, *drawn = [evaluation.to_dict() for evaluation in found]
        against = {"against": drawn.pop()} if options.against is not None else {}
        sampled = {"sampled": drawn[0]} if drawn else {}
        sys.stdout.write(json.dumps({**first, **sampled, **against}, indent=2) + "\n")
    else:
        console = Console(markup=False, highlight=False)
        console.print(comparison_table(found, scenario_word(configuration_of(options))))
        if options.against is not None:
            console.print(difference(found[0], found[-1]), soft_wrap=True)
    return DONE


def difference(own: Evaluation, other: Evaluation) -> str:
    """Return a sentence about the difference of two policies' rewards on the same farms or scenarios."""
    pairs = zip(own.per_farm, other.per_farm, strict=True)
    apart = [replace(score, reward=score.reward - reference.reward) for score, reference in pairs]
    total = replace(own.total, reward=own.total.reward - other.total.reward)
    low, high = replace(own, per_farm=tuple(apart), total=total).interval
    return (
        f"{own.policy} minus {other.policy}: {total.reward:+.2f} per agent and episode (95 % interval {low:+.2f} to "
        f"{high:+.2f})"
    )


def evaluations(arguments: EvaluateArguments) -> list[Evaluation]:
    """Return the evaluation for the arguments, and for a policy file with a distribution that of drawn actions, too.

    A policy that has hardly learned may fail by its likeliest actions and do well by drawn ones.

    Raises:
        UsageError: something in the arguments does not exist or is impossible.
    """
    farms = parse_farms(arguments.farms)
    if arguments.episodes < 1:
        raise UsageError(f"--episodes must be 1 or more, not {arguments.episodes}.")
    if len(farms) * arguments.episodes > MAX_EPISODES:
        raise UsageError(
            f"{len(farms):,} farms with {arguments.episodes:,} episodes each are too many: at most {MAX_EPISODES:,} "
            "episodes on all farms together."
        )
    config = configuration_of(arguments)
    name = policy_name(arguments)
    shown = arguments.run_dir.name if arguments.run_dir and not arguments.policy else name
    policies = {shown: run_policy(name, config)}
    if is_file(Path(name)) and (actors := load_policy(Path(name))[0]).draws:
        policies[f"{shown}, sampled"] = SampledPolicy(actors)
    if arguments.against is not None:
        policies[f"against {arguments.against.name}"] = run_policy(_policy_in(arguments.against), config)
    episodes = arguments.episodes
    with _reach(arguments, config) as reach, progress("evaluating") as tell:
        return [
            evaluate_run(config, policy, farms, episodes, name=name, reach=reach, tell=part(tell, done, len(policies)))
            for done, (name, policy) in enumerate(policies.items())
        ]


@contextmanager
def _reach(arguments: EvaluateArguments, config: RunConfig) -> Iterator[Reach | None]:
    """Listen for environments that others serve, and wait for a first one; for others there is nothing to do."""
    if not config.env.served:
        yield None
        return
    from eia_sec.rollout.remote.served import copies_of  # noqa: PLC0415  (pettingzoo loads only for its users)

    endpoint = Endpoint.parse(arguments.endpoint, arguments.tls)
    endpoint.require_private(insecure=False, advice="choose a loopback address, such as tcp/127.0.0.1:7447")
    with reached(endpoint, "evaluate") as reach:
        when_served(config, endpoint, lambda: copies_of(reach, config.env.served))
        yield reach


def policy_name(arguments: EvaluateArguments) -> str:
    """Return the policy's name or the path of its file."""
    if arguments.policy is not None:
        return arguments.policy
    if arguments.run_dir is None:
        raise PolicyError("nothing to evaluate: give --run-dir DIR or --policy NAME.")
    return _policy_in(arguments.run_dir)


def _policy_in(run_dir: Path) -> str:
    """Return the path of a run's policy; raise RunDirError if it has none."""
    path = run_dir / POLICY
    if not path.is_file():
        raise RunDirError(f"{run_dir} has no {POLICY}: the run has not saved a policy yet.")
    return str(path)


def parse_farms(text: str) -> range:
    """Return the farm seeds that A:B names.

    Raises:
        UsageError: it is not A:B with 0 <= A < B, or names more than MAX_FARMS farms.
    """
    first, colon, end = text.partition(":")
    first, end = first.strip(), end.strip()
    if not (colon and first.isdecimal() and end.isdecimal() and max(len(first), len(end)) <= DIGITS):
        raise UsageError(f"--farms must be A:B with whole numbers, 1000:1020 for instance, not {text!r}.")
    farms = range(int(first), int(end))
    if not farms:
        raise UsageError(f"--farms {text} names no farm: B must be larger than A.")
    if farms.stop - farms.start > MAX_FARMS or farms.stop > 2**63:
        raise UsageError(f"--farms {text} is out of range: at most {MAX_FARMS:,} farms, seeds below 2^63.")
    return farms


def configuration_of(arguments: EvaluateArguments, farm_only: str | None = None) -> RunConfig:
    """Return the run's or the preset's configuration with the two files' and the single values in it.

    Args:
        arguments: the options.
        farm_only: for a command that works only with the farm, its complaint for `eia_sec.common.farm.require_farm`.

    Raises:
        UsageError: something in the arguments does not exist or is impossible.
    """
    config = PRESETS[preset_of(arguments.policy)]
    folder = arguments.run_dir or arguments.against
    if folder is not None:
        config = RunDirectory(folder).configuration()
    if arguments.config is not None:
        config = from_toml(arguments.config, config)
    if farm_only is not None:
        require_farm(config, farm_only)
    require_env(config, arguments.env)
    if arguments.env is not None:
        config = replace(config, env=replace(config.env, name=arguments.env))
    if arguments.farm_file is not None:
        config = with_farm_file(config, arguments.farm_file)
    config = with_settings(config, arguments.set)
    if arguments.farm_file is not None:
        require_farm(config, NO_FARM)  # --set may have named another environment
    return config
