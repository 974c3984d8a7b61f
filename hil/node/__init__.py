"""What makes a process a node on the bus: its cycle, its clock, what it reads and sends, its timing."""

from hil.node.clock import (
    Clock,
    CycleStart,
    RealTimeClock,
    first_deadline,
    next_deadline,
)
from hil.node.cycle import CycleStatistics, DeadlinesMissed, Node, OverloadPolicy
from hil.node.inbox import CycleTiming, Inbox, Received
from hil.node.lockstep import LockstepClock, LockstepError
from hil.node.options import NodeOptions, OptionsError
from hil.node.outbox import Outbox
from hil.node.process import NodeProcess, build_node, main
from hil.node.realtime import RealTimeRights, Right
from hil.node.timing import CYCLE_FIELDS, RingError, RingHeader, TimingReader, TimingRing, ring_directory
from hil.node.unit import FrameLink, Probe, Unit, UnitBuilder, default_phase_ns

__all__ = [
    "CYCLE_FIELDS",
    "Clock",
    "CycleStart",
    "CycleStatistics",
    "CycleTiming",
    "DeadlinesMissed",
    "FrameLink",
    "Inbox",
    "LockstepClock",
    "LockstepError",
    "Node",
    "NodeOptions",
    "NodeProcess",
    "OptionsError",
    "Outbox",
    "OverloadPolicy",
    "Probe",
    "RealTimeClock",
    "RealTimeRights",
    "Received",
    "Right",
    "RingError",
    "RingHeader",
    "TimingReader",
    "TimingRing",
    "Unit",
    "UnitBuilder",
    "build_node",
    "default_phase_ns",
    "first_deadline",
    "main",
    "next_deadline",
    "ring_directory",
]
