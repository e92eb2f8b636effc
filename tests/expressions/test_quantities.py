"""Dimensions, units and literals."""

from fractions import Fraction

import pytest
from hypothesis import given
from hypothesis import strategies as st

from deepbots_cli.diagnostics.nearest import Replacement
from deepbots_cli.expressions.dimensions import (
    ANGLE,
    FORCE,
    FREQUENCY,
    LENGTH,
    NUMBER,
    SPEED,
    TIME,
    TORQUE,
    UNITS,
    Dimension,
    prefixed_unit,
    suggest_unit,
)
from deepbots_cli.expressions.written import units_in

exponents = st.integers(-4, 4) | st.fractions(-2, 2, max_denominator=4)
dimensions = st.builds(Dimension, exponents, exponents, exponents, exponents).map(
    lambda dimension: dimension * NUMBER  # brings exponents into normal form
)


@given(dimensions, dimensions)
def test_multiplying_and_dividing_by_a_dimension_cancel(a, b):
    """Apart from radians of a rotation, which work and power do not have."""
    quotient = a * b / b
    is_of_rotation = (a * b).kg != 0 and (a * b).m == 2 * (a * b).kg
    expected = a._replace(rad=quotient.rad) if is_of_rotation else a
    assert quotient == expected
    assert hash(quotient) == hash(expected)


@given(dimensions, exponents)
def test_a_power_of_a_product_is_the_product_of_powers(a, n):
    assert (a * SPEED) ** n == a**n * SPEED**n


def test_the_square_root_of_an_area_is_a_length():
    assert (LENGTH**2) ** Fraction(1, 2) == LENGTH


def test_dimensions_read_as_a_person_would_write_them():
    assert str(SPEED / TIME) == "m/s^2"
    assert str(TORQUE / ANGLE) == "N*m/rad"
    assert str(LENGTH ** Fraction(1, 2)) == "m^(1/2)"
    assert NUMBER.description == "a plain number"
    assert ANGLE.description == "an angle (rad)"
    assert SPEED.description == "a speed (m/s)"
    assert (LENGTH * ANGLE).description == "a quantity in m*rad"


@pytest.mark.parametrize(
    ("text", "values", "dimension"),
    [
        ("15 deg", [0.2617993877991494], ANGLE),
        ("57 cm", [0.57], LENGTH),
        ("20 mm", [0.02], LENGTH),
        ("1_000 ms", [1.0], TIME),
        ("3e-4", [3e-4], NUMBER),
        ("-.5 m", [-0.5], LENGTH),
        ("2 %", [0.02], NUMBER),
        ("10 N*m", [10.0], TORQUE),
        ("0.1 N*m*s/rad", [0.1], TORQUE * TIME / ANGLE),
        ("2 m/s^2", [2.0], SPEED / TIME),
        ("90 km/h", [25.0], SPEED),
        ("50 Hz", [50.0], FREQUENCY),
        ("3 1/s", [3.0], FREQUENCY),
        ("5 cm^2", [5e-4], LENGTH**2),
        ("0.6 -0.4 m", [0.6, -0.4], LENGTH),
        ("0 0 1 m", [0.0, 0.0, 1.0], LENGTH),
        ("10 70 30 cm", [0.1, 0.7, 0.3], LENGTH),
        ("0 5 10 15 mm", [0.0, 0.005, 0.01, 0.015], LENGTH),
        ("0.6 m - 0.4 m", [0.2], LENGTH),
    ],
)
def test_literals_are_numbers_in_si(bench, text, values, dimension):
    assert bench.clean(text).type.dimension == dimension
    assert bench.values(text) == pytest.approx(values, rel=1e-14)


def test_a_unit_binds_tighter_than_any_operator(bench):
    assert bench.values("1 / 2 m/s * speed", speed=3.0) == [1.5]
    assert bench.clean("1 / 2 m/s").type.dimension == TIME / LENGTH


def test_a_unit_name_alone_is_one_of_it(bench):
    assert bench.values("x / cm", x=0.25) == [25.0]
    assert bench.clean("abs(speed) / (m/s)").type.dimension == NUMBER


def test_a_bare_left_bound_takes_the_unit_of_the_right_one(bench):
    assert bench.clean("clamp(angle, -20 .. 20 deg)").type.dimension == ANGLE
    assert bench.codes("clamp(x, 1 .. track)") == ["DB502"]


@pytest.mark.parametrize("name", sorted(set(UNITS) - {"%"}))
def test_every_unit_is_understood_behind_a_number(bench, name):
    assert bench.clean(f"2 {name}").type.dimension == UNITS[name].dimension


@pytest.mark.parametrize(
    ("typed", "meant"),
    [("meters", "m"), ("degrees", "deg"), ("Nm", "N*m"), ("hz", "Hz"), ("sec", "s"), ("kgg", "kg")],
)
def test_a_misspelled_unit_is_recognized(bench, typed, meant):
    suggested = suggest_unit(typed)
    assert suggested is not None
    assert suggested.text == meant
    assert suggested.safe == (typed != "kgg")  # a unit written out is certain, a slip of the finger a guess
    finding = bench.only(f"5 {typed}")
    assert (finding.code, finding.piece) == ("DB501", typed)
    assert f"`{meant}`" in finding.help


def test_a_force_is_a_mass_times_an_acceleration(bench):
    assert bench.clean("2 kg * 3 m/s^2 + 1 N").type.dimension == FORCE


@pytest.mark.parametrize(("typed", "unit"), [("mrad", "rad"), ("um", "m"), ("uN", "N")])
def test_a_multiple_of_a_unit_is_never_taken_for_the_unit(typed, unit):
    assert suggest_unit(typed) is None
    prefixed = prefixed_unit(typed)
    assert prefixed is not None
    assert prefixed[1] == unit


def test_a_unit_in_capitals_is_the_unit():
    assert suggest_unit("KG") == Replacement("kg", safe=False)


@pytest.mark.parametrize(
    ("text", "units"),
    [
        ("arm_2m - 1 cm", ["cm"]),
        ("joint_1h * 2 rad/s", ["rad/s"]),
        ("0.5 m*gain", ["m"]),
        ("5 cm/max(2, 1)", ["cm"]),
        ("3 mm/s*gain + 2 N*m", ["mm/s", "N*m"]),
    ],
)
def test_the_units_of_a_text_are_those_behind_numbers(text: str, units: list[str]) -> None:
    assert [unit.text for unit in units_in(text)] == units
