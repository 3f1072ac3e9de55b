"""Write thresholds.md beside this file: every threshold of the diagnosis, and what concealed cases say of it.

``python docs/make_thresholds.py`` writes it; a test holds that it is current.
"""

from __future__ import annotations

from pathlib import Path

from machopt.measurement.diagnosis import thresholds

PAGE = Path(__file__).with_name("thresholds.md")
CONCERNS = {
    "DETECTION": "What is named, and what is said beside it",
    "PROOF": "Whether anything is left out, and whether what was found proves itself",
    "NOISE": "Which readings tell the noise",
    "RECORD": "What is wrong with the record",
    "RESTING": "Load tests and poses",
    "MOTION": "Motions",
    "CHECKED": "What is wrong with a record of load tests, for `identify` and `diagnose`",
    "IDENTIFIED": "What an identification keeps, and says beside it",
    "ESTIMATED": "Noise and weights of both",
}
HEAD = """# Thresholds

Written by `docs/make_thresholds.py` from `machopt/measurement/diagnosis/thresholds/`,
`machopt/measurement/identification/thresholds.py` and `machopt/measurement/estimation/thresholds.py`; do not edit.
`measured`: set on the cases named; `statistics`: follows from what it
means; `judgement`: chosen by an engineer, and no set of cases set it.

What the cases say, whoever chose the number: `{script}` ({date}) took

{sets},

noted every number that a threshold was held against, and answered cases again with thresholds a quarter lower and
higher (a share or a factor near one: a quarter of what parts it from one). Where no answer changes between two numbers,
these cases would not have noticed any other value between them. Where that is narrow and no diagnosis changes with a
quarter less or more, the value matters little. *Better* is more that is right and nothing more that is wrong, *worse*
the opposite, *otherwise* another verdict or other names that are as right. With all thresholds that a case reads a
quarter lower at once, {less} of {cases} answers changed, with all a quarter higher {more}. To set one otherwise and
count: [architecture](architecture.md).
"""


def page() -> str:
    """The text of the page."""
    made = thresholds.read_sensitivity_table()
    cases, less, more = made.changes_when_all_perturbed
    sets = "\n".join(f"- {s}" for s in made.case_sets)
    out = [HEAD.format(script=made.script, date=made.date, sets=sets, cases=cases, less=less, more=more)]
    for concern, title in CONCERNS.items():
        out += [
            f"## {title}",
            "",
            "| threshold | value | what it is | from | what the cases say |",
            "|---|---|---|---|---|",
        ]
        out += [_row(t) for t in thresholds.list_thresholds() if t.concern == concern]
        out.append("")
    return "\n".join(out)


def _row(t: thresholds.ThresholdEntry) -> str:
    cells = (f"`{t.key}`", f"{t.value:.4g}", t.meaning, t.origin.describe(), t.sensitivity.describe())
    return "| " + " | ".join(c.replace("|", "\\|") for c in cells) + " |"


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
