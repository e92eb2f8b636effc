"""Bodies of an engine by name, and pooled ones in one of several forms."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Generic, ParamSpec, Protocol, TypeVar

from deepbots_cli.errors import EngineError

Entry = TypeVar("Entry")
Arguments = ParamSpec("Arguments")
Result = TypeVar("Result")


def named(table: Mapping[str, Entry], name: str, message: str) -> Entry:
    """Return the entry called `name`.

    Raises:
        EngineError: There is none. It begins with `message`, and lists the existing names.
    """
    try:
        return table[name]
    except KeyError:
        raise EngineError(f"{message} '{name}'; there are {', '.join(table)}") from None


class BodyForm(Protocol):
    """A body in an engine."""

    def deactivate(self) -> None:
        """Make the body absent: touched and seen by nothing."""

    def activate(self) -> None:
        """Make the body present."""


Body = TypeVar("Body", bound=BodyForm)


class Pool(Generic[Body]):
    """The forms of one name. A body that is not pooled has one form and is always present."""

    def __init__(self, name: str, forms: Sequence[tuple[str, Body]], pooled: bool) -> None:
        self.name = name
        self.pooled = pooled
        self.present = not pooled
        self.current = forms[0][1]
        self._forms = dict(forms)

    def __iter__(self) -> Iterator[Body]:
        return iter(self._forms.values())

    def choose(self, form: str) -> None:
        self.current = named(self._forms, form, f"'{self.name}' has no variant")

    def deactivate(self) -> None:
        """Make the body absent, in the first form."""
        if self.pooled:
            self.present = False
            self.current = next(iter(self))
            for body in self:
                body.deactivate()

    def activate(self) -> Body:
        """Make the body present, in the chosen form."""
        self.present = True
        self.current.activate()
        return self.current

    def bind_current(
        self, bind: Callable[[Body], Callable[Arguments, Result]]
    ) -> Callable[Arguments, Result]:
        """Bind a function to the form that is present when it is called. A body with a single form is bound
        directly, without a look-up."""
        if len(self._forms) == 1:
            return bind(self.current)
        table = {id(body): bind(body) for body in self}

        def call_current(*args: Arguments.args, **kwargs: Arguments.kwargs) -> Result:
            return table[id(self.current)](*args, **kwargs)

        return call_current
