"""machopt: how an industrial robot holds itself while it drills and mills.

Pipeline of the main job (``machopt optimize CELL TOOLPATH -o OUT``)::

    cell.yaml ──formats.cell──────► domain.cell.Cell ──► model.robot.Robot (kinematics)
    CAM file  ──formats.toolpath──► domain.toolpath.Toolpath

    candidates ─► score ─► choose ─► smooth ─► check ─► retime ─► export ─► verify ─► report
    every q       index    best      γ(s) as    FCL      feed,     tables,   other     one page
    or a reason   per q    sequence  a curve             jerk      KRL       code

Each step is one file in :mod:`machopt.plan` and owns its result type; ``plan/pipeline.py`` draws the
arrows. Imports point one way::

    cli → batch → job → report | formats | verify → diagnose → plan | identify | design | workspace
        → model → domain → se3 → errors

Frames: ``world`` → ``base_link`` → joints → ``flange`` → ``tcp``; ``workpiece`` is the frame of the CAM
coordinates. ``T_a_b`` maps coordinates in b to coordinates in a. Twists and wrenches: linear part first.
TCP +z points out of the tool into the workpiece; the CAM tool axis (i, j, k) is −z of the TCP. ``gamma``
turns the TCP about its own z, right-handed.
Units: SI inside (m, rad, N, N·m, kg, s); mm, degrees and mm/min only in files and reports.
"""

__version__ = "0.1.0"
