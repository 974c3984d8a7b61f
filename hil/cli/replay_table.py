"""What `hil replay` prints: a line per signal, frames without a partner, the first deviation, the verdict."""

from __future__ import annotations

from rich.console import Console
from rich.table import Table
from rich.text import Text

from hil.bench.replay import MessageResult, Replayed, SignalResult

MARKS = {"match": ("match", "green"), "deviates": ("deviates", "red"), "ignored": ("ignored", "dim")}
MOST_TIMES = 3


def print_result(console: Console, result: Replayed, *, show_all: bool = False) -> None:
    """Print the result; fits 80 columns."""
    console.print(f"[bold]{result.node}[/bold] against {result.place.log}", highlight=False, soft_wrap=True)
    console.print(_how(result), highlight=False, style="dim")
    console.print(_table(result, show_all=show_all))
    for message in result.comparison.messages:
        if not message.ignored:
            _frames(console, message)
    first = result.comparison.first
    if first is not None:
        console.print(f"first deviation at {first.time_s:.3f} s: {first.name} {first.what}", highlight=False)
    ignored = sum(signal.verdict == "ignored" for signal in result.comparison.signals)
    silent = sum(signal.verdict == "no frames" for signal in result.comparison.signals)
    if not show_all and (ignored or silent):
        console.print(
            f"not listed: {ignored} signals ignored, {silent} never sent (--all lists them)", style="dim"
        )
    if result.comparison.matches:
        console.print("\n[bold green]match[/]: the node answers as it was recorded", highlight=False)
    else:
        count = sum(signal.verdict == "deviates" for signal in result.comparison.signals)
        console.print(
            f"\n[bold red]deviates[/]: {count} signal{'s' if count != 1 else ''} beyond the tolerance",
            highlight=False,
        )


def _how(result: Replayed) -> str:
    of = result.title if result.scenario is None else f"{result.title}, {result.scenario.law}"
    frames = f"{result.restbus_frames} frames of the restbus"
    live = result.live
    if live is None:
        mode = "lockstep" if result.lockstep else "real time"
        speed = result.duration_s / result.wall_s if result.wall_s > 0 else 0.0
        return f"{of}, {mode}: {result.cycles} cycles ({result.instants}), {frames}, {speed:.0f}x real time"
    text = (
        f"{of}, live on {live.bus}: {result.duration_s:.1f} s, {result.cycles} cycles of the device;"
        f" {frames}, sent {live.late_p50_us:.0f} us after they were due (p99 {live.late_p99_us:.0f},"
        f" max {live.late_max_us:.0f}); the first {live.settle_s:g} s do not count"
    )
    if live.dropped:
        text += f"; {live.dropped} frames of the device were lost on the way here"
    if live.stopped:
        text += "; ended early"
    return text


def _table(result: Replayed, *, show_all: bool) -> Table:
    table = Table(box=None, pad_edge=False)
    table.add_column("signal", overflow="fold")
    for name in ("frames", "max dev.", r"at \[s]", "tolerance"):
        table.add_column(name, justify="right", no_wrap=True)
    table.add_column("unit", no_wrap=True)
    table.add_column("", no_wrap=True)
    before = ""
    for signal in result.comparison.signals:
        if signal.verdict in ("ignored", "no frames") and not show_all:
            continue
        if signal.message != before:
            before = signal.message
            table.add_row(Text(before, style="bold"))
        table.add_row(*_row(signal))
    return table


def _row(signal: SignalResult) -> list[str | Text]:
    worst = signal.worst
    differs = worst is not None and worst.deviation > 0.0
    exact = not signal.tolerance
    if worst is None:
        deviation = "-"
    elif exact:  # how often: a distance between states says nothing
        deviation = f"{signal.deviating} frames" if signal.deviating else "0"
    else:
        deviation = f"{worst.deviation:.4g}"
    return [
        f"  {signal.signal.name}",
        str(signal.frames),
        deviation,
        f"{worst.time_s:.2f}" if worst is not None and differs else "",
        "exact" if exact else f"{signal.tolerance:g}",
        signal.signal.unit,
        Text(*MARKS.get(signal.verdict, (signal.verdict, "dim"))),
    ]


def _frames(console: Console, message: MessageResult) -> None:
    for what, times in (("missing", message.missing_s), ("additional", message.additional_s)):
        if times:
            some = ", ".join(f"{time_s:.2f}" for time_s in times[:MOST_TIMES])
            more = ", …" if len(times) > MOST_TIMES else ""
            console.print(
                f"{message.name}: {len(times)} {what} (at {some}{more} s);"
                f" {message.recorded} recorded, {message.replayed} replayed",
                style="red",
                highlight=False,
            )
    if message.wrong_length:
        console.print(f"{message.name}: {message.wrong_length} frames of another length", style="red")
