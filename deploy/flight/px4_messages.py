"""Messages of PX4's own Zenoh module: CDR and type hashes through rosbags, and the attachment of rmw_zenoh.

The definitions are those of px4_msgs, without constants and comments. Key expressions name a type's version by its
hash, so a message of another version never arrives in the place of one of these.
"""

import struct
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from eia_sec.common.errors import SchemaError, UsageError

DEFINITIONS: Final = {
    "OffboardControlMode": """
        uint64 timestamp
        bool position velocity acceleration attitude body_rate thrust_and_torque direct_actuator
    """,
    "TrajectorySetpoint": """
        uint64 timestamp
        float32[3] position velocity acceleration jerk
        float32 yaw yawspeed
    """,
    "VehicleLocalPosition": """
        uint64 timestamp timestamp_sample
        bool xy_valid z_valid v_xy_valid v_z_valid
        float32 x y z
        float32[2] delta_xy
        uint8 xy_reset_counter
        float32 delta_z
        uint8 z_reset_counter
        float32 vx vy vz z_deriv
        float32[2] delta_vxy
        uint8 vxy_reset_counter
        float32 delta_vz
        uint8 vz_reset_counter
        float32 ax ay az heading heading_var unaided_heading delta_heading
        uint8 heading_reset_counter
        bool heading_good_for_control
        float32 tilt_var
        bool xy_global z_global
        uint64 ref_timestamp
        float64 ref_lat ref_lon
        float32 ref_alt
        bool dist_bottom_valid
        float32 dist_bottom dist_bottom_var delta_dist_bottom
        uint8 dist_bottom_reset_counter dist_bottom_sensor_bitfield
        float32 eph epv evh evv
        bool dead_reckoning
        float32 vxy_max vz_max hagl_min hagl_max_z hagl_max_xy
    """,
}
"""Of PX4 1.16, 1.17 and 1.18: each type's fields, a line for those of one type that follow each other."""
STATUS_HEAD: Final = """
        uint64 timestamp armed_time takeoff_time
        uint8 arming_state latest_arming_reason latest_disarming_reason
        uint64 nav_state_timestamp
        uint8 nav_state_user_intention nav_state executor_in_charge
"""
STATUS_MIDDLE: Final = """
        uint8 hil_state vehicle_type
        bool failsafe failsafe_and_user_took_over
        uint8 failsafe_defer_state
        bool gcs_connection_lost
        uint8 gcs_connection_lost_counter
        bool high_latency_data_link_lost is_vtol is_vtol_tailsitter in_transition_mode in_transition_to_fw
        uint8 system_type system_id component_id
        bool safety_button_available safety_off power_input_valid usb_connected open_drone_id_system_present
        bool open_drone_id_system_healthy parachute_system_present parachute_system_healthy
"""
STATUS_TAIL: Final = """
        bool rc_calibration_in_progress calibration_enabled pre_flight_checks_pass
"""
STATUS: Final = (
    STATUS_HEAD
    + """
        uint32 valid_nav_states_mask can_set_nav_states_mask
        uint16 failure_detector_status
    """
    + STATUS_MIDDLE
    + STATUS_TAIL,
    STATUS_HEAD
    + """
        uint8 nav_state_display
        bool accepts_offboard_setpoints
        uint32 valid_nav_states_mask can_set_nav_states_mask
    """
    + STATUS_MIDDLE
    + """
        bool traffic_avoidance_system_present
    """
    + STATUS_TAIL,
)
"""VehicleStatus of PX4 1.16 and 1.17, and that of 1.18."""
HEADER: Final = b"\x00\x01\x00\x00"
"""What precedes CDR of least significant bytes first."""
SLACK: Final = 64
"""Most bytes that may follow a message: PX4 sends its whole buffer, which is up to 32 bytes longer."""
ATTACHMENT: Final = struct.Struct("<qqB16s")
"""Sequence number, time, the length of what follows, and the publisher's identity."""
GID: Final = 16
"""Length of a publisher's identity."""


@dataclass(frozen=True)
class MessageType:
    """A type of px4_msgs in one version.

    Attributes:
        name: without its package.
        type_hash: RIHS01_ and 64 hexadecimal digits.
        size: of a message with its header; no field has a length of its own.
    """

    name: str
    type_hash: str
    size: int
    _store: Any
    _zeros: dict[str, Any]

    @classmethod
    def of(cls, name: str, definition: str) -> "MessageType":
        """Return the type of a definition, see DEFINITIONS; raise UsageError where rosbags is not installed."""
        try:
            from rosbags.typesys import (  # noqa: PLC0415 - an extra that few users need
                Stores,
                get_types_from_msg,
                get_typestore,
            )
        except ImportError:
            raise UsageError("the bridge needs the package rosbags: pip install 'eia-sec[px4]'.") from None
        lines = [line.split() for line in definition.split("\n") if line.strip()]
        fields = [(kind, field) for kind, *names in lines for field in names]
        store, full = get_typestore(Stores.EMPTY), f"px4_msgs/msg/{name}"
        store.register(get_types_from_msg("\n".join(" ".join(pair) for pair in fields), full))
        zeros = {field: _zero(kind) for kind, field in fields}
        size = len(store.serialize_cdr(store.types[full](**zeros), full))
        return cls(name, store.hash_rihs01(full), size, store, zeros)

    def encode(self, **values: Any) -> bytes:
        """Return a message; fields that are not given are 0."""
        full = f"px4_msgs/msg/{self.name}"
        arrays = {name: np.array(value, np.float32) for name, value in values.items() if isinstance(value, tuple)}
        message = self._store.types[full](**{**self._zeros, **values, **arrays})
        return bytes(self._store.serialize_cdr(message, full, little_endian=True))

    def decode(self, payload: bytes) -> Any:
        """Return a message; raise SchemaError where it cannot be one."""
        if payload[: len(HEADER)] != HEADER or not self.size <= len(payload) <= self.size + SLACK:
            raise SchemaError(f"PX4 told a {self.name} that is none: {len(payload)} bytes, not {self.size}.")
        return self._store.deserialize_cdr(payload[: self.size], f"px4_msgs/msg/{self.name}")


def _zero(kind: str) -> Any:
    """Return the zero of a field's type."""
    base, _, length = kind.partition("[")
    zero = np.zeros(int(length[:-1]) if length else 1, np.dtype(base))
    return zero if length else zero[0].item()


def gid_of(attachment: bytes) -> bytes:
    """Return the identity of a message's publisher; raise SchemaError where an attachment is none of rmw_zenoh's."""
    if len(attachment) != ATTACHMENT.size or attachment[16] != GID:
        raise SchemaError("a message of PX4 has no attachment of rmw_zenoh.")
    return attachment[-GID:]
