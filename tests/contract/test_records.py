"""The dataclasses of deepbots behave as those of the standard library."""

from __future__ import annotations

import copy
import dataclasses
import pickle
from collections.abc import Callable
from typing import Any

import pytest

from deepbots_cli.records import dataclass as record

Decorator = Callable[..., Any]


def classes(dataclass: Decorator) -> list[type]:
    """Return classes with each option and kind of field, made by a decorator."""

    @dataclass(frozen=True)
    class Frozen:
        """A frozen class."""

        a: int
        b: tuple[int, ...] = ()
        c: dict[str, int] = dataclasses.field(default_factory=dict, hash=False)
        d: str = dataclasses.field(default="d", repr=False, compare=False)

        def __post_init__(self) -> None:
            if self.a < 0:
                raise ValueError("a is negative")

    @dataclass(frozen=True)
    class Derived(Frozen):
        """A class with more fields."""

        e: float = 0.5

    @dataclass
    class Changeable:
        """A class with a field that is not in `__init__`."""

        a: int = 1
        b: list[int] = dataclasses.field(default_factory=list)
        c: list[int] = dataclasses.field(init=False, default_factory=list)
        d: int = dataclasses.field(init=False, default=3)
        e: int = dataclasses.field(init=False)

    @dataclass(eq=False, kw_only=True)
    class Identical:
        """A class whose instances equal only themselves."""

        a: int
        b: int = 2

    @dataclass(frozen=True)
    class Own:
        """A class with its own methods."""

        a: int

        def __eq__(self, other: object) -> bool:
            return True

        def __repr__(self) -> str:
            return "own"

    return [Frozen, Derived, Changeable, Identical, Own]


CALLS: list[tuple[tuple[Any, ...], dict[str, Any]]] = [
    ((), {}),
    ((1,), {}),
    ((-1,), {}),
    ((1, (2,), {"x": 3}), {}),
    ((), {"a": 1}),
    ((1,), {"a": 1}),
    ((1,), {"d": "other"}),
    ((1,), {"e": 2.0}),
    ((1,), {"unknown": 2}),
    ((), {"a": 1, "b": 2}),
]


def outcome(act: Callable[[], Any]) -> object:
    """Return the result of a function as text, or the class of its error."""
    try:
        return repr(act()).replace("record.", "").replace("dataclass.", "")
    except (AttributeError, TypeError, ValueError) as error:
        return type(error).__name__


@pytest.mark.parametrize("index", range(5))
def test_an_instance_behaves_as_one_of_the_standard_library(index: int) -> None:
    ours, theirs = classes(record)[index], classes(dataclasses.dataclass)[index]
    assert [field.name for field in dataclasses.fields(ours)] == [
        field.name for field in dataclasses.fields(theirs)
    ]
    for args, kwargs in CALLS:
        acts = [
            lambda cls: cls(*args, **kwargs),  # noqa: B023
            lambda cls: vars(cls(*args, **kwargs)),  # noqa: B023
            lambda cls: cls(*args, **kwargs) == cls(*args, **kwargs),  # noqa: B023
            lambda cls: cls(*args, **kwargs) == cls(7),  # noqa: B023
            lambda cls: len({cls(*args, **kwargs), cls(*args, **kwargs)}),  # noqa: B023
            lambda cls: dataclasses.replace(cls(*args, **kwargs), a=5),  # noqa: B023
            lambda cls: dataclasses.asdict(cls(*args, **kwargs)),  # noqa: B023
            lambda cls: copy.deepcopy(cls(*args, **kwargs)),  # noqa: B023
            lambda cls: setattr(cls(*args, **kwargs), "a", 2),  # noqa: B023
            lambda cls: delattr(cls(*args, **kwargs), "a"),  # noqa: B023
        ]
        for act in acts:
            assert outcome(lambda: act(ours)) == outcome(lambda: act(theirs))  # noqa: B023


@record(frozen=True)
class Kept:
    """A class that a pickle can name."""

    a: int
    b: str = ""


def test_an_instance_survives_a_process() -> None:
    assert pickle.loads(pickle.dumps(Kept(1, "x"))) == Kept(1, "x")
