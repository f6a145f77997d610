"""What `eia-sec fleet render prometheus` writes asks for figures that there are, and Prometheus takes it."""

import json
import re
import shutil
import stat
import subprocess
from pathlib import Path

import pytest
import yaml

from eia_sec.deploy.commands.fleet.fleet import command
from eia_sec.deploy.commands.monitoring.monitor import MonitorArguments
from eia_sec.deploy.monitor.openmetrics import STATES, RunCollector
from eia_sec.deploy.options import parse
from tests.deploy.monitor.test_live_view import SNAPSHOT

FLEET = """
run = "field_1"
[training]
preset = "quick"
[network]
endpoint = "tcp/127.0.0.1:7447"
[learner]
host = "here"
[hosts.here]
host = "local"
workers = 1
"""
SERIES = {
    'eia_sec_unexplained_steps{run="field_1"}': "0x30 500x60",
    'eia_sec_accepted_steps{run="field_1"}': "0+100x30 3000x90",
    'eia_sec_lost_steps{run="field_1"}': "0x120",
    'eia_sec_run_state{run="field_1", eia_sec_run_state="training"}': "1x120",
    'eia_sec_process_up{run="field_1", role="learner", name="learner", host="here"}': "1x60 0x2 stale",
    'eia_sec_process_trouble{run="field_1", role="rollout", name="0", host="here"}': "0x72 1x3 stale",
    'up{job="eia-sec-field_1"}': "1x120",
}
"""A sample every ten seconds: the ledger stops to add up after five minutes, the learner goes after ten, a worker
after twelve. What is gone for half a minute is no longer served."""
FIRING = {
    "4m": (),
    "8m": ("StepsUnexplained",),
    "13m": ("LearnerGone", "ProcessInTrouble", "StepsUnexplained"),
    "19m": ("LearnerGone", "NoProgress", "StepsUnexplained"),
}


@pytest.fixture
def rendered(tmp_path: Path) -> Path:
    """The folder of the files of a small fleet."""
    (tmp_path / "fleet.toml").write_text(FLEET, encoding="utf-8")
    folder = tmp_path / "rendered"
    assert command(["render", "prometheus", str(tmp_path / "fleet.toml"), "--out", str(folder)]) == 0
    return folder


def test_every_name_that_is_asked_for_is_served(rendered: Path) -> None:
    """Rules and panels name families and states of the collector, with the fleet's run."""
    collector = RunCollector("field_1")
    collector.show(SNAPSHOT)
    served = {family.name for family in collector.collect()}
    rules = yaml.safe_load((rendered / "alerts.yml").read_text())["groups"][0]["rules"]
    panels = json.loads((rendered / "dashboard.json").read_text())["panels"]
    asked = [rule["expr"] for rule in rules] + [target["expr"] for panel in panels for target in panel["targets"]]
    names = {name for expression in asked for name in re.findall(r"eia_sec_\w+(?=\{)", expression)}
    assert names <= served
    assert len(names) > 15
    assert set(re.findall(r'eia_sec_run_state="([^"]+)"', " ".join(asked))) <= set(STATES)
    assert all('run="field_1"' in expression or "eia-sec-field_1" in expression for expression in asked)
    assert len({(panel["gridPos"]["x"], panel["gridPos"]["y"]) for panel in panels}) == len(panels)


def test_the_command_that_serves_them_is_said(tmp_path: Path, rendered: Path, capsys: pytest.CaptureFixture) -> None:
    """It is one that the monitor understands, at the port that is scraped; other users may read the files."""
    assert command(["render", "prometheus", str(tmp_path / "fleet.toml"), "--out", str(rendered)]) == 0
    said = capsys.readouterr().out.splitlines()[-1].split("eia-sec monitor ")[1].split()
    options = parse(MonitorArguments, said, "monitor")
    scraped = yaml.safe_load((rendered / "prometheus.yml").read_text())["scrape_configs"][0]
    assert scraped["static_configs"] == [{"targets": [f"localhost:{options.openmetrics}"]}]
    assert (options.run, options.connect) == ("field_1", "tcp/127.0.0.1:7447")
    assert {stat.S_IMODE(path.stat().st_mode) for path in rendered.iterdir()} == {0o644}


@pytest.mark.skipif(shutil.which("promtool") is None, reason="promtool, of Prometheus, is not installed")
def test_prometheus_takes_the_files_and_alerts_when_it_should(rendered: Path) -> None:
    """Its own tool reads configuration and rules, and runs the rules over made-up samples."""
    tests = {
        "rule_files": ["alerts.yml"],
        "evaluation_interval": "10s",
        "tests": [
            {
                "interval": "10s",
                "input_series": [{"series": name, "values": values} for name, values in SERIES.items()],
                "promql_expr_test": [
                    {
                        "expr": 'count by (alertname) (ALERTS{alertstate="firing"})',
                        "eval_time": at,
                        "exp_samples": [{"labels": f'{{alertname="EiaSec{name}"}}', "value": 1} for name in names],
                    }
                    for at, names in FIRING.items()
                ],
            }
        ],
    }
    (rendered / "tests.yml").write_text(yaml.safe_dump(tests), encoding="utf-8")
    for words in (
        ["check", "config", "prometheus.yml"],
        ["check", "rules", "alerts.yml"],
        ["test", "rules", "tests.yml"],
    ):
        done = subprocess.run(["promtool", *words], cwd=rendered, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stdout + done.stderr
