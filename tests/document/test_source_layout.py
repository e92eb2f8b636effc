"""The canonical layout changes white space only and keeps comments and columns. Shipped files have it."""

from __future__ import annotations

import random

import pytest

from deepbots_cli import api
from deepbots_cli.diagnostics import Findings, Source
from deepbots_cli.document import shipped, to_data
from deepbots_cli.document.layout import canonical_text
from deepbots_cli.document.parse import parse
from tests.few import LIGHT, few

SHIPPED = shipped.scenario_names()

UNTIDY = """

deepbots:   1
name:  CartPole
# about
world:
    timestep:    32 ms     # tick
    # inner
    arena:   {  size: 1 1 m ,wall_height: 0.1 m,
              friction: 1.0  }
    list:
    -   a: 1
        b:   2
    # between
    -   c:  "x  y
          z"
    - - 1
      -   2



    text: |
        first
          second

        third
signals:
   x:      1
   longer: 2
"""
TIDY = """deepbots: 1
name: CartPole
# about
world:
  timestep: 32 ms        # tick
  # inner
  arena: {size: 1 1 m, wall_height: 0.1 m,
            friction: 1.0}
  list:
    - a: 1
      b: 2
    # between
    - c: "x  y
          z"
    - - 1
      - 2

  text: |
      first
        second

      third
signals:
  x:      1
  longer: 2
"""


def text_of(name):
    return shipped.scenario_path(name).read_text(encoding="utf-8")


def meaning(text):
    findings = Findings()
    root = parse(Source("", text), findings)
    return None if root is None or findings.errors else to_data(root)


def test_blanks_blank_lines_and_indentation_are_put_in_order():
    assert canonical_text(UNTIDY) == TIDY
    assert canonical_text(TIDY) == TIDY


@pytest.mark.parametrize("name", SHIPPED)
def test_a_shipped_scenario_is_in_the_canonical_layout(name):
    assert canonical_text(text_of(name)) == text_of(name)


def test_comments_by_the_ten_thousand_and_brackets_over_thousands_of_lines_end():
    # Whatever is quadratic in the lines takes minutes here.
    comments = "a: 1\n" + "# a word\n" * 40_000
    assert canonical_text(comments) == comments
    brackets = "a: [\n" + "  x,\n" * 7_000 + "]\n"
    assert canonical_text(brackets) == brackets


def test_line_ends_stay():
    assert canonical_text(UNTIDY.replace("\n", "\r\n")) == TIDY.replace("\n", "\r\n")


def disturbed(text, seed):
    """White space that means nothing, here and there, and indentation by four."""
    chance = random.Random(seed)
    lines = []
    for line in text.split("\n"):
        body = line.lstrip(" ")
        line = " " * 2 * (len(line) - len(body)) + body
        if chance.random() < 0.3 and not body.startswith("#"):
            line = line.replace(": {", ":   {  ", 1).replace("}}", "  } }", 1)
        lines.append(line + " " * chance.choice([0, 0, 2]))
        if chance.random() < 0.1:
            lines += ["", ""]
    return "\n".join(lines)


@pytest.mark.parametrize("name", few(SHIPPED, LIGHT))
def test_any_layout_of_a_scenario_is_changed_without_its_meaning_and_once_for_all(name):
    for seed in range(3):
        text = disturbed(text_of(name), seed)
        before = meaning(text)
        done = canonical_text(text) if before is not None else None
        if done is not None:
            assert meaning(done) == before
            assert canonical_text(done) == done


@pytest.mark.parametrize("name", few(SHIPPED, LIGHT))
def test_a_scenario_compiles_to_the_same_before_and_after(name):
    path = shipped.scenario_path(name).resolve()
    text = text_of(name)
    layouts = [
        canonical_text(text),
        *(canonical_text(other) for other in [disturbed(text, 1)] if meaning(other) == meaning(text)),
    ]
    digests = {api.compile(api.load(path, drafts={path: layout.encode()})).digest for layout in layouts}
    assert digests == {api.compile(path).digest}
