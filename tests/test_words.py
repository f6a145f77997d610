"""Names and prose use the field's words, and folders stay small."""

import io
import re
import subprocess
import tokenize
from collections import Counter
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
FOLDERS = ("common", "rollout", "learner", "elite", "deploy", "research", "tests", "docs")
MOST_MODULES = 15
"""Python modules on a folder's own floor, its __init__ left out."""

NAMES = frozenset(
    {
        "appraise",
        "appraised",
        "bank",
        "banks",
        "bookkeeping",
        "climb",
        "climbed",
        "climbing",
        "climbs",
        "crew",
        "crews",
        "desk",
        "figures",
        "lens",
        "offender",
        "offenders",
        "onlooker",
        "onlookers",
        "overdue",
        "rehearsal",
        "rehearse",
        "rounds",
        "slope",
        "slopes",
        "tarpit",
        "tell",
        "telling",
        "tells",
        "throwing",
        "thrown",
        "told",
    }
)
"""Words that no name contains; `figure` is matplotlib's, and `round` Python's."""
EARLIER = {
    "learner/checkpoint/trainer_state.py": "figures",
    "tests/learner/test_trainer.py": "figures",
    "common/history/history.py": "told",
    "tests/common/test_history.py": "told",
}
"""Files that read what earlier versions wrote, and the word that these used."""
LEARNER_NAMES = frozenset(("choose", "decide", "decided"))
"""Words that no name of an algorithm contains."""
PROSE = re.compile(
    r"\b(tell|tells|telling|told|desk|tarpit|offenders?|onlookers?|rehears\w+|bookkeeping|appraise\w*|crews?"
    r"|update rounds?|rounds? due|gradient rounds?|figures|throws? a farm|thrown|rows pay|what rows pay)\b",
    re.IGNORECASE,
)
"""Words that no docstring, comment or page contains."""
WORD = re.compile(r"[A-Z]+(?![a-z])|[A-Z]?[a-z]+")


def ours(*endings: str) -> list[str]:
    """Return the files under version control, or new, with these endings; results, the log and this file left out."""
    listed = subprocess.run(
        ["git", "ls-files", "--cached", "--others", "--exclude-standard"],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=True,
    )
    return [
        name
        for name in listed.stdout.splitlines()
        if name.endswith(endings)
        and (name.split("/")[0] in FOLDERS or name == "README.md")
        and not name.startswith("research/results/")
        and name != "tests/test_words.py"
        and (ROOT / name).exists()
    ]


def private_words(name: str, text: str) -> list[str]:
    """Return every private word of a Python file, with its line."""
    banned = NAMES | (LEARNER_NAMES if name.startswith("learner/algorithms/") else frozenset())
    found = []
    for token in tokenize.generate_tokens(io.StringIO(text).readline):
        if token.type == tokenize.NAME and not token.line[token.start[1] :].startswith("tell()"):  # a file's position
            words = {word.lower() for word in WORD.findall(token.string)}
            found += [f"{name}:{token.start[0]}: {token.string}" for _ in words & banned]
        elif token.type in (tokenize.COMMENT, tokenize.STRING, getattr(tokenize, "FSTRING_MIDDLE", -1)):
            hits = [match[0] for match in PROSE.finditer(token.string) if match[0] != EARLIER.get(name)]
            found += [f"{name}:{token.start[0]}: {hit}" for hit in hits]
    return found


@pytest.mark.parametrize("folder", FOLDERS)
def test_python_uses_the_words_of_the_field(folder):
    """No name, docstring, comment or message of a folder holds a private word."""
    files = [name for name in ours(".py") if name.startswith(f"{folder}/")]
    assert [hit for name in files for hit in private_words(name, (ROOT / name).read_text())] == []


def test_pages_use_the_words_of_the_field():
    """No page holds a private word."""
    hits = [
        f"{name}:{number}: {match[0]}"
        for name in ours(".md")
        if name != "research/LOG.md"
        for number, line in enumerate((ROOT / name).read_text().splitlines(), 1)
        for match in PROSE.finditer(line)
    ]
    assert hits == []


def test_a_private_word_would_be_found():
    """A name, a docstring and a comment with a private word are each found."""
    text = 'def tell_offenders():\n    """Nothing is told."""\n    x = round(1.0)  # a crew\n'
    assert len(private_words("common/x.py", text)) == 4


def test_folders_are_small():
    """No folder has more than 15 modules on its own floor."""
    floors = Counter(str(Path(name).parent) for name in ours(".py") if not name.endswith("__init__.py"))
    assert {folder: count for folder, count in floors.items() if count > MOST_MODULES} == {}
