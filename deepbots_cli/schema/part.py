"""The parts that a scenario is made of, and how parts, lists and mappings nest.

`Part` is the base of every model. `spec_of` turns the annotations of its fields into a small tree of
specs, which is what `walk`, `validate` and `export` go by:

    Leaf          a single value (fields, plain, names)
    Part          a mapping with known keys: the model class itself
    Mapped        a mapping with keys that the user chose
    Listed        a list
    Alternatives  several forms, told apart by the shape of the data
    Kinds         several models, told apart by the word under one key
"""

from __future__ import annotations

import types
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache
from typing import Annotated, Any, ClassVar, Literal, TypeVar, Union, get_args, get_origin

from pydantic import BaseModel, ConfigDict, GetCoreSchemaHandler, Strict
from pydantic_core import CoreSchema, core_schema

from deepbots_cli.diagnostics.nearest import meant
from deepbots_cli.schema.fields import Leaf, article, at, count, mismatch, problem
from deepbots_cli.schema.plain import choose_from

T = TypeVar("T")
Many = Annotated[tuple[T, ...], Strict(False)]
"""A list in the file, a tuple in the model."""


@dataclass(frozen=True)
class Keys:
    """How many of these keys may stand beside each other in a part."""

    names: tuple[str, ...]
    least: Literal[0, 1] = 0
    most: int = 1


class Part(BaseModel):
    """A mapping whose keys the language knows.

    Schemas are built when they are first used: a scenario uses a third of them.
    """

    model_config = ConfigDict(strict=True, extra="forbid", frozen=True, defer_build=True)

    needs: ClassVar[tuple[Keys, ...]] = ()
    marks: ClassVar[frozenset[str]] = frozenset()
    """Among several mapping forms, the keys that give this one away."""


@dataclass(frozen=True)
class Size:
    """The least number of entries of a list or mapping.

    It is not asked for again after faulty entries were taken out, which `validate` says in the context.
    """

    least: int = 1
    noun: str = "entry"

    def __get_pydantic_core_schema__(self, source: object, handler: GetCoreSchemaHandler) -> CoreSchema:
        return core_schema.with_info_after_validator_function(self._check, handler(source))

    def _check(self, value: Any, info: core_schema.ValidationInfo) -> Any:
        if len(value) < self.least and not info.context:
            if not value:
                raise problem("DB107", "is empty", f"give at least {count(self.least, self.noun)}")
            raise problem("DB106", f"expected at least {count(self.least, self.noun)}, found {len(value)}")
        return value


@dataclass(frozen=True)
class Listed:
    """The spec of a list."""

    item: Spec
    least: int = 0


@dataclass(frozen=True)
class Mapped:
    """The spec of a mapping with keys of the user's own."""

    key: Leaf
    value: Spec
    least: int = 0


@dataclass(frozen=True)
class Alternatives:
    """The spec of a value that may take one of several forms."""

    options: tuple[Spec, ...]

    def index(self, value: object) -> int | None:
        """Which form `value`, raw or validated, has."""
        return next((i for i, option in enumerate(self.options) if _fits(option, value)), None)

    def tag(self, index: int | None) -> int | str | None:
        """A mark of this form that is no step into data of this form."""
        return "list" if index is not None and isinstance(self.options[index], Listed) else index

    def choose(self, value: object) -> Spec | None:
        index = self.index(value)
        return None if index is None else self.options[index]

    def complaint(self) -> dict[str, str | int | float]:
        """What is said of a value that has none of the forms; how the first that is a single value is written."""
        told: dict[str, str | int | float] = {"expected": " or ".join(dict.fromkeys(noun_of(option) for option in self.options))}
        hints = [hint for option in self.options if isinstance(option, Leaf) if (hint := option.help_for(None))]
        if hints:
            told["help"] = hints[0]
        return told


def _fits(spec: Spec, value: object) -> bool:
    if isinstance(value, Part):
        return spec is type(value)
    match spec:
        case Leaf():
            # Of a single value the kind itself shall complain, not the choice between the forms.
            return spec.holds(list(value)) if isinstance(value, (list, tuple)) else not isinstance(value, dict)
        case Listed():
            return isinstance(value, (list, tuple))
        case Mapped() | Kinds():
            return isinstance(value, dict)
        case type():
            return isinstance(value, dict) and (not spec.marks or not spec.marks.isdisjoint(value))
        case _:
            return False


@dataclass(frozen=True)
class Forms:
    """Marks a union whose member is told by the shape of the data; members with `marks` come first.

    A tagged union puts its tag into the place of an error. No tag here can be mistaken for a step into the data (a
    number where a mapping or a text stands, a word where a list stands), so that `validate` can take them out again.
    """

    def __get_pydantic_core_schema__(self, source: object, handler: GetCoreSchemaHandler) -> CoreSchema:
        options = get_args(source)
        spec = Alternatives(tuple(spec_of(option) for option in options))
        return core_schema.tagged_union_schema(
            {spec.tag(index): handler.generate_schema(option) for index, option in enumerate(options)},
            discriminator=lambda value: spec.tag(spec.index(value)),
            custom_error_type="DB103",
            custom_error_message="{expected}",
            custom_error_context=spec.complaint(),
        )


FORMS = Forms()


@dataclass(frozen=True)
class Kinds:
    """Marks a field whose model is told by the word under `key`; models are looked up when they are used.

    `marked` holds models that go without that word and are known by another key.
    """

    key: str
    names: tuple[str, ...]
    model: Callable[[str], type[Part]]
    marked: tuple[tuple[str, type[Part]], ...] = ()

    def __get_pydantic_core_schema__(self, source: object, handler: GetCoreSchemaHandler) -> CoreSchema:
        return core_schema.with_info_plain_validator_function(self._validate)

    def find(self, value: object) -> type[Part] | None:
        """The model for `value`, raw or validated; None if its kind is unknown."""
        if isinstance(value, Part):
            return type(value)
        if not isinstance(value, Mapping):
            return None
        word = value.get(self.key)
        if isinstance(word, str) and word in self.names:
            return self.model(word)
        return next((model for mark, model in self.marked if word is None and mark in value), None)

    def _validate(self, value: object, info: core_schema.ValidationInfo) -> Part:
        model = self.find(value)
        if model is None:
            raise self._complaint(value)
        return model.model_validate(value, context=info.context)

    def _complaint(self, value: object) -> Exception:
        if not isinstance(value, Mapping):
            return mismatch("a mapping", f"write it like `{{{self.key}: {self.names[0]}}}`")
        marks = [mark for mark, _ in self.marked]
        if self.key not in value:
            wanted = " or ".join(f"`{key}`" for key in [self.key, *marks])
            return problem(
                "DB102",
                f"missing key {wanted}",
                f"give `{self.key}`: one of {', '.join(f'`{name}`' for name in self.names)}",
                (self.key, *marks),
            )
        word = value[self.key]
        if not isinstance(word, str):
            return at(self.key, mismatch(f"the name of {article(self.key)}", choose_from("", self.names)), word)
        near = meant(word, self.names, ours=True)
        return at(self.key, problem("DB104", f"unknown {self.key} `{word[:40]}`", choose_from(word, self.names), meant=near), word)


Spec = Leaf | type[Part] | Listed | Mapped | Alternatives | Kinds


def noun_of(spec: Spec) -> str:
    """What a finding calls a value of this spec."""
    match spec:
        case Leaf():
            return spec.noun
        case Listed(item=item):
            return f"a list of {item.plural}" if isinstance(item, Leaf) else "a list"
        case Alternatives(options=options):
            return " or ".join(dict.fromkeys(noun_of(option) for option in options))
        case _:
            return "a mapping"


@cache
def fields(part: type[Part]) -> Mapping[str, Spec]:
    """The keys of a part, in order, each with its spec."""
    return types.MappingProxyType({name: spec_of(info.annotation, tuple(info.metadata)) for name, info in part.model_fields.items()})


def spec_of(annotation: Any, metadata: tuple[object, ...] = ()) -> Spec:
    """The spec of an annotation; one that the language has no spec for is a mistake in a model."""
    if get_origin(annotation) is Annotated:
        return spec_of(annotation.__origin__, (*annotation.__metadata__, *metadata))
    least = 0
    for item in metadata:
        match item:
            case Leaf():
                return item.bound(annotation)
            case Kinds():
                return item
            case Forms():
                return Alternatives(tuple(spec_of(option) for option in get_args(annotation)))
            case Size():
                least = item.least
    origin, arguments = get_origin(annotation), get_args(annotation)
    if origin in (Union, types.UnionType):
        (only,) = (option for option in arguments if option is not types.NoneType)
        return spec_of(only, metadata)
    if origin is dict:
        key = spec_of(arguments[0])
        if isinstance(key, Leaf):
            return Mapped(key, spec_of(arguments[1]), least)
    if origin is tuple:
        return Listed(spec_of(arguments[0]), least)
    if isinstance(annotation, type) and issubclass(annotation, Part):
        return annotation
    raise TypeError(f"no spec for {annotation!r}")
