"""Every key expression of the protocol: the whole table, one formatter, one parser.

    eia-sec/v3/{run}/transition/{worker}        request   worker -> learner        DeliveryMessage, ChunkMessages, ack
    eia-sec/v3/{run}/params/actors              state     learner -> everybody     ParametersMessage
    eia-sec/v3/{run}/ctl/progress               state     learner -> everybody     ProgressMessage
    eia-sec/v3/{run}/ctl/learner/{verb}         request   anybody -> learner       CommandMessage, an answer back
    eia-sec/v3/{run}/eval/{worker}              request   coordinator -> worker    EvaluationOrder, result back
    eia-sec/v3/{run}/imitation/learner          request   coordinator -> learner   ImitationMessage, receipt
    eia-sec/v3/{run}/imitation/event            state     coordinator -> everybody ImitationMessage
    eia-sec/v3/{run}/watch/{worker}             request   watcher -> worker        WatchRequest, WatchTerms back
    eia-sec/v3/{run}/view/{worker}              lossy     worker -> watchers       ViewMessage, while it is watched
    eia-sec/v3/{run}/metric/{role}/{name}       lossy     every process            MetricMessage
    eia-sec/v3/{run}/live/{role}/{name}         token     every process            presence
    eia-sec/v3/{run}/flight/{vehicle}/observation  lossy  vehicle -> flight node   ObservationMessage
    eia-sec/v3/{run}/flight/{vehicle}/setpoint     lossy  flight node -> vehicle   SetpointMessage

*request*: acknowledged, resent until answered. *state*: latest wins, late joiners get it. *lossy*: may be dropped, a
running counter shows the gaps. *token*: Zenoh liveliness.
"""

import re
from dataclasses import dataclass
from typing import Final

from common.errors import KeyExpressionError
from common.names import check_name, is_name
from common.protocol.frame import PROTOCOL

ROOT: Final = f"eia-sec/v{PROTOCOL}"


@dataclass(frozen=True)
class KeyFamily:
    """One shape of key.

    Attributes:
        plane: first segment after the run: transition, params, ctl, eval, imitation, watch, view, metric, live or
            flight.
        template: the segments after the run, variables in braces.
        delivery: request, state, lossy or token.
        sender: who puts or asks.
        receiver: who reads or answers.
        messages: names of the types in `common.protocol.messages` that travel on it, an answer last.
        pace: how often.
    """

    plane: str
    template: str
    delivery: str
    sender: str = ""
    receiver: str = ""
    messages: tuple[str, ...] = ()
    pace: str = ""

    def key(self, run: str, **variables: str) -> str:
        """Return the key for a run; raise ConfigError when a name cannot be a key segment."""
        for name, value in {"run": run, **variables}.items():
            check_name(value, name)
        return f"{ROOT}/{run}/{self.template.format(**variables)}"

    def pattern(self, run: str, **variables: str) -> str:
        """Return the key expression that covers the family in one run, or the part of it that the variables name."""
        wanted = {name: "*" for name in re.findall(r"{([a-z]+)}", self.template)}
        for name, value in {"run": run, **variables}.items():
            check_name(value, name)
        return f"{ROOT}/{run}/{self.template.format(**{**wanted, **variables})}"


TRANSITION: Final = KeyFamily(
    "transition",
    "transition/{worker}",
    "request",
    "worker",
    "learner",
    ("DeliveryMessage", "ChunkMessage", "ChunkAck"),
    "one at a time, with all chunks that wait and fit, as fast as the learner answers",
)
PARAMETERS: Final = KeyFamily(
    "params",
    "params/actors",
    "state",
    "learner",
    "everybody",
    ("ParametersMessage",),
    "at most every `learner.publish_seconds`, and after each imitation event",
)
PROGRESS: Final = KeyFamily(
    "ctl", "ctl/progress", "state", "learner", "everybody", ("ProgressMessage",), "10 per second"
)
COMMAND: Final = KeyFamily(
    "ctl",
    "ctl/learner/{verb}",
    "request",
    "anybody",
    "learner",
    ("CommandMessage", "ConfigurationMessage", "ReceiptMessage"),
    "when needed; the verbs are configuration, lead and drain",
)
EVALUATION: Final = KeyFamily(
    "eval",
    "eval/{worker}",
    "request",
    "coordinator",
    "worker",
    ("EvaluationOrder", "EvaluationResult"),
    "for each imitation event",
)
IMITATION: Final = KeyFamily(
    "imitation",
    "imitation/learner",
    "request",
    "coordinator",
    "learner",
    ("ImitationMessage", "ReceiptMessage"),
    "for each imitation event",
)
IMITATION_EVENT: Final = KeyFamily(
    "imitation", "imitation/event", "state", "coordinator", "everybody", ("ImitationMessage",), "for each one applied"
)
WATCH: Final = KeyFamily(
    "watch",
    "watch/{worker}",
    "request",
    "watcher",
    "worker",
    ("WatchRequest", "WatchTerms"),
    "1 per second of each watcher, while a browser looks",
)
VIEW: Final = KeyFamily(
    "view",
    "view/{worker}",
    "lossy",
    "worker",
    "watchers",
    ("ViewMessage",),
    "while somebody watches; 25 steps per second on average",
)
METRIC: Final = KeyFamily(
    "metric",
    "metric/{role}/{name}",
    "lossy",
    "learner, coordinator, workers, flight nodes",
    "everybody",
    ("MetricMessage",),
    "1 per second",
)
LIVE: Final = KeyFamily(
    "live",
    "live/{role}/{name}",
    "token",
    "learner, coordinator, workers, flight nodes",
    "everybody",
    (),
    "while it lives",
)
OBSERVATION: Final = KeyFamily(
    "flight",
    "flight/{vehicle}/observation",
    "lossy",
    "vehicle",
    "flight node",
    ("ObservationMessage",),
    "as often as the vehicle likes; the newest in each period counts",
)
SETPOINT: Final = KeyFamily(
    "flight",
    "flight/{vehicle}/setpoint",
    "lossy",
    "flight node",
    "vehicle",
    ("SetpointMessage",),
    "every period of the flight node, 10 per second by default",
)

FAMILIES: Final = (
    TRANSITION,
    PARAMETERS,
    PROGRESS,
    COMMAND,
    EVALUATION,
    IMITATION,
    IMITATION_EVENT,
    WATCH,
    VIEW,
    METRIC,
    LIVE,
    OBSERVATION,
    SETPOINT,
)


@dataclass(frozen=True)
class ParsedKey:
    """A key taken apart.

    Attributes:
        family: the declaration that covers it.
        run: the run's name.
        variables: the values of the template's variables.
    """

    family: KeyFamily
    run: str
    variables: dict[str, str]


def parse(key: str) -> ParsedKey:
    """Take a concrete key apart; raise KeyExpressionError for wildcards and for keys of no family."""
    head, segments = key.split("/")[:2], key.split("/")[2:]
    if "/".join(head) != ROOT or len(segments) < 3 or not all(map(is_name, segments)):
        raise KeyExpressionError(f"{key[:120]!r} is not a key of {ROOT}.")
    run, rest = segments[0], segments[1:]
    for family in FAMILIES:
        template = family.template.split("/")
        if len(template) == len(rest):
            variables = {t[1:-1]: part for t, part in zip(template, rest, strict=True) if t.startswith("{")}
            if all(t.startswith("{") or t == part for t, part in zip(template, rest, strict=True)):
                return ParsedKey(family, run, variables)
    raise KeyExpressionError(f"{key[:120]!r} belongs to no family of keys.")
