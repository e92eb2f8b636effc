"""Colours: words and hexadecimal figures as shares of red, green and blue, fixed or drawn."""

from __future__ import annotations

from typing import TYPE_CHECKING

from deepbots_cli.document.nodes import Path
from deepbots_cli.expressions.types import Constant, Invocation, Stage, Type, Vector
from deepbots_cli.program.resets import RandomizedParameter
from deepbots_cli.program.values import Expression
from deepbots_cli.program.world import Colour
from deepbots_cli.scenario.fields import COLOURS, colour_options

if TYPE_CHECKING:
    from deepbots_cli.compiler.namespace import Namespace


def colour(namespace: Namespace, path: Path, given: str | None, of: tuple[str, str] | None = None) -> Colour | None:
    """The colour at `path`, None where none is given.

    Of several to draw from it is the first, and the draw is noted as a variation of a body and link, `of`; without
    one, a draw is a finding.
    """
    if given is None:
        return None
    if of is not None:
        namespace.colours[:] = [known for known in namespace.colours if known.of != of]  # as for a link that two patterns mean
    options = [_paint(word) for word in colour_options(given)]
    if len(options) > 1 and of is None:
        help = "it is the same in every episode; give one colour"
        namespace.values.findings.add("DB407", namespace.values.span(path), "a draw of a colour that is fixed", help=help)
    elif len(options) > 1 and of is not None:
        owner = ".".join(map(str, path)) + "".join(f":{name}" for name in of if name)
        text, single = namespace.values.text(path, given), Type(stage=Stage.EPISODE)
        ends = tuple(Constant(single, 0, 0, (end,)) for end in (0.0, len(options) - 1.0))
        which = Invocation(single, 0, 0, "integer", (), ends, 0)
        shades = tuple(Constant(single, 0, 0, (share,)) for option in options for share in option[:3])
        drawn = Vector(single, 0, len(text.text), (which, *shades))
        namespace.colours.append(RandomizedParameter("colour", of, Expression("colour", text.span, text.text, drawn, owner)))
    return options[0]


def _paint(word: str) -> Colour:
    if word.startswith("#"):
        return (int(word[1:3], 16) / 255, int(word[3:5], 16) / 255, int(word[5:7], 16) / 255, 1.0)
    return (*COLOURS[word], 1.0)
