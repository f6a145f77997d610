"""Two policies on the same episode, as a film and as plots of their paths."""

from collections.abc import Callable, Iterator
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path

from eia_sec.common.config import FarmConfig
from eia_sec.common.errors import UsageError
from eia_sec.deploy.progress import part
from eia_sec.deploy.reports.film import Film
from eia_sec.deploy.reports.plots import save_comparison
from eia_sec.rollout.evaluation import episode_seed, record
from eia_sec.rollout.heuristics.farms import make_farms
from eia_sec.rollout.policies import policy_of
from eia_sec.rollout.rendering.scene import Observer, Scene
from eia_sec.rollout.rendering.side_by_side import SideBySidePicture


@dataclass(frozen=True)
class Comparison:
    """Two policies, and the episode that both fly.

    Attributes:
        config: the farm.
        policies: names or files; see `eia_sec.rollout.policies.policy_of`.
        names: their labels in the film and plots.
        farm: seed of the farm.
        episode: number of the episode on it, that of `eia-sec evaluate`.
    """

    config: FarmConfig
    policies: tuple[str, str]
    names: tuple[str, str]
    farm: int
    episode: int


def scenes_of(comparison: Comparison) -> Iterator[tuple[Scene, Scene]]:
    """Yield both farms after the reset and after each step."""
    own, other = (_flight(comparison, policy) for policy in comparison.policies)
    yield from zip(own, other, strict=True)


def film(
    comparison: Comparison, path: Path, rate: float, every: int, tell: Callable[[float], None] = lambda share: None
) -> None:
    """Write a film with a frame every few steps, and one of the last step.

    Args:
        comparison: the policies and the episode.
        path: the file, .mp4 or .gif.
        rate: frames per second.
        every: environment steps per frame.
        tell: called after each step with the share of the film that is done, 0 to 1.

    Raises:
        PolicyError: a policy does not exist or does not fit the farm.
        UsageError: there is no ffmpeg, or the file cannot be written.
    """
    last, picture = comparison.config.world.steps, None
    with ExitStack() as stack:
        for scenes in scenes_of(comparison):
            if picture is None:
                picture = SideBySidePicture(comparison.names, scenes)
                reel = stack.enter_context(Film(path, picture.size, rate))
            picture.note(scenes)
            if scenes[0].step % every == 0 or scenes[0].step == last:
                reel.add(picture.draw(scenes))
            tell(scenes[0].step / last)


def paper_pictures(
    comparison: Comparison, paths: list[Path], tell: Callable[[float], None] = lambda share: None
) -> None:
    """Save the final state with all paths, both policies side by side, PNG or PDF by the files' endings.

    Args:
        comparison: the policies and the episode.
        paths: the files.
        tell: called with the share of both flights that is done, 0 to 1.

    Raises:
        PolicyError: a policy does not exist or does not fit the farm.
        UsageError: a file cannot be written.
    """
    flown = [
        record(
            comparison.config,
            policy_of(policy, comparison.config),
            comparison.farm,
            comparison.episode,
            part(tell, done, len(comparison.policies)),
        )
        for done, policy in enumerate(comparison.policies)
    ]
    try:
        for path in paths:
            path.parent.mkdir(parents=True, exist_ok=True)
            save_comparison(dict(zip(comparison.names, flown, strict=True)), path)
    except OSError as error:
        raise UsageError(f"{path} cannot be written: {error.strerror}.") from error


def _flight(comparison: Comparison, name: str) -> Iterator[Scene]:
    batch, policy = make_farms(comparison.config, 1), policy_of(name, comparison.config)
    observer = Observer(batch, 0)
    batch.reset(0, comparison.farm, episode_seed(comparison.farm, comparison.episode))
    policy.reset(batch, 0)
    observer.observe()
    yield observer.scene()
    while not batch.ended.all():
        batch.step(policy.act(batch))
        observer.observe()
        yield observer.scene()
