"""What the language answers to a value that cannot be meant; `validate` gives it a place and words."""

from __future__ import annotations

from deepbots_cli.diagnostics.nearest import Meant
from deepbots_cli.document.nodes import Path


class Refusal(Exception):  # noqa: N818
    """A complaint about the value at `path`, or about its key.

    A `headline` is taken as it is. Without one, DB101 is an unknown key, DB102 a `missing` one, and DB103 a value other than
    what was `expected`, or than what its place in the language says.
    """

    def __init__(
        self,
        code: str,
        headline: str | None = None,
        help: str | None = None,
        *,
        path: Path = (),
        expected: str | None = None,
        missing: tuple[str, ...] = (),
        meant: Meant | None = None,
    ) -> None:
        super().__init__(code, headline or expected)
        self.code = code
        self.headline = headline
        self.help = help
        self.path = path
        self.expected = expected
        self.missing = missing
        self.meant = meant
        self.at_key = False

    def below(self, path: Path, *, at_key: bool = False) -> Refusal:
        """The same complaint, with its place seen from further up."""
        self.path = (*path, *self.path)
        self.at_key = at_key
        return self


def problem(code: str, headline: str, help: str | None = None, missing: tuple[str, ...] = (), meant: Meant | None = None) -> Refusal:
    """A complaint in our own words; `meant` is what to write instead of the whole value."""
    return Refusal(code, headline, help, missing=missing, meant=meant)


def mismatch(expected: str | None = None, help: str | None = None, meant: Meant | None = None) -> Refusal:
    """A value of the wrong type: `validate` adds what was found instead."""
    return Refusal("DB103", None, help, expected=expected, meant=meant)


def at(step: str | int, refusal: Refusal) -> Refusal:
    """The same complaint one step further down."""
    return refusal.below((step,))
