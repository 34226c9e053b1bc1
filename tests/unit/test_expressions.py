"""Expressions: what they mean, and that nothing but an expression gets through."""

import time

import numpy as np
import pytest

from pdpetsc.errors import InputError
from pdpetsc.expressions import Expression

X = np.linspace(-1.0, 1.0, 9)
PLACE = "plate.toml: sets.left"


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("1 + 2 * X ** 2 - X / 4", 1 + 2 * X**2 - X / 4),
        ("-X + +2", 2 - X),
        ("2 ** 3 ** 2", np.full(9, 512.0)),
        ("1 / 2", np.full(9, 0.5)),
        ("sin(pi * X) * exp(-X)", np.sin(np.pi * X) * np.exp(-X)),
        ("hypot(X, 3) + arctan2(X, 2) + minimum(X, 0)", np.hypot(X, 3) + np.arctan2(X, 2) + np.minimum(X, 0)),
        ("where(X > 0, sqrt(X), 0)", np.sqrt(np.maximum(X, 0))),
        ("where(true, 1, 2)", np.ones(9)),
        (" X\n + 1", X + 1),
        ("1e-4", np.full(9, 1e-4)),
        (1.5, np.full(9, 1.5)),
        (-2, np.full(9, -2.0)),
    ],
)
def test_numbers(text, expected):
    value = Expression(text, ["X", "t"])(X=X, t=0.5)
    np.testing.assert_allclose(value, expected, rtol=1e-15)
    assert value.dtype == float
    assert value.flags.writeable


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("X < 0", X < 0),
        ("X == 0 or X != 0", np.ones(9, bool)),
        ("-0.5 < X <= 0.5", (X > -0.5) & (X <= 0.5)),
        ("X < 0 and not X < -0.5 and true", (X < 0) & (X >= -0.5)),
        ("not (X < 0 or X > 0.5)", (X >= 0) & (X <= 0.5)),
        ("X < 0 or X > 0.5 and X > 0.7", (X < 0) | (X > 0.7)),
        ("1 < 2", np.ones(9, bool)),
        ("false", np.zeros(9, bool)),
        ("X > 0 and sqrt(X) < 0.5", (X > 0) & (X < 0.25)),
    ],
)
def test_conditions(text, expected):
    mask = Expression(text, ["X"]).mask(X=X)
    assert mask.dtype == bool
    np.testing.assert_array_equal(mask, expected)


def test_shape_is_that_of_all_variables():
    assert Expression("t", ["X", "t"])(X=X, t=2.0).shape == (9,)
    assert Expression("t", ["X", "t"])(X=X[:0], t=2.0).shape == (0,)
    assert Expression("X < t", ["X", "t"]).mask(X=X[:0], t=2.0).shape == (0,)
    assert Expression("2 * t", ["t"])(t=2.0) == 4.0


def test_result_is_no_view_of_a_variable():
    coordinates = X.copy()
    Expression("X", ["X"])(X=coordinates)[:] = 7.0
    np.testing.assert_array_equal(coordinates, X)


def test_names():
    expression = Expression("X + sin(t) * pi", ["X", "Y", "t"])
    assert expression.names == {"X", "t"}
    assert "t" in expression.names
    assert "Y" not in expression.names


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("X <", "'X <' is not an expression; allowed names: X, spacing"),
        ("", "'' is not an expression"),
        ("X + Q", "uses the unknown name 'Q'; allowed names: X, spacing"),
        ("x < 0", "unknown name 'x' (did you mean 'X'?)"),
        ("sqr(X)", "unknown function 'sqr' (did you mean 'sqrt'?), known are sin, cos"),
        ("sin(X, X)", "gives sin 2 argument(s) instead of 1"),
        ("where(X, 1, 2)", "holds a number where a condition is needed (X)"),
        ("not X", "holds a number where a condition is needed (X)"),
        ("1 + (X < 0)", "holds a condition where a number is needed (X < 0)"),
        ("(X < 0) & (X > 1)", "write 'and' instead of '&'"),
        ("X ^ 2", "write '**' for a power"),
        ("9**9**9", "'9**9**9' is inf"),
        ("1 / 0", "is inf"),
        ("1" + "0" * 400, "holds a number that is too large"),
        ("X" * 2001, "has 2001 characters, more than 2000"),
        ("-" * 1900 + "X", "is nested too deeply"),
        ("(" * 900 + "X" + ")" * 900, "expression"),
        ("X" + "+X" * 900, "is nested too deeply"),
        (float("nan"), "is nan"),
        (True, "is neither a number nor an expression in quotes"),
        ([1, 2], "is neither a number nor an expression in quotes"),
    ],
)
def test_one_sentence_says_what_is_wrong(text, reason):
    with pytest.raises(InputError) as caught:
        Expression(text, ["X", "spacing"], PLACE)
    message = str(caught.value)
    assert message.startswith(f"{PLACE}: ")
    assert reason in message
    assert "\n" not in message and len(message) < 500


@pytest.mark.parametrize(
    "text",
    [
        "__import__('os').system('true')", "().__class__", "X.dtype", "X[0]", "[X]", "(X, X)", "{1: 2}", "'a'",
        "b'a'", "1j", "...", "None", "lambda: 1", "(lambda: 1)()", "X if X > 0 else 1", "(X := 2)", "X is X",
        "X in X", "X // 2", "X % 2", "X @ X", "~X", "X << 1", "sin(*X)", "sin(x=X)", "sin(X, out=X)", "f'{X}'",
        "[i for i in X]", "print(X)", "eval('1')", "sin", "sin.__call__(X)", "X; X", "import os", "X = 1", "\0",
        "\ud800", "await X", "yield", "numpy.sin(X)", "#", "X\\",
    ],
)  # fmt: skip
def test_nothing_else_is_an_expression(text):
    with pytest.raises(InputError):
        Expression(text, ["X"])


def test_powers_of_powers_do_not_hang():
    start = time.perf_counter()
    with pytest.raises(InputError, match="is inf at X = 9"):
        Expression("X ** 9 ** 9 ** 9", ["X"])(X=9.0)
    assert time.perf_counter() - start < 1.0


def test_values_that_are_not_finite_are_named_with_their_point():
    expression = Expression("log(X) * Y", ["X", "Y"], PLACE)
    with pytest.raises(InputError) as caught:
        expression(X=np.array([1.0, -2.0, -3.0]), Y=1.0)
    assert str(caught.value) == f"{PLACE}: 'log(X) * Y' is nan at X = -2, Y = 1"


def test_numbers_and_conditions_are_not_interchangeable():
    with pytest.raises(InputError, match="is a condition where a number is needed"):
        Expression("X < 0", ["X"])(X=X)
    with pytest.raises(InputError, match="is a number where a condition is needed"):
        Expression("X", ["X"]).mask(X=X)
