"""Data to parts: every value is held against its spec, and what cannot be meant is refused, with its place."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

from deepbots_cli.document.nodes import Path
from deepbots_cli.scenario.fields import Leaf
from deepbots_cli.scenario.part import REQUIRED, Alternatives, Kinds, Listed, Mapped, Part, Size, Spec, fields
from deepbots_cli.scenario.refusal import Refusal, mismatch

P = TypeVar("P", bound=Part)


def check(part: type[P], data: object, *, lenient: bool) -> tuple[P | None, list[Refusal]]:
    """The part in `data`, or everything that keeps it from being one.

    If `lenient`, lists and mappings may lack entries: faulty ones were taken out.
    """
    checker = _Checker(lenient)
    found = checker.value(part, data, ())
    return (found if isinstance(found, part) and not checker.refusals else None), checker.refusals


class _Checker:
    """What it returns for a faulty value is not to be used."""

    def __init__(self, lenient: bool) -> None:
        self.refusals: list[Refusal] = []
        self._lenient = lenient

    def value(self, spec: Spec, value: object, path: Path) -> object:
        match spec:
            case Leaf():
                return self._ask(spec.check, value, path)
            case Listed():
                return self._list(spec, value, path)
            case Mapped():
                return self._mapping(spec, value, path)
            case Alternatives():
                chosen = spec.choose(value)
                return self._refuse(spec.complaint(), path) if chosen is None else self.value(chosen, value, path)
            case Kinds():
                model = spec.find(value)
                return self._refuse(spec.complaint(value), path) if model is None else self._part(model, value, path)
            case _:
                return self._part(spec, value, path)

    def _ask(self, check: Callable[[object], object], value: object, path: Path, *, at_key: bool = False) -> object:
        try:
            return check(value)
        except Refusal as refusal:
            return self._refuse(refusal, path, at_key=at_key)

    def _refuse(self, refusal: Refusal, path: Path, *, at_key: bool = False) -> object:
        self.refusals.append(refusal.below(path, at_key=at_key))
        return None

    def _list(self, spec: Listed, value: object, path: Path) -> object:
        if not isinstance(value, list):
            return self._refuse(mismatch(), path)
        before = len(self.refusals)
        found = tuple(self.value(spec.item, item, (*path, index)) for index, item in enumerate(value))
        self._check_size(spec.size, value, path, before)
        return found

    def _mapping(self, spec: Mapped, value: object, path: Path) -> object:
        if not isinstance(value, dict):
            return self._refuse(mismatch(), path)
        before = len(self.refusals)
        found = {}
        for key, item in value.items():
            self._ask(spec.key.check, key, (*path, key), at_key=True)
            found[key] = self.value(spec.value, item, (*path, key))
        self._check_size(spec.size, value, path, before)
        return found

    def _check_size(self, size: Size, value: list[object] | dict[str, object], path: Path, before: int) -> None:
        """Of a value without faults inside."""
        if not self._lenient and len(self.refusals) == before:
            self._ask(lambda _: size.check(len(value)), value, path)

    def _part(self, part: type[Part], value: object, path: Path) -> object:
        if not isinstance(value, dict):
            return self._refuse(mismatch(), path)
        known, given = fields(part), {}
        for name, field in part.declared.items():
            if name in value:
                given[name] = self.value(known[name], value[name], (*path, name))
            elif field.default is REQUIRED:
                self._refuse(Refusal("DB102", missing=(name,)), path, at_key=True)
        for key in value:
            if key not in known:
                self._refuse(Refusal("DB101"), (*path, key), at_key=True)
        return part(**given)
