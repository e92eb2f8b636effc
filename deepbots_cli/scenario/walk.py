"""Walking a scenario by the shapes of its keys: paths, single values, the shape at a path, all sections."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping

from deepbots_cli.document.nodes import NodePath
from deepbots_cli.scenario.base import Forms, Kinds, ListOf, MappingOf, Section, Shape, section_fields
from deepbots_cli.scenario.fields.base import FieldType


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
