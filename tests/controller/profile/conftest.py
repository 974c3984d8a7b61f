"""The paper's case, and the two helpers that benchmarks use as well."""

from __future__ import annotations

import importlib.util
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

from controller.profile.problem import Efforts, Problem
from hil.railway import load_line, load_train
from hil.railway.library import find_line, find_train


def _beside(name: str) -> ModuleType:
    """A module of this folder; pytest's importlib mode has no packages of tests."""
    if name not in sys.modules:
        spec = importlib.util.spec_from_file_location(name, Path(__file__).parent / f"{name}.py")
        assert spec is not None
        assert spec.loader is not None
        module = importlib.util.module_from_spec(spec)
        sys.modules[name] = module
        spec.loader.exec_module(module)
    return sys.modules[name]


@pytest.fixture(scope="session")
def solve_ipopt() -> Callable[..., Any]:
    return _beside("ipopt").solve_ipopt  # type: ignore[no-any-return]


@pytest.fixture(scope="session")
def routes() -> ModuleType:
    return _beside("routes")


@pytest.fixture(scope="session")
def paper_case() -> Callable[..., Problem]:
    """Cat Linh - La Thanh as the paper has it: a point mass, any effort, -1.4 to +1.1 m/s2."""
    train = load_train(find_train("cat_linh_4car"))
    lines = {
        "forward": (load_line(find_line("cat_linh_la_thanh")), 78.0),
        "reverse": (load_line(find_line("la_thanh_cat_linh")), 83.0),
    }

    def make(direction: str = "forward", time_s: float | None = None, **changes: Any) -> Problem:
        line, paper_time_s = lines[direction]
        mesh = {"max_step_m": changes.pop("max_step_m")} if "max_step_m" in changes else {}
        problem = Problem.of_line(
            line,
            train,
            line.stops[0].position_m,
            line.stops[-1].position_m,
            paper_time_s if time_s is None else time_s,
            max_acceleration_mps2=1.1,
            max_deceleration_mps2=1.4,
            traction_efficiency=1.0,
            regeneration_efficiency=0.0,
            **mesh,
        )
        return replace(problem, **{"traction": Efforts(), "braking": Efforts(), **changes})

    return make
