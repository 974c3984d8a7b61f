"""What the bench sees of a run on the bus: where the train is, and whether the run has ended."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from hil.canbus.contract import Contract, MessageCodec
from hil.node.inbox import bus_identifier

WATCHED = ("ATO_Status", "ATO_Position", "ODO_Motion", "ATP_Permission", "ATO_Timing")

SETTLE_S = 1.5
"""A train that has held this long at the stop has arrived: blending and jerk have died out."""

GIVE_UP_S = 4.0
"""Standing this long outside the stop under a brake command: the run is over."""


@dataclass(frozen=True)
class View:
    """The train as last heard on the bus. SI units."""

    time_s: float = 0.0
    position_m: float = 0.0
    speed_mps: float = 0.0
    reference_speed_mps: float = 0.0
    distance_to_stop_m: float = 0.0
    standstill: bool = True
    mode: str = "-"
    supervision: str = "-"
    law: str = "-"
    permitted_speed_mps: float | None = None  # None before the protection has said anything
    deadline_misses: int = 0


@dataclass(frozen=True)
class Ending:
    """How a run ended: `arrived`, `stopped`, `no_departure`, `timeout`, `aborted` or `died`."""

    how: str
    because: str


class Watch:
    """Keeps the last frame of each watched message; decodes only when somebody looks."""

    def __init__(self, contract: Contract, *, time_limit_s: float, departure_limit_s: float = 20.0) -> None:
        contract.require(WATCHED)
        self._codecs: dict[int, MessageCodec] = {
            bus_identifier(contract.message(name)): contract.message(name) for name in WATCHED
        }
        self._last: dict[int, bytes] = {}
        self._choices = {
            (codec.name, signal.name): signal.choices
            for codec in self._codecs.values()
            for signal in codec.signals
        }
        self._time_limit_s = time_limit_s
        self._departure_limit_s = departure_limit_s
        self._departed = False
        self._standing_since_s: float | None = None

    @property
    def identifiers(self) -> tuple[int, ...]:
        """The CAN identifiers to listen to."""
        return tuple(self._codecs)

    def hear(self, can_id: int, data: bytes) -> None:
        """Take a frame."""
        if can_id in self._codecs:
            self._last[can_id] = data

    def view(self, time_s: float) -> View:
        """The train now, at `time_s` since the run began."""
        values: dict[str, dict[str, float]] = {name: {} for name in WATCHED}
        for can_id, data in self._last.items():
            codec = self._codecs[can_id]
            if len(data) == codec.length:
                values[codec.name] = codec.decode(bytes(data))
        motion, status, place = values["ODO_Motion"], values["ATO_Status"], values["ATO_Position"]
        return View(
            time_s=time_s,
            position_m=motion.get("Position", 0.0),
            speed_mps=motion.get("Speed", 0.0),
            reference_speed_mps=status.get("ReferenceSpeed", 0.0),
            distance_to_stop_m=place.get("DistanceToStop", 0.0),
            standstill=bool(motion.get("Standstill", 1)),
            mode=self._name("ATO_Status", "Mode", status),
            supervision=self._name("ATO_Status", "Supervision", status),
            law=self._name("ATO_Status", "Law", status),
            permitted_speed_mps=values["ATP_Permission"].get("PermittedSpeed"),
            deadline_misses=int(values["ATO_Timing"].get("DeadlineMisses", 0)),
        )

    def ending(self, view: View, *, controlled: bool = True) -> Ending | None:
        """Whether the run is over. `controlled` is False once the controller has died."""
        driving = view.mode in ("RUN", "STOPPING")
        self._departed = self._departed or driving
        standing = view.standstill and not (driving and controlled)
        if not standing:
            self._standing_since_s = None
        elif self._standing_since_s is None:
            self._standing_since_s = view.time_s
        stood_s = 0.0 if self._standing_since_s is None else view.time_s - self._standing_since_s
        if self._departed and controlled and view.mode == "HOLD" and stood_s >= SETTLE_S:
            return Ending("arrived", "the train holds at its stop")
        if self._departed and stood_s >= GIVE_UP_S:
            side = "before" if view.distance_to_stop_m >= 0 else "past"
            return Ending(
                "stopped",
                f"the train stands {abs(view.distance_to_stop_m):.1f} m {side} its stop"
                f" (mode {view.mode}, supervision {view.supervision})",
            )
        if not self._departed and view.time_s > self._departure_limit_s:
            return Ending(
                "no_departure",
                f"no departure within {self._departure_limit_s:g} s"
                f" (mode {view.mode}, supervision {view.supervision})",
            )
        if view.time_s > self._time_limit_s:
            return Ending("timeout", f"not arrived within {self._time_limit_s:g} s (mode {view.mode})")
        return None

    def _name(self, message: str, signal: str, values: Mapping[str, float]) -> str:
        if signal not in values:
            return "-"
        number = int(values[signal])
        return str(self._choices.get((message, signal), {}).get(number, number))
