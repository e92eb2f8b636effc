"""Columns of text."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from deepbots_cli.cli.tables import row_as_lines, table
from deepbots_cli.diagnostics.render import display_width

CELLS = st.one_of(
    st.none(),
    st.booleans(),
    st.integers(),
    st.floats(),
    st.text(max_size=12),
    st.lists(st.text(max_size=3), max_size=3),
)
ROWS = st.lists(st.fixed_dictionaries({"a": CELLS, "b": CELLS, "c": CELLS}), min_size=1, max_size=5)


def test_numbers_stand_to_the_right_and_text_to_the_left():
    assert table([{"name": "x", "steps": 5}, {"name": "longer", "steps": 12_000}], indent="") == (
        "name     steps\n------  ------\nx            5\nlonger  12,000"
    )


def test_a_column_without_any_value_is_left_out():
    assert "empty" not in table([{"name": "x", "empty": None, "also": []}])
    assert "empty" not in row_as_lines({"name": "x", "empty": ""})


def test_wide_characters_take_two_columns():
    first, _, second, third = table([{"n": "日本", "m": "x"}, {"n": "ab", "m": "y"}], indent="").splitlines()
    assert display_width(second[: second.index("x")]) == third.index("y") == first.index("m")


@given(rows=ROWS)
def test_any_values_make_lines_that_no_terminal_obeys(rows):
    text = table(rows)
    assert text.replace("\n", "").isprintable()
    assert text.count("\n") == len(rows) + 1


def test_a_long_list_is_cut_short_and_says_how_long_it_is():
    assert (
        row_as_lines({"joints": [f"j{n}" for n in range(12)]}, indent="")
        == "joints  j0, j1, j2, j3, ... 12 in all"
    )
    assert row_as_lines({"joints": [f"j{n}" for n in range(5)]}, indent="") == "joints  j0, j1, j2, j3, j4"
