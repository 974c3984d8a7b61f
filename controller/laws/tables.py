"""The tables `[controller.<law>]` of a scenario: one per law, every key optional.

`preset = "paper"` starts from what the law's paper prints, in the units of a train; `"train"`, the default,
from the form that a real drive on a real bus needs. Keys that are given replace the preset's; what they are
is said where the law is.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Annotated, Any, Literal, Self

from pydantic import Field, model_validator

from controller.laws import fsmc, fsmc_eso, fuzzy_d, fuzzy_pid, pid, smc, speedt
from hil.railway.files import FileModel

Positive = Annotated[float, Field(gt=0.0)]
NotNegative = Annotated[float, Field(ge=0.0)]
Seconds = Annotated[float, Field(ge=0.0, le=10.0)]
Two = Annotated[tuple[Positive, Positive], Field(strict=False)]
Three = Annotated[tuple[Positive, Positive, Positive], Field(strict=False)]


class LawTable(FileModel):
    """What the tables have in common."""

    preset: Literal["train", "paper"] = "train"

    def given(self) -> dict[str, Any]:
        """The keys that replace the preset's."""
        return self.model_dump(exclude={"preset"}, exclude_none=True)

    @model_validator(mode="after")
    def _peaks_ascend(self) -> Self:
        for key, peaks in self.given().items():
            if isinstance(peaks, tuple) and list(peaks) != sorted(set(peaks)):
                raise ValueError(f"{key} {list(peaks)} must ascend")
        return self


class PidConfig(LawTable):
    """PID; see :class:`controller.laws.pid.PidGains`."""

    kp_per_s: NotNegative | None = None
    ki_per_s2: NotNegative | None = None
    kd: NotNegative | None = None
    derivative_filter_per_s: Positive | None = None
    feed_forward: bool | None = None

    def parameters(self) -> pid.PidGains:
        """The law's own gains."""
        return replace(pid.PAPER_ON_TRAIN if self.preset == "paper" else pid.PidGains(), **self.given())


class SpeedTConfig(LawTable):
    """SpeedT; see :class:`controller.laws.speedt.SpeedTParameters`."""

    error_peaks_mps: Two | None = None
    rate_peaks_mps2: Two | None = None
    output_peaks_mps2: Three | None = None
    rate_filter_s: Seconds | None = None
    feed_forward: bool | None = None

    def parameters(self) -> speedt.SpeedTParameters:
        """The law's own parameters."""
        preset = speedt.PAPER_ON_TRAIN if self.preset == "paper" else speedt.SpeedTParameters()
        return replace(preset, **self.given())


class FuzzyDConfig(LawTable):
    """Fuzzy-D; see :class:`controller.laws.fuzzy_d.FuzzyDParameters`."""

    error_peaks_mps: Two | None = None
    rate_peaks_mps2: Two | None = None
    output_peaks_mps2: Three | None = None
    gain: Positive | None = None
    derivative_gain: NotNegative | None = None
    integral_gain_per_s2: NotNegative | None = None
    rate_filter_s: Seconds | None = None
    feed_forward: bool | None = None

    def parameters(self) -> fuzzy_d.FuzzyDParameters:
        """The law's own parameters."""
        preset = fuzzy_d.PAPER_ON_TRAIN if self.preset == "paper" else fuzzy_d.FuzzyDParameters()
        return replace(preset, **self.given())


class FuzzyPidConfig(LawTable):
    """Fuzzy PID; see :class:`controller.laws.fuzzy_pid.FuzzyPidParameters`."""

    kp_per_s: NotNegative | None = None
    kp_range_per_s: NotNegative | None = None
    ki_per_s2: NotNegative | None = None
    ki_range_per_s2: NotNegative | None = None
    kd: NotNegative | None = None
    kd_range: NotNegative | None = None
    error_range_mps: Positive | None = None
    rate_range_mps2: Positive | None = None
    tables: Literal["textbook", "symmetric"] | None = None
    rate_filter_s: Seconds | None = None
    feed_forward: bool | None = None

    def parameters(self) -> fuzzy_pid.FuzzyPidParameters:
        """The law's own parameters."""
        preset = fuzzy_pid.PAPER if self.preset == "paper" else fuzzy_pid.FuzzyPidParameters()
        return replace(preset, **self.given())


class SmcConfig(LawTable):
    """Sliding mode; see :class:`controller.laws.smc.SmcParameters`."""

    beta: Annotated[float, Field(ge=1.0, le=3.0)] | None = None
    uncertainty_mps2: NotNegative | None = None
    reaching_mps2: Positive | None = None
    disturbance_mps2: NotNegative | None = None
    boundary_layer_mps: NotNegative | None = None
    preview: bool | None = None

    def parameters(self) -> smc.SmcParameters:
        """The law's own parameters."""
        return replace(smc.PAPER if self.preset == "paper" else smc.SmcParameters(), **self.given())


class FsmcConfig(LawTable):
    """Fuzzy sliding mode; see :class:`controller.laws.fsmc.FsmcParameters`."""

    gain_mps2: Positive | None = None
    half_range_s: Positive | None = None
    half_range_rate_mps2: Positive | None = None
    s_input_unit: Literal["m/s", "km/h"] | None = None
    rate_filter_s: Seconds | None = None
    preview: bool | None = None

    def parameters(self) -> fsmc.FsmcParameters:
        """The law's own parameters."""
        return replace(fsmc.PAPER if self.preset == "paper" else fsmc.FsmcParameters(), **self.given())


class FsmcEsoConfig(LawTable):
    """Fuzzy sliding mode with observer; see :class:`controller.laws.fsmc_eso.FsmcEsoParameters`."""

    gain_mps2: Positive | None = None
    half_range_s_mps: Positive | None = None
    half_range_rate_mps2: Positive | None = None
    bandwidth_per_s: Annotated[float, Field(gt=0.0, le=20.0)] | None = None
    rate_filter_s: Seconds | None = None
    smoothing_s: Seconds | None = None
    disturbance_lead_s: Annotated[float, Field(ge=0.0, le=1.0)] | None = None
    dead_time_s: Annotated[float, Field(ge=0.0, le=2.0)] | None = None
    lag_s: Annotated[float, Field(ge=0.0, le=3.0)] | None = None
    learning_s: Annotated[float, Field(ge=0.0, le=1000.0)] | None = None
    unmodelled_limit_mps2: Positive | None = None
    speed_resolution_mps: Annotated[float, Field(ge=0.0, le=0.1)] | None = None
    reported_effort: bool | None = None
    preview: bool | None = None

    def parameters(self) -> fsmc_eso.FsmcEsoParameters:
        """The law's own parameters."""
        preset = fsmc_eso.PAPER if self.preset == "paper" else fsmc_eso.FsmcEsoParameters()
        return replace(preset, **self.given())
