"""The page on the environment: its tables are those of the code, its code runs, and its picture is what it says."""

import re
from pathlib import Path

import matplotlib.image
import numpy as np
import pytest

from eia_sec.common.config import FarmConfig, ObservationConfig, RewardConfig
from eia_sec.rollout.envs.parallel_env import parallel_env
from research.pages.environment_tables import picture, spaces_table

ROOT = Path(__file__).resolve().parents[3]
PAGE = "docs/reference/environment.md"


def code_blocks(document):
    return re.findall(r"^```python\n(.*?)^```", (ROOT / document).read_text(encoding="utf-8"), re.M | re.S)


@pytest.mark.parametrize(("document", "number"), [(PAGE, 5), ("README.md", 1)])
def test_the_code_of_a_page_runs(document, number):
    """All blocks of a page run one after another, and leave a finished environment or frames behind."""
    blocks, names = code_blocks(document), {}
    assert len(blocks) == number
    for block in blocks:
        exec(compile(block, str(document), "exec"), names)  # the page's own code is what this test is about
    assert names["observations"]
    if document == PAGE:
        assert len(names["frames"]) == 5
        assert not np.array_equal(names["frames"][0], names["frames"][-1])


@pytest.mark.parametrize(
    "config",
    [FarmConfig(), FarmConfig(observation=ObservationConfig(form="printed"), reward=RewardConfig(nearest="any"))],
)
def test_the_table_counts_every_number(config):
    """The numbers of each type's rows add up to its space, and bounds are the space's."""
    farm = parallel_env(config)
    sizes, bounds, name = {}, {}, ""
    for line in spaces_table(config).splitlines()[2:]:
        cells = [cell.strip() for cell in line.strip("|").split("|")]
        name = cells[0].split("_0`")[0].strip("`") or name
        times, _, size = cells[2].rpartition(" x ")
        sizes[name] = sizes.get(name, 0) + int(times or 1) * int(size)
        bounds.setdefault(name, []).append((float(cells[3]), float(cells[4])))
    for kind, total in sizes.items():
        space = farm.observation_space(f"{kind}_0")
        assert space.shape == (total,)
        assert min(low for low, _ in bounds[kind]) == pytest.approx(space.low.min(), abs=1e-4)
        assert max(high for _, high in bounds[kind]) == pytest.approx(space.high.max(), abs=1e-4)
    assert len(sizes) == 3


def test_the_committed_picture_is_a_rendered_farm():
    """The picture of the page is what the renderer draws, as far as fonts allow."""
    kept = matplotlib.image.imread(ROOT / "docs/images/farm.png")
    assert picture().shape[:2] == kept.shape[:2]
    assert np.abs(picture() / 255.0 - kept[..., :3]).mean() < 0.002
