"""The pictures in the documentation show the policy that ships."""

import json

from eia_sec.common.policy_file import load_policy
from eia_sec.rollout.shipped_policies import shipped_file
from research.pages.pictures import FOLDER, SHOWN


def test_the_pictures_are_of_the_policy_that_ships():
    """Whoever ships another policy makes the pictures anew."""
    notes = json.loads((FOLDER / "pictures.json").read_text(encoding="utf-8"))
    assert load_policy(shipped_file(SHOWN))[0].digest().startswith(notes["policy"])
    assert len(notes["policy"]) == 16
    assert {path.name for path in FOLDER.glob("*.png")} >= {"watch.png", "watch-mpe.png", "replay.png"}
