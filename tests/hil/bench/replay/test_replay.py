"""A recorded log against one node: exact where it has to be, and every change of the log is found."""

from __future__ import annotations

import pytest

from hil.bench.replay import ReplayError, ReplayRequest, replay
from hil.bench.replay.picture import draw_picture

TICK_NS = 10_000_000
AT = 500  # the tick that is tampered with


def stamped(frames):
    return [(tick * TICK_NS, can_id, data) for tick, can_id, data in frames]


def tampered(frames, can_id, change):
    """The frames with one of this identifier changed, at tick AT or soon after; None takes it out."""
    told, done = [], False
    for tick, i, data in frames:
        if not done and i == can_id and tick >= AT:
            done = True
            new = change(data)
            if new is not None:
                told.append((tick, i, new))
        else:
            told.append((tick, i, data))
    assert done
    return told


def one_step_more(codec, name):
    """Changes a signal by one step of its resolution, leaving counter and CRC alone."""
    signal = codec.signal(name)

    def change(data):
        return (int.from_bytes(data, "little") + (1 << signal.start_bit)).to_bytes(len(data), "little")

    return change


@pytest.mark.parametrize("node", ["controller", "plant_sim"])
def test_a_lockstep_recording_of_the_same_version_matches_to_the_last_bit(lockstep_run, node):
    result = replay(ReplayRequest(lockstep_run, node))
    assert result.lockstep
    assert result.comparison.matches
    compared = [signal for signal in result.comparison.signals if signal.frames]
    assert sum(signal.frames for signal in compared) > 3_000
    assert all((signal.recorded == signal.replayed).all() for signal in compared)  # counters and CRC too


def test_a_step_in_one_frame_is_found_where_it_is(frames, run_of, contract):
    codec = contract.message("ATO_Command")
    run = run_of(stamped(tampered(frames, codec.can_id, one_step_more(codec, "EffortDemand"))))
    comparison = replay(ReplayRequest(run)).comparison
    assert not comparison.matches
    assert [signal.name for signal in comparison.signals if signal.deviating] == ["ATO_Command.EffortDemand"]
    (signal,) = comparison.worst(4)
    assert signal.deviating == 1
    assert signal.worst.deviation == pytest.approx(0.01)
    assert comparison.first.time_s == AT * 0.01
    allowed = replay(ReplayRequest(run, tolerances=["ATO_Command.EffortDemand=0.01"]))
    assert allowed.comparison.matches
    assert replay(ReplayRequest(run, ignore=["ATO_Command.Effort*"])).comparison.matches


def test_frames_that_are_not_in_both_are_told(frames, run_of, contract):
    status = contract.message("ATO_Status").can_id
    lost = replay(ReplayRequest(run_of(stamped(tampered(frames, status, lambda data: None))))).comparison
    (message,) = [message for message in lost.messages if message.deviates]
    assert (message.name, len(message.additional_s), len(message.missing_s)) == ("ATO_Status", 1, 0)

    at = next(k for k, (tick, can_id, _) in enumerate(frames) if can_id == status and tick >= AT)
    twice = [*frames[: at + 1], frames[at], *frames[at + 1 :]]
    doubled = replay(ReplayRequest(run_of(stamped(twice), name="twice"))).comparison
    (message,) = [message for message in doubled.messages if message.deviates]
    assert (message.name, len(message.additional_s), len(message.missing_s)) == ("ATO_Status", 0, 1)


def test_another_input_gives_other_answers(frames, run_of, contract):
    doors = contract.message("ATP_Permission").can_id
    closed = replay(ReplayRequest(run_of(stamped(f for f in frames if f[1] != doors)))).comparison
    assert not closed.matches
    assert any(s.name == "ATO_Command.Mode" and s.verdict == "deviates" for s in closed.signals)


def test_what_a_node_measured_of_its_own_time_is_ignored_unless_the_rules_say_no(
    frames, run_of, contract, tmp_path
):
    timing = contract.message("ATO_Timing")
    run = run_of(stamped(tampered(frames, timing.can_id, one_step_more(timing, "WakeupLatency"))))
    assert replay(ReplayRequest(run)).comparison.matches
    rules = tmp_path / "rules.toml"
    rules.write_text("default_ignore = false\n")
    assert not replay(ReplayRequest(run, rules=rules)).comparison.matches
    rules.write_text('default_ignore = false\n[tolerance]\n"ATO_Timing.*" = 2\n')
    assert replay(ReplayRequest(run, rules=rules)).comparison.matches


def test_a_log_without_sync_is_replayed_in_the_cycles_that_its_stamps_show(frames, run_of, contract):
    """Stamped as in real time: the controller's frames 0.3 ms after its cycle, the plant's 0.6 ms."""
    own = {codec.can_id for codec in contract.sent_by("ATO")}
    protocol = {contract.message(name).can_id for name in ("SYNC", "ATO_SyncDone", "TCU_SyncDone")}
    told = [
        (tick * TICK_NS + (300_000 if can_id in own else 600_000), can_id, data)
        for tick, can_id, data in frames
        if can_id not in protocol
    ]
    for kind in ("log", "asc"):
        result = replay(ReplayRequest(run_of(told, kind, kind) / f"frames.{kind}"))
        assert not result.lockstep
        assert result.comparison.matches, result.comparison.first
        speed = next(s for s in result.comparison.signals if s.name == "ATO_Status.ReferenceSpeed")
        assert speed.frames > 50
        assert speed.replayed.max() > 5.0  # the train drives


def test_the_picture_shows_what_deviates_and_there_is_none_of_a_match(lockstep_run, tmp_path):
    assert draw_picture(replay(ReplayRequest(lockstep_run)), tmp_path) is None
    other = replay(ReplayRequest(lockstep_run, overrides=["controller.law=pid"]))
    path = draw_picture(other, tmp_path)
    assert path.read_bytes().startswith(b"\x89PNG")
    assert path.stat().st_size > 20_000


@pytest.mark.parametrize(
    ("request_of", "words"),
    [
        (lambda run: ReplayRequest(run / "none.blf"), "no such log"),
        (lambda run: ReplayRequest(run / "scenario.toml"), "not a frame log"),
        (lambda run: ReplayRequest(run, "bench"), "--node bench"),
        (lambda run: ReplayRequest(run, tolerances=["ATO_Command.EffortDemand"]), "expected"),
        (lambda run: ReplayRequest(run, tolerances=["ATO_Command.EffortDemand=-1"]), "0 or more"),
        (lambda run: ReplayRequest(run, ignore=["ATO_Comand.Mode"]), "nearest: ATO_Command.Mode"),
    ],
)
def test_bad_input_is_told_in_one_line(lockstep_run, request_of, words):
    with pytest.raises(ReplayError, match=words) as caught:
        replay(request_of(lockstep_run))
    assert "\n" not in str(caught.value)
    assert caught.value.exit_code == 2


def test_a_log_with_lost_ticks_is_no_log_of_a_run(frames, run_of):
    with pytest.raises(ReplayError, match="ticks were lost"):
        replay(ReplayRequest(run_of(stamped(f for f in frames if not 200 <= f[0] < 210))))


def test_a_log_alone_needs_its_scenario_and_somebody_elses_log_is_refused(frames, run_of, contract):
    run = run_of(stamped(frames))
    (run / "scenario.toml").unlink()
    with pytest.raises(ReplayError, match="--scenario"):
        replay(ReplayRequest(run))
    others = run_of([(tick, 0x7FF, b"\0") for tick in range(3)], name="others")
    with pytest.raises(ReplayError, match="nothing to compare"):
        replay(ReplayRequest(others))
