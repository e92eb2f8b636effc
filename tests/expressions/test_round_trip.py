"""A tree that is printed with as few parentheses as it needs is read as the same tree."""

from hypothesis import given, settings
from hypothesis import strategies as st

from deepbots_cli.expressions.check import check_drawn, check_range
from deepbots_cli.expressions.dimensions import UNITS
from deepbots_cli.expressions.functions import FUNCTIONS
from deepbots_cli.expressions.lower import constant_values, lower
from deepbots_cli.expressions.parser import parse
from deepbots_cli.expressions.syntax import (
    Binary,
    Call,
    Conditional,
    Member,
    Name,
    Number,
    Range,
    Truth,
    Unary,
    Vector,
)
from deepbots_cli.expressions.targets import to_python
from deepbots_cli.expressions.types import Context
from deepbots_cli.expressions.unification import expect_value

LEVELS = {"or": 1, "and": 2, "not": 3, "<": 4, "==": 4, "+": 5, "-": 5, "*": 6, "/": 6, "neg": 7, "^": 8}
ATOM = 9


def printed(node, at_least=0):
    """The text of a tree where operators that bind less than `at_least` are in parentheses."""
    text, binds = _printed(node)
    return text if binds >= at_least else f"({text})"


def _printed(node):
    match node:
        case Number(value=value, unit=unit):
            return f"{value:g} {unit.text}" if unit else f"{value:g}", LEVELS["^"] if unit else ATOM
        case Vector(items=items, unit=unit):
            return " ".join([*(f"{item.value:g}" for item in items), *([unit.text] if unit else [])]), 0
        case Truth(value=value):
            return str(value).lower(), ATOM
        case Name():
            return node.dotted, ATOM
        case Member(value=value, member=member):
            return f"{printed(value, ATOM)}.{member}", ATOM
        case Call(function=function, args=args):
            return f"{function}({', '.join(map(printed, args))})", ATOM
        case Range(low=low, high=high):
            return f"{printed(low)} .. {printed(high)}", 0
        case Unary(operator=operator, operand=operand):
            level = LEVELS["neg" if operator == "-" else operator]
            return f"{operator} {printed(operand, level)}", level
        case Binary(operator=operator, left=left, right=right):
            levels = {
                "when": (0, 0.5, 0.5),
                "^": (LEVELS["^"], ATOM, LEVELS["neg"]),
                "<": (4, 5, 5),
                "==": (4, 5, 5),
            }
            level, on_left, on_right = levels.get(operator) or (
                LEVELS[operator],
                LEVELS[operator],
                LEVELS[operator] + 1,
            )
            return f"{printed(left, on_left)} {operator} {printed(right, on_right)}", level
    first = printed(node.value, 0 if isinstance(node.value, Vector) else 0.5)
    return f"{first} if {printed(node.condition, 0.5)} else {printed(node.otherwise)}", 0


def placeless(node):
    """The tree without its places."""
    if isinstance(node, Call):
        return "call", node.function, placeless(node.args)
    if not isinstance(node, tuple):
        return node
    parts = tuple(placeless(part) for part in node)
    return (type(node).__name__, *parts[2:]) if hasattr(node, "start") else parts


def tree(kind, *parts):
    return kind(0, 0, *parts)


names = st.sampled_from(["x", "flag", "cart.pole_angle"]).map(lambda name: tree(Name, tuple(name.split("."))))
numbers = st.builds(
    lambda value, unit: tree(Number, float(value), UNITS.get(unit)),
    st.integers(0, 99),
    st.sampled_from(["", "m", "deg", "%"]),
)
atoms = names | numbers | st.booleans().map(lambda value: tree(Truth, value))
vectors = st.builds(
    lambda values, unit: tree(Vector, tuple(tree(Number, float(value)) for value in values), UNITS.get(unit)),
    st.lists(st.integers(-9, 9), min_size=2, max_size=3),
    st.sampled_from(["", "m"]),
)


def grown(below):
    def call(name, args):
        return Call(0, 0, name, tuple(args), 0)

    slots = below | vectors
    operators = st.sampled_from([operator for operator in LEVELS if operator not in ("not", "neg")])
    return st.one_of(
        st.builds(lambda operator, a, b: tree(Binary, operator, a, b), operators, below, below),
        st.builds(lambda operand: tree(Unary, "not", operand), below),
        st.builds(lambda operand: tree(Unary, "-", operand), names),
        st.builds(call, st.sampled_from(["abs", "hypot"]), st.lists(slots, min_size=1, max_size=2)),
        st.builds(lambda a: tree(Member, Call(0, 0, "position", (a,), 0), "x"), names),
        st.builds(lambda a, c, b: tree(Conditional, a, c, b), slots, below, slots),
    )


values = st.recursive(atoms, grown, max_leaves=8)
texts = (
    values
    | st.builds(lambda a, c: tree(Binary, "when", a, c), values, values)
    | st.builds(lambda a, b: tree(Range, a, b), names, values)
)


def refuse(*finding, **more):
    raise AssertionError(finding)


@settings(deadline=None)
@given(texts)
def test_a_printed_tree_is_read_as_the_same_tree(written):
    read_again = parse(printed(written), refuse)
    assert placeless(read_again) == placeless(written)


# Any text whatever gives findings or a value: no exception, no long wait


NAMES = "x speed gas flag home stride cart cart.tip cart.legs cart.pole_angle ball broken radio nonsense"
OTHERS = "0 1 2.5 1e308 1e-308 100_000 and or not when every each step true if else where"
SIGNS = "+ - * / ^ ( ) ( ) , .. +- | . < <= == != > ** && = [ ] ? : %"
WORDS = [*FUNCTIONS, *UNITS, *NAMES.split(), *OTHERS.split(), *SIGNS.split()]
soup = st.lists(st.sampled_from(WORDS), max_size=25).map(" ".join) | st.lists(
    st.sampled_from(WORDS), max_size=25
).map("".join)


def take(bench, text):
    """Everything the language does with a text, to the end."""
    bench.text = text
    bench.findings = []
    tree = parse(text, bench.report)
    if tree is None:
        assert len(bench.findings) == 1
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
