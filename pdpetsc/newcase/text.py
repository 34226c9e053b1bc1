"""The text of a new case: what all have in common, and what there is of each kind."""

import math
import re
from string import Template
from typing import Any

from pdpetsc.errors import InputError

CELLS = {"1": 100, "2": 50, "3": 24}
"""Cells along the longest side, at least."""
ROWS = 5
"""Rows of cells over the thinnest part, at least."""
UNEVEN = 0.04
"""How much a cell may be stretched for the sides to be whole numbers of cells."""
DENSITY = {"m": 7850.0, "mm": 7.85e-9}
UNITS = {
    "m": "metres, newtons, seconds and what follows from them (Pa, kg/m^3, J/m^2)",
    "mm": "millimetres, newtons, seconds and what follows from them (MPa, t/mm^3, N/mm)",
}
LABELS = {"m": "", "mm": 'units = { length = "mm", force = "N" }  # labels of pictures and tables\n'}
STRAIN = 1e-3
"""That of the loads: small, and far above rounding."""
NOTCH = 0.5
"""Of the height: its end is then three horizons from all borders."""
CRITICAL = 2e-3
"""Stretch at which a bar fails."""

WHOLE = Template("""\
$schema# $summary
# Written by `pdpetsc new`; units are $units,
# but any consistent set will do. All keys: docs/case-file.md. Would it fit, and is it sound?  pdpetsc check FILE
title = "$title"
$labels
[body]
size = $size$thickness
spacing = $spacing  # between particles; halve it to see whether results still change
horizon = $horizon  # times the spacing
layers = $layers
$cut
[sets]  # conditions of the place before deformation
clamp = "X < 0"  # the layer outside of the body
pulled = "$pulled"

[material.solid]
model = "$model"$model_comment
E = $E
$nu$plane
$density$damage
[[load]]
kind = "displacement"
set = "clamp"
component = "all"
value = 0.0

$load
$solver
$output
[[probe]]  # numbers that are followed: history.csv, summary.json
name = "elongation"
field = "u"
component = "x"
set = "pulled"
reduce = "mean"

[[probe]]
name = "reaction"
field = "reaction"
component = "x"
set = "$held"
reduce = "sum"

$expect""")

LOADS = {
    "tension": Template("""\
[[load]]
kind = "force"  # in total, shared by the particles of the set
set = "pulled"
component = "x"
value = "$force * t"  # t runs from 0 to 1
"""),
    "fracture": Template("""\
[[load]]
kind = "displacement"
set = "pulled"
component = "x"
value = "$stretch * t"  # t runs from 0 to 1
"""),
    "motion": Template("""\
[[load]]
kind = "velocity"
set = "pulled"
component = "x"
value = $velocity  # from the start on: a strain of 0.1 % runs to the left
"""),
}
SOLVERS = {
    "tension": "[solver]\nsteps = 4  # load steps, each by Newton's method\n",
    "fracture": "[solver]\nsteps = 10  # between them bonds fail until none is critical\n",
    "motion": """\
[solver]
mode = "verlet"  # explicit motion, in steps of 0.9 of the stable one
end_time = $end_time  # the wave goes to the clamp and back
""",
}
OUTPUTS = {
    "tension": '[output]\npicture = "stress"  # of result.png: von Mises\n',
    "fracture": '[output]\npicture = "damage"  # of result.png: the share of bonds that have failed\n'
    'curve = { x = "elongation", y = "reaction" }\n',
    "motion": '[output]\npicture = "v"  # of result.png; pdpetsc plot DIR --animate\n'
    'curve = { x = "time", y = "reaction" }\n',
}
EXPECTATIONS = {
    "tension": """\
[[expect]]  # what must come out; if it does not, the exit code is 4
value = "balance.force"
below = 1e-9
source = "equilibrium: reactions and loads cancel"
""",
    "fracture": """\
[[expect]]  # what must come out; if it does not, the exit code is 4
value = "fracture.broken_bonds"
above = 0
source = "it is pulled hard enough for bonds to fail"
""",
    "motion": """\
[[expect]]  # what must come out; if it does not, the exit code is 4
value = "energies.imbalance"
equals = 0.0
atol = $energy  # a hundredth of the work
source = "energy is kept"
""",
}
SUMMARIES = {
    "tension": "$body is clamped at its left end and pulled by a force at its right one.",
    "fracture": "$body is clamped at its left end and pulled at its right one until bonds fail.",
    "motion": "$body is clamped at its left end, and its right one is pulled away at a constant speed: a wave.",
}
TITLES = {"tension": "Tension", "fracture": "Fracture", "motion": "A wave"}
COMMENTS = {
    "correspondence": '  # large strains; elasticity = "hencky" and others',
    "ordinary": "  # the linear peridynamic solid",
    "bond": "  # bond-based: its Poisson's ratio is fixed, $fixed here",
    "abd": "  # the ordinary model with constants a, b, d",
}


def case_text(answers: dict[str, Any], first: str = "") -> str:
    """Return a case file.

    Args:
        answers: to `questions.QUESTIONS`.
        first: what it begins with.

    Raises:
        InputError: no lattice fits the sides.
    """
    kind, dim, size = answers["kind"], answers["dim"], answers["size"]
    spacing, factor = (
        spacing_of(size, dim, kind),
        2.015 if (kind, answers["model"]) == ("tension", "correspondence") else 3.015,
    )
    length, modulus, units = size[0], answers["E"], answers["units"]
    thickness = {"1": (length / 20) ** 2, "3": 1.0}.get(dim) or answers["thickness"]
    area = math.prod(size[1:]) * thickness
    speed = math.sqrt(modulus / DENSITY[units])
    notch = NOTCH * size[1] if dim != "1" and kind == "fracture" else 0.0
    release_rate = float(f"{1e-5 * modulus * factor * spacing:.2g}")
    tough = math.sqrt(release_rate / (math.pi * modulus * notch)) if notch else 1.5 * CRITICAL
    values = {
        "schema": first,
        "size": f"[{', '.join(_text(side) for side in size)}]",
        "thickness": {
            "1": f"\nthickness = {_rounded(thickness)}  # the bar's cross-section",
            "2": f"\nthickness = {_text(thickness)}",
            "3": "",
        }[dim],
        "spacing": f"{spacing:.10g}",
        "horizon": factor,
        "layers": '{ left = "horizon", right = "horizon" }  # particles outside of the body, to hold it by'
        if kind == "fracture" else '{ left = "horizon" }  # particles outside of the body, to hold it by',
        "cut": _cut(answers, notch),
        "pulled": f"X > {_text(length)}" + ("" if kind == "fracture" else " - spacing"),
        "E": _in_thousands(modulus),
        "nu": f"nu = {answers['nu']:g}\n" if "nu" in answers else "",
        "plane": {
            "1": 'plane = "stress"  # a bar: its sides are free',
            "2": f'plane = "{answers.get("plane")}"  # "strain" is for thick parts, "stress" for sheets',
            "3": "# influence = \"gaussian\"  # weights of bonds by their length; constant without it",
        }[dim],
        "density": f"density = {_text(DENSITY[units])}\n" if kind == "motion" else "",
        "units": UNITS[units],
        "labels": LABELS[units],
        "damage": _damage(dim, release_rate, notch, length) if kind == "fracture" else "",
        "force": _rounded(STRAIN * modulus * area),
        "stretch": _rounded(tough * length),
        "velocity": _rounded(STRAIN * speed),
        "end_time": _rounded(2 * length / speed),
        "energy": _rounded(0.02 * STRAIN**2 * modulus * area * length),
        "model": answers["model"],
        "fixed": "any" if dim == "1" else "1/3" if answers.get("plane") == "stress" else "1/4",
    }  # fmt: skip
    values["held"] = "pulled" if kind == "fracture" else "clamp"
    shape = {"1": "A bar", "2": "A plate", "3": "A block"}[dim]
    values["body"] = shape + (" with a notch" if notch else " with a hole" if answers.get("hole") else "")
    values["title"] = f"{TITLES[kind]} in {dim}D"
    values["model_comment"] = COMMENTS[answers["model"]]
    values |= {"summary": SUMMARIES[kind], "load": LOADS[kind].template, "solver": SOLVERS[kind]}
    values |= {"output": OUTPUTS[kind], "expect": EXPECTATIONS[kind]}
    return _aligned(Template(WHOLE.substitute(values)).substitute(values))


def spacing_of(size: tuple[float, ...], dim: str, kind: str) -> float:
    """Return a spacing of which all sides are whole multiples, or nearly.

    Raises:
        InputError: none of a reasonable number of cells is.
    """
    step = 2 if kind == "fracture" else 1  # a notch in the middle runs between particles
    least = max(CELLS[dim], math.ceil(ROWS * max(size) / min(size)))
    least += least % step

    def uneven(count: int) -> float:
        cells = [side * count / max(size) for side in size]
        return max(abs(c / round(c) - 1) for c in cells)

    counts = range(least, 2 * least + 1, step)
    best = next((count for count in counts if uneven(count) < 1e-6), None) or min(counts, key=uneven)
    if uneven(best) > UNEVEN:
        raise InputError(f"--size: no spacing of {least} to {2 * least} cells fits all sides; choose rounder lengths")
    return max(size) / best


def _cut(answers: dict[str, Any], notch: float) -> str:
    """Hole or notch."""
    size = answers["size"]
    middle = [_text(side / 2) for side in size[:2]]
    if answers.get("hole"):
        return f'keep = "hypot(X - {middle[0]}, Y - {middle[1]}) > {_text(answers["hole"])}"  # a hole\n'
    if not notch:
        return ""
    x, low, high = middle[0], _text(-0.1 * size[1]), _text(notch)
    if len(size) == 2:
        return f"cracks = [{{ from = [{x}, {low}], to = [{x}, {high}] }}]  # cuts through bonds\n"
    back, front = _text(-size[2]), _text(2 * size[2])
    corners = ((low, back), (high, back), (high, front), (low, front))
    polygon = ", ".join(f"[{x}, {y}, {z}]" for y, z in corners)
    return f"cracks = [{{ polygon = [{polygon}] }}]  # cuts\n"


def _damage(dim: str, release_rate: float, notch: float, length: float) -> str:
    """The table of failing bonds: by energy where there is a notch, by strength in a bar, in its middle."""
    lines = ["", "[damage.solid]", 'criterion = "critical_stretch"']
    if notch:
        lines.append(f"G_c = {_text(release_rate)}  # energy that a crack takes per area")
    else:
        lines += [f"critical = {CRITICAL:g}", f"along = [{{ at = [{_text(length / 2)}] }}]  # only there"]
    return "\n".join([*lines, 'exempt = ["clamp", "pulled"]  # bonds that never fail', ""])


def _aligned(text: str) -> str:
    """Comments beside entries one under the other."""
    parts = [re.fullmatch(r"([^#]*\S)  # (.*)", line) for line in text.splitlines()]
    lines = [f"{part[1]:<42} # {part[2]}" if part else line for part, line in zip(parts, text.splitlines())]
    return "\n".join([*lines, ""])


def _in_thousands(number: float) -> str:
    """A large number as engineers write it, 210e9."""
    power = 3 * math.floor(math.log10(number) / 3)
    return f"{number / 10**power:.6g}e{power}" if power > 3 else _text(number)


def _rounded(number: float) -> str:
    return _text(float(f"{number:.3g}"))


def _text(number: float) -> str:
    """A number of TOML, without noise from rounding."""
    text = f"{number:.12g}".replace("e+", "e")
    return text if set(text) & set(".e") else f"{text}.0"
