"""machopt: plan milling and drilling with an industrial robot so that it deflects little.

Pipeline of the main job (``machopt optimize CELL TOOLPATH -o OUT``)::

    cell.yaml ──cell.cell_reader─────────► data_types.cell.Cell ──► kinematics.robot.Robot
    CAM file  ──toolpath.toolpath_reader─► data_types.toolpath.Toolpath

    candidates ─► score ─► choose ─► smooth ─► check ─► retime ─► export ─► verify ─► report
    every q       index    best      γ(s) as    FCL      feed,     tables,   other     one page
    or a reason   per q    sequence  a curve             jerk      KRL       code

Each step is one file in :mod:`machopt.planning` and owns its result type; ``planning/pipeline/path_planner.py`` draws
the arrows. Imports point one way::

    cli → api → batch | view → commands → cell_setup → program_export → report → verification → input_files | output
        → measurement | placement → planning | workspace_map → stiffness → collision | dynamics | toolpath
        → cell | kinematics | programs → effects | options | path_building → data_types | file_formats → errors
        → numerics

As a library (:mod:`machopt.api`)::

    import machopt

    cell = machopt.Cell.load("cells/kr500_milling")
    plan = machopt.optimize(cell, "part.cls", rotation_step_deg=2.5)
    plan.points["deflection_mm"], plan.verify().ok, plan.save("out/part")

Frames: ``world`` → ``base_link`` → joints → ``flange`` → ``tcp``; ``workpiece`` is the frame of the CAM
coordinates. ``T_a_b`` maps coordinates in b to coordinates in a. Twists and wrenches: linear part first.
TCP +z points out of the tool into the workpiece; the CAM tool axis (i, j, k) is −z of the TCP. ``gamma``
turns the TCP about its own z, right-handed.
Units: SI inside (m, rad, N, N·m, kg, s); mm, degrees and mm/min only in files and reports.
"""

from __future__ import annotations

import sys
from importlib import import_module
from types import ModuleType
from typing import TYPE_CHECKING

from machopt.errors import InputError, MachoptError, VerificationError
from machopt.version import __version__

if TYPE_CHECKING:
    from machopt.api import (
        Cell,
        CuttingCoefficients,
        Diagnosis,
        Figure,
        FrequencyResponseIdentification,
        Identification,
        Map,
        Placement,
        Plan,
        PosePlan,
        Table,
        Toolpath,
        batch,
        diagnose,
        fit_cutting_coefficients,
        identify,
        identify_frequency_responses,
        map,
        optimize,
        place,
        plan_poses,
    )

__all__ = [
    "Cell",
    "CuttingCoefficients",
    "Diagnosis",
    "Figure",
    "FrequencyResponseIdentification",
    "Identification",
    "InputError",
    "MachoptError",
    "Map",
    "Placement",
    "Plan",
    "PosePlan",
    "Table",
    "Toolpath",
    "VerificationError",
    "__version__",
    "batch",
    "diagnose",
    "fit_cutting_coefficients",
    "identify",
    "identify_frequency_responses",
    "map",
    "optimize",
    "place",
    "plan_poses",
]
"""The names that stay: what is not here may change with any version."""


def _define_lazy_name(name: str) -> property:
    """A public name, imported on first use, so that ``import machopt`` loads nothing heavy."""

    def get(_: ModuleType) -> object:
        return getattr(import_module("machopt.api"), name)

    def keep(_: ModuleType, __: object) -> None:
        """Functions have the names of commands, and so have the packages behind them: importing
        ``machopt.measurement.identification.fitting.weighted_fit`` puts its package here as an attribute, which must
        not take the function's place."""

    return property(get, keep)


class _LazyModule(ModuleType):
    """This module, with its public names as properties."""

    def __dir__(self) -> list[str]:
        return sorted({*super().__dir__(), *__all__})


for _name in __all__:
    if _name not in globals():
        setattr(_LazyModule, _name, _define_lazy_name(_name))
sys.modules[__name__].__class__ = _LazyModule
