"""Bodies of an engine by name: single ones, and pooled ones that are absent until placed and may take several forms."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import TYPE_CHECKING, ParamSpec, TypeVar

from deepbots_cli.engines.lookup import find

if TYPE_CHECKING:
    from deepbots_cli.engines.pybullet.body import Body

Given = ParamSpec("Given")
Told = TypeVar("Told")


class Pool:
    """The forms of one name. A body that is not pooled has one form and is always present."""

    def __init__(self, name: str, forms: Sequence[tuple[str, Body]], pooled: bool) -> None:
        self.name = name
        self.pooled = pooled
        self.present = not pooled
        self.chosen = forms[0][1]
        self._forms = dict(forms)

    def __iter__(self) -> Iterator[Body]:
        return iter(self._forms.values())

    def choose(self, form: str) -> None:
        self.chosen = find(self._forms, form, f"'{self.name}' has no variant")

    def leave(self) -> None:
        """Be absent, in the first form."""
        if self.pooled:
            self.present, self.chosen = False, next(iter(self))
            for body in self:
                body.suspend()

    def enter(self) -> Body:
        """Be present, in the chosen form."""
        self.present = True
        self.chosen.wake()
        return self.chosen

    def bound(self, bind: Callable[[Body], Callable[Given, Told]]) -> Callable[Given, Told]:
        """What `bind` makes of the present form; a body of one form pays nothing for there being others."""
        if len(self._forms) == 1:
            return bind(self.chosen)
        table = {id(body): bind(body) for body in self}

        def of_chosen(*given: Given.args, **named: Given.kwargs) -> Told:
            return table[id(self.chosen)](*given, **named)

        return of_chosen
