"""Expressions that users write in case files, read by a small grammar of our own and never by Python's `eval`."""

import ast
import difflib
import operator
import warnings
from collections.abc import Callable, Iterable
from functools import reduce
from typing import NamedTuple

import numpy as np

from pdpetsc.errors import InputError

NAMES = ("X", "Y", "Z")
"""Of the reference coordinates."""

CONSTANTS = {"pi": np.pi, "true": True, "false": False}
FUNCTIONS = {
    name: getattr(np, name)
    for name in (
        "sin", "cos", "tan", "arcsin", "arccos", "arctan", "arctan2", "sinh", "cosh", "tanh", "exp", "expm1",
        "log", "log1p", "log10", "sqrt", "abs", "hypot", "minimum", "maximum", "where", "floor", "ceil", "sign",
    )
}  # fmt: skip
_ARITHMETIC = {
    ast.Add: np.add,
    ast.Sub: np.subtract,
    ast.Mult: np.multiply,
    ast.Div: np.divide,
    ast.Pow: operator.pow,  # np.power squares numbers fifteen times more slowly
    ast.UAdd: np.positive,
    ast.USub: np.negative,
}
_COMPARISONS = {
    ast.Lt: np.less,
    ast.LtE: np.less_equal,
    ast.Gt: np.greater,
    ast.GtE: np.greater_equal,
    ast.Eq: np.equal,
    ast.NotEq: np.not_equal,
}
_LOGIC = {ast.And: np.logical_and, ast.Or: np.logical_or}
_INSTEAD = {
    ast.BitAnd: "write 'and' instead of '&'",
    ast.BitOr: "write 'or' instead of '|'",
    ast.Invert: "write 'not' instead of '~'",
    ast.BitXor: "write '**' for a power",
}
_LONGEST = 2000  # characters
_DEEPEST = 150  # levels of nesting; each costs up to three frames of Python's stack


def hint(word: str, choices: Iterable[str]) -> str:
    """Return " (did you mean 'x'?)" for the choice nearest to a word, or nothing."""
    by_lower_case = {choice.lower(): choice for choice in choices}
    near = difflib.get_close_matches(word.lower(), by_lower_case, n=1)
    return f" (did you mean {by_lower_case[near[0]]!r}?)" if near else ""


def _short(text: str) -> str:
    return text if len(text) <= 80 else text[:77] + "..."


class Expression:
    """A number, formula or condition of named variables, for example ``hypot(X, Y) > 0.01 and X < 1``.

    Logic is evaluated for all points at once: both branches of `where` and both sides of `and` are computed
    everywhere, undefined values that are not selected do no harm, and a comparison with one is false.

    Args:
        text: The expression, or a plain number.
        names: Names of the variables that it may use.
        place: File and key path, to begin messages with.

    Raises:
        InputError: The text is no expression of these variables.
    """

    def __init__(self, text: str | float, names: Iterable[str], place: str = ""):
        self.place = place
        self.text = " ".join(text.split()) if isinstance(text, str) else repr(text)
        allowed = tuple(names)
        try:
            tree = _parse(self.text if isinstance(text, str) else text)
            self.is_condition, self._evaluate = _Reader(allowed).read(tree)
        except _ReadingError as error:
            self._fail(f"{error}; allowed names: {', '.join(allowed) or 'none'}")
        self.names = frozenset(n.id for n in ast.walk(tree) if isinstance(n, ast.Name)).intersection(allowed)
        if not self.names:
            self._value({})  # a constant shows at once whether it is finite

    def __repr__(self) -> str:
        return f"Expression({self.text!r})"

    def __call__(self, **values) -> np.ndarray:
        """Return the number at each point.

        Args:
            values: Every allowed variable, arrays or numbers; the result has their common shape.

        Raises:
            InputError: A value is not finite (on the rank that owns the point only).
        """
        if self.is_condition:
            self._fail("is a condition where a number is needed, as in where(X < 0, 1, 2)")
        return self._value(values)

    def mask(self, **values) -> np.ndarray:
        """Return whether the condition holds at each point.

        Raises:
            InputError: The expression is a number.
        """
        if not self.is_condition:
            self._fail("is a number where a condition is needed, such as X < 0")
        return self._value(values)

    def _value(self, values: dict) -> np.ndarray:
        arrays = {name: np.asarray(value, dtype=float) for name, value in values.items()}
        shape = np.broadcast_shapes(*(array.shape for array in arrays.values()))
        with np.errstate(all="ignore"):
            result = np.array(np.broadcast_to(self._evaluate(arrays), shape))
        if not np.all(np.isfinite(result)):
            first = np.unravel_index(np.argmin(np.isfinite(result)), shape)
            point = [f"{name} = {np.broadcast_to(arrays[name], shape)[first]:g}" for name in sorted(self.names)]
            self._fail(f"is {result[first]}" + (" at " + ", ".join(point) if point else ""))
        return result

    def _fail(self, reason: str):
        raise InputError(f"{self.place}{': ' if self.place else ''}{_short(self.text)!r} {reason}")


class _ReadingError(Exception):
    """Why a text is no expression."""


class _Term(NamedTuple):
    """A part of an expression: its kind, and how its value follows from the variables."""

    is_condition: bool
    evaluate: Callable[[dict], np.ndarray | np.generic]


def _parse(text: str | float) -> ast.expr:
    """Return the syntax tree of a text, of bounded size."""
    if isinstance(text, int | float) and not isinstance(text, bool):
        return ast.Constant(text)
    if not isinstance(text, str):
        raise _ReadingError("is neither a number nor an expression in quotes")
    if len(text) > _LONGEST:
        raise _ReadingError(f"has {len(text)} characters, more than {_LONGEST}")
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # Python's remarks on a text that is not Python
            tree = ast.parse(text, mode="eval").body
    except (SyntaxError, ValueError):
        raise _ReadingError("is not an expression") from None
    except (RecursionError, MemoryError):
        raise _ReadingError("is nested too deeply") from None
    level, depth = [tree], 0
    while level:
        level, depth = [child for node in level for child in ast.iter_child_nodes(node)], depth + 1
    if depth > _DEEPEST:
        raise _ReadingError("is nested too deeply")
    return tree


def coordinates(position: np.ndarray, spacing: np.ndarray) -> dict[str, np.ndarray]:
    """The variables of places: X, Y, Z as far as the dimension goes, and the local spacing."""
    return dict(zip(NAMES, position.T)) | {"spacing": spacing}


class _Reader:
    """Turns a syntax tree into a function of the variables; what it does not list is refused."""

    def __init__(self, names: tuple[str, ...]):
        self.names = names

    def read(self, node: ast.expr) -> _Term:
        match node:
            case ast.Constant(value=bool() | int() | float()):
                return _constant(node.value)
            case ast.Name():
                return self._name(node.id)
            case ast.BinOp() if type(node.op) in _ARITHMETIC:
                return _apply(_ARITHMETIC[type(node.op)], self._number(node.left), self._number(node.right))
            case ast.UnaryOp(op=ast.Not()):
                return _apply(np.logical_not, self._condition(node.operand), is_condition=True)
            case ast.UnaryOp() if type(node.op) in _ARITHMETIC:
                return _apply(_ARITHMETIC[type(node.op)], self._number(node.operand))
            case ast.Compare() if all(type(operator) in _COMPARISONS for operator in node.ops):
                return self._comparison(node)
            case ast.BoolOp():
                return _fold(_LOGIC[type(node.op)], [self._condition(value) for value in node.values])
            case ast.Call(func=ast.Name(id=name), keywords=[]):
                return self._call(name, node.args)
            case ast.BinOp() | ast.UnaryOp() if type(node.op) in _INSTEAD:
                raise _ReadingError(f"is not an expression: {_INSTEAD[type(node.op)]}")
        raise _ReadingError(f"holds something that no expression may hold ({type(node).__name__})")

    def _number(self, node: ast.expr) -> Callable:
        is_condition, evaluate = self.read(node)
        if is_condition:
            raise _ReadingError(f"holds a condition where a number is needed ({_short(ast.unparse(node))})")
        return evaluate

    def _condition(self, node: ast.expr) -> Callable:
        is_condition, evaluate = self.read(node)
        if not is_condition:
            raise _ReadingError(f"holds a number where a condition is needed ({_short(ast.unparse(node))})")
        return evaluate

    def _name(self, name: str) -> _Term:
        if name in self.names:
            return _Term(False, lambda values: values[name])
        if name in CONSTANTS:
            return _constant(CONSTANTS[name])
        raise _ReadingError(f"uses the unknown name {name!r}{hint(name, [*self.names, *CONSTANTS])}")

    def _comparison(self, node: ast.Compare) -> _Term:
        """``a < b < c`` means ``a < b and b < c``."""
        sides = [self._number(side) for side in (node.left, *node.comparators)]
        pairs = [
            _apply(_COMPARISONS[type(operator)], left, right).evaluate
            for operator, left, right in zip(node.ops, sides, sides[1:], strict=False)
        ]
        return _fold(np.logical_and, pairs)

    def _call(self, name: str, arguments: list[ast.expr]) -> _Term:
        if name not in FUNCTIONS:
            known = ", ".join(FUNCTIONS)
            raise _ReadingError(f"calls the unknown function {name!r}{hint(name, FUNCTIONS)}, known are {known}")
        function = FUNCTIONS[name]
        count = 3 if function is np.where else function.nin
        if len(arguments) != count:
            raise _ReadingError(f"gives {name} {len(arguments)} argument(s) instead of {count}")
        readers = [self._condition if function is np.where else self._number, self._number, self._number]
        return _apply(function, *(read(argument) for read, argument in zip(readers, arguments, strict=False)))


def _constant(value: bool | float) -> _Term:
    """Numbers become floats, so that ``9**9**9`` overflows at once instead of growing."""
    if isinstance(value, bool):
        return _Term(True, lambda values: np.bool_(value))
    try:
        number = np.float64(value)
    except OverflowError:
        raise _ReadingError("holds a number that is too large") from None
    return _Term(False, lambda values: number)


def _apply(function: Callable, *operands: Callable, is_condition: bool = False) -> _Term:
    return _Term(is_condition, lambda values: function(*(operand(values) for operand in operands)))


def _fold(function: Callable, operands: list[Callable]) -> _Term:
    return _Term(True, lambda values: reduce(function, (operand(values) for operand in operands)))
