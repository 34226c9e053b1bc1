"""What a new case depends on: options or questions, each with its check and its default."""

import math
from collections.abc import Callable
from typing import Any, NamedTuple

from pdpetsc.commands import OPTIONS
from pdpetsc.errors import InputError

Answers = dict[str, Any]


def _choice(name: str) -> Callable[[str, Answers], str]:
    """One of the choices of an option."""

    def parse(text: str, answers: Answers) -> str:
        choices = OPTIONS[f"--{name}"].choices
        if text not in choices:
            from pdpetsc.expressions import hint

            raise InputError(f"must be one of {', '.join(choices)}, not {text!r}{hint(text, choices)}")
        return text

    return parse


def _number(text: str) -> float:
    try:
        number = float(text)
    except ValueError:
        number = math.nan
    if not math.isfinite(number):
        raise InputError(f"must be a number, not {text!r}")
    return number


def _positive(text: str, answers: Answers) -> float:
    number = _number(text)
    if not 0 < number < 1e300:
        raise InputError(f"must be greater than 0, not {text}")
    return number


def _poisson(text: str, answers: Answers) -> float:
    number = _number(text)
    if not -1 < number < 0.5:
        raise InputError(f"must be above -1 and below 0.5, not {text}")
    return number


def _size(text: str, answers: Answers) -> tuple[float, ...]:
    try:
        size = tuple(_positive(part.strip(), answers) for part in text.split(","))
    except InputError as error:
        raise InputError(f"{error}; lengths have commas between them, as 120,60") from None
    if len(size) != int(answers["dim"]):
        raise InputError(f"must be {answers['dim']} length(s) with commas between them, not {text!r}")
    return size


def _hole(text: str, answers: Answers) -> float:
    radius, most = _number(text), 0.4 * min(answers["size"][:2])
    if not 0 <= radius <= most:
        raise InputError(f"must be between 0 and {most:g}, 0.4 of the shorter side, not {text}")
    return radius


class Question(NamedTuple):
    """What is asked.

    Attributes:
        text: for people; {units} and {stiffness} are the unit of lengths and that of Young's modulus.
        parse: from a word and the answers so far to a value.
        default: a word, by the answers so far.
        applies: whether it makes sense after the answers so far; and why not.
    """

    text: str
    parse: Callable[[str, Answers], Any]
    default: Callable[[Answers], str]
    applies: Callable[[Answers], bool] = lambda answers: True
    otherwise: str = ""


SIZES = {
    "m": {"1": "0.1", "2": "0.1,0.04", "3": "0.1,0.04,0.02"},
    "mm": {"1": "100", "2": "100,40", "3": "100,40,20"},
}
STIFFNESS = {"m": ("pascals", "210e9"), "mm": ("MPa", "210e3")}
QUESTIONS = {
    "kind": Question("What happens: tension, fracture or motion?", _choice("kind"), lambda a: "tension"),
    "dim": Question("Dimensions of the body: 1, 2 or 3?", _choice("dim"), lambda a: "2"),
    "model": Question(
        "Material model: correspondence (large strains), ordinary, bond (fixed Poisson's ratio) or abd?",
        _choice("model"),
        lambda a: "correspondence",
    ),
    "units": Question("Units: m (with N, s and Pa) or mm (with N, s and MPa)?", _choice("units"), lambda a: "m"),
    "size": Question("Lengths of its sides in {units}, with commas?", _size, lambda a: SIZES[a["units"]][a["dim"]]),
    "thickness": Question(
        "Thickness in {units}?", _positive, lambda a: f"{min(a['size']) / 4:g}", lambda a: a["dim"] == "2",
        "a plane body alone has one",
    ),
    "plane": Question(
        "Plane strain (thick parts) or stress (sheets)?", _choice("plane"), lambda a: "strain",
        lambda a: a["dim"] == "2", "a plane body alone is in plane strain or stress",
    ),
    "E": Question("Young's modulus in {stiffness}?", _positive, lambda a: STIFFNESS[a["units"]][1]),
    "nu": Question(
        "Poisson's ratio?", _poisson, lambda a: "0.3", lambda a: a["model"] != "bond",
        "a bond-based material has a fixed Poisson's ratio",
    ),
    "hole": Question(
        "Radius of a round hole in the middle in {units}, 0 for none?", _hole,
        lambda a: f"{0.2 * min(a['size'][:2]) if a['kind'] == 'tension' else 0:.3g}",
        lambda a: a["dim"] != "1" and a["kind"] != "fracture",
        "a hole goes with tension and motion in 2D and 3D",
    ),
}  # fmt: skip
"""In the order in which they are asked; each is an option of the same name."""


def answers(given: dict[str, str], asking: bool) -> Answers:
    """Return a value for each question that applies: from the options given, from a person, or the default.

    Raises:
        InputError: an option is wrong, or does not go with the others; the person has left.
    """
    found: Answers = {}
    if "size" in given and "dim" not in given:
        given = given | {"dim": str(given["size"].count(",") + 1)}
    for name, question in QUESTIONS.items():
        if not question.applies(found):
            if name in given:
                raise InputError(f"--{name}: {question.otherwise}")
            continue
        if asking:
            found[name] = _ask(question, found)
            continue
        try:
            found[name] = question.parse(given.get(name, question.default(found)), found)
        except InputError as error:
            raise InputError(f"--{name}: {error}") from None
    return found


def _ask(question: Question, found: Answers) -> Any:
    """Ask until the answer is one."""
    default, units = question.default(found), found.get("units", "m")
    text = question.text.format(units=units, stiffness=STIFFNESS[units][0])
    while True:
        try:
            word = input(f"{text} [{default}] ").strip()
        except (EOFError, KeyboardInterrupt):
            print()
            raise InputError("no answer; nothing was written") from None
        try:
            return question.parse(word or default, found)
        except InputError as error:
            print(f"  {error}")
