"""Sample diagnoses for tests of page, JSON and tables."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from machopt.data_types.documents.diagnosis_document import JobEffectSection
from machopt.data_types.measurements.recording import Recording
from machopt.data_types.stiffness import StiffnessTerm
from machopt.measurement.diagnosis.data_types.diagnosis_problem import (
    BaseUnknown,
    CoordinateFamily,
    DiagnosisProblem,
    KinematicCorrection,
    LawCurve,
    RecordCorrection,
    UntestableEffect,
)
from machopt.measurement.diagnosis.data_types.diagnosis_result import (
    BaseCoefficient,
    DetectionLimit,
    DiagnosisResult,
    EstimatedValue,
    Finding,
    HoldoutErrors,
    HoldoutProof,
    MismatchShare,
    RivalExplanation,
)

POSES, EACH = 30, 16
N = POSES * EACH
ARCMIN = np.pi / 180 / 60
K = np.array([1.41e6, 4.01e5, 9.35e5, 3.60e5, 3.70e5, 3.80e5])


def recording(*, motion: bool = False) -> Recording:
    """Return load cycles with loading and unloading at 30 poses in two sessions."""
    rng = np.random.default_rng(5)
    pose = np.repeat(np.arange(1, POSES + 1), EACH)
    force = np.tile(np.concatenate([np.linspace(250, 2000, 8), np.linspace(2000, 250, 8)]), POSES)
    wrench = np.zeros((N, 6))
    wrench[:, 2] = -force
    branch = np.tile(np.repeat([1, -1], 8), POSES).astype(np.int8)
    q = np.repeat(rng.uniform(-1.5, 1.5, (POSES, 6)), EACH, axis=0)
    return Recording(
        kind="motion" if motion else "deflection",
        source="tests_of_may",
        q=q,
        pose=pose,
        cycle=pose,
        session=(pose > 15).astype(np.int64),
        line=np.arange(2, N + 2),
        wrench=wrench,
        branch=None if motion else branch,
        displacement=np.zeros((N, 3)),
        files=("data.csv",),
    )


def _estimate(value: float, unit: str, half: float) -> EstimatedValue:
    return EstimatedValue(value, unit, (value - half, value + half), (value - 1.2 * half, value + 1.2 * half))


def hysteresis(joint: int = 3, after: float = 0.025) -> Finding:
    """Return a finding of 0.9 arcmin of hysteresis with its loop."""
    r, rng = recording(), np.random.default_rng(6)
    torque = -r.wrench[:, 2] * (0.6 + 0.3 * np.cos(r.q[:, 1]))  # type: ignore[index]
    up = np.linspace(-300, 1900, 60)
    loop_x = np.concatenate([up, up[::-1]])
    width = 0.9

    def play(x: np.ndarray, branch: np.ndarray) -> np.ndarray:
        return 0.5 * width * branch * (1 - np.exp(-np.abs(x) / 300))

    law = play(loop_x, np.concatenate([np.ones(60), -np.ones(60)]))
    per_reading = play(torque, r.branch.astype(float))  # type: ignore[union-attr]
    left = rng.normal(0, 0.25, N)
    left[7] = 40.0  # a reading that hardly depends on the joint
    place = f"joint:{joint}"
    return Finding(
        effect="joint_hysteresis",
        location=place,
        law="play operator on the joint torque",
        equation="φ = P_w[τ_j]/k: Prandtl–Ishlinskii with one play (Ruderman 2012)",
        note="on load reversal",
        one_of=(("joint_hysteresis", place),),
        parameters={"width": _estimate(0.9, "arcmin", 0.08), "threshold": _estimate(212.0, "N·m", 31.0)},
        before=0.061,
        after=after,
        p_value=0.0004,
        rivals=(
            RivalExplanation(
                effect="joint_backlash",
                location=place,
                law="dead zone on total torque",
                closed=0.31,
                standing="rejected",
                p_value=0.0002,
            ),
            RivalExplanation(
                effect="joint_hysteresis",
                location=place,
                law="Bouc–Wen",
                closed=0.96,
                standing="not excluded",
                p_value=0.31,
            ),
            RivalExplanation(
                effect="joint_creep",
                location=place,
                law="first order",
                closed=0.22,
                standing="rejected",
                p_value=0.0001,
            ),
            RivalExplanation(
                effect="joint_hysteresis",
                location="joint:2",
                law="play",
                closed=0.12,
                standing="rejected",
                p_value=0.0001,
                placebo=True,
            ),
            RivalExplanation(
                effect="joint_hysteresis",
                location=place,
                law="branches shuffled",
                closed=0.01,
                standing="rejected",
                p_value=0.0001,
                placebo=True,
            ),
        ),
        correction=RecordCorrection("joint_hysteresis", place, {"width_arcmin": 0.9}) if joint == 99 else None,
        curve=LawCurve(
            x=loop_x,
            law=law,
            x_label=f"torque at joint {joint} in N·m",
            y_label="twist in arcmin",
            data_x=torque,
            per_reading=per_reading,
        ),
        curve_residual=left,
    )


def link() -> Finding:
    """Return a finding of a compliant link that cannot be distinguished from two alternatives; its law is used by
    the planner."""
    rng = np.random.default_rng(8)
    x = rng.uniform(-900, 900, N)
    return Finding(
        effect="link_compliance",
        location="link:4",
        law="beam with one EI",
        equation="L³/3EI, L²/2EI, L/EI (Euler–Bernoulli)",
        note="in bending across the forearm",
        one_of=(("link_compliance", "link:4"), ("joint_coupling", "joint:4-5"), ("tool_compliance", "tool")),
        parameters={
            "compliance": _estimate(2.4e-7, "rad/(N·m)", 0.4e-7),
            "share_of_deflection": _estimate(14.2, "%", 2.2),
        },
        before=0.025,
        after=0.021,
        p_value=0.012,
        rivals=(
            RivalExplanation(
                effect="joint_pose_dependent_stiffness",
                location="joint:4",
                law="first harmonic",
                closed=0.45,
                standing="rejected",
                p_value=0.003,
            ),
            RivalExplanation(
                effect="tool_compliance",
                location="tool",
                law="6×6 diagonal",
                closed=0.93,
                standing="not excluded",
                p_value=0.22,
            ),
        ),
        correction=StiffnessTerm("link_compliance", "link:4", {"EI_Nm2": 3.1e6, "length_mm": 600.0}),
        curve=LawCurve(
            x=np.array([-900.0, 900.0]),
            law=np.array([-0.2, 0.2]),
            x_label="moment at link 4 in N·m",
            y_label="rotation in mrad",
            data_x=x,
            per_reading=0.2 * x / 900,
        ),
        curve_residual=rng.normal(0, 0.08, N),
    )


def zero_offset() -> Finding:
    """Return a kinematic correction without a curve."""
    return Finding(
        effect="joint_zero_offset",
        location="joint:5",
        law="constant offset",
        equation="Δx = J_5 Δφ",
        note="",
        one_of=(("joint_zero_offset", "joint:5"), ("displacement_frame", "sensor:displacement")),
        parameters={"offset": _estimate(0.021, "deg", 0.006)},
        before=0.0212,
        after=0.0203,
        p_value=0.04,
        correction=KinematicCorrection("joint_zero_offset", "joint:5", {"offset_deg": 0.021}),
    )


def frame() -> Finding:
    """Return an error of the recording, which is not written to a model file."""
    return Finding(
        effect="force_sensor_frame",
        location="sensor:force",
        law="axes turned",
        equation="w_recorded = (I + [φ]×) w",
        note="",
        one_of=(("force_sensor_frame", "sensor:force"),),
        parameters={"angle": _estimate(1.8, "deg", 0.2)},
        before=0.05,
        after=0.03,
        p_value=0.0004,
        correction=RecordCorrection("force_sensor_frame", "sensor:force", {"rotation_deg": [0.1, 1.7, -0.4]}),
        record=True,
    )


def _limits() -> tuple[DetectionLimit, ...]:
    out = []
    for effect, unit, size in (
        ("joint_backlash", "arcmin", 0.11),
        ("joint_hysteresis", "arcmin", 0.14),
        ("joint_nonlinear_stiffness", "%", 12.0),
        ("joint_pose_dependent_stiffness", "%", 6.0),
    ):
        for j in range(1, 7):
            value = size * (1 + 0.4 * abs(j - 3))
            if j == 6:
                out.append(
                    DetectionLimit(
                        effect=effect, location=f"joint:{j}", value=np.inf, unit=unit, standing="not testable"
                    )
                )
            elif j == 1 and effect == "joint_pose_dependent_stiffness":
                both = ((effect, "joint:1"), ("base_compliance", "base"))
                out.append(
                    DetectionLimit(
                        effect=effect, location="joint:1", value=value, unit=unit, standing="only as a set", one_of=both
                    )
                )
            else:
                out.append(DetectionLimit(effect=effect, location=f"joint:{j}", value=value, unit=unit))
    out += [
        DetectionLimit(effect="link_compliance", location=f"link:{j}", value=3e-8 * j, unit="rad/(N·m)")
        for j in range(1, 6)
    ]
    out += [
        DetectionLimit(effect="base_compliance", location="base", value=4.1e-9, unit="rad/(N·m)"),
        DetectionLimit(
            effect="tool_compliance",
            location="tool",
            value=0.021,
            unit="µm/N",
            standing="only as a set",
            one_of=(("tool_compliance", "tool"), ("link_compliance", "link:6")),
        ),
        DetectionLimit(effect="force_sensor_frame", location="sensor:force", value=0.31, unit="deg"),
        DetectionLimit(effect="joint_coupling", location="joint:4-5", value=2.2e-8, unit="rad/(N·m)"),
        DetectionLimit(effect="gravity_compensator", location="joint:2", value=3.3, unit="%"),
    ]
    return tuple(out)


def _errors(before: float, after: float, spoilt: tuple[int, ...], columns: int = 3) -> HoldoutErrors:
    rng = np.random.default_rng(9)
    noise = 0.02e-3
    r = recording()
    scale = np.repeat(rng.uniform(0.4, 1.6, POSES), EACH)[:, None]
    loop = r.branch.astype(float)[:, None] * scale * np.array([0.3, 0.4, 1.0])[:3].mean()  # type: ignore[union-attr]
    residual = rng.normal(0, noise, (N, columns)) + 1e-3 * before * loop
    final = rng.normal(0, noise, (N, columns)) + 1e-3 * max(after - 0.02, 0.0) * loop
    for n in spoilt:
        residual[n] += 1.2e-3
        final[n] += 1.2e-3
    retained = ~np.isin(np.arange(N), spoilt)
    by = np.array(
        [
            [
                1e3 * np.sqrt(np.mean(x[EACH * g : EACH * (g + 1)][retained[EACH * g : EACH * (g + 1)]] ** 2))
                for x in (residual, final)
            ]
            for g in range(POSES)
        ]
    )
    return HoldoutErrors(residual, final, by, np.arange(POSES))


def _coefficients() -> tuple[BaseCoefficient, ...]:
    out = [
        BaseCoefficient(
            BaseUnknown(name=f"joint {j + 1}", unit="rad/(N·m)", lower=0.0, location=f"joint:{j + 1}"),
            1.12 / k,
            1 / k,
            0.03 / k,
        )
        for j, k in enumerate(K)
    ]
    out[5] = replace(out[5], value=0.0, sigma=1e-8)  # at its bound
    out.append(
        BaseCoefficient(
            BaseUnknown(name="force gain, session 2", unit="1", location="sensor:force"), 0.011, 0.007, 0.002
        )
    )
    return tuple(out)


def explained() -> DiagnosisResult:
    """Return a diagnosis with one named effect: hysteresis of joint 3."""
    used = np.ones(N, bool)
    used[[40, 133, 400]] = False
    r = recording()
    force = np.linalg.norm(r.wrench[:, :3], axis=1)  # type: ignore[index]
    return DiagnosisResult(
        channel="deflection",
        predicted="TCP displacement under load",
        verdict="explained",
        sentence="57 µm of 61 µm on unseen poses come back in every repeat. They sit at joint 3, on load reversal: "
        "0.90 arcmin (0.82 … 0.98) of hysteresis. With it unseen poses err by 25 µm, 83 % of the repeatable power is "
        "closed (p < 0.001). Nothing else in the catalogue does as well. Next: nothing needs telling apart.",
        unit="mm",
        heldout_before=0.061,
        noise_floor=0.022,
        repeatable=0.057,
        mismatch_p=0.0002,
        heldout_after=0.025,
        explained=0.83,
        repeatable_after=0.0235,
        findings=(hysteresis(),),
        mismatch=(
            MismatchShare("joint:3", 0.78, "on load reversal"),
            MismatchShare("link:3", 0.41, ""),
            MismatchShare("joint:2", 0.19, "in phase"),
            MismatchShare("link:2", 0.16, ""),
            MismatchShare("tool", 0.06, ""),
            MismatchShare("sensor:force", 0.03, ""),
            MismatchShare("base", 0.012, ""),
            MismatchShare("joint:4", 0.004, ""),
            MismatchShare("branch", 0.71, "unloading against loading", "data"),
            MismatchShare("load", 0.22, "at low load", "data"),
            MismatchShare("q3", 0.11, "where joint 3 is stretched", "data"),
            MismatchShare("session", 0.02, "", "data"),
        ),
        limits=_limits(),
        untestable=(
            *(UntestableEffect("joint_creep", f"joint:{j}", "the recording has no time") for j in range(1, 7)),
            UntestableEffect("thermal_drift", "environment", "the recording has neither time nor temperature"),
            *(UntestableEffect("joint_friction", f"joint:{j}", "needs a motion with torques") for j in range(1, 7)),
        ),
        coefficients=_coefficients(),
        errors=_errors(0.061, 0.025, (40, 133, 400)),
        proof=HoldoutProof(
            groups=np.array([3, 8, 14, 19, 22, 28]),
            before=0.064,
            after=0.026,
            noise_floor=0.022,
            wins=6,
            of=6,
            p_value=0.0156,
        ),
        used=used,
        outliers=np.array([41, 134, 401]),
        axes={
            "load": force,
            "session": r.session.astype(float),
            "branch": r.branch.astype(float),
            "q3": r.q[:, 2],  # type: ignore[union-attr]
        },
        tried=1312,
        next_experiment="Load joint 3 through zero at q3 = 40° and −30°: ± 600 N along x, 6 cycles of 8 steps each.",
        notes=("Force gain of session 2 differs from session 1 by 0.7 %.",),
        warnings=("Joint 6 is hardly loaded by these readings.",),
    )


def consistent() -> DiagnosisResult:
    """Return a diagnosis without any effect."""
    return replace(
        explained(),
        verdict="consistent",
        findings=(),
        proof=None,
        heldout_before=0.0228,
        heldout_after=0.0228,
        sentence="Model and recording agree: unseen poses err by 23 µm where readings scatter by 22 µm, and nothing of "
        "it comes back in repeats (p 0.41). Backlash of 0.11 arcmin at joint 3 would have been seen.",
        noise_floor=0.022,
        repeatable=0.0031,
        mismatch_p=0.41,
        explained=np.nan,
        repeatable_after=0.0031,
        mismatch=(),
        errors=_errors(0.0, 0.0, ()),
        used=np.ones(N, bool),
        outliers=np.zeros(0, np.int64),
        next_experiment="",
        notes=(),
        warnings=(),
    )


def insufficient() -> DiagnosisResult:
    """Return a diagnosis without a finding because of too few readings."""
    return replace(
        consistent(),
        verdict="insufficient",
        mismatch_p=np.nan,
        sentence="Not enough data: 23 µm are left on load tests that no fit saw, and nothing was measured twice.",
        next_experiment="A second session over the same poses and loads would do.",
    )


def unexplained() -> DiagnosisResult:
    """Return a diagnosis with a mismatch that no term explains."""
    d = explained()
    return replace(
        d,
        verdict="unexplained",
        findings=(),
        proof=None,
        heldout_after=0.061,
        explained=0.0,
        repeatable_after=0.057,
        sentence="57 µm of 61 µm on unseen poses come back in every repeat, and no law of the catalogue predicts them. "
        "They live at joint 3 or link 3, mostly between loading and unloading.",
        errors=replace(d.errors, final=d.errors.residual, by_group=d.errors.by_group[:, [0, 0]]),
        next_experiment="Repeat poses 4 and 17 with holds of 60 s at each load: rest time splits creep from friction.",
    )


def three() -> DiagnosisResult:
    """Return a diagnosis with three findings, two of them with alternatives, and one unexplained share."""
    d = explained()
    return replace(
        d,
        verdict="partly_explained",
        findings=(hysteresis(after=0.03), link(), zero_offset()),
        explained=0.55,
        repeatable_after=0.038,
        heldout_after=0.0423,
        errors=_errors(0.061, 0.0423, (40, 133, 400)),
        mismatch=(
            *d.mismatch[:7],
            MismatchShare("joint:4-5", 0.2, "in posture"),
            MismatchShare("rows:41,134,401", 0.05, ""),
            MismatchShare("controller", 0.31, ""),
            *d.mismatch[8:],
        ),
        sentence="57 µm of 61 µm on unseen poses come back in every repeat. Three effects close 55 % of it: hysteresis "
        "of joint 3, compliance of link 4 (or of the tool, or a coupling of joints 4 and 5), a zero offset of joint 5.",
    )


def torque() -> DiagnosisResult:
    """Return a diagnosis of friction in motor torques of six joints."""
    d, rng = explained(), np.random.default_rng(4)
    before = rng.normal(0, 6, (N, 6)) + 14 * np.sign(np.sin(np.arange(N) / 20))[:, None]
    after = rng.normal(0, 6.4, (N, 6))
    by = np.array([[np.sqrt(np.mean(x[16 * g : 16 * g + 16] ** 2)) for x in (before, after)] for g in range(POSES)])
    speed = np.sin(np.arange(N) / 20)
    line = np.linspace(-1, 1, 200)
    f = Finding(
        effect="joint_friction",
        location="joint:2",
        law="Coulomb, viscous and Stribeck",
        equation="τ = (c + (s − c) exp(−(v/v_s)²)) sign v + b v",
        note="at reversal",
        one_of=(("joint_friction", "joint:2"),),
        parameters={"coulomb": _estimate(182.0, "N·m", 12.0), "viscous": _estimate(41.3, "N·m·s/rad", 5.0)},
        before=15.2,
        after=6.5,
        p_value=0.0004,
        correction=RecordCorrection("joint_friction", "joint:2", {"coulomb_Nm": 182.0}),
        curve=LawCurve(
            x=line,
            law=14 * np.sign(line) + 3 * line,
            x_label="velocity of joint 2 in rad/s",
            y_label="friction torque in N·m",
            data_x=speed,
            per_reading=14 * np.sign(speed) + 3 * speed,
        ),
        curve_residual=after[:, 1],
    )
    return replace(
        d,
        channel="torque",
        predicted="joint torque by rigid-body dynamics",
        unit="N·m",
        heldout_before=15.2,
        heldout_after=6.5,
        noise_floor=6.1,
        repeatable=13.9,
        findings=(f,),
        errors=HoldoutErrors(before, after, by, np.arange(POSES)),
        mismatch=(
            MismatchShare("joint:2", 0.66, "at reversal"),
            MismatchShare("joint:3", 0.21, "at reversal"),
            MismatchShare("sensor:tau", 0.04, ""),
            MismatchShare("qd2", 0.6, "near standstill", "data"),
        ),
        axes={"qd2": speed, "time": np.arange(N) * 0.012},
        used=np.ones(N, bool),
        outliers=np.zeros(0, np.int64),
        proof=HoldoutProof(
            groups=np.array([3, 8, 14]), before=15.0, after=6.4, noise_floor=6.1, wins=3, of=3, p_value=0.125
        ),
        sentence="13.9 N·m of 15.2 N·m come back in every repeat: friction of joint 2, 182 N·m Coulomb.",
    )


def problem(d: DiagnosisResult) -> DiagnosisProblem:
    """Return the labels of the readings as a channel states them: groups counted from 0, and one family per joint
    for torques."""
    r = recording()
    group = r.pose - 1
    columns = d.errors.residual.shape[1]
    if d.channel == "torque":
        families = tuple(
            CoordinateFamily(name=f"joint {j + 1}", columns=(j,), unit="N·m", factor=1.0) for j in range(columns)
        )
    else:
        families = (CoordinateFamily(name="translation", columns=(0, 1, 2), unit="mm", factor=1e3),)
    return DiagnosisProblem(
        channel=d.channel,
        y=d.errors.residual,
        base=np.zeros((N, columns, 1)),
        unknowns=(BaseUnknown(name="none", unit=""),),
        families=families,
        group=group,
        visit=group,
        cycle=group,
        session=r.session,
        replicate=np.full(N, -1),
        line=r.line,
        row=np.arange(1, N + 1),
    )


def job() -> JobEffectSection:
    """Return a result of --toolpath."""
    s = np.arange(60)
    return JobEffectSection.model_validate(
        {
            "toolpath": "rivets.apt",
            "reason": None,
            "sentence": "The chosen rotation changes at 41 of 60 points; the worst predicted "
            "deflection falls from 0.212 to 0.148 mm.",
            "changes": [
                {"what": "worst predicted deflection", "before": 0.212, "after": 0.148, "unit": "mm"},
                {"what": "mean predicted deflection", "before": 0.114, "after": 0.098, "unit": "mm"},
                {"what": "points that change rotation", "before": 0, "after": 41, "unit": ""},
            ],
            "point": s.tolist(),
            "gamma_before_deg": (20 * np.sin(s / 9)).tolist(),
            "gamma_after_deg": (35 * np.sin(s / 9) + 8).tolist(),
            "deflection_before_mm": (0.11 + 0.02 * np.sin(s / 5)).tolist(),
            "deflection_unchanged_mm": (0.15 + 0.06 * np.sin(s / 5)).tolist(),
            "deflection_after_mm": [*(0.12 + 0.03 * np.sin(s[:-1] / 5)).tolist(), None],
        }
    )
