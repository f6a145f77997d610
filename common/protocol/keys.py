"""Every key of the protocol: who sends what to whom, how it is delivered and how often.

This table repeats the declarations below; a test compares the two. ROOT and the run's name precede every key.

    transition/{worker}           request  worker -> learner        DeliveryMessage, ChunkMessage, ChunkAck
    params/actors                 state    learner -> everybody     ParametersMessage
    ctl/progress                  state    learner -> everybody     ProgressMessage
    ctl/learner/{verb}            request  anybody -> learner       CommandMessage, ConfigurationMessage, ReceiptMessage
    eval/{worker}                 request  coordinator -> worker    EvaluationOrder, EvaluationResult
    imitation/learner             request  coordinator -> learner   ImitationMessage, ReceiptMessage
    imitation/event               state    coordinator -> everybody ImitationMessage
    population/learner            request  coordinator -> learner   ExploitMessage, ReceiptMessage
    watch/{worker}                request  watcher -> worker        WatchRequest, WatchTerms
    view/{worker}                 lossy    worker -> watchers       ViewMessage, StepsMessage
    metric/{role}/{name}          lossy    everyone -> everybody    MetricMessage
    live/{role}/{name}            token    everyone -> everybody
    flight/{vehicle}/pose         lossy    vehicle -> flight nodes  PoseMessage
    flight/{vehicle}/setpoint     lossy    flight node -> vehicle   SetpointMessage
    request/{environment}/{verb}  request  worker -> environment    ClaimRequest, StepRequest, LeaseRequest,
                                                                    ClaimAnswer, StepAnswer, LeaseAnswer
    live/{environment}            token    environment -> worker

- request: repeated until it is answered; the table lists the request's message first and the answers last.
- state: the latest value wins, and late joiners get it.
- lossy: may be dropped; a counter in the message shows gaps.
- token: Zenoh liveliness; it exists as long as the process is connected.

A flight node is watched as a worker is, under its own name.

A served environment belongs to no run: ENVIRONMENT_ROOT precedes the last two. docs/reference/remote_protocol.md says
what a program without this package needs to know of them.

Keys of another program's protocol are in no family: PX4_TOPICS.
"""

import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final, Literal

from eia_sec.common.errors import KeyExpressionError
from eia_sec.common.names import check_name, is_name
from eia_sec.common.protocol.frame import PROTOCOL

ROOT: Final = f"eia-sec/v{PROTOCOL}"
"""Every key begins with this and the run's name."""
ENVIRONMENT_ROOT: Final = "eia-sec/environment/v1"
"""Every key of a served environment begins with this. Its version is its own: a robot's program outlives PROTOCOL."""
VERBS: Final = ("configuration", "lead", "drain", "arguments")
"""Commands that the learner knows; a command's key ends in its verb."""
ENVIRONMENT_VERBS: Final = ("claim", "step", "renew", "release")
"""What a worker asks of a served environment; the request's key ends in it."""

Delivery = Literal["request", "state", "lossy", "token"]


@dataclass(frozen=True)
class KeyFamily:
    """All keys of one shape.

    Attributes:
        template: the segments after the run's name, or after `root`; variables in braces.
        delivery: see the module's docstring.
        sender: who publishes or asks.
        receiver: who reads or answers.
        messages: names of the message types in `eia_sec.common.protocol.messages` that it carries, answers last; those
            of environments are in `eia_sec.common.protocol.environment_messages`.
        pace: how often messages are sent.
        root: what precedes the template of a family that belongs to no run, else empty.
    """

    template: str
    delivery: Delivery
    sender: str
    receiver: str
    messages: tuple[str, ...]
    pace: str
    root: str = ""

    @property
    def encoding(self) -> str:
        """Zenoh's encoding of what is published on these keys: bytes, and the message in them; empty for the others."""
        return f"application/octet-stream;{ROOT}/{self.messages[0]}" if self.delivery in ("state", "lossy") else ""

    @property
    def shown(self) -> str:
        """The template as tables show it: a family of no run with its root."""
        return f"{self.root}/{self.template}" if self.root else self.template

    def key(self, run: str = "", **variables: str) -> str:
        """Return the key for a run; raise ConfigError when a name cannot be a key segment."""
        return f"{self._before(run, variables)}/{self.template.format(**variables)}"

    def pattern(self, run: str = "", **variables: str) -> str:
        """Return the key expression of the family in one run; variables that are not given become wildcards."""
        wildcards = dict.fromkeys(re.findall(r"{([a-z]+)}", self.template), "*")
        return f"{self._before(run, variables)}/{self.template.format(**{**wildcards, **variables})}"

    def _before(self, run: str, variables: Mapping[str, str]) -> str:
        for name, value in variables.items():
            check_name(value, name)
        return self.root or f"{ROOT}/{check_name(run, 'run')}"


EVERY_PROCESS: Final = "learner, coordinator, workers, flight nodes"

TRANSITION: Final = KeyFamily(
    template="transition/{worker}",
    delivery="request",
    sender="worker",
    receiver="learner",
    messages=("DeliveryMessage", "ChunkMessage", "ChunkAck"),
    pace="one at a time, with all waiting chunks that fit, as fast as the learner answers",
)
PARAMETERS: Final = KeyFamily(
    template="params/actors",
    delivery="state",
    sender="learner",
    receiver="everybody",
    messages=("ParametersMessage",),
    pace="on policy after each iteration, else at most every `learner.publish_seconds`; after each imitation event",
)
PROGRESS: Final = KeyFamily(
    template="ctl/progress",
    delivery="state",
    sender="learner",
    receiver="everybody",
    messages=("ProgressMessage",),
    pace="10 per second",
)
COMMAND: Final = KeyFamily(
    template="ctl/learner/{verb}",
    delivery="request",
    sender="anybody",
    receiver="learner",
    messages=("CommandMessage", "ConfigurationMessage", "ReceiptMessage"),
    pace=f"when needed; the verbs are {', '.join(VERBS)}",
)
EVALUATION: Final = KeyFamily(
    template="eval/{worker}",
    delivery="request",
    sender="coordinator",
    receiver="worker",
    messages=("EvaluationOrder", "EvaluationResult"),
    pace="for each imitation event",
)
IMITATION: Final = KeyFamily(
    template="imitation/learner",
    delivery="request",
    sender="coordinator",
    receiver="learner",
    messages=("ImitationMessage", "ReceiptMessage"),
    pace="for each imitation event",
)
IMITATION_EVENT: Final = KeyFamily(
    template="imitation/event",
    delivery="state",
    sender="coordinator",
    receiver="everybody",
    messages=("ImitationMessage",),
    pace="for each applied event",
)
POPULATION: Final = KeyFamily(
    template="population/learner",
    delivery="request",
    sender="coordinator",
    receiver="learner",
    messages=("ExploitMessage", "ReceiptMessage"),
    pace="for each round of a population",
)
WATCH: Final = KeyFamily(
    template="watch/{worker}",
    delivery="request",
    sender="watcher",
    receiver="worker",
    messages=("WatchRequest", "WatchTerms"),
    pace="1 per second from each watcher, while a browser shows the page",
)
VIEW: Final = KeyFamily(
    template="view/{worker}",
    delivery="lossy",
    sender="worker",
    receiver="watchers",
    messages=("ViewMessage", "StepsMessage"),
    pace="while somebody watches; 25 steps per second on average",
)
METRIC: Final = KeyFamily(
    template="metric/{role}/{name}",
    delivery="lossy",
    sender=EVERY_PROCESS,
    receiver="everybody",
    messages=("MetricMessage",),
    pace="1 per second",
)
LIVE: Final = KeyFamily(
    template="live/{role}/{name}",
    delivery="token",
    sender=EVERY_PROCESS,
    receiver="everybody",
    messages=(),
    pace="while it lives",
)
POSE: Final = KeyFamily(
    template="flight/{vehicle}/pose",
    delivery="lossy",
    sender="vehicle",
    receiver="flight nodes",
    messages=("PoseMessage",),
    pace="as the vehicle chooses, 5 to 20 per second; each tells again what was served in the last 5 s",
)
SETPOINT: Final = KeyFamily(
    template="flight/{vehicle}/setpoint",
    delivery="lossy",
    sender="flight node",
    receiver="vehicle",
    messages=("SetpointMessage",),
    pace="every period of the flight node, 10 per second by default",
)

ENVIRONMENT: Final = KeyFamily(
    template="request/{environment}/{verb}",
    delivery="request",
    sender="worker",
    receiver="environment",
    messages=("ClaimRequest", "StepRequest", "LeaseRequest", "ClaimAnswer", "StepAnswer", "LeaseAnswer"),
    pace=f"for each step of a served environment; the verbs are {', '.join(ENVIRONMENT_VERBS)}",
    root=ENVIRONMENT_ROOT,
)
ENVIRONMENT_LIVE: Final = KeyFamily(
    template="live/{environment}",
    delivery="token",
    sender="environment",
    receiver="worker",
    messages=(),
    pace="while it is served",
    root=ENVIRONMENT_ROOT,
)

FAMILIES: Final = (
    TRANSITION,
    PARAMETERS,
    PROGRESS,
    COMMAND,
    EVALUATION,
    IMITATION,
    IMITATION_EVENT,
    POPULATION,
    WATCH,
    VIEW,
    METRIC,
    LIVE,
    POSE,
    SETPOINT,
    ENVIRONMENT,
    ENVIRONMENT_LIVE,
)


@dataclass(frozen=True)
class Px4Topic:
    """The keys of a topic of PX4's own Zenoh module, which names them as rmw_zenoh does.

    They are used between one vehicle's autopilot and its bridge, on a link of their own.

    Attributes:
        topic: the ROS topic.
        kind: its type in px4_msgs.
        told: whether the autopilot sends it; else it reads it.
    """

    topic: str
    kind: str
    told: bool

    def key(self, type_hash: str) -> str:
        """Return the key for a version of the type.

        Args:
            type_hash: RIHS01_ and 64 hexadecimal digits; "*" for all versions.
        """
        return f"{PX4_DOMAIN}/{self.topic}/px4_msgs::msg::dds_::{self.kind}_/{type_hash}"


PX4_DOMAIN: Final = 0
"""PX4's parameter ZENOH_DOMAIN_ID; its default."""
PX4_POSITION: Final = Px4Topic("fmu/out/vehicle_local_position", "VehicleLocalPosition", told=True)
PX4_STATUS: Final = Px4Topic("fmu/out/vehicle_status", "VehicleStatus", told=True)
PX4_OFFBOARD: Final = Px4Topic("fmu/in/offboard_control_mode", "OffboardControlMode", told=False)
PX4_SETPOINT: Final = Px4Topic("fmu/in/trajectory_setpoint", "TrajectorySetpoint", told=False)
PX4_TOPICS: Final = (PX4_POSITION, PX4_STATUS, PX4_OFFBOARD, PX4_SETPOINT)


@dataclass(frozen=True)
class ParsedKey:
    """A parsed key.

    Attributes:
        family: the declaration that covers it.
        run: the run's name; empty for a family of no run.
        variables: the values of the template's variables.
    """

    family: KeyFamily
    run: str
    variables: dict[str, str]


def parse(key: str) -> ParsedKey:
    """Parse a concrete key; raise KeyExpressionError for wildcards and for keys of no family."""
    segments = key.split("/")
    if all(map(is_name, segments)):
        for family in FAMILIES:
            root = (family.root or f"{ROOT}/{{run}}").split("/")
            shape = [*root, *family.template.split("/")]
            if len(shape) == len(segments):
                pairs = list(zip(shape, segments, strict=True))
                if all(part.startswith("{") or part == segment for part, segment in pairs):
                    found = {part[1:-1]: segment for part, segment in pairs if part.startswith("{")}
                    return ParsedKey(family, found.pop("run", ""), found)
    raise KeyExpressionError(f"{key[:120]!r} belongs to no family of keys.")
