"""The simulated robot: geometry and weights from a cell's URDF, everything else from the case.

The URDF is read here with the standard library; the elastic parts are bodies, not compliances: a link is a row of rigid
pieces with hinges between them (n pieces: tip deflection of a clamped beam to 1/(4 n²)), the pedestal a plate on four
bolts, a loose bearing one more hinge with clearance.
"""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from simulator.gear_torque_laws import Law, Spring
from simulator.serial_chain import Chain, Placement, shift, turn_rpy

Array = NDArray[np.float64]
PIECES = 10  # of a beam


@dataclass(frozen=True)
class Nominal:
    """What the cell folder says."""

    name: str
    joints: tuple[Placement, ...]  # of each joint in the link before
    axes: Array  # (6, 3)
    mass: Array  # (7,) kg of base_link and the links
    com: Array  # (7, 3) m in the link
    flange: Placement  # in link 6
    tcp: Placement  # in flange
    tool_mass: float  # kg
    tool_com: Array  # (3,) m in flange
    lower: Array  # (6,) rad
    upper: Array  # (6,) rad
    speed: Array  # (6,) rad/s
    home: Array  # (6,) rad
    stiffness: Array  # (6,) N·m/rad as in stiffness.yaml
    urdf: Path


def read_nominal(cell: Path) -> Nominal:
    """Geometry, weights and stiffness of a cell folder; cells of this repository only (flow lists, six joints)."""
    text = (cell / "cell.yaml").read_text(encoding="utf-8")
    tool = text[text.index("\ntool:") :]
    root = ET.parse(cell / "robot.urdf").getroot()
    joints = {j.get("name"): j for j in root.findall("joint")}
    chain = [joints[f"a{i}"] for i in range(1, 7)]
    links = [_only(chain[0], "parent").get("link"), *(_only(j, "child").get("link") for j in chain)]
    inertial = {link.get("name"): link.find("inertial") for link in root.findall("link")}
    mass, com = np.zeros(7), np.zeros((7, 3))
    for i, name in enumerate(links):
        body = inertial[name]
        if body is not None:
            mass[i], com[i] = float(_only(body, "mass").get("value", "0")), _floats(_only(body, "origin").get("xyz"))
    limits = [_only(j, "limit") for j in chain]
    tcp = re.search(r"tcp: \{xyz_mm: \[(.*?)\], rpy_deg: \[(.*?)\]\}", tool)
    assert tcp is not None
    return Nominal(
        name=cell.name,
        joints=tuple(_placement(j) for j in chain),
        axes=np.array([_floats(_only(j, "axis").get("xyz")) for j in chain]),
        mass=mass,
        com=com,
        flange=_placement(joints["flange_fixed"]),
        tcp=Placement(turn_rpy(np.radians(_list(tcp[2]))), _list(tcp[1]) / 1e3),
        tool_mass=float(_word(tool, "mass_kg")),
        tool_com=_list(_word(tool, "com_mm").strip("[]")) / 1e3,
        lower=np.array([float(v.get("lower", "0")) for v in limits]),
        upper=np.array([float(v.get("upper", "0")) for v in limits]),
        speed=np.array([float(v.get("velocity", "0")) for v in limits]),
        home=np.radians(_list(_word(text, "home_deg").strip("[]"))),
        stiffness=_list(_word((cell / "stiffness.yaml").read_text(encoding="utf-8"), "joints_Nm_per_rad").strip("[]")),
        urdf=cell / "robot.urdf",
    )


@dataclass(frozen=True)
class Beam:
    """A link or shank along a straight line; each piece has its own section."""

    EIy: float  # N·m², bending about the first cross axis
    EIz: float
    GJ: float  # N·m²
    taper: float = 0.0  # share by which the far end is slimmer
    only: str = "all"  # all | bending | torsion


@dataclass(frozen=True)
class Plate:
    """The robot's foot on four bolts at (±a, ±a); a loose one has its own stiffness when it is drawn out."""

    half: float  # m
    vertical: Array  # (4,) N/m pressed
    drawn: Array  # (4,) N/m pulled
    sideways: float  # N/m each
    only: str = "all"  # all | spin: turns about z only

    CORNERS = ((1.0, 1.0), (1.0, -1.0), (-1.0, 1.0), (-1.0, -1.0))

    def force(self, x: Array) -> tuple[Array, Array]:
        """Restoring force (B, 6) of shifts and small turns (B, 6) and its slope (B, 6, 6); N, N·m."""
        f, K = np.zeros_like(x), np.zeros((len(x), 6, 6))
        for corner, pressed, drawn in zip(self.CORNERS, self.vertical, self.drawn, strict=True):
            c = self.half * np.array([*corner, 0.0])
            G = np.zeros((3, 6))  # motion of the corner
            G[:, :3] = np.eye(3)
            G[:, 3:] = np.array([[0, c[2], -c[1]], [-c[2], 0, c[0]], [c[1], -c[0], 0]])
            up = x @ G[2]
            # the bolt's washer beds in over a micrometre: a smooth change of slope
            bed = 0.5 * (1.0 + np.tanh(up / 1e-6))
            k = pressed + (drawn - pressed) * bed
            stiff = np.stack([np.full_like(k, self.sideways), np.full_like(k, self.sideways), k], axis=1)
            f += (stiff * (x @ G.T)) @ G
            K += np.einsum("ci,bc,cj->bij", G, stiff, G)
        return f, K


@dataclass(frozen=True)
class Hinge:
    """One more degree of freedom at the outer end of a body, before the next joint."""

    body: int  # 0 base_link … 6 link 6
    turns: bool
    axis: Array  # (3,) in the frame of the next joint, or of the flange
    law: Law


@dataclass(frozen=True)
class Hose:
    """A spring or weightless line from a point of a body to a point of the hall."""

    body: int
    local: Array  # (3,) m in the body
    anchor: Array  # (3,) m in base
    tension: float  # N
    rate: float  # N/m about ``rest``
    rest: float  # m

    def pull(self, at: Array) -> Array:
        """Force (B, 3) N on the body at points (B, 3)."""
        line = self.anchor - at
        length = np.linalg.norm(line, axis=1)
        return np.asarray(line * (np.maximum(self.tension + self.rate * (length - self.rest), 0.0) / length)[:, None])


@dataclass
class Arm:
    """A robot as it is, not as its cell says."""

    nominal: Nominal
    laws: list[Law]
    mix: Array = field(default_factory=lambda: np.eye(6))  # joint twists per gear twist (shafts through the wrist)
    zero: Array = field(default_factory=lambda: np.zeros(6))  # rad, true minus encoder
    lengthen: Array = field(default_factory=lambda: np.zeros((6, 3)))  # m, of joint origins
    mass_scale: Array = field(default_factory=lambda: np.ones(7))
    tool_mass: float = 0.0
    tool_com: Array = field(default_factory=lambda: np.zeros(3))
    beams: dict[int, Beam] = field(default_factory=dict)  # by link
    shank: Beam | None = None
    plate: Plate | None = None
    hinges: list[Hinge] = field(default_factory=list)
    hoses: list[Hose] = field(default_factory=list)
    grows: list[int] = field(default_factory=list)  # links with prescribed growth and bow (heat)
    misread: list[tuple[int, object]] = field(default_factory=list)  # joint, callable q (B, 6) -> rad

    def true_angles(self, encoder: Array) -> Array:
        """Where the unloaded gears stand (N, 6) rad when the encoders show ``encoder``."""
        q = encoder + self.zero
        for joint, error in self.misread:
            q = q.copy()
            q[:, joint] += error(encoder)  # type: ignore[operator]
        return q


def arm_of(nominal: Nominal) -> Arm:
    """The arm exactly as its cell says."""
    return Arm(
        nominal, [Spring(float(k)) for k in nominal.stiffness], tool_mass=nominal.tool_mass, tool_com=nominal.tool_com
    )


@dataclass
class Model:
    """The chain of an arm and what holds each of its degrees of freedom."""

    chain: Chain
    joint: NDArray[np.int64]  # (6,) index of the joints
    stiff: Array  # (n,) N·m/rad or N/m of plain springs; 0 where something else holds
    plate: NDArray[np.int64]  # (6,) or (0,)
    hinge: list[tuple[int, Law]]
    growth: dict[int, tuple[int, tuple[int, ...]]]  # link: its extension, its bow (prescribed)
    frames: list[int]  # (7,) frame of each body
    flange: tuple[int, Placement]


def build(arm: Arm) -> Model:
    """Assemble the chain."""
    nominal, chain = arm.nominal, Chain()
    stiff: dict[int, float] = {}
    joint, frames, hinge = [], [], []
    growth: dict[int, tuple[int, tuple[int, ...]]] = {}
    plate = np.zeros(0, np.int64)
    if arm.plate is not None:
        if arm.plate.only == "spin":
            plate = np.array([chain.add(True, np.eye(3)[2])])
        else:
            plate = np.array([chain.add(k > 2, np.eye(3)[k % 3]) for k in range(6)])
    for body in range(7):
        if body > 0:
            chain.step(shift(arm.lengthen[body - 1]))
            joint.append(chain.add(True, nominal.axes[body - 1]))
        frames.append(len(chain))
        end = nominal.joints[body] if body < 6 else nominal.flange
        mass, com = nominal.mass[body] * arm.mass_scale[body], nominal.com[body]
        line = end.t
        length = float(np.linalg.norm(line))
        if body in arm.beams:
            add_beam(chain, stiff, arm.beams[body], line, mass, com - 0.5 * line)
            chain.step(Placement(end.R, np.zeros(3)))
        else:
            chain.weigh(mass, com)
            if body in arm.grows and length > 0:
                growth[body] = _growth(chain, line)
                chain.step(Placement(end.R, np.zeros(3)))
            else:
                chain.step(end)
        for h in arm.hinges:
            if h.body == body:
                hinge.append((chain.add(h.turns, h.axis), h.law))
    flange = (len(chain), chain.pending)
    chain.weigh(arm.tool_mass, arm.tool_com)
    if arm.shank is not None:
        add_beam(chain, stiff, arm.shank, nominal.tcp.t, 0.0, np.zeros(3))
        chain.step(Placement(nominal.tcp.R, np.zeros(3)))
    else:
        chain.step(nominal.tcp)
    k = np.zeros(len(chain))
    for d, value in stiff.items():
        k[d] = value
    return Model(chain, np.array(joint), k, plate, hinge, growth, frames, flange)


def _growth(chain: Chain, line: Array) -> tuple[int, tuple[int, ...]]:
    """Half the link, its lengthening and its bow, the other half."""
    length = np.linalg.norm(line)
    chain.step(shift(0.5 * line))
    first = chain.add(False, line / length)
    _, y, z = _frame(line)
    bow = (chain.add(True, y), chain.add(True, z))
    chain.step(shift(0.5 * line))
    return first, bow


def add_beam(chain: Chain, stiff: dict[int, float], beam: Beam, line: Array, mass: float, aside: Array) -> None:
    """Pieces along ``line``; the mass lies along it, moved aside as a whole so that its centre stays."""
    n, length = PIECES, float(np.linalg.norm(line))
    x, y, z = _frame(line)
    h = length / n
    for piece in range(n):
        middle = (piece + 0.5) / n
        slim = 1.0 - beam.taper * (middle - 0.5)
        chain.step(shift(0.5 * h * x))
        if beam.only != "torsion":
            for axis, EI in ((y, beam.EIy), (z, beam.EIz)):
                stiff[chain.add(True, axis)] = EI * slim / h
        if beam.only != "bending":
            stiff[chain.add(True, x)] = beam.GJ * slim / h
        if mass > 0:
            chain.weigh(mass / n, aside)
        chain.step(shift(0.5 * h * x))


def tip_softness(beam: Beam, length: float) -> float:
    """m/N by which the free end of such pieces gives way to a force across it, about the second axis."""
    middle = (np.arange(PIECES) + 0.5) / PIECES
    turned = length / PIECES / (beam.EIz * (1.0 - beam.taper * (middle - 0.5)))  # rad/(N·m) of each hinge
    return float(turned @ (length * (1.0 - middle)) ** 2)


def _frame(line: Array) -> tuple[Array, Array, Array]:
    x = line / np.linalg.norm(line)
    y = np.cross(np.eye(3)[int(np.argmin(np.abs(x)))], x)
    y /= np.linalg.norm(y)
    return x, y, np.cross(x, y)


def _only(parent: ET.Element, tag: str) -> ET.Element:
    found = parent.find(tag)
    assert found is not None, tag
    return found


def _placement(joint: ET.Element) -> Placement:
    origin = _only(joint, "origin")
    return Placement(turn_rpy(_floats(origin.get("rpy"))), _floats(origin.get("xyz")))


def _floats(text: str | None) -> Array:
    return np.array([float(v) for v in (text or "0 0 0").split()])


def _list(text: str) -> Array:
    return np.array([float(v) for v in text.split(",")])


def _word(text: str, key: str) -> str:
    found = re.search(rf"{key}: (\[.*?\]|\S+)", text)
    assert found is not None, key
    return found[1].split("#")[0].strip()
