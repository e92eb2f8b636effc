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
from typing import Annotated, Any, ClassVar, Final, Literal, TypeVar, Union, get_args, get_origin, get_type_hints

from deepbots_cli.scenario.fields import Leaf, article, count
from deepbots_cli.scenario.plain import choose_from, word_meant
from deepbots_cli.scenario.refusal import Refusal, at, mismatch, problem

T = TypeVar("T")
Many = tuple[T, ...]
"""A list in the file, a tuple in the model."""

REQUIRED: Final = object()
"""The default of a field that has none."""


@dataclass(frozen=True)
class Field:
    """What is said of a key beside its type; `default` is shared by all parts that leave it out."""

    description: str
    default: object = REQUIRED


def field(*, description: str, default: object = REQUIRED) -> Any:
    """How a part declares a key, beside its type."""
    return Field(description, default)


@dataclass(frozen=True)
class Keys:
    """How many of these keys may stand beside each other in a part."""

    names: tuple[str, ...]
    least: Literal[0, 1] = 0
    most: int = 1


class Part:
    """A mapping whose keys the language knows: the base of every model.

    A model declares its keys as annotated fields. The annotations are read when a scenario first has such a part (`fields`),
    since it uses a third of them. `check` makes parts of data. They are not to be changed.
    """

    needs: ClassVar[tuple[Keys, ...]] = ()
    marks: ClassVar[frozenset[str]] = frozenset()
    """Among several mapping forms, the keys that give this one away."""

    declared: ClassVar[Mapping[str, Field]] = {}
    """The fields by their keys, in order, those of the bases first."""
    _defaults: ClassVar[Mapping[str, object]] = {}

    given: frozenset[str]
    """The keys that the user wrote."""

    def __init_subclass__(cls) -> None:
        members = {name: value for base in reversed(cls.__mro__) for name, value in vars(base).items()}
        cls.declared = types.MappingProxyType({name: value for name, value in members.items() if isinstance(value, Field)})
        cls._defaults = {name: field.default for name, field in cls.declared.items() if field.default is not REQUIRED}

    def __init__(self, **given: object) -> None:
        self.__dict__.update(self._defaults, **given, given=frozenset(given))

    def __setattr__(self, name: str, value: object) -> None:
        raise AttributeError(f"a {type(self).__name__} cannot be changed")


@dataclass(frozen=True)
class Size:
    """The least number of entries of a list or mapping, and what one is called."""

    least: int = 1
    noun: str = "entry"

    def check(self, size: int) -> None:
        """Raise a `problem` if there are too few."""
        if size < self.least:
            if not size:
                raise problem("DB107", "is empty", f"give at least {count(self.least, self.noun)}")
            raise problem("DB106", f"expected at least {count(self.least, self.noun)}, found {size}")


ANY_SIZE = Size(0)


@dataclass(frozen=True)
class Listed:
    """The spec of a list."""

    item: Spec
    size: Size = ANY_SIZE


@dataclass(frozen=True)
class Mapped:
    """The spec of a mapping with keys of the user's own."""

    key: Leaf
    value: Spec
    size: Size = ANY_SIZE


@dataclass(frozen=True)
class Alternatives:
    """The spec of a value that may take one of several forms."""

    options: tuple[Spec, ...]

    def index(self, value: object) -> int | None:
        """Which form `value`, raw or validated, has."""
        return next((i for i, option in enumerate(self.options) if _fits(option, value)), None)

    def choose(self, value: object) -> Spec | None:
        index = self.index(value)
        return None if index is None else self.options[index]

    def complaint(self) -> Refusal:
        """What is said of a value that has none of the forms; how the first that is a single value is written."""
        hints = (option.help_for(None) for option in self.options if isinstance(option, Leaf))
        return mismatch(noun_of(self), next((hint for hint in hints if hint), None))


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


class Forms:
    """Marks a union whose member is told by the shape of the data; members with `marks` come first."""


FORMS = Forms()


@dataclass(frozen=True)
class Kinds:
    """Marks a field whose model is told by the word under `key`; models are looked up when they are used.

    `marked` holds models that go without that word and are known by another key; `sentences` say of each kind what it is, in the
    order of the names, where several have one model.
    """

    key: str
    names: tuple[str, ...]
    model: Callable[[str], type[Part]]
    marked: tuple[tuple[str, type[Part]], ...] = ()
    sentences: tuple[str, ...] = ()

    def about(self, name: str) -> str:
        """What the kind of this name is, in a sentence."""
        own = dict(zip(self.names, self.sentences, strict=False)).get(name)
        return own or " ".join((self.model(name).__doc__ or "").partition("\n\n")[0].split())

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

    def complaint(self, value: object) -> Refusal:
        """What is said of a value whose model `find` does not know."""
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
            return at(self.key, mismatch(f"the name of {article(self.key)}", choose_from("", self.names)))
        near = word_meant(word, self.names)
        return at(self.key, problem("DB104", f"unknown {self.key} `{word[:40]}`", choose_from(word, self.names), meant=near))


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


_FIELDS: dict[type[Part], Mapping[str, Spec]] = {}


def fields(part: type[Part]) -> Mapping[str, Spec]:
    """The keys of a part, in order, each with its spec."""
    found = _FIELDS.get(part)
    if found is None:
        annotations = get_type_hints(part, include_extras=True)
        found = _FIELDS[part] = types.MappingProxyType({name: spec_of(annotations[name]) for name in part.declared})
    return found


def spec_of(annotation: Any, metadata: tuple[object, ...] = ()) -> Spec:
    """The spec of an annotation; one that the language has no spec for is a mistake in a model."""
    if get_origin(annotation) is Annotated:
        return spec_of(annotation.__origin__, (*annotation.__metadata__, *metadata))
    size = ANY_SIZE
    for item in metadata:
        match item:
            case Leaf():
                return item.bound(annotation)
            case Kinds():
                return item
            case Forms():
                return Alternatives(tuple(spec_of(option) for option in get_args(annotation)))
            case Size():
                size = item
    origin, arguments = get_origin(annotation), get_args(annotation)
    if origin in (Union, types.UnionType):
        (only,) = (option for option in arguments if option is not types.NoneType)
        return spec_of(only, metadata)
    if origin is dict:
        key = spec_of(arguments[0])
        if isinstance(key, Leaf):
            return Mapped(key, spec_of(arguments[1]), size)
    if origin is tuple:
        return Listed(spec_of(arguments[0]), size)
    if isinstance(annotation, type) and issubclass(annotation, Part):
        return annotation
    raise TypeError(f"no spec for {annotation!r}")
