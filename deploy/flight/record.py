"""A flight's record: poses, set-points with their reasons, and the farm's map, as an MCAP file that Foxglove opens.

Messages are JSON with JSON schemas. `/tf` has Foxglove's own schema FrameTransforms, which its 3D panel shows.
"""

import json
import time
from collections.abc import Mapping
from dataclasses import fields
from pathlib import Path
from types import TracebackType
from typing import IO, Any, Final, Self, get_args, get_origin, get_type_hints

import numpy as np

from eia_sec.common.config import FarmConfig
from eia_sec.common.errors import UsageError
from eia_sec.common.log import log
from eia_sec.common.protocol.codec import Message
from eia_sec.common.protocol.messages import PoseMessage, SetpointMessage
from eia_sec.rollout.followed_farm import FollowedFarm

CHUNK: Final = 64 * 1024
"""Bytes of a chunk; what a killed node loses is at most the last one."""
FIELD: Final = "field"
"""Name of the field's frame: x along its width, y along its depth, z up, m."""
_KINDS: Final[dict[Any, str]] = {bool: "boolean", int: "integer", float: "number", str: "string"}
_VECTOR: Final = {"type": "object", "properties": {axis: {"type": "number"} for axis in "xyz"}}
_TIME: Final = {"type": "object", "properties": {"sec": {"type": "integer"}, "nsec": {"type": "integer"}}}
_TRANSFORM: Final = {
    "type": "object",
    "properties": {
        "timestamp": _TIME,
        "parent_frame_id": {"type": "string"},
        "child_frame_id": {"type": "string"},
        "translation": _VECTOR,
        "rotation": {"type": "object", "properties": {axis: {"type": "number"} for axis in "xyzw"}},
    },
}
_TRANSFORMS: Final = {"type": "object", "properties": {"transforms": {"type": "array", "items": _TRANSFORM}}}
_MAP: Final = {
    "type": "object",
    "properties": {
        "step": {"type": "integer"},
        "plots_y": {"type": "integer"},
        "vdf": {"type": "array", "items": {"type": "number"}},
        "aoi": {"type": "array", "items": {"type": "number"}},
        "relay": {"type": "array", "items": {"type": "integer"}},
        "gone": {"type": "array", "items": {"type": "boolean"}},
    },
}


class FlightRecord:
    """An MCAP file under way; use it as a context manager.

    A record that cannot be written any more ends, and the flight goes on.

    Args:
        path: a file that does not exist yet.
        about: what to note of the flight: the policy's name, for instance.
        toml: the farm's configuration.
        config: the same.

    Attributes:
        written: messages in the file.
        lost: messages that came after the record had ended.
        fault: why it ended, or empty.

    Raises:
        UsageError: mcap is not installed, or the file exists or cannot be made.
    """

    def __init__(self, path: Path, about: Mapping[str, str], toml: str, config: FarmConfig) -> None:
        try:
            from mcap.writer import CompressionType, Writer  # noqa: PLC0415 - an extra that few users need
        except ImportError:
            raise UsageError("--record needs the package mcap: pip install 'eia-sec[record]'.") from None
        try:
            self._file: IO[bytes] = path.open("xb")
        except OSError as error:
            raise UsageError(f"{path} cannot be made: {error.strerror}.") from error
        self._path, self._config = path, config
        self._channels: dict[str, int] = {}
        self._counts: dict[str, int] = {}
        self.written, self.lost, self.fault = 0, 0, ""
        self._writer = Writer(self._file, chunk_size=CHUNK, compression=CompressionType.ZSTD)
        self._writer.start()
        self._writer.add_metadata("flight", dict(about))
        now = time.time_ns()
        self._writer.add_attachment(now, now, "farm.toml", "application/toml", toml.encode())
        self._schemas = {
            name: self._writer.register_schema(name, "jsonschema", json.dumps(schema).encode())
            for name, schema in (
                ("eia_sec.Pose", _schema(PoseMessage)),
                ("eia_sec.Setpoint", _schema(SetpointMessage)),
                ("eia_sec.FarmMap", _MAP),
                ("foxglove.FrameTransforms", _TRANSFORMS),
            )
        }

    def __enter__(self) -> Self:
        """Return the record."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Finish the file."""
        self._guarded(self._writer.finish)
        self._guarded(self._file.close)

    def pose(self, vehicle: str, message: PoseMessage, place: tuple[float, float], now: float) -> None:
        """Note a pose that is used, and its place in the field, m."""
        self._put(f"/vehicle/{vehicle}/pose", "eia_sec.Pose", _plain(message), now, message.stamp)
        stamp = {"sec": message.stamp // 10**6, "nsec": message.stamp % 10**6 * 1000}
        transform = {
            "timestamp": stamp,
            "parent_frame_id": FIELD,
            "child_frame_id": vehicle,
            "translation": {"x": place[0], "y": place[1], "z": message.height},
            "rotation": {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0},
        }
        self._put("/tf", "foxglove.FrameTransforms", {"transforms": [transform]}, now, message.stamp)

    def setpoint(self, vehicle: str, message: SetpointMessage, now: float) -> None:
        """Note a set-point that is sent."""
        self._put(f"/vehicle/{vehicle}/setpoint", "eia_sec.Setpoint", _plain(message), now, int(now * 1e6))

    def farm(self, farm: FollowedFarm, now: float) -> None:
        """Note the map after a step: counters, each served agent's relay, and who is gone."""
        whole = {
            "step": int(farm.time[0]),
            "plots_y": self._config.world.plots_y,
            "vdf": farm.vdf[0].ravel().tolist(),
            "aoi": farm.aoi[0].tolist(),
            "relay": farm.assignment[0].tolist(),
            "gone": farm.gone[0].tolist(),
        }
        self._put("/farm/map", "eia_sec.FarmMap", whole, now, int(now * 1e6))

    def alarms(self) -> list[str]:
        """Return a sentence if the record has ended."""
        return [f"the record {self._path} ended: {self.fault}; the flight goes on without."] if self.fault else []

    def _put(self, topic: str, schema: str, whole: dict[str, Any], now: float, stamp: int) -> None:
        if self.fault:
            self.lost += 1
            return
        if topic not in self._channels:
            self._channels[topic] = self._writer.register_channel(topic, "json", self._schemas[schema])
        number = self._counts[topic] = self._counts.get(topic, 0) + 1
        data = json.dumps(whole).encode()
        self._guarded(
            lambda: self._writer.add_message(self._channels[topic], int(now * 1e9), data, stamp * 1000, number)
        )
        self.written += not self.fault

    def _guarded(self, do: Any) -> None:
        try:
            do()
        except (OSError, ValueError) as error:  # a full disk, or a file that a full disk has closed
            if not self.fault:
                self.fault = str(error)
                log(self.alarms()[0])


def _schema(kind: type[Message]) -> dict[str, Any]:
    """Return the JSON schema of a message."""
    hints = get_type_hints(kind)
    return {
        "type": "object",
        "title": kind.__name__,
        "properties": {item.name: _kind(hints[item.name]) for item in fields(kind)},  # type: ignore[arg-type]  # every message is a dataclass
    }


def _kind(hint: Any) -> dict[str, Any]:
    if hint in _KINDS:
        return {"type": _KINDS[hint]}
    if get_origin(hint) is tuple:
        return {"type": "array", "items": _kind(get_args(hint)[0])}
    if get_origin(hint) is np.ndarray:
        return {"type": "array", "items": {"type": "integer"}}
    return {"type": ["number", "null"]}


def _plain(message: Message) -> dict[str, Any]:
    """Return a message as JSON's types."""
    found = vars(message)
    return {name: value.tolist() if isinstance(value, np.ndarray) else value for name, value in found.items()}
