"""A torque beside a gear by the joint's own angle (a balancer), as each channel sees it: the laws of the registry.

In measured poses the torque bends the joint, whatever the load. A load test sees the spring's slope beside the gear's
stiffness, and the lever arms that the bend at rest moves. A motor carries the torque as it is.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from machopt.arrays import Array
from machopt.diagnose import calibrated
from machopt.diagnose.laws.motion_frame import Scene, curve, joint_law
from machopt.diagnose.nouns.problem import Curve, Finer, Hypothesis, Quantity, RecordCorrection, Shape
from machopt.diagnose.nouns.readings import Readings
from machopt.domain.location import joints_of, located
from machopt.domain.stiffness import Term
from machopt.effects import files, registry
from machopt.effects.compensator import LINKAGE, in_file
from machopt.effects.given import Parameters
from machopt.effects.protocol import Beside, Effect
from machopt.estimate.noise import joint_sensitivity

SUBSCRIPTS = "₁₂₃₄₅₆"
ARM = 6  # joints that a stiffness.yaml is of
FINE = 90  # points of a line over the joint's range
RATIO, ANGLE = 1.5, np.radians(30.0)  # of a spring's length to the next one that is searched, and of its angle
NEAR = 7  # of each, between and beyond


def in_poses(r: Readings) -> list[Hypothesis]:
    """The torque bends the joint."""
    if r.masses is None:
        return []
    return [_bends(r, effect, where, law) for effect, where in _places() if _turns(r, where) for law in effect.beside]


def in_load_tests(r: Readings) -> list[Hypothesis]:
    """A spring beside the gear, of the law that files state."""
    return [_stiffens(r, effect, where, effect.beside[0]) for effect, where in _places() if _turns(r, where)]


def in_torques(scene: Scene) -> list[Hypothesis]:
    """What the motor carries, the law with the fewest numbers first."""
    return [
        _carried(scene, effect, where, law)
        for effect, where in _places()
        if _moves(scene, joints_of(where)[0])
        for law in sorted(effect.beside, key=lambda law: len(law.shape))
    ]


def known(terms: Sequence[Term], q: Array) -> Array:
    """(M, n) N·m that the cell's own terms put on joints at angles q (M, n): motors and gears carry so much less."""
    out = np.zeros_like(q)
    for term in terms:
        effect = registry.elastic(term.effect)
        if effect.beside and (j := joints_of(term.location)[0]) < q.shape[1]:
            law = effect.beside[0]
            values, shape, _ = files.read(law, Parameters(term.parameters, term.effect))
            out[:, j] += law.torque(shape, q[:, j]) @ values
    return out


def shapeless(q: Array) -> Array:
    """(M, n, p) N·m that laws of angle alone ask at angles q (M, n) rad, at their places."""
    parts = [
        (j, law.torque(np.zeros(0), q[:, j]))
        for effect, where in _places()
        if (j := joints_of(where)[0]) < q.shape[1]
        for law in effect.beside
        if not law.shape
    ]
    out = np.zeros((*q.shape, sum(x.shape[1] for _, x in parts)))
    at = 0
    for j, x in parts:
        out[:, j, at : at + x.shape[1]] = x
        at += x.shape[1]
    return out


def _places() -> list[tuple[Effect, str]]:
    return [(e, where) for e in registry.of_beside() for where in e.places]


def _turns(r: Readings, where: str) -> bool:
    j = joints_of(where)[0]
    return bool(r.compliance[j] > 0.0 and np.ptp(r.state.q[:, j]) >= calibrated.RESTING.least_turn)


def _moves(scene: Scene, j: int) -> bool:
    return j < scene.joints and scene.moves(j) and not scene.prismatic[j]


def _note(where: str) -> str:
    return f"joint {located(where).which} only, by its angle"


def _bends(r: Readings, effect: Effect, where: str, law: Beside) -> Hypothesis:
    j = joints_of(where)[0]
    q, c, sub = r.state.q[:, j], float(r.compliance[j]), SUBSCRIPTS[j]
    along = np.linspace(q.min(), q.max(), FINE)

    def torque(at: Array, shape: Shape) -> Array:
        return law.torque(np.array(shape), at)

    def sizes(x: Array, shape: Shape) -> Mapping[str, Quantity]:
        return {"peak_torque": Quantity(float(np.abs(torque(along, shape) @ x).max()), "N·m")}

    def line(x: Array, shape: Shape) -> Curve:
        return Curve(
            x=np.degrees(along),
            law=torque(along, shape) @ x,
            x_label=f"joint {j + 1} in deg",
            y_label="torque in N·m",
            data_x=np.degrees(q),
            per_reading=torque(q, shape) @ x,
        )

    return Hypothesis(
        effect=effect.called,
        location=where,
        law=law.name,
        equation=f"Δ{sub} = c{sub} τ, {law.equation}",
        columns=lambda shape: r.lift(j, c * torque(q, shape)),
        quantities=sizes,
        shapes=law.grid(),
        family="joint",
        note=_note(where),
        penalty=law.penalty,
        curve=line,
        finer=Finer(about=_around) if law is LINKAGE else None,
    )


def _around(shape: Shape, share: float) -> tuple[Shape, ...]:
    """Springs about one, as far as a share of the way to the next ones that are searched."""
    steps = (share * np.linspace(-1.0, 1.0, NEAR)).tolist()
    return tuple((shape[0] * RATIO**a, shape[1] + ANGLE * b) for a in steps for b in steps)


def _stiffens(r: Readings, effect: Effect, where: str, law: Beside) -> Hypothesis:
    j = joints_of(where)[0]
    q, tau, c, sub = r.state.q[:, j], r.load_torque[:, j], r.compliance[j], SUBSCRIPTS[j]
    # the spring also moves the arm at rest, and with it every lever arm of the load
    moved = joint_sensitivity(r.state.J, r.wrench, r.compliance)[:, : r.dimensions, j]

    def columns(shape: Shape) -> Array:
        torque, slope = (of(np.array(shape), q) for of in (law.torque, law.slope))
        return np.asarray(r.lift(j, c**2 * tau[:, None] * slope) + moved[:, :, None] * (c * torque)[:, None, :])

    def sizes(x: Array, shape: Shape) -> Mapping[str, Quantity]:
        slope = law.slope(np.array(shape), np.linspace(q.min(), q.max(), 60))
        peak = float(np.abs(law.torque(np.array(shape), along) @ x).max())
        varies = Quantity(50.0 * float(np.ptp(slope @ x)) * c, "%")
        return {"variation": varies, "peak_torque": Quantity(peak, "N·m"), **law.sizes(x)}

    along = np.linspace(q.min(), q.max(), FINE)
    weight = float(np.abs(r.weight_torque[:, j]).max())

    def buildable(x: Array, shape: Shape) -> bool:
        """A balancer is there for the weight."""
        peak = float(np.abs(law.torque(np.array(shape), along) @ x).max())
        return peak <= calibrated.RESTING.most_balanced * weight

    return Hypothesis(
        effect=effect.called,
        location=where,
        law=law.name,
        equation=f"k{sub}(q{sub}) = k{sub} − ∂τ/∂q{sub}, {law.equation}",
        columns=columns,
        quantities=sizes,
        shapes=law.grid(),
        correction=lambda x, s: Term(effect.called, where, files.write(law, x, np.array(s))),
        family="joint",
        note=_note(where),
        penalty=law.penalty,
        buildable=buildable,
    )


def _carried(scene: Scene, effect: Effect, where: str, law: Beside) -> Hypothesis:
    j = joints_of(where)[0]
    q = scene.motion.q[:, j]
    planned = scene.joints == ARM and not any(scene.prismatic)  # else no stiffness.yaml is there to hold it

    def signal(s: Shape) -> Array:
        return law.torque(np.array(s), q)

    def sizes(x: Array, s: Shape) -> Mapping[str, Quantity]:
        pull = signal(s) @ x
        # the offset of the joint hides a constant part: what varies is what is seen
        return {
            "variation": Quantity(float(np.ptp(pull)), "N·m"),
            "peak_torque": Quantity(float(np.abs(pull).max()), "N·m"),
        }

    def stated(x: Array, s: Shape) -> Term | RecordCorrection:
        # on the joint, so that its motor carries less
        parameters = files.write(effect.beside[0], *in_file(law, -x, np.array(s)))
        return (Term if planned else RecordCorrection)(effect.called, where, parameters)

    return joint_law(
        scene,
        j,
        effect.called,
        law.name,
        f"τ{SUBSCRIPTS[j]} −= τ, {law.equation}",
        signal,
        sizes,
        law.grid(),
        family="compensator",
        curve=lambda x, s: curve(scene, np.degrees(q), signal(s) @ x, f"joint {j + 1} in degrees", "torque in N·m"),
        note=f"with the angle of joint {j + 1}",
        correction=stated,
    )
