"""Recorded answers beside replayed ones: frames paired by cycle, signals compared within their tolerance."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from hil.bench.replay.restbus import Said
from hil.bench.replay.rules import Rules
from hil.canbus.codec import MessageCodec
from hil.canbus.signals import SignalSpec
from hil.node.inbox import bus_identifier

__all__ = ["Comparison", "FirstDeviation", "MessageResult", "SignalResult", "compare"]

NS_PER_S = 1e9
LEFT_OUT_CYCLES, BETWEEN_CYCLES = 1.6, 0.4
"""A pause so long is a frame left out, two frames so close are one too many; what is between is jitter."""

Array = NDArray[np.float64]


class Sample(NamedTuple):
    """One pair of values: when [s], recorded and replayed value, how far apart they count."""

    time_s: float
    recorded: float
    replayed: float
    deviation: float


@dataclass(frozen=True)
class SignalResult:
    """One signal over all pairs of frames, in the DBC's unit.

    `deviating`: frames beyond the tolerance. `worst`: where they are furthest apart, None without frames;
    `first`: the first frame beyond the tolerance. The arrays (n) are for pictures.
    """

    message: str
    signal: SignalSpec
    ignored: bool
    frames: int
    tolerance: float
    deviating: int
    worst: Sample | None
    first: Sample | None
    time_s: Array = field(repr=False)
    recorded: Array = field(repr=False)
    replayed: Array = field(repr=False)

    @property
    def name(self) -> str:
        """Message.Signal."""
        return f"{self.message}.{self.signal.name}"

    @property
    def verdict(self) -> str:
        """`match`, `deviates`, `ignored` or `no frames`."""
        if self.ignored:
            return "ignored"
        if not self.frames:
            return "no frames"
        return "deviates" if self.deviating else "match"

    def say(self, value: float) -> str:
        """A value as people read it: the word of a state, else number and unit."""
        word = self.signal.choices.get(int(value)) if float(value).is_integer() else None
        return str(word) if word is not None else f"{value:.10g} {self.signal.unit}".rstrip()


@dataclass(frozen=True)
class MessageResult:
    """Frames of one message: recorded, replayed, and those without a partner, with their times [s].

    Counted are the frames within the span that is judged. `wrong_length`: those, of both sides, whose length
    is not the DBC's; they are not compared.
    """

    name: str
    ignored: bool
    recorded: int
    replayed: int
    missing_s: tuple[float, ...]
    additional_s: tuple[float, ...]
    wrong_length: int
    signals: tuple[SignalResult, ...]

    @property
    def deviates(self) -> bool:
        """Whether anything about it deviates."""
        if self.ignored:
            return False
        return bool(self.missing_s or self.additional_s or self.wrong_length) or any(
            signal.verdict == "deviates" for signal in self.signals
        )


@dataclass(frozen=True)
class FirstDeviation:
    """The first thing that deviates: when [s], and what, in words."""

    time_s: float
    name: str
    what: str


@dataclass(frozen=True)
class Comparison:
    """All messages of the node."""

    messages: tuple[MessageResult, ...]

    @property
    def matches(self) -> bool:
        """Whether the node answers as it was recorded."""
        return not any(message.deviates for message in self.messages)

    @property
    def signals(self) -> tuple[SignalResult, ...]:
        """All signals of all messages."""
        return tuple(signal for message in self.messages for signal in message.signals)

    @property
    def first(self) -> FirstDeviation | None:
        """The first deviation in time."""
        found: list[FirstDeviation] = []
        for message in self.messages:
            if message.ignored:
                continue
            if message.missing_s:
                found.append(FirstDeviation(message.missing_s[0], message.name, "is missing in the replay"))
            if message.additional_s:
                found.append(FirstDeviation(message.additional_s[0], message.name, "is in the replay only"))
            for signal in message.signals:
                if signal.verdict == "deviates" and signal.first is not None:
                    before, after = signal.say(signal.first.recorded), signal.say(signal.first.replayed)
                    words = f"recorded {before}, replayed {after}"
                    found.append(FirstDeviation(signal.first.time_s, signal.name, words))
            if message.wrong_length:
                words = f"{message.wrong_length} frames have another length than the DBC says"
                found.append(FirstDeviation(0.0, message.name, words))
        return min(found, key=lambda deviation: deviation.time_s, default=None)

    def worst(self, count: int) -> list[SignalResult]:
        """The deviating signals, the one that is the most tolerances off first."""
        deviating = [signal for signal in self.signals if signal.verdict == "deviates"]

        def severity(signal: SignalResult) -> float:
            deviation = signal.worst.deviation if signal.worst is not None else 0.0
            return deviation / (signal.tolerance or abs(signal.signal.scale))

        return sorted(deviating, key=severity, reverse=True)[:count]


def compare(
    codecs: Iterable[MessageCodec],
    recorded: Sequence[Said],
    replayed: Sequence[Said],
    rules: Rules,
    *,
    event_window_ns: int = 0,
    neighbours: int = 0,
    span_ns: tuple[int, int] | None = None,
) -> Comparison:
    """Compare what a node said with what was recorded; times of both count from the same moment.

    A cyclic message is paired within half of its cycle time, one without a cycle within `event_window_ns`.
    `neighbours`: a value may also be the recorded one so many frames sooner or later, or lie between.
    `span_ns`: only frames recorded from then until then are judged, and the node has a clock of its own: a
    cyclic frame without a partner counts only if the node left one out, or sent one between two.
    """
    by_id: dict[int, tuple[list[Said], list[Said]]] = {}
    for which, frames in enumerate((recorded, replayed)):
        for said in frames:
            by_id.setdefault(said.can_id, ([], []))[which].append(said)
    results = []
    for codec in sorted(codecs, key=lambda codec: codec.can_id):
        before, after = by_id.get(bus_identifier(codec), ([], []))
        fitting = tuple([said for said in side if len(said.data) == codec.length] for side in (before, after))
        window_ns = event_window_ns if codec.cycle_ns is None else codec.cycle_ns // 2 - 1
        pairs, missing, additional = _pair(fitting[0], fitting[1], window_ns)
        if span_ns is not None:
            pairs = [pair for pair in pairs if _lies_in(span_ns, pair[0].time_ns)]
            missing, additional = _within(span_ns, missing, additional, fitting[1], window_ns, codec.cycle_ns)
        counted = [[said for said in side if _lies_in(span_ns, said.time_ns)] for side in (before, after)]
        results.append(
            MessageResult(
                name=codec.name,
                ignored=rules.ignores_message(codec),
                recorded=len(counted[0]),
                replayed=len(counted[1]),
                missing_s=tuple(said.time_ns / NS_PER_S for said in missing),
                additional_s=tuple(said.time_ns / NS_PER_S for said in additional),
                wrong_length=sum(len(said.data) != codec.length for side in counted for said in side),
                signals=_signals(codec, pairs, rules, neighbours),
            )
        )
    return Comparison(tuple(results))


def _lies_in(span_ns: tuple[int, int] | None, time_ns: int) -> bool:
    return span_ns is None or span_ns[0] <= time_ns <= span_ns[1]


def _pair(
    recorded: Sequence[Said], replayed: Sequence[Said], window_ns: int
) -> tuple[list[tuple[Said, Said]], list[Said], list[Said]]:
    """Pairs in order, what has no partner in the replay, what has none in the recording."""
    pairs, missing, additional = [], [], []
    i = j = 0
    while i < len(recorded) and j < len(replayed):
        apart = replayed[j].time_ns - recorded[i].time_ns
        if abs(apart) <= window_ns:
            pairs.append((recorded[i], replayed[j]))
            i, j = i + 1, j + 1
        elif apart > 0:
            missing.append(recorded[i])
            i += 1
        else:
            additional.append(replayed[j])
            j += 1
    return pairs, [*missing, *recorded[i:]], [*additional, *replayed[j:]]


def _within(
    span_ns: tuple[int, int],
    missing: list[Said],
    additional: list[Said],
    replayed: Sequence[Said],
    window_ns: int,
    cycle_ns: int | None,
) -> tuple[list[Said], list[Said]]:
    """The frames without a partner that count: well inside the span, whose edges may have cut their partners
    off, and not just the slip of one clock against the other.
    """
    first, last = span_ns[0] + window_ns, span_ns[1] - window_ns
    times = np.array([said.time_ns for said in replayed], dtype=np.int64)

    def around(time_ns: int, side: Literal["left", "right"]) -> tuple[float, float]:
        """How long before and after a moment the node spoke (inf: never)."""
        before, after = (
            int(np.searchsorted(times, time_ns)) - 1,
            int(np.searchsorted(times, time_ns, side=side)),
        )
        return (
            float(time_ns - times[before]) if before >= 0 else np.inf,
            float(times[after] - time_ns) if after < len(times) else np.inf,
        )

    def left_out(said: Said) -> bool:
        return cycle_ns is None or sum(around(said.time_ns, "left")) > LEFT_OUT_CYCLES * cycle_ns

    def between(said: Said) -> bool:
        return cycle_ns is None or min(around(said.time_ns, "right")) < BETWEEN_CYCLES * cycle_ns

    return (
        [said for said in missing if first <= said.time_ns <= last and left_out(said)],
        [said for said in additional if first <= said.time_ns <= last and between(said)],
    )


def _signals(
    codec: MessageCodec, pairs: Sequence[tuple[Said, Said]], rules: Rules, neighbours: int
) -> tuple[SignalResult, ...]:
    time_s = np.array([before.time_ns for before, _ in pairs], dtype=np.float64) / NS_PER_S
    recorded = codec.decode_columns(_payloads([before.data for before, _ in pairs], codec.length))
    replayed = codec.decode_columns(_payloads([after.data for _, after in pairs], codec.length))
    return tuple(
        _signal(codec, signal, time_s, recorded[:, k], replayed[:, k], rules, neighbours)
        for k, signal in enumerate(codec.signals)
    )


def _signal(
    codec: MessageCodec,
    signal: SignalSpec,
    time_s: Array,
    recorded: Array,
    replayed: Array,
    rules: Rules,
    neighbours: int,
) -> SignalResult:
    tolerance = rules.tolerance_of(codec, signal)
    ignored = rules.ignores(codec, signal)
    exact = bool(signal.integer or signal.choices)
    deviation = _deviation(recorded, replayed, neighbours, exact=exact)
    # A tolerance of one step is to allow one step, whatever the last digit of the difference.
    beyond = np.flatnonzero(deviation > tolerance * (1.0 + 1e-9))

    def sample(index: int) -> Sample:
        row = (time_s[index], recorded[index], replayed[index], deviation[index])
        return Sample(*(float(number) for number in row))

    return SignalResult(
        message=codec.name,
        signal=signal,
        ignored=ignored,
        frames=len(deviation),
        tolerance=tolerance,
        deviating=0 if ignored else len(beyond),
        worst=sample(int(np.argmax(deviation))) if len(deviation) else None,
        first=sample(int(beyond[0])) if len(beyond) else None,
        time_s=time_s,
        recorded=recorded,
        replayed=replayed,
    )


def _deviation(recorded: Array, replayed: Array, neighbours: int, *, exact: bool) -> Array:
    """How far each replayed value is from the recorded one, or from those that count beside it (n)."""
    deviation: Array = np.abs(replayed - recorded)
    low, high = recorded.copy(), recorded.copy()
    for shift in range(1, neighbours + 1):
        for here, there in (
            (slice(shift, None), slice(None, -shift)),
            (slice(None, -shift), slice(shift, None)),
        ):
            beside = recorded[there]
            if exact:  # between two states there is nothing
                deviation[here] = np.minimum(deviation[here], np.abs(replayed[here] - beside))
            low[here] = np.minimum(low[here], beside)
            high[here] = np.maximum(high[here], beside)
    if exact or not neighbours:
        return deviation
    return np.maximum(np.maximum(low - replayed, replayed - high), 0.0)


def _payloads(data: Sequence[bytes], length: int) -> NDArray[np.uint8]:
    return np.frombuffer(b"".join(data), np.uint8).reshape(len(data), length)
