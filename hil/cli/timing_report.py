"""What `hil timing` prints: tables, a histogram, the verdict, and what costs most on this host."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table

from hil.bench.timing.advice import Advice
from hil.bench.timing.campaign import Campaign
from hil.bench.timing.limits import Judged, verdict
from hil.bench.timing.request import FULL, FULL_ALONE, LOOP_PLAIN, LOOP_SPIN, PEER, TITLES, TimingRequest
from hil.bench.timing.samples import Measured, Spread, ratio, spread
from hil.cli.waiting import waiting_words

BAR = " ▏▎▍▌▋▊▉█"
WIDEST_BAR = 16
EDGES_US = (0, 1, 2, 5, 10, 20, 50, 100, 200, 500, 1000, 2000, 5000, 10_000, math.inf)
SHORT = {LOOP_PLAIN: "plain", LOOP_SPIN: "spin", FULL: "bench", FULL_ALONE: "no recorder", PEER: PEER}
CONDITIONS = {"idle": "as it was", "load": "every core busy"}
LISTED_MISSES = 10


def announce(console: Console, request: TimingRequest, seconds: float) -> None:
    """Say what is measured, and how long it takes."""
    parts = ", ".join(TITLES[part] for part in request.parts)
    slices = f"{request.slices} slices of {request.slice_s:g} s each" if request.slices > 1 else "one slice"
    console.print(
        f"[bold]timing[/bold] at {request.period_s * 1e3:g} ms: {parts}; {slices},"
        f" bus {request.bus.interface}; about {_duration(seconds)}",
        highlight=False,
        soft_wrap=True,
    )


def report(
    console: Console,
    campaign: Campaign,
    rows: Sequence[Judged],
    found: Sequence[Advice],
    files: Sequence[Path],
) -> None:
    """Print everything, the verdict and the advice last."""
    for note in campaign.notes:
        console.print(note, style="yellow", highlight=False, soft_wrap=True)
    for condition in dict.fromkeys(where for where, _ in campaign.measured):
        parts = {part: known for (where, part), known in campaign.measured.items() if where == condition}
        if len(campaign.request.conditions) > 1:
            told = f": {campaign.load}" if condition == "load" else ""
            console.print(f"\n[bold underline]{CONDITIONS[condition]}{told}[/]", highlight=False)
        console.print()
        console.print(latency_table(parts))
        if PEER in parts and len(parts) > 1:
            console.print()
            console.print(ratio_table(parts))
        console.print()
        console.print(histogram_table(parts, console.width))
        if FULL in parts:
            console.print()
            console.print(loop_table(parts[FULL]))
            console.print(waiting_line(parts[FULL]), style="dim", highlight=False, soft_wrap=True)
            for line in miss_lines(parts[FULL], campaign.request.period_s):
                console.print(line, highlight=False, soft_wrap=True)
    console.print()
    console.print(verdict_table(rows))
    for line in remarks(rows):
        console.print(line, style="dim", highlight=False)
    if found:
        console.print("\n[bold]What costs most on this host[/bold]")
        for number, item in enumerate(found, 1):
            console.print(
                f" {number}. [bold]{item.what}[/bold]: {item.cost}", highlight=False, soft_wrap=True
            )
            console.print(f"    {item.remedy}", style="dim", highlight=False, soft_wrap=True)
    colour = {"passed": "green", "failed": "red", "not judged": "yellow"}[verdict(list(rows))]
    console.print(f"\n[bold {colour}]{verdict(list(rows))}[/]", highlight=False)
    console.print(f"results: {', '.join(str(file) for file in files)}", highlight=False, soft_wrap=True)


def latency_table(parts: dict[str, Measured]) -> Table:
    """Wake-up latency of every part, its CPU time, its missed deadlines."""
    table = _table("wake-up latency [us]", "cycles", "p50", "p99", "p99.9", "max", "CPU", "missed")
    for part, known in parts.items():
        whole = spread(known.wakeup_latency_us)
        if whole is not None:
            missed = known.missed()
            table.add_row(
                TITLES[part], str(whole.count), *_figures(whole), _cpu(known),
                str(sum(missed.values())) if missed else "",
            )  # fmt: skip
    return table


def ratio_table(parts: dict[str, Measured]) -> Table:
    """Every part over cyclictest, and the error of the distance between two wake-ups."""
    table = _table("over cyclictest", "p50", "p99", "p99.9", "max", "period error [us] p99", "max")
    peer = spread(parts[PEER].wakeup_latency_us) if PEER in parts else None
    for part, known in parts.items():
        whole = spread(known.wakeup_latency_us)
        if part == PEER or whole is None:
            continue
        ratios = [_ratio(ratio(whole, peer, name)) for name in ("p50", "p99", "p999", "max")]
        error = spread(np.abs(known.values("period_error_us")))
        table.add_row(
            TITLES[part], *ratios, *(("", "") if error is None else (_us(error.p99), _us(error.max)))
        )
    return table


def histogram_table(parts: dict[str, Measured], width: int = 80) -> Table:
    """Cycles in each range of latency, bars on a scale of powers of ten; `width` in characters."""
    table = Table("cycles with", box=None, pad_edge=False)
    table.columns[0].no_wrap = True
    counts = {}
    for part, known in parts.items():
        table.add_column(SHORT[part], no_wrap=True)
        counts[part] = np.histogram(known.wakeup_latency_us, bins=np.array(EDGES_US))[0]
    filled = np.flatnonzero(sum(counts.values()))
    if not len(filled):
        return table
    most = max(int(column.max()) for column in counts.values())
    room = (width - 18) // len(parts) - len(str(most)) - 3
    for row in range(int(filled[0]), int(filled[-1]) + 1):
        cells = [bar(int(counts[part][row]), most, max(2, min(room, WIDEST_BAR))) for part in parts]
        table.add_row(_range(EDGES_US[row], EDGES_US[row + 1]), *cells)
    return table


def bar(count: int, most: int, width: int) -> str:
    """A bar of log(1 + count), `width` characters for `most`, and the count; one cycle is a visible step."""
    if not count:
        return ""
    eighths = max(1, round(8 * width * math.log1p(count) / math.log1p(most)))
    whole, rest = divmod(eighths, 8)
    return f"{'█' * whole}{BAR[rest].strip()} {count}"


def loop_table(known: Measured) -> Table:
    """Where the time of the control loop goes: the split of the step, signal age, command latency."""
    table = _table("control loop [us]", "p50", "p99", "p99.9", "max")
    lines = {f"  {name}": values for name, values in known.spans_us().items()}
    lines |= {
        "execution, wake-up to sent": known.values("execution_us"),
        "signal age: ODO_Motion when it is used": known.values("signal_age_us"),
        "command latency: ODO_Motion to ATO_Command": known.values("command_latency_us"),
        "wake-up latency of the plant": known.values("plant_latency_us"),
    }
    for name, values in lines.items():
        whole = spread(values)
        if whole is not None:
            table.add_row(name, *_figures(whole))
    return table


def waiting_line(known: Measured) -> str:
    """How the controller waited for its deadlines."""
    said = known.slices[-1].rights
    return f"the controller {waiting_words(said.get('spin'), said.get('rehearsal'))}"


def miss_lines(known: Measured, period_s: float) -> list[str]:
    """What became of missed deadlines; the first ones in full."""
    misses, missed = known.misses(), sum(known.missed().values())
    lost = sum(piece.frames_lost for piece in known.slices)
    lines = [f"[red]{lost} frames were lost on the bus[/red]"] if lost else []
    if not missed:
        return [*lines, "no deadline missed by either node"]
    if known.unseen is None:
        return [*lines, f"{missed} deadlines missed; no witness can say why"]
    lines.append(
        f"{missed} deadlines missed in {len(misses)} stalls;"
        f" [{'red' if known.unseen else 'green'}]{known.unseen} unseen by the witness[/]"
    )
    for miss in sorted(misses, key=lambda miss: (miss.seen, -miss.lost_ns))[:LISTED_MISSES]:
        stall = f"{(miss.stall_ns or 0) / 1e3:.0f} us"
        lines.append(
            f"  {miss.node}, cycle {miss.cycle}: {miss.missed} missed, {miss.lost_ns / 1e3:.0f} us lost;"
            f" the witness was late by {stall}"
            + ("" if miss.seen else ", [red]which does not explain it[/red]")
        )
    if len(misses) > LISTED_MISSES:
        lines.append(f"  and {len(misses) - LISTED_MISSES} more in timing.json")
    return lines


def verdict_table(rows: Sequence[Judged]) -> Table:
    """Every limit, its value and what became of it."""
    several = len({row.condition for row in rows}) > 1
    table = _table("verdict", "value", "limit", "unit", "")
    table.columns[3].justify = table.columns[4].justify = "left"
    marks = {True: "[green]passed[/green]", False: "[red]failed[/red]", None: "[yellow]not judged[/yellow]"}
    for row in rows:
        name = f"{row.name}{' [dim](busy)[/dim]' if several and row.condition == 'load' else ''}"
        table.add_row(name, _value(row.value), f"{row.limit:g}", row.unit, marks[row.passed])
    return table


def remarks(rows: Sequence[Judged]) -> list[str]:
    """Why limits were not judged, or passed all the same; each reason once."""
    names: dict[str, list[str]] = {}
    for row in rows:
        if row.why:
            names.setdefault(row.why, []).append(row.name)
    return [
        f"{found[0] if len(found) == 1 else f'{len(found)} limits'}: {why}" for why, found in names.items()
    ]


def markdown(campaign: Campaign) -> str:
    """The latency table for the recording."""
    lines = ["| part | | cycles | p50 | p99 | p99.9 | max |", "|:--|:--|--:|--:|--:|--:|--:|"]
    for (condition, part), known in campaign.measured.items():
        whole = spread(known.wakeup_latency_us)
        if whole is not None:
            cells = " | ".join(_figures(whole))
            lines.append(f"| {TITLES[part]} | {CONDITIONS[condition]} | {whole.count} | {cells} |")
    return "Wake-up latency, us\n\n" + "\n".join(lines) + "\n"


def _table(*columns: str) -> Table:
    table = Table(*columns, box=None, pad_edge=False)
    for column in table.columns[1:]:
        column.justify = "right"
    return table


def _figures(whole: Spread) -> tuple[str, ...]:
    return tuple(_us(value) for value in (whole.p50, whole.p99, whole.p999, whole.max))


def _us(value: float) -> str:
    return f"{value:.1f}" if abs(value) < 100 else f"{value:.0f}"


def _ratio(value: float | None) -> str:
    return "-" if value is None else f"{value:.2f}"


def _value(value: float | None) -> str:
    return "-" if value is None else f"{value:.3f}".rstrip("0").rstrip(".")


def _cpu(known: Measured) -> str:
    """CPU of the loop itself: of the controller where there are several processes."""
    shares = known.cpu_share()
    name = "controller" if known.part in (FULL, FULL_ALONE) else next(iter(shares), "")
    return f"{100 * shares[name]:.1f} %" if name in shares else ""


def _range(low: float, high: float) -> str:
    def text(us: float) -> str:
        return f"{us:g} us" if us < 1000 else f"{us / 1000:g} ms"

    return f"{text(low)} and more" if math.isinf(high) else f"{text(low)} to {text(high)}"


def _duration(seconds: float) -> str:
    return f"{seconds:.0f} s" if seconds < 100 else f"{seconds / 60:.0f} min"
