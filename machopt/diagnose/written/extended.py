"""The stiffness that a diagnosis leaves: joints as refitted, and the terms with what was found."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from machopt.diagnose import calibrated
from machopt.diagnose.nouns.problem import RecordCorrection
from machopt.diagnose.nouns.result import Coefficient, Diagnosis, spring_shown
from machopt.domain.cell import Cell
from machopt.domain.location import joints_of, located
from machopt.domain.stiffness import SOFTEST, STIFFEST, Stiffness, Term
from machopt.effects.words import spoken
from machopt.errors import InputError
from machopt.model.elastic import against
from machopt.model.robot import load_robot
from machopt.model.terms.against import Against
from machopt.model.terms.compiled import compile_terms

JOINTS = 6


@dataclass(frozen=True)
class Extended:
    """What a diagnosis makes of a cell's stiffness; None where fewer than six joints are known, or one slides."""

    before: Stiffness | None  # joints refitted, without what was found
    after: Stiffness | None  # with it
    withheld: tuple[Term, ...] = ()  # terms that are not in it
    said: tuple[str, ...] = ()  # why, a sentence each


def stiffness_of(cell: Cell, d: Diagnosis, *, weight_alone: bool = False) -> Extended:
    """Joints as refitted and terms, without and with what was found; what the data do not show is the cell's.

    Weight alone turns a joint by an amount that the angles fix, as geometry and waves of a gear do. A spring that is
    far from the cell's in poses ``weight_alone`` is rather what is left of those, and stays out of the stiffness.

    A fit knows no sign of a joint's compliance with all its terms. A finding that would turn the joint against its load
    is named in the diagnosis and withheld from the stiffness; its joints keep the springs that fit without it.
    """
    springs = {c.unknown.spring: c for c in d.coefficients if c.unknown.spring is not None}
    found = tuple(f.correction for f in d.findings if isinstance(f.correction, Term))
    known = () if cell.stiffness is None else cell.stiffness.terms
    if (cell.stiffness is None and len(springs) < JOINTS) or cell.arm_prismatic:
        return Extended(None, None)
    impossible = {id(t): why for t in found if (why := _impossible(cell, t)) is not None}
    withheld = [t for t in found if id(t) in impossible]
    said = [
        f"{spoken(t.effect, t.location)} is not in stiffness.yaml, and the joints keep the springs that fit without "
        f"it, since nothing that is built can be so: {impossible[id(t)]}"
        for t in withheld
    ]
    found = tuple(t for t in found if id(t) not in impossible)
    new = {_name(t) for t in found}
    terms = (*(t for t in known if _name(t) not in new), *found)
    near = calibrated.RECORD.far_spring if weight_alone else np.inf
    before = _made(cell, springs, known, lambda c: c.before, near)
    # a joint's own finding is withheld with the spring that was fitted beside it; a body's is beside all of them
    bare = set(range(1, JOINTS + 1)) if withheld else set()
    after = _made(cell, springs, terms, lambda c: c.before if c.unknown.spring in bare else c.value, near)
    while found and (wrong := _against(cell, after)) is not None:
        out = _culprit(terms, new, wrong)
        bare.update(_joints(out) or range(1, JOINTS + 1))
        withheld.append(out)
        said.append(
            f"{spoken(out.effect, out.location)} is not in stiffness.yaml, and its joint keeps the spring that fits "
            f"without it: {wrong.said}"
        )
        terms = tuple(t for t in terms if t is not out)
        after = _made(cell, springs, terms, lambda c: c.before if c.unknown.spring in bare else c.value, near)
    told = [j for j, c in sorted(springs.items()) if cell.stiffness is not None and spring_shown(c.value, c.sigma)]
    said += [
        f"joint {j} keeps the cell's spring in stiffness.yaml: poses bend under weight alone, where geometry that "
        f"was not found looks like a spring more than {near:g} times off; the same poses with a load would tell"
        for j in told
        if _off(cell, j, springs[j].value) > near
    ]
    return Extended(before, after, tuple(withheld), tuple(said))


def beside(d: Diagnosis, made: Extended) -> Diagnosis:
    """The diagnosis where what was withheld stays in it, and says so."""
    findings = tuple(
        replace(f, correction=RecordCorrection(f.correction.effect, f.correction.location, f.correction.parameters))
        if any(f.correction is t for t in made.withheld) and f.correction is not None
        else f
        for f in d.findings
    )
    return replace(d, findings=findings, warnings=(*d.warnings, *made.said))


def _made(
    cell: Cell,
    springs: Mapping[int, Coefficient],
    terms: tuple[Term, ...],
    of: Callable[[Coefficient], float],
    near: float,
) -> Stiffness:
    """Joints by the springs that the data show within a factor ``near`` of the cell's, and terms."""
    if not springs:
        assert cell.stiffness is not None  # else six joints are shown
        return cell.stiffness if terms == cell.stiffness.terms else replace(cell.stiffness, terms=terms)
    prior, out = None if cell.stiffness is None else cell.stiffness.joints, []
    for j in range(JOINTS):
        c = springs.get(j + 1)
        value = 0.0 if c is None else of(c)
        sure = c is not None and spring_shown(value, c.sigma)
        if prior is not None and not (sure and _off(cell, j + 1, value) <= near):
            out.append(float(prior[j]))
        else:
            out.append(float(np.clip(1.0 / max(value, 1.0 / STIFFEST), SOFTEST, STIFFEST)))
    known = cell.stiffness
    if known is None:
        return Stiffness(joints=np.array(out), terms=terms)
    return Stiffness(joints=np.array(out), terms=terms, external=known.external, position=known.position)


def _off(cell: Cell, joint: int, compliance: float) -> float:
    """Factor between a compliance above zero and the cell's, to either side."""
    assert cell.stiffness is not None
    ratio = compliance * float(cell.stiffness.joints[joint - 1])
    return max(ratio, 1.0 / ratio)


def _impossible(cell: Cell, term: Term) -> str | None:
    """Why no file may hold a term, by the law's own word; None where one may."""
    try:
        compile_terms((term,), load_robot(cell), cell.tool.T_flange_tcp, None)
    except InputError as error:
        return error.reason
    return None


def _against(cell: Cell, stiffness: Stiffness) -> Against | None:
    """As the planner looks at it."""
    return against(stiffness, load_robot(cell), cell.tool.T_flange_tcp, cell.arm_limits)


def _culprit(terms: Sequence[Term], new: set[tuple[str, str]], wrong: Against) -> Term:
    """The term that is said to be wrong, or what was found at its joint: the cell's own held before."""
    named = [t for t in terms if _name(t) == (wrong.effect, wrong.location)]
    beside = [t for t in terms if _name(t) in new and _joints(t) & _joints(wrong)]
    return next(t for t in (*(t for t in named if _name(t) in new), *beside, *named))


def _joints(of: Term | Against) -> set[int]:
    return {j + 1 for j in joints_of(of.location)} if located(of.location).of_joints else set()


def _name(t: Term) -> tuple[str, str]:
    return t.effect, t.location
