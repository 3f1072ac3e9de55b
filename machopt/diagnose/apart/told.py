"""What plan.json tells of the explanations that a measurement is to tell apart."""

from __future__ import annotations

from machopt.design.maximin import LEVEL, POWER, needed_noncentrality
from machopt.design.measurement import UNLOADED_TWICE
from machopt.diagnose.apart.disputes import Stand
from machopt.diagnose.apart.separate import Discriminating, described
from machopt.domain.results.poses import DiscriminateTold, NoiseTold, PairTold, StandTold


def apart_told(a: Discriminating) -> DiscriminateTold:
    enough = needed_noncentrality()
    own = a.noise.displacement * UNLOADED_TWICE**0.5
    return DiscriminateTold(
        level=LEVEL,
        power=POWER,
        noncentrality_needed=enough,
        noise_mm=NoiseTold(own=own * 1e3, pose=a.noise.pose * 1e3),
        steps=tuple(a.steps),
        cycles=a.noise.cycles,
        least_noncentrality_per_cycle=a.least,
        random_least_noncentrality_per_cycle=a.random,
        pairs=tuple(
            PairTold(
                one=_stand(p.one),
                two=_stand(p.two),
                words=described(p),
                why=p.why,
                noncentrality_per_cycle=p.per_cycle,
                noncentrality_planned=p.planned,
                cycles_for_power=p.cycles,
                cycles_until_diagnose_excludes=p.until,
                random_noncentrality_per_cycle=p.random,
                told_apart=p.told,
                otherwise=p.advice or None,
            )
            for p in a.pairs
        ),
    )


def _stand(s: Stand) -> StandTold:
    return StandTold(effect=s.effect, location=s.location, law=s.law)
