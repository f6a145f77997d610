"""The house rules, as far as a program can hold them."""

import ast
import functools
import importlib.util
import itertools
import re
import subprocess
import sys
import tokenize
import tomllib
import zipfile
from importlib.metadata import distributions, packages_distributions
from pathlib import Path

import pytest
from packaging.specifiers import SpecifierSet
from packaging.utils import canonicalize_name

ROOT = Path(__file__).resolve().parents[1]
PACKAGES = {
    "common": {"common"},
    "rollout": {"rollout", "common"},
    "learner": {"learner", "common"},
    "elite": {"elite", "common"},
    "deploy": {"deploy", "common", "rollout", "learner", "elite"},
}
NOT_OURS = {".git", ".venv", ".venvs", "runs", "dist", "build", "__pycache__"}
SOURCE_FILES = sorted(
    path.relative_to(ROOT).as_posix()
    for folder in (*PACKAGES, "tests", "research")
    for path in (ROOT / folder).rglob("*.py")
    if ".venvs" not in path.parts
)
PACKAGE_FILES = [name for name in SOURCE_FILES if name.split("/")[0] in PACKAGES]
TEST_FILES = [name for name in SOURCE_FILES if name.startswith("tests/")]

FORBIDDEN_MODULES = {"pickle", "_pickle", "cPickle", "dill", "cloudpickle", "joblib", "shelve", "marshal"}
FORBIDDEN_CALLS = {"torch.load", "torch.save"}


@functools.cache
def providers() -> dict[str, list[str]]:
    """Return the distributions that provide each installed module."""
    return {module: [name.lower() for name in names] for module, names in packages_distributions().items()}


@functools.cache
def tree(name: str) -> ast.Module:
    return ast.parse((ROOT / name).read_text())


def imports(module: ast.AST) -> set[str]:
    """Return the dotted names of all modules that a module imports anywhere."""
    found = set()
    for node in ast.walk(module):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.level == 0 and node.module:
            found |= {node.module} | {f"{node.module}.{alias.name}" for alias in node.names}
    return found


def top_levels(module: ast.AST) -> set[str]:
    return {name.split(".")[0] for name in imports(module)}


def our_packages(module: ast.AST) -> set[str]:
    """Return which of our five packages, of the laboratory and of the tests a module imports."""
    ours = {name.split(".")[1] for name in imports(module) if name.startswith("eia_sec.")}
    return ours & set(PACKAGES) | top_levels(module) & {"tests", "research"}


def imports_relatively(module: ast.AST) -> bool:
    return any(isinstance(node, ast.ImportFrom) and node.level for node in ast.walk(module))


def pickles(module: ast.AST) -> list[str]:
    """Return every use of pickle and its kin in a module."""
    found = sorted(top_levels(module) & FORBIDDEN_MODULES)
    found += sorted(imports(module) & FORBIDDEN_CALLS)
    for node in ast.walk(module):
        if isinstance(node, ast.Attribute) and ast.unparse(node) in FORBIDDEN_CALLS:
            found.append(ast.unparse(node))
        if isinstance(node, ast.keyword) and node.arg == "allow_pickle" and ast.unparse(node.value) != "False":
            found.append("allow_pickle")
    return found


def suppressions_without_reason(path: Path) -> list[str]:
    """Return the comments that silence a checker without saying why."""
    silent = re.compile(r"(?:noqa(?::\s*[A-Z]+\d+(?:\s*,\s*[A-Z]+\d+)*)?|type:\s*ignore(?:\[[^\]]*\])?)(.*)")
    with path.open("rb") as source:
        comments = [token.string for token in tokenize.tokenize(source.readline) if token.type == tokenize.COMMENT]
    matches = [(comment, silent.search(comment.lstrip("# "))) for comment in comments]
    return [comment for comment, match in matches if match and len(match[1].strip(" #-:,")) < 10]


def run(*arguments: str, folder: Path = ROOT) -> subprocess.CompletedProcess[str]:
    return subprocess.run([sys.executable, "-m", *arguments], cwd=folder, capture_output=True, text=True, check=False)


def test_import_direction():
    """Common imports none of ours; rollout, learner and elite only common; none imports tests or the laboratory."""
    wrong = {name: our_packages(tree(name)) - PACKAGES[name.split("/")[0]] for name in PACKAGE_FILES}
    assert {name: packages for name, packages in wrong.items() if packages} == {}
    assert [name for name in PACKAGE_FILES if imports_relatively(tree(name))] == []


def test_one_module_knows_zenoh():
    """Exactly one module of the packages imports zenoh, and it lies in common."""
    users = [name for name in PACKAGE_FILES if "zenoh" in top_levels(tree(name))]
    assert len(users) == 1
    assert users[0].startswith("common/")


def test_imports_are_declared_dependencies():
    """The packages import the standard library, each other, and what pyproject.toml declares, extras too."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    extras = {name: texts for name, texts in project["optional-dependencies"].items() if name != "dev"}
    texts = [*project["dependencies"], *(text for group in extras.values() for text in group)]
    declared = {re.split(r"[<>=!~\[; ]", text)[0].lower() for text in texts}
    ours = set(sys.stdlib_module_names) | {"eia_sec"}
    foreign = {module: name for name in PACKAGE_FILES for module in top_levels(tree(name)) - ours}
    # An extra that is not installed here has the name of its module.
    by_module = {module: providers().get(module, [module]) for module in foreign}
    assert {module: foreign[module] for module, names in by_module.items() if not declared.intersection(names)} == {}


def test_no_pickle():
    """Nothing pickles or unpickles, by whatever name."""
    assert {name: found for name in SOURCE_FILES if (found := pickles(tree(name)))} == {}


@pytest.mark.parametrize(
    "code",
    [
        "import pickle",
        "from joblib import dump",
        "import torch\ntorch.load(path)",
        "from torch import save",
        "import numpy as np\nnp.load(path, allow_pickle=True)",
    ],
)
def test_pickle_would_be_found(code):
    """Each kind of pickling is found by the rule above."""
    assert pickles(ast.parse(code))


def test_suppressions_have_a_reason():
    """Whatever silences a checker says why, beside it."""
    assert {name: found for name in SOURCE_FILES if (found := suppressions_without_reason(ROOT / name))} == {}


def test_suppression_without_reason_would_be_found(tmp_path):
    """A bare suppression is found by the rule above, and one with its reason is not."""
    path = tmp_path / "code.py"
    bare = ["# " + "noqa", "# " + "noqa: E501", "# " + "type: ignore[arg-type]"]
    path.write_text("".join(f"x = 1  {comment}\ny = 2  {comment}  # the reason stands here\n" for comment in bare))
    assert suppressions_without_reason(path) == bare


def test_tests_say_what_they_hold_and_hold_it():
    """Every test has a docstring of one sentence, and asserts or expects a refusal."""
    tests = [
        (f"{name}::{node.name}", node)
        for name in TEST_FILES
        for node in ast.walk(tree(name))
        if isinstance(node, ast.FunctionDef) and node.name.startswith("test_")
    ]
    mute = [name for name, test in tests if not (ast.get_docstring(test) or "").endswith(".")]
    idle = [name for name, test in tests if not any(map(holds_something, ast.walk(test)))]
    assert (mute, idle) == ([], [])


def holds_something(node: ast.AST) -> bool:
    if isinstance(node, ast.Call):
        called = ast.unparse(node.func).rpartition(".")[2]
        return called == "raises" or called.lstrip("_").startswith(("assert", "check", "expect"))
    return isinstance(node, ast.Assert)


@pytest.mark.parametrize(
    "command",
    [("ruff", "check", "."), ("ruff", "format", "--check", "."), ("mypy",)],
    ids=["ruff check", "ruff format", "mypy"],
)
def test_checkers_pass(command):
    """Ruff and strict mypy have nothing to say."""
    result = run(*command)
    assert result.returncode == 0, result.stdout + result.stderr


def test_no_machine_path_and_no_registry_host():
    """No text file names a folder of somebody's machine or the host of a package registry."""
    machine = re.compile(r"(?<![\w.~\-])/(?:work|root|home|opt)/")
    registry = re.compile(
        "|".join(re.escape(host) for host in ("pypi" + ".org", "pytorch" + ".org/whl", "python" + "hosted"))
    )
    found = []
    for path in ROOT.rglob("*"):
        name = path.relative_to(ROOT).as_posix()
        hidden = set(path.relative_to(ROOT).parts) & NOT_OURS or name.startswith((".mypy", ".ruff", ".pytest", ".hypo"))
        if hidden or not path.is_file():
            continue
        text = path.read_bytes().decode("utf-8", errors="ignore")
        temporary = name in PACKAGE_FILES and "/tmp/" in text
        if machine.search(text) or registry.search(text) or temporary:
            found.append(name)
    assert found == []


def test_one_import_name_leads_to_the_five_folders():
    """`eia_sec` is this checkout's, its folders are those at the top, and no other name is on the path."""
    assert set(providers().get("eia_sec", [])) <= {"eia-sec"}
    for package in PACKAGES:
        origin = importlib.util.find_spec(f"eia_sec.{package}").origin
        assert Path(origin).resolve().parent == ROOT / package
        assert "eia-sec" not in providers().get(package, [])


def test_wheel_holds_the_packages_and_nothing_else(tmp_path):
    """The wheel holds `eia_sec` with every file of the five folders, the licence and the command, and nothing else."""
    result = run("hatchling", "build", "-t", "wheel", "-d", str(tmp_path))
    assert result.returncode == 0, result.stderr
    (wheel,) = tmp_path.glob("*.whl")
    with zipfile.ZipFile(wheel) as archive:
        names = set(archive.namelist())
        (commands,) = (archive.read(name).decode() for name in names if name.endswith("/entry_points.txt"))
    metadata = {name for name in names if name.split("/")[0].endswith(".dist-info")}
    sources = {"eia_sec/__init__.py", "eia_sec/remote.py", "eia_sec/py.typed"} | {
        f"eia_sec/{path.relative_to(ROOT).as_posix()}"
        for package in PACKAGES
        for path in (ROOT / package).rglob("*")
        if path.is_file() and "__pycache__" not in path.parts
    }
    assert names - metadata == sources
    assert any(name.endswith("/licenses/LICENSE") for name in metadata)
    assert "eia-sec = eia_sec.deploy.cli:main" in commands


def test_constraints_pin_every_direct_dependency():
    """Every direct dependency is pinned to one version in constraints.txt, and the pinned version is an allowed one."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    direct = [*project["dependencies"], *itertools.chain(*project["optional-dependencies"].values())]
    lines = (ROOT / "constraints.txt").read_text().splitlines()
    pins = dict(line.split("==") for line in lines if line and not line.startswith("#"))
    assert all(re.fullmatch(r"[0-9.]+", version) for version in pins.values())
    assert {re.split(r"[<>=]", text)[0] for text in direct} - set(pins) == set()


def test_pinned_packages_run_on_the_oldest_python_that_is_promised():
    """Nothing that is installed here needs a later one, so that setting up does not fail there."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    oldest = project["requires-python"].removeprefix(">=") + ".0"
    lines = (ROOT / "constraints.txt").read_text().splitlines()
    pinned = {canonicalize_name(line.partition("==")[0]) for line in lines if not line.startswith("#")}
    found = {canonicalize_name(each.name): each.metadata.get("Requires-Python") for each in distributions()}
    needs = {name: need for name, need in found.items() if name in pinned and need}
    assert {"torch", "numpy", "typing-extensions"} <= set(needs)
    assert [name for name, need in needs.items() if not SpecifierSet(need).contains(oldest)] == []
