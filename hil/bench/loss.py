"""Frames lost on purpose: what `[bus] loss_probability` means, and where it can be had."""

from __future__ import annotations

from hil.bench.errors import ScenarioError
from hil.bench.outcome import RunOptions
from hil.canbus.contract import Contract
from hil.canbus.memory import Loss
from hil.node.inbox import bus_identifier

SPARED = "SYNC"
SPARED_ENDING = "_SyncDone"
"""The lockstep protocol itself: without it there would be no run, only a wait for a frame that is gone."""


def frame_loss(contract: Contract, probability: float, seed: int) -> Loss:
    """Loss of any frame but SYNC and the answers to it. Which ones follows from the seed."""
    spared = (
        bus_identifier(codec)
        for codec in contract.messages.values()
        if codec.name == SPARED or codec.name.endswith(SPARED_ENDING)
    )
    return Loss(probability, seed, frozenset(spared))


def check_loss(options: RunOptions) -> None:
    """ScenarioError if frames are to be lost on a bus where the bench does not decide that."""
    probability = options.scenario.bus.loss_probability
    if probability > 0.0 and not (options.lockstep and options.bus.interface == "virtual"):
        raise ScenarioError(
            f"bus.loss_probability = {probability:g}: frames are lost on purpose only in lockstep within one"
            " process; run with --lockstep -i virtual"
        )
