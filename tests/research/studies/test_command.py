"""What `python -m research.studies` refuses."""

import pytest

from eia_sec.common.errors import EiaSecError
from research.studies.command import command


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ([], "nothing to reproduce"),
        (["harvest"], "no study 'harvest'"),
        (["training", "--jobs", "0"], "jobs must be"),
        (["training", "--seeds", "-1"], "seeds must be"),
        (["training", "--uavs", "6"], "--uavs is for scalability"),
        (["scalability", "--uavs", "2"], "uavs must be"),
        (["run"], "takes the command of a study"),
        (["run", "by hand", "nowhere.job.json"], "not a study's run"),
    ],
)
def test_a_mistake_is_one_sentence(arguments: list[str], said: str) -> None:
    """A mistake is refused before anything is run."""
    with pytest.raises(EiaSecError, match=said):
        command(arguments)
