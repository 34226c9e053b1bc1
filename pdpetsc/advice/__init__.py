"""What looks wrong with the physics of a case: `pdpetsc check` warns of it, and nothing is refused.

A rule is a function of the case and of what is `Known` of it, which yields sentences with place, cause and remedy.
docs/command-line.md lists the rules with their bounds and reasons.
"""

from pdpetsc.advice import failure, horizons, loading, materials  # noqa: F401  fill RULES
from pdpetsc.advice.base import RULES, Known
from pdpetsc.case import Case
from pdpetsc.census import QUICK, take_census
from pdpetsc.prediction import Prediction


def advise(case: Case, prediction: Prediction) -> list[str]:
    """Return what there is to warn of, the same on every rank."""
    known = Known(prediction.time_step, take_census(case, QUICK).materials)
    return [text for each in RULES for text in each(case, known)]
