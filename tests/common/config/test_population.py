"""The section `[population]`: hyperparameters and their ranges are checked against the algorithm."""

import pytest

from eia_sec.common.config import RunConfig
from eia_sec.common.config.files import from_toml, read_saved, to_toml, with_values
from eia_sec.common.errors import ConfigError

TABLE = """
[population]
members = 4
[population.hyperparameters]
actor_rate = [1e-4, 1e-2]
entropy_start = [1e-3, 0.1]
"""


def config(text: str = TABLE) -> RunConfig:
    """Return a configuration with this text."""
    return from_toml(text, RunConfig())


def test_a_table_names_hyperparameters_and_their_ranges():
    """It survives being written and read, and members share a seed of networks that a run alone has by itself."""
    found = config()
    assert dict(found.population.hyperparameters) == {"actor_rate": (1e-4, 1e-2), "entropy_start": (1e-3, 0.1)}
    assert read_saved(to_toml(found)) == found
    member = with_values(found, {"seed": 7, "population.seed": 3})
    assert (member.network_seed, RunConfig(seed=7).network_seed) == (3, 7)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (
            "discount = [0.9, 0.99]",
            "names discount, which ippo cannot change while it learns; it can change actor_rate",
        ),
        ("actor_rate = [1e-2, 1e-4]", "must be the lowest and the highest value"),
        ("actor_rate = [1e-4]", "must be the lowest and the highest value"),
        ("actor_rate = [0.0, 1e-2]", "hyperparameters.actor_rate must be above 0"),
        ("actor_rate = [2e-2, 3e-2]", "0.001, with which member 0 begins, lies outside population.hyperparameters"),
        ("gae_lambda = [0.9, 1.5]", "gae_lambda must be between 0.0 and 1.0, not 1.5"),
        ("actor_rate = 1e-3", "must be a list of numbers"),
    ],
)
def test_an_impossible_range_is_refused(text, said):
    """In one sentence, before any process starts."""
    with pytest.raises(ConfigError) as refused:
        config(f"[population]\nmembers = 2\n[population.hyperparameters]\n{text}\n")
    assert said in str(refused.value)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("members = 1", "members must be 2 or more, or 0 for a run alone"),
        ("members = 65", "members must be between 0 and 64"),
        ("perturbation = 0.5", "perturbation must be between 1.0 and 10.0"),
        ("rate = 1.5", "rate must be between 0.0 and 1.0"),
        ("interval = 0.0", "interval must be between 0.001 and 1.0"),
    ],
)
def test_an_impossible_population_is_refused(text, said):
    """Likewise."""
    with pytest.raises(ConfigError, match=said):
        config(f"[population]\n{text}\n")


def test_an_algorithm_off_policy_changes_its_rates():
    """Its other options are refused, as it builds them in."""
    off_policy = RunConfig().with_algorithm("eia-sec")
    ranges = "[population]\nmembers = 2\n[population.hyperparameters]\n"
    assert from_toml(f"{ranges}critic_rate = [1e-4, 1e-2]\n", off_policy).population.hyperparameters
    with pytest.raises(ConfigError, match="names clip, which eia-sec cannot change"):
        from_toml(f"{ranges}clip = [0.1, 0.3]\n", off_policy)
