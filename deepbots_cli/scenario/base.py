"""The base of the models: sections, unions of them, sizes; the shape of the value of a key; walks of a
scenario by these shapes.

A key of a section is one annotated field of its model, with its sentence as a docstring below. `shape_of`
reads an annotation:

    FieldType     a single value (fields)
    Section       a mapping with known keys: the model class itself
    MappingOf     a mapping with names that the user chooses
    ListOf        a list
    Forms         a union that is discriminated by the form of the value
    Kinds         a union of sections that is discriminated by the word under one key

The compiler, the language server, the JSON Schema and the reference pages use these shapes.
"""

# Annotations are not postponed, because pydantic compiles postponed ones of `Section` again for each model.

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import field
from functools import cache, cached_property
from types import NoneType, UnionType
from typing import Annotated, Any, ClassVar, Literal, Self, TypeVar, Union, get_args, get_origin

from pydantic import (
    BaseModel,
    ConfigDict,
    GetCoreSchemaHandler,
    PrivateAttr,
    TypeAdapter,
    ValidationError,
    ValidationInfo,
    model_validator,
)
from pydantic_core import CoreSchema, InitErrorDetails, PydanticCustomError, core_schema

from deepbots_cli.document.nodes import NodePath
from deepbots_cli.plugins import import_attribute
from deepbots_cli.records import dataclass
from deepbots_cli.scenario.documentation import example_of, key_for, section_description
from deepbots_cli.scenario.fields import (
    FieldType,
    Flag,
    Text,
    Word,
    choices_help,
    error,
    error_at,
    mismatch,
    with_article,
    word_replacement,
)
from deepbots_cli.scenario.quantities import MEASURES, Column, Number, Quantity, Range, WholeNumber
from deepbots_cli.words import counted

T = TypeVar("T")
Many = tuple[T, ...]
"""A list in the file, a tuple in the model."""

LENIENT = "lenient"
"""Key of the validation context. If it is set, lists and mappings may have too few entries, since faulty ones
were removed."""


@dataclass(frozen=True)
class KeyCount:
    """The number of these keys that a section may have at once."""

    names: tuple[str, ...]
    min: Literal[0, 1] = 0
    max: int = 1

    def errors(self, data: Mapping[str, object]) -> Iterator[InitErrorDetails]:
        """Yield the errors of the keys of a section."""
        present = [name for name in self.names if name in data]
        if len(present) > self.max:
            headline = f"`{present[-1]}` cannot be combined with `{present[0]}`"
            problem = error("DB101", headline, "keep one of the two", rival=present[0])
            yield InitErrorDetails(type=problem, loc=(present[-1],), input=data[present[-1]])
        elif len(present) < self.min:
            names = " or ".join(f"`{name}`" for name in self.names)
            yield InitErrorDetails(
                type=error("DB102", f"missing key {names}", "write one of them", missing=self.names),
                input=data,
            )


class Section(BaseModel):
    """A mapping with known keys."""

    # Without `defer_build`, importing the package builds the validators of all sections.
    model_config = ConfigDict(extra="forbid", frozen=True, defer_build=True)

    key_rules: ClassVar[tuple[KeyCount, ...]] = ()
    identifying_keys: ClassVar[frozenset[str]] = frozenset()
    """Keys that distinguish this form from other forms that are mappings."""

    # pydantic lets a private attribute of a frozen model be set.
    _path: NodePath = PrivateAttr(())

    @property
    def path(self) -> NodePath:
        """The place of the section in its file."""
        return self._path

    @model_validator(mode="wrap")
    @classmethod
    def _check_keys(cls, data: Any, handler: Callable[[Any], Self]) -> Self:
        errors: list[InitErrorDetails] = []
        if isinstance(data, Mapping):
            errors = [rule_error for keys in cls.key_rules for rule_error in keys.errors(data)]
        if not errors:
            return handler(data)
        try:
            handler(data)
        except ValidationError as refusal:
            for field_error in refusal.errors(include_url=False):
                kind = PydanticCustomError(field_error["type"], field_error["msg"], field_error.get("ctx"))
                errors.append(InitErrorDetails(type=kind, loc=field_error["loc"], input=field_error["input"]))
        # An exception of this validator replaces the errors of the handler, so it has both.
        raise ValidationError.from_exception_data(cls.__name__, errors)


@dataclass(frozen=True)
class Size:
    """The minimum number of entries of a list or mapping, and the word for one."""

    min: int = 1
    noun: str = "entry"

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        return core_schema.with_info_after_validator_function(self._check, handler(source))

    def _check(self, value: Any, info: ValidationInfo) -> Any:
        if len(value) < self.min and not (info.context and info.context.get(LENIENT)):
            if not value:
                raise error("DB107", "is empty", f"write at least {counted(self.min, self.noun)}")
            raise error("DB106", f"expected at least {counted(self.min, self.noun)}, found {len(value)}")
        return value


def key_instead_of(section: type[Section], word: str) -> str | None:
    """Return the key of a section that `word` is written for."""
    return key_for(word, section.model_fields, (model.__name__ for model in section.__mro__))


@dataclass(frozen=True)
class ListOf:
    """The shape of a list."""

    item: "Shape"


@dataclass(frozen=True)
class MappingOf:
    """The shape of a mapping with keys that the user chooses."""

    key: FieldType
    value: "Shape"


@dataclass(frozen=True)
class Forms:
    """A union that is discriminated by the form of the value; sections with `identifying_keys` first. `FORMS`
    is one in an annotation."""

    options: "tuple[Shape, ...]" = ()
    annotations: tuple[Any, ...] = ()

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        return core_schema.with_info_plain_validator_function(_forms_of(source).validate)

    def validate(self, value: object, info: ValidationInfo) -> object:
        index = self.index(value)
        if index is None:
            raise mismatch(noun_of(self), self.help_for(value), value=value)
        return _validator(self.annotations[index]).validate_python(value, context=info.context)

    def help_for(self, value: object) -> str | None:
        """Return the help of the first option that is a single value."""
        hints = (option.help_for(value) for option in self.options if isinstance(option, FieldType))
        return next((hint for hint in hints if hint), None)

    def index(self, value: object) -> int | None:
        """Return the index of the option whose form `value`, raw or validated, has."""
        return next((i for i, option in enumerate(self.options) if fits(option, value)), None)

    def choose(self, value: object) -> "Shape | None":
        index = self.index(value)
        return None if index is None else self.options[index]


FORMS = Forms()


def fits(shape: "Shape", value: object) -> bool:
    """Return whether a value, raw or validated, has the form that a shape takes: a single value, a list, a
    mapping."""
    if isinstance(value, Section):
        return shape is type(value)
    match shape:
        case FieldType():
            # The field type itself refuses a single value of the wrong type, not the choice between the
            # forms.
            return (
                shape.has_form(list(value))
                if isinstance(value, (list, tuple))
                else not isinstance(value, dict)
            )
        case ListOf():
            return isinstance(value, (list, tuple))
        case MappingOf() | Kinds():
            return isinstance(value, dict)
        case Forms():
            return shape.index(value) is not None
        case type():
            return isinstance(value, dict) and (
                not shape.identifying_keys or not shape.identifying_keys.isdisjoint(value)
            )
        case _:
            return False


_validator = cache(TypeAdapter)


@cache
def _forms_of(annotation: Any) -> Forms:
    options = get_args(annotation)
    return Forms(tuple(map(shape_of, options)), options)


class ImportedModels(Mapping[str, type[Section]]):
    """The models in the table at `module:attribute`, which is imported when it is first read: a model takes
    0.5 ms to create."""

    def __init__(self, place: str) -> None:
        self._place = place

    @cached_property
    def _models(self) -> Mapping[str, type[Section]]:
        return dict(import_attribute(self._place))

    def __getitem__(self, name: str) -> type[Section]:
        return self._models[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._models)

    def __len__(self) -> int:
        return len(self._models)


@dataclass(frozen=True, eq=False)
class Kinds:
    """A union of sections that is discriminated by the word under `key`.

    `models_by_key` has the models that have no such word and are recognized by another key, `help_by_key` the
    texts to write instead of a key that belongs elsewhere, `gone` the texts to write instead of a word that
    the language had. Without a word, a section is of the kind `default`, if there is one.
    """

    key: str
    models: Mapping[str, type[Section]]
    models_by_key: Mapping[str, type[Section]] = field(default_factory=dict)
    help_by_key: Mapping[str, str] = field(default_factory=dict)
    default: str | None = None
    gone: Mapping[str, str] = field(default_factory=dict)

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(self.models)

    @property
    def distinct_models(self) -> tuple[type[Section], ...]:
        """Each model once."""
        return tuple(dict.fromkeys((*self.models.values(), *self.models_by_key.values())))

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        return core_schema.with_info_plain_validator_function(self.validate)

    def find(self, value: object) -> type[Section] | None:
        """Return the model for `value`, raw or validated; None if its kind is unknown."""
        if isinstance(value, Section):
            return type(value) if type(value) in self.distinct_models else None
        if not isinstance(value, Mapping):
            return None
        word = value.get(self.key, self.default)
        if isinstance(word, str) and word in self.models:
            return self.models[word]
        return next(
            (model for key, model in self.models_by_key.items() if word is None and key in value),
            None,
        )

    def _example(self, value: object) -> str:
        """Return a section with the required keys, of the kind that a single value names."""
        name = value if isinstance(value, str) and value in self.models else self.names[0]
        required = [
            key
            for key, info in self.models[name].model_fields.items()
            if info.is_required() and key != self.key
        ]
        entries = {self.key: name, **{key: example_text(self.models[name], key) for key in required}}
        return f"{{{', '.join(f'{key}: {text}' for key, text in entries.items() if text)}}}"

    def validate(self, value: object, info: ValidationInfo) -> Section:
        model = self.find(value)
        if model is not None:
            return model.model_validate(value, context=info.context)
        if not isinstance(value, Mapping):
            raise mismatch("a mapping", f"write it like `{self._example(value)}`", value=value)
        if self.key not in value:
            keys = " or ".join(f"`{key}`" for key in (self.key, *self.models_by_key))
            help = f"write `{self.key}`: one of {', '.join(f'`{name}`' for name in self.names)}"
            help = next((text for key, text in self.help_by_key.items() if key in value), help)
            raise error("DB102", f"missing key {keys}", help, missing=(self.key, *self.models_by_key))
        word = value[self.key]
        if not isinstance(word, str):
            raise error_at(
                self.key,
                mismatch(f"the name of {with_article(self.key)}", choices_help("", self.names), value=word),
            )
        if word in self.gone:
            raise error_at(self.key, error("DB104", f"the {self.key} `{word}` is gone", self.gone[word]))
        unknown = error(
            "DB104",
            f"unknown {self.key} `{word[:40]}`",
            choices_help(word, self.names),
            replacement=word_replacement(word, self.names),
        )
        raise error_at(self.key, unknown)


def kind_of(model: type[Section], key: str = "type") -> str:
    """Return the word under `key` for the kind of a model; empty if there are several."""
    words = get_args(model.model_fields[key].annotation)
    return str(words[0]) if len(words) == 1 else ""


def check_kind_model(name: str, model: type[Section], place: str, key: str = "type") -> None:
    """Check the model of a kind that a plug-in calls `name`, and whose code for the runtime is at `place`.

    Raises:
        ValueError: It lacks a part; the message names it.
        TypeError: A field has a type that no scenario can contain.
    """
    if kind_of(model, key) != name:
        raise ValueError(f'{model.__name__} needs the field `{key}: Literal["{name}"]`')
    if not section_description(model) or not place.partition(":")[2]:
        raise ValueError(
            f"{model.__name__} needs a docstring, and the `module:attribute` of its code for the runtime"
        )
    section_fields(model)


def kind_parameters(model: type[Section], *bases: type[Section]) -> Iterator[tuple[str, FieldType]]:
    """Yield the fields that the model of a kind has beyond those of its `bases`.

    Raises:
        ValueError: One of them is not a single value.
    """
    inherited = {name for base in bases if issubclass(model, base) for name in base.model_fields}
    for name, shape in section_fields(model).items():
        if name not in inherited:
            if not isinstance(shape, FieldType):
                raise ValueError(f"{model.__name__}.{name} is not a single value")
            yield name, shape


Shape = FieldType | type[Section] | ListOf | MappingOf | Forms | Kinds


def noun_of(shape: Shape) -> str:
    """Return the noun for a value of this shape, with its article."""
    match shape:
        case FieldType():
            return shape.noun
        case ListOf(item=item):
            return f"a list of {item.plural}" if isinstance(item, FieldType) else "a list"
        case Forms(options=options):
            return " or ".join(dict.fromkeys(noun_of(option) for option in options))
        case _:
            return "a mapping"


def unit_of(shape: Shape) -> str:
    """Return the SI unit of a value, `1` for a plain number; empty for other values."""
    match shape:
        case Quantity(measure=measure) | Range(measure=measure) | Column(measure=measure):
            return MEASURES[measure][2]
        case MappingOf(value=inner) | ListOf(item=inner):
            return unit_of(inner)
        case Forms(options=options):
            return next((unit for unit in map(unit_of, options) if unit), "")
        case _:
            return ""


@cache
def section_fields(section: type[Section]) -> Mapping[str, Shape]:
    """Return the keys of a section, in order, each with its shape."""
    return {
        name: shape_of(info.annotation, tuple(info.metadata)) for name, info in section.model_fields.items()
    }


_PLAIN_FIELD_TYPES: Mapping[object, FieldType] = {
    int: WholeNumber(),
    float: Number(),
    bool: Flag(),
    str: Text(),
}
"""Field types of plain Python types, which pydantic validates itself."""


def shape_of(annotation: Any, metadata: tuple[Any, ...] = ()) -> Shape:
    """Return the shape of an annotation without None.

    Raises:
        TypeError: The annotation of a model has no shape.
    """
    origin = get_origin(annotation)
    arguments = get_args(annotation)
    if origin is Annotated:
        return shape_of(arguments[0], (*annotation.__metadata__, *metadata))
    for item in metadata:
        if isinstance(item, Forms):
            return _forms_of(annotation)
        if isinstance(item, (FieldType, Kinds)):
            return item
    if origin is Literal:
        return Word(arguments)
    if origin in (Union, UnionType):
        (only,) = (option for option in arguments if option is not NoneType)
        return shape_of(only, metadata)
    if origin is dict and isinstance(key := shape_of(arguments[0]), FieldType):
        return MappingOf(key, shape_of(arguments[1]))
    if origin is tuple:
        return ListOf(shape_of(arguments[0]))
    if isinstance(annotation, type) and issubclass(annotation, Section):
        return annotation
    if annotation in _PLAIN_FIELD_TYPES:
        return _PLAIN_FIELD_TYPES[annotation]
    raise TypeError(f"no shape for {annotation!r}")


def example_text(section: type[Section], key: str) -> str:
    """Return the example of a key as text; of a word, the first one."""
    if example := example_of(section, key):
        return example.text
    shape = section_fields(section)[key]
    return shape.words[0] if isinstance(shape, Word) else ""


# Walking a scenario


def set_paths(value: object, path: NodePath = ()) -> None:
    """Set the paths of `value` and of all sections below it."""
    if isinstance(value, Section):
        value._path = path
        below: Iterable[tuple[str | int, object]] = value.__dict__.items()
    elif isinstance(value, dict):
        below = value.items()
    elif isinstance(value, tuple):
        below = enumerate(value)
    else:
        return
    for step, item in below:
        set_paths(item, (*path, step))


def visit_values(section: Section, path: NodePath = ()) -> Iterator[tuple[NodePath, FieldType, object]]:
    """Yield the path, the field type and the written value of every single value in a validated section.

    A key that the user chose comes before the values of its entry, with the path of the entry, the field type
    of keys, and the key as value. Defaults are not visited.
    """
    for name, shape in section_fields(type(section)).items():
        if name in section.model_fields_set:
            yield from _visit(shape, getattr(section, name), (*path, name))


def _visit(shape: Shape, value: object, path: NodePath) -> Iterator[tuple[NodePath, FieldType, object]]:
    if isinstance(value, Section):
        yield from visit_values(value, path)
        return
    match shape, value:
        case FieldType(), tuple():
            for index, item in enumerate(value):
                yield (*path, index), shape, item
        case FieldType(), _:
            yield path, shape, value
        case ListOf(), tuple():
            for index, item in enumerate(value):
                yield from _visit(shape.item, item, (*path, index))
        case MappingOf(), Mapping():
            for key, item in value.items():
                yield (*path, key), shape.key, key
                yield from _visit(shape.value, item, (*path, key))
        case Forms(), _:
            form = shape.choose(value)
            if form is not None:
                yield from _visit(form, value, path)


def chosen_shape(shape: Shape, data: object) -> Shape | None:
    """Return the shape after choosing among forms and kinds by the data; None if there is no choice."""
    match shape:
        case Forms():
            form = shape.choose(data)
            return None if form is None else chosen_shape(form, data)
        case Kinds():
            return shape.find(data)
        case _:
            return shape


def shape_at(shape: Shape, data: object, path: NodePath, *, choose: bool = True) -> Shape | None:
    """Return the shape of the value at `path` in raw data; None if the path does not exist in the language.

    Unless `choose`, the result may be a union of forms or kinds.
    """
    for step in path:
        match chosen_shape(shape, data), data:
            case (ListOf(item=item), list()) if isinstance(step, int) and 0 <= step < len(data):
                shape = item
                data = data[step]
            case (MappingOf(value=value), dict()) if step in data:
                shape = value
                data = data[step]
            case (type() as section, dict()) if (
                step in data and (below := section_fields(section).get(str(step))) is not None
            ):
                shape = below
                data = data[step]
            case _:
                return None
    return chosen_shape(shape, data) if choose else shape


def walk_sections(
    shape: Shape, path: tuple[str, ...] = (), kind_key: str = ""
) -> Iterator[tuple[tuple[str, ...], type[Section] | Kinds, str]]:
    """Yield every section and every union of kinds below a shape: its path, and the key of its kind.

    In the path `*` is a name that the user chooses.
    """
    match shape:
        case ListOf(item=inner):
            yield from walk_sections(inner, path)
        case MappingOf(value=inner):
            yield from walk_sections(inner, (*path, "*"))
        case Forms(options=options):
            for option in options:
                yield from walk_sections(option, path)
        case Kinds():
            yield path, shape, ""
            for name, model in (*shape.models.items(), *shape.models_by_key.items()):
                yield from walk_sections(model, path, shape.key if name in shape.models else "")
        case type():
            yield path, shape, kind_key
            for name, below in section_fields(shape).items():
                yield from walk_sections(below, (*path, name))
