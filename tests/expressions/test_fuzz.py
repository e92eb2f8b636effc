"""Any text whatever gives findings or a value: no exception, no long wait."""

from hypothesis import given, settings
from hypothesis import strategies as st

from deepbots_cli.expressions.check import check_drawn, check_range
from deepbots_cli.expressions.dimensions import UNITS
from deepbots_cli.expressions.functions import FUNCTIONS
from deepbots_cli.expressions.lower import constant_values, lower, to_python
from deepbots_cli.expressions.parser import parse
from deepbots_cli.expressions.types import Context
from deepbots_cli.expressions.unification import expect_value

NAMES = "x speed gas flag home stride cart cart.tip cart.legs cart.pole_angle ball broken radio nonsense"
OTHERS = "0 1 2.5 1e308 1e-308 100_000 and or not when every each step true if else where"
SIGNS = "+ - * / ^ ( ) ( ) , .. +- | . < <= == != > ** && = [ ] ? : %"
WORDS = [*FUNCTIONS, *UNITS, *NAMES.split(), *OTHERS.split(), *SIGNS.split()]
soup = st.lists(st.sampled_from(WORDS), max_size=25).map(" ".join) | st.lists(
    st.sampled_from(WORDS), max_size=25
).map("".join)


def take(bench, text):
    """Everything the language does with a text, to the end."""
    bench.text, bench.said = text, []
    tree = parse(text, bench.report)
    if tree is None:
        assert len(bench.said) == 1
        return
    scope = bench.scope.__class__(Context.PARAMETER)
    check_range(tree, scope, bench.report)
    drawn = check_drawn(tree, scope, bench.report)
    if drawn is None:
        return
    expect_value(drawn.value, bench.report, "the field", boolean=drawn.value.type.boolean)
    constant_values(drawn.value)
    for scalar in lower(drawn.value, "item"):
        compile(to_python(scalar, lambda read: "v"), "item", "eval")


@settings(deadline=2000)
@given(st.text(max_size=60))
def test_any_text_is_answered(bench_of, text):
    take(bench_of(), text)


@settings(deadline=2000)
@given(soup)
def test_any_soup_of_known_words_is_answered(bench_of, text):
    take(bench_of(), text)


@settings(deadline=2000)
@given(
    st.sampled_from(
        [
            "abs(",
            "(",
            "-",
            "clamp(1 - ",
            "x if flag else ",
            "delta(",
            "2^",
            "wrap(",
            "not ",
            "norm(home * ",
            "1 - (1 - ",
        ]
    ),
    st.integers(1, 70),
)
def test_any_depth_is_answered_and_what_passes_is_python(bench_of, opening, count):
    text = (
        opening * count
        + "x"
        + (", 0 .. 1)" if opening.startswith("clamp") else ")") * (count * opening.count("("))
    )
    take(bench_of(), text)
