"""What ``import machopt`` offers: the commands as functions, their results in memory.

::

    Cell.load ──┐
                ├─ optimize ─► Plan ── points, joints, deflection, figures.map(), verify(), save(OUT)
    Toolpath.read ┘
    identify ─► Identification   diagnose ─► Diagnosis   map ─► Map   plan_poses ─► PosePlan
    fit_cutting_coefficients ─► CuttingCoefficients

Each function calls the service that its command calls, so ``save(OUT)`` writes what the command writes, and takes the
command's options under the names that ``manifest.json`` has for them. Numbers have the units of the files: mm, degrees,
N, N·m, mm/min. Arrays are read-only. Nothing is printed; what is wrong with an input is an
:class:`~machopt.errors.InputError`.

The names stand in ``machopt/__init__.py``; this package is not imported before one of them is used.
"""

from machopt.api.batch_run import batch
from machopt.api.cell import Cell
from machopt.api.cutting_coefficients import CuttingCoefficients, fit_cutting_coefficients
from machopt.api.diagnosis import Diagnosis, diagnose
from machopt.api.figure import Figure
from machopt.api.frequency_responses import FrequencyResponseIdentification, identify_frequency_responses
from machopt.api.identification import Identification, identify
from machopt.api.placement import Placement, place
from machopt.api.plan import Plan, optimize
from machopt.api.pose_plan import PosePlan, plan_poses
from machopt.api.table import Table
from machopt.api.toolpath import Toolpath
from machopt.api.workspace_map import Map, map

__all__ = [
    "Cell",
    "CuttingCoefficients",
    "Diagnosis",
    "Figure",
    "FrequencyResponseIdentification",
    "Identification",
    "Map",
    "Placement",
    "Plan",
    "PosePlan",
    "Table",
    "Toolpath",
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
