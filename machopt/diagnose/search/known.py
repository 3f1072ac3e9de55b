"""K_C: known physics that is counted from the start, and named where the recording shows it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import ndtr

from machopt.arrays import Array
from machopt.diagnose import calibrated
from machopt.diagnose.evidence import heldout
from machopt.diagnose.evidence.grams import base_model, regrouped
from machopt.diagnose.evidence.heldout import Fitted
from machopt.diagnose.nouns.result import Estimate, Finding, Share
from machopt.diagnose.search.select import with_chosen
from machopt.diagnose.search.state import State
from machopt.domain.stiffness import Term


@dataclass(frozen=True)
class Known:
    """The finding, and what the base leaves on unseen groups without it."""

    finding: Finding
    residual_without: Array  # (N, D) SI

    def among(self, shares: Sequence[Share], floor: float) -> list[Share]:
        """Shares of the whole mismatch: what K_C takes alone, and of the rest what the others take.

        Args:
            shares: of what is left beside K_C.
            floor: noise, in the finding's unit.
        """
        power, left = (max(e**2 - floor**2, 0.0) for e in (self.finding.before, self.finding.after))
        rest = min(left / power, 1.0) if power > 0.0 else 1.0
        own = self.finding.location
        scaled = [replace(s, share=1.0 - rest if s.axis == own else rest * s.share) for s in shares]
        return [s for s in scaled if s.share > 0.0 or s.axis == own]


def geometric_finding(state: State) -> Known | None:
    """K_C as a finding where leaving it out would cost as much as any effect must bring; None elsewhere."""
    problem = state.problem
    if problem.known is None or not problem.known.any():
        return None
    columns = [k for k, u in enumerate(problem.unknowns) if u.location != "arm"]
    bare = replace(
        problem,
        y=problem.y + problem.known,
        base=problem.base[:, :, columns],
        unknowns=tuple(problem.unknowns[k] for k in columns),
    )
    model, unit = base_model(bare, state.w, np.random.default_rng(0))
    model = regrouped(model, state.base)
    alone = Fitted(model, bare.base, unit, bare.y)
    without, best = model, with_chosen(state.base, state.chosen)
    for c in state.chosen:  # by their columns: what laws keep of themselves are products with other readings
        without = without.with_columns(c.columns, c.tried.precision(c.scored.shape))
    gain = (without.rss - best.rss) / best.spread
    if gain < max(calibrated.DETECTION.gain, calibrated.DETECTION.named * len(state.base.y)):
        return None
    own = np.sqrt(gain)
    share = 100.0 * float(np.linalg.norm(problem.known[state.used]) / np.linalg.norm(bare.y[state.used]))
    before = alone.heldout()
    after = state.fitted(()).heldout()
    wide = share / own
    return Known(
        Finding(
            effect="geometric_stiffness",
            location="arm",
            law="loaded equilibrium",
            equation="K_C of load and weight, dumas2011 eqs. 8–10, solved instead of linearised",
            note="grows with the load squared",
            one_of=(("geometric_stiffness", "arm"),),
            parameters={
                "share": Estimate(
                    share, "%", (share - 1.645 * wide, share + 1.645 * wide), (share - 1.96 * wide, share + 1.96 * wide)
                )
            },
            before=heldout.rmse(problem, before, state.used),
            after=heldout.rmse(problem, after, state.used),
            p_value=float(2 * ndtr(-own)),
            correction=Term("geometric_stiffness", "arm", {}),
        ),
        before,
    )
