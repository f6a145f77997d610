"""What watches a fleet with Prometheus and Grafana: a scrape configuration, alert rules and a dashboard.

The figures are those of `eia-sec monitor --openmetrics`, see `eia_sec.deploy.monitor.openmetrics`.
"""

import json
import shlex
from typing import Any, Final

from eia_sec.deploy.hosts.containers import as_yaml
from eia_sec.deploy.hosts.fleet_file import FleetSpec

PORT: Final = 9464
"""Port of the figures; the one that OpenTelemetry's exporter for Prometheus has."""
SCRAPE: Final = "10s"

_ALERTS: Final = (
    ("StepsUnexplained", "critical", "1m", "eia_sec_unexplained_steps{$} != 0", "The ledger does not add up."),
    (
        "LearnerGone",
        "critical",
        "1m",
        'max_over_time(eia_sec_process_up{$, role="learner"}[30m]) == 1 '
        'unless on (run) (eia_sec_process_up{$, role="learner"} == 1) '
        'unless on (run) max_over_time(eia_sec_run_state{$, eia_sec_run_state=~"draining|finished"}[30m]) == 1',
        "The learner is gone, and the run was neither finished nor asked to stop.",
    ),
    (
        "RunWithoutLearner",
        "critical",
        "1m",
        'eia_sec_run_state{$, eia_sec_run_state="without learner"} == 1',
        "Workers hold the parameters of a learner that is not there.",
    ),
    (
        "NoProgress",
        "critical",
        "5m",
        "delta(eia_sec_accepted_steps{$}[5m]) <= 0 and on (run) "
        'eia_sec_run_state{$, eia_sec_run_state="training"} == 1',
        "The learner trains and has accepted no step for five minutes.",
    ),
    ("StepsLost", "warning", "0m", "delta(eia_sec_lost_steps{$}[10m]) > 0", "Steps were lost, and counted."),
    (
        "ProcessInTrouble",
        "warning",
        "0m",
        "sum_over_time(eia_sec_process_trouble{$}[2m]) >= 3",
        "{{ $labels.role }} {{ $labels.name }} on {{ $labels.host }} is gone, silent, far behind or slow.",
    ),
    ("Alarms", "warning", "5m", "eia_sec_alarms{$} > 0", "The monitor shows alarms; `eia-sec monitor` has their text."),
    ("MonitorDown", "warning", "2m", 'up{job="eia-sec-@"} == 0', "Nobody serves the run's figures."),
)
"""Name, severity, how long it must hold, expression, meaning; `$` stands for the run's label, `@` for its name."""
_PANELS: Final = (
    ("Reward per agent", "none", (("eia_sec_reward{$}", "{{type}}"),)),
    ("Score omega of elites", "none", (("eia_sec_elite_score{$}", "{{type}}"),)),
    ("Progress", "percentunit", (("eia_sec_run_progress_ratio{$}", "done"),)),
    (
        "Steps a second",
        "none",
        (
            ('sum(eia_sec_process_rate{$, role="rollout"})', "simulated"),
            ("deriv(eia_sec_accepted_steps{$}[1m])", "accepted"),
        ),
    ),
    (
        "Waiting",
        "percentunit",
        (("eia_sec_learner_wait_ratio{$}", "learner"), ("eia_sec_worker_wait_ratio{$}", "workers")),
    ),
    ("Age of the newest chunks' policies, versions", "none", (("eia_sec_lag_versions{$}", "mean"),)),
    (
        "Steps that were not learned from",
        "none",
        (
            ("eia_sec_lost_steps{$}", "lost"),
            ("eia_sec_rejected_steps{$}", "rejected"),
            ("eia_sec_unexplained_steps{$}", "unexplained"),
        ),
    ),
    ("Steps in flight", "none", (("eia_sec_in_flight_steps{$}", "in flight"),)),
    ("Processes", "none", (("sum by (role) (eia_sec_process_up{$})", "{{role}}"),)),
    ("Silence of processes", "s", (("max by (role) (eia_sec_process_silence_seconds{$})", "{{role}}"),)),
    (
        "Trouble",
        "none",
        (
            ("eia_sec_alarms{$}", "alarms"),
            ("eia_sec_environment_outages{$}", "outages of environments"),
            ("eia_sec_step_timeouts{$}", "step timeouts"),
        ),
    ),
    ("Environment's metrics", "none", (("eia_sec_episode_metric{$}", "{{metric}}"),)),
)
"""Title, unit and, for each curve, expression and legend of the dashboard's panels."""


def prometheus(fleet: FleetSpec) -> dict[str, str]:
    """Return prometheus.yml, alerts.yml and dashboard.json of a fleet, by name."""
    run = fleet.run
    scrape = {
        "global": {"scrape_interval": SCRAPE, "evaluation_interval": SCRAPE},
        "rule_files": ["alerts.yml"],
        "scrape_configs": [
            {"job_name": f"eia-sec-{run}", "static_configs": [{"targets": [f"localhost:{PORT}"]}]},
        ],
    }
    rules = [
        {
            "alert": f"EiaSec{name}",
            "expr": _of(run, expression),
            "for": lasting,
            "labels": {"severity": severity, "run": run},
            "annotations": {"summary": f"Run {run}: {meaning}"},
        }
        for name, severity, lasting, expression, meaning in _ALERTS
    ]
    return {
        "prometheus.yml": as_yaml([scrape]),
        "alerts.yml": as_yaml([{"groups": [{"name": f"eia-sec-{run}", "rules": rules}]}]),
        "dashboard.json": json.dumps(_dashboard(run), indent=1) + "\n",
    }


def command(fleet: FleetSpec) -> str:
    """Return the command that serves the figures which the files are about."""
    words = ["eia-sec", "monitor", "--run", fleet.run, "--connect", fleet.network.endpoint, "--openmetrics", str(PORT)]
    own = [] if fleet.keys is None else ["--tls", str(fleet.keys / "monitor.monitor")]
    return shlex.join([*words, *own])


def _of(run: str, expression: str) -> str:
    return expression.replace("{$", f'{{run="{run}"').replace("@", run)


def _dashboard(run: str) -> dict[str, Any]:
    """Return a dashboard for Grafana 10 or newer: two columns of panels."""
    panels = [
        {
            "id": place + 1,
            "title": title,
            "type": "timeseries",
            "datasource": {"type": "prometheus", "uid": "${source}"},
            "gridPos": {"x": 12 * (place % 2), "y": 8 * (place // 2), "w": 12, "h": 8},
            "fieldConfig": {"defaults": {"unit": unit}, "overrides": []},
            "targets": [
                {"refId": chr(ord("A") + index), "expr": _of(run, expression), "legendFormat": legend}
                for index, (expression, legend) in enumerate(curves)
            ],
        }
        for place, (title, unit, curves) in enumerate(_PANELS)
    ]
    source = {"name": "source", "label": "Prometheus", "type": "datasource", "query": "prometheus"}
    return {
        "title": f"EIA-SEC {run}",
        "uid": f"eia-sec-{run}"[:40],
        "schemaVersion": 39,
        "refresh": SCRAPE,
        "time": {"from": "now-6h", "to": "now"},
        "templating": {"list": [source]},
        "panels": panels,
    }
