"""Packets for the browser: a JSON header and the arrays that it lists.

    header bytes u32 little-endian | header, padded with spaces to a multiple of four | arrays

The header's "arrays" gives for each array its name, dtype (f4 or u1), shape and place behind the header, bytes; each
begins at a multiple of four, so that the browser can view it without a copy.
"""

import json
import struct
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from eia_sec.common.config import FarmConfig
from eia_sec.common.farm import farm_team
from eia_sec.common.protocol.messages import StepsMessage, ViewMessage, WatchTerms
from eia_sec.common.protocol.view_checks import NO_RELAY
from eia_sec.rollout.rendering.palette import (
    AGE_STOPS,
    COLOURS,
    GONE,
    LABELS,
    LINK_DOWN,
    PART_COLOURS,
    SENSOR_MARKERS,
    SOIL_STOPS,
    STRESS,
    TYPES,
    ZONE,
)
from eia_sec.rollout.rendering.scene import TRAIL_STEPS, camera_radius, chain_of, links_up, radio_radius
from eia_sec.rollout.sim.conditions.stress import patches
from eia_sec.rollout.sim.conditions.wind import wind_series
from eia_sec.rollout.sim.layout import Layout
from eia_sec.rollout.sim.stations import base_place, station_places

_LENGTH: Final = struct.Struct("<I")
_DTYPES: Final = {"<f4": "f4", "|u1": "u1"}

Array = NDArray[np.float32] | NDArray[np.uint8]


@dataclass(frozen=True)
class Packet:
    """One message to the browser.

    Attributes:
        data: its bytes.
        frames: number of frames in it; 0 for other packets.
    """

    data: bytes
    frames: int = 0


def pack(kind: str, fields: Mapping[str, Any], arrays: Mapping[str, Array], frames: int = 0) -> Packet:
    """Return a packet.

    Args:
        kind: scene, frames or state.
        fields: more fields of the header.
        arrays: float32 and uint8 arrays by name.
        frames: frames in it.
    """
    listing, parts, place = [], [], 0
    for name, array in arrays.items():
        data = array.tobytes()
        listing.append([name, _DTYPES[array.dtype.str], list(array.shape), place])
        parts.append(data + bytes(-len(data) % 4))
        place += len(parts[-1])
    header = json.dumps({"kind": kind, **fields, "arrays": listing}).encode()
    header += b" " * (-len(header) % 4)
    return Packet(b"".join((_LENGTH.pack(len(header)), header, *parts)), frames)


def scene(run: str, worker: str, farm: FarmConfig, terms: WatchTerms) -> Packet:
    """Return what the page needs once: the farm's measures, and the project's colours, marks and names."""
    world = farm.world
    counts = {group.name: group.count for group in farm_team(farm).groups}
    types = [{"name": name, "label": LABELS[name], "colour": COLOURS[name], "count": counts[name]} for name in TYPES]
    fields = {
        "title": "EIA-SEC farm",
        "run": run,
        "worker": worker,
        "field": [world.field_x, world.field_y],
        "plots": [world.plots_x, world.plots_y],
        "sensors": world.sensors,
        "cycles": list(world.sensor_cycles),
        "markers": [SENSOR_MARKERS[kind % len(SENSOR_MARKERS)] for kind in range(len(world.sensor_cycles))],
        "most": [world.aoi_max, world.vdf_max],
        "steps": world.steps,
        "step_seconds": world.step_seconds,
        "reach": {"monitoring": camera_radius(farm), "collection": radio_radius(farm)},
        "types": types,
        "parts": [
            {"name": name, "colour": PART_COLOURS[place % len(PART_COLOURS)]}
            for place, name in enumerate(terms.part_names)
        ],
        "top_speed": max(world.speed_x_max, world.speed_y_max),
        "age": list(AGE_STOPS),
        "soil": list(SOIL_STOPS),
        "trail": TRAIL_STEPS,
        "pace": terms.steps_per_second,
        **_conditions(farm),
    }
    return pack("scene", fields, {})


def _conditions(farm: FarmConfig) -> dict[str, Any]:
    """Return what the page needs of zones, links, chains, failures, batteries and stress, for farms with them."""
    found: dict[str, Any] = {}
    if farm.zones.some:
        found["zone"] = ZONE
    if farm.relay.require_link:
        found["link_down"] = {"colour": LINK_DOWN, "range": farm.relay.link_range}
    if farm.relay.chained:
        height, longest = farm.world.height_communication, farm.relay.hop_range
        found["base"] = {"place": base_place(farm).tolist(), "height": height, "range": longest}
    if farm.loses_uavs:
        found["gone"] = GONE
    if farm.battery.some:
        found["stations"] = station_places(farm).tolist()
    if farm.stress.patches:
        found["stress"] = {"colour": STRESS, "radius": farm.stress.radius}
    if farm.stress.faster:
        found["areas"] = {"colour": STRESS, "outlines": [corners for _, corners in farm.stress.faster]}
    return found


def course(message: ViewMessage | StepsMessage, version: int) -> dict[str, Any]:
    """Return what the page is told of the episode in any frames, and of who acts."""
    return {
        "episode": str(message.episode),  # seeds have up to 63 bits, but numbers in the browser keep 53
        "first": message.first,
        "skipped": message.skipped,
        "noise_std": message.noise_std,
        "uniform": message.uniform,
        "version": version,
    }


def frames(message: ViewMessage, farm: FarmConfig, layout: Layout, version: int) -> Packet:
    """Return frames of an episode, with what the seeds determine: sensors, no-fly zones, wind and patches of stress."""
    fields: dict[str, Any] = {
        "farm": message.farm,
        **course(message, version),
        "zones": [zone.tolist() for zone in layout.zones],
    }
    arrays: dict[str, Array] = {
        name: getattr(message, name) for name in ("position", "assignment", "quality", "aoi", "vdf", "level", "parts")
    }
    arrays["sensor"] = layout.sensor_xy.astype(np.float32)
    wind = wind_series(farm, message.farm, message.episode)
    if len(wind):
        arrays["wind"] = wind[message.first : message.first + len(message.position)].astype(np.float32)
    arrays["kind"] = layout.sensor_type.astype(np.uint8)
    arrays |= {name: sent for name in ("gone", "charge", "known") if (sent := getattr(message, name)) is not None}
    if farm.relay.require_link:
        joined = _joined(message, farm)
        arrays["linked"] = _linked(message, farm, joined)
        if farm.relay.chained:
            arrays["joined"] = joined.astype(np.uint8)
    if farm.stress.patches:
        place, time = patches(farm, message.farm, message.episode)
        fields["patches"] = np.concatenate([place, time], axis=1).tolist()
    return pack("frames", fields, arrays, len(message.position))


def _joined(message: ViewMessage, farm: FarmConfig) -> NDArray[np.bool_]:
    """Return which relays are joined to the base station, [F, n_c]; of farms without one, which live."""
    places = message.position.astype(np.float64)
    gone = np.zeros(places.shape[:2], np.bool_) if message.gone is None else message.gone.astype(np.bool_)
    return np.stack([chain_of(farm, *frame) for frame in zip(places, gone, strict=True)])


def _linked(message: ViewMessage, farm: FarmConfig, joined: NDArray[np.bool_]) -> NDArray[np.uint8]:
    """Return 1 for each served UAV whose relay is within range and joined, [F, n_m + n_d]."""
    relays = np.where(message.assignment == NO_RELAY, -1, message.assignment.astype(np.int64))
    places = message.position.astype(np.float64)
    shown = zip(places, relays, joined, strict=True)
    return np.stack([links_up(farm, *frame) for frame in shown]).astype(np.uint8)


def state(sentence: str, fields: Mapping[str, Any]) -> Packet:
    """Return the state: a sentence, empty while frames arrive; whether it tells of a fault, workers, and losses."""
    return pack("state", {"sentence": sentence, **fields}, {})
