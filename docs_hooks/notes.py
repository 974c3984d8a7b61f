"""Meanings of keys whose source says nothing beside them; all others are said where the key is defined."""

from __future__ import annotations

_FILE = {
    "schema": "Version of the format.",
    "name": "Short name, as `hil list` shows it; the file has the same.",
    "title": "One line for people.",
    "source": "Where the numbers come from; what is printed there and what is chosen.",
}
_EFFORT = {
    "max_effort_kn": "Largest effort at the wheel rim.",
    "max_power_kw": "Largest power at the wheel rim; the effort falls as power over speed above it.",
    "time_constant_s": "First-order lag of the effort.",
    "dead_time_s": "Time before the effort begins to follow the demand.",
    "jerk_limit_mps3": "Fastest change of the effort, over the mass.",
    "points[].speed_kmh": "Speed of this point.",
    "points[].effort_kn": "Effort there; straight lines in between.",
}
_PEAKS = {
    "error_peaks_mps": "Where the terms small and big of the speed error have their peaks.",
    "rate_peaks_mps2": "The same for the rate of the error.",
    "output_peaks_mps2": "The same for the output: small, medium, big.",
}


def _under(path: str, notes: dict[str, str]) -> dict[str, str]:
    return {f"{path}.{key}": text for key, text in notes.items()}


SCENARIO: dict[str, str] = {
    "schema": _FILE["schema"],
    "name": "Short name; part of the name of the run's directory.",
    "title": _FILE["title"],
    "source": _FILE["source"],
    "journey.line": "A shipped line, or a file (.toml, or .json of TTOBench) beside this one.",
    "journey.train": "A shipped train, or a file beside this one.",
    "journey.from": "Name of the stop where the train starts.",
    "journey.to": "Name of a stop beyond it.",
    "journey.time_s": "Timetable: departure to standstill. Less than the permitted speed allows is an error.",
    "journey.seed": "Of everything random: odometer noise, missed balises, lost frames.",
    "controller.law": "The control law.",
    "controller.period_s": "Period of the controller's cycle.",
    "controller.profile.traction_share": "Share of the nominal tractive effort that the plan may use.",
    "controller.replanning.enabled": "Whether a train that is late, early or restricted gets a new plan.",
    "controller.feed_forward.friction_lead_s": "As `lead_s`, of the friction brake, which takes over where"
    " the motor brake fades out.",
    "controller.pid.kp_per_s": "Gain of the speed error.",
    "controller.pid.ki_per_s2": "Gain of its integral.",
    "controller.pid.kd": "Gain of its rate.",
    **_under("controller.speedt", _PEAKS),
    **_under("controller.fuzzy_d", _PEAKS),
    "controller.fuzzy_d.gain": "Of the rule base's output.",
    "controller.fuzzy_d.derivative_gain": "Of the rate of the error.",
    "controller.fuzzy_d.integral_gain_per_s2": "Of the integral of the error.",
    "controller.fuzzy_pid.kp_per_s": "Middle of the gain of the error.",
    "controller.fuzzy_pid.ki_per_s2": "Middle of the gain of the integral.",
    "controller.fuzzy_pid.ki_range_per_s2": "How far the rules move it.",
    "controller.fuzzy_pid.kd": "Middle of the gain of the rate.",
    "controller.fuzzy_pid.kd_range": "How far the rules move it.",
    "controller.fuzzy_pid.error_range_mps": "Range of the error that the tables cover.",
    "controller.fuzzy_pid.rate_range_mps2": "Range of its rate.",
    "controller.fuzzy_pid.tables": "Rule tables: the common textbook ones are not symmetric in the error.",
    "controller.fsmc.half_range_rate_mps2": "Half range of the rate of the sliding variable.",
    "controller.fsmc_eso.half_range_rate_mps2": "Half range of the rate of the sliding variable.",
    "controller.supervision.overspeed_warning_mps": "So much above the permitted speed: no traction.",
    "controller.supervision.overspeed_brake_mps": "So much above it: service brake.",
    "controller.supervision.overrun_m": "So far past the stop point: service brake for good.",
    "controller.supervision.roll_back_m": "So far backward: emergency brake.",
    "controller.supervision.roll_back_mps": "So fast backward: emergency brake.",
    "controller.supervision.balise_tolerance_m": "Farther from its place than this, a telegram or a position"
    " is not believed.",
    "plant.period_s": "Period of the plant's cycle.",
    "plant.substep_s": "Step of the integration; it divides the period.",
    "plant.train.mass_factor": "Of the mass.",
    "plant.train.davis_factor": "Of the running resistance.",
    "plant.disturbance.amplitude_mps2": "A.",
    "plant.disturbance.angular_frequency_radps": "w.",
    "plant.disturbance.phase_rad": "Phase at the start of the run.",
    "plant.odometry.speed_noise_mps": "Standard deviation of white noise on the measured speed.",
    "plant.odometry.balise_error_m": "Standard deviation of the position that is read at a balise.",
    "plant.odometry.missed_balise_probability": "How often a balise is not read.",
    "plant.atp.restrictions.start_m": "Where it begins.",
    "plant.atp.restrictions.end_m": "Where it ends.",
    "plant.atp.restrictions.limit_kmh": "Highest speed within.",
    "plant.command.lost_brake": "What brakes when ATO_Command is lost.",
    "plant.command.recovery": "What ends it: good commands again, or those and a standstill.",
    "plant.command.recovery_commands": "So many accepted in a row are good again.",
    "bus.interface": "python-can interface.",
    "bus.channel": "Its channel.",
    "bus.bitrate": "On the local bus frames then take their time on the wire.",
    "verdict.stop_error_m": "Distance from the stop point at standstill.",
    "verdict.rms_speed_error_mps": "True speed against the reference, while the controller drives.",
    "verdict.overspeed_mps": "Above the permitted speed.",
    "verdict.jerk_mps3": "Largest, either way.",
    "verdict.trip_time_error_s": "Against the timetable, or what was possible once others held the train.",
    "verdict.max_deadline_misses": "Of controller and of plant, in real time.",
    "verdict.max_consecutive_deadline_misses": "The same, in a row.",
    "timing.max_consecutive_overloads": "In a row. None: it never halts.",
}

LINE: dict[str, str] = {
    **_FILE,
    "start_m": "Where the line's data begin; at least the train's length before the first stop.",
    "end_m": "Where they end; beyond the last stop.",
    "default_limit_kmh": "Speed limit wherever no other is given.",
    "curve_coefficient": "Curve resistance is this over the radius, N/kN.",
    "stops.name": "As the scenario names it.",
    "stops.position_m": "Where the front of the train stops.",
    "gradients.permille": "Positive climbs.",
    "curves.radius_m": "Radius.",
    "tunnels.resistance_n_per_kn": "Additional resistance; without it, it follows from the length.",
    "balises.number": "Number in its telegram.",
    "balises.position_m": "Where it lies.",
    "speed_limits.limit_kmh": "Holds until the rear of the train has left.",
    **{
        f"{table}.{key}": text
        for table in ("speed_limits", "gradients", "curves", "tunnels")
        for key, text in (("start_m", "Where it begins."), ("end_m", "Where it ends."))
    },
}

TRAIN: dict[str, str] = {
    **_FILE,
    "mass_t": "Mass.",
    "rotating_mass_factor": "Inertia of rotating parts as a share of the mass: 0.08, not 1.08.",
    "length_m": "Gradients, curves and limits act along it.",
    "powered_mass_fraction": "Share of the weight on motored axles; limits traction by adhesion.",
    "starting_resistance_n_per_kn": "Additional resistance at standstill.",
    "max_acceleration_mps2": "Largest acceleration in service.",
    "max_braking_mps2": "Full service braking.",
    "comfort_jerk_mps3": "What the plan keeps to.",
    "max_speed_kmh": "Of the vehicle, whatever the line permits.",
    "traction_efficiency": "Wheel rim over line.",
    "regeneration_efficiency": "Back to the line over braking work.",
    "davis.a_n": "a of a + b v + c v².",
    "davis.b_n_per_mps": "b, v in m/s.",
    "davis.c_n_per_mps2": "c.",
    "specific_davis.a_n_per_kn": "a of a + b V + c V².",
    "specific_davis.b_n_per_kn_per_kmh": "b, V in km/h.",
    "specific_davis.c_n_per_kn_per_kmh2": "c.",
    **_under("traction", {key.replace("[]", ""): text for key, text in _EFFORT.items()}),
    **_under("electrodynamic", {key.replace("[]", ""): text for key, text in _EFFORT.items()}),
    "electrodynamic.fade_start_kmh": "Full above.",
    "electrodynamic.fade_end_kmh": "None below.",
    "pneumatic.max_effort_kn": "Full service braking.",
    "pneumatic.emergency_effort_kn": "Emergency braking.",
    "pneumatic.holding_effort_kn": "Holding brake.",
    "pneumatic.time_constant_s": _EFFORT["time_constant_s"],
    "pneumatic.dead_time_s": _EFFORT["dead_time_s"],
}
