"""The shape of a JSON record, which msgspec compares with its model before pydantic parses it.

A run may come from someone else. pydantic parses the whole text before it looks at a key, and keeps an error
of 0.9 kB for each value: files of 2 MB took 0.4 to 2.6 GB. msgspec ends at the first value that does not fit.
What fits takes 8 to 10 times its size in pydantic.
"""

from __future__ import annotations

import dataclasses
import json
import re
from collections.abc import Mapping, Sequence
from functools import cache
from pathlib import Path
from types import NoneType, UnionType
from typing import Annotated, Any, Literal, NamedTuple, Union, get_args, get_origin, get_type_hints

from pydantic import BaseModel

from deepbots_cli.words import printable

SKIPPED = "skipped"
"""The key of `json_schema_extra` of a model with the keys of its object that it does not read, or None for all
further keys."""
MAX_NUMBER = 1e100
"""The limit of all floats, whose squares are still finite. Integers without limits of their own have 64 bits."""
_GROUPS, _BYTES_PER_GROUP = 200_000, 40
_KEYS, _BYTES_PER_KEY = 150_000, 12
"""The limits of lists and objects, and of keys: so many, or one in so many bytes of a longer text. Each takes
200 bytes in pydantic. An episode of CartPole has 4 groups and 15 keys in 285 bytes."""
_ESCAPED = re.compile(r"\\(?:[^u]|u[0-9a-fA-F]{4}(?:\\u[0-9a-fA-F]{4})*)|[^\x00-\x7e]", re.DOTALL)
_AT = re.compile(r"(.*?)(?: - at `(?:key in )?\$\.?(.*)`)?", re.DOTALL)


class UnfitError(ValueError):
    """The text is not that of the model; the message has the field and the reason."""


class _Shape(NamedTuple):
    """The types of msgspec for a record: `checked` is compared with the text, and `kept` has the parts of the
    text that the model reads."""

    checked: Any
    kept: Any


def fitting_text(content: bytes, model: type[BaseModel]) -> bytes:
    """Return the JSON object of a record with those keys alone that `model` reads. Its strings are lines:
    control characters and invisible ones become escapes that can be read.

    Raises:
        UnfitError: It is not JSON, has other keys or types, lacks a key, or has a number beyond the limits.
    """
    import msgspec  # of the extra `sim`, without which there are no runs

    shape = _shape_of(model)
    try:
        text = content.decode()
        if "\\" in text or "\x7f" in text or not text.isascii():
            text = _ESCAPED.sub(_with_visible_letters, text)
        groups, keys = text.count("[") + text.count("{"), text.count(":")
        if groups > max(_GROUPS, len(text) // _BYTES_PER_GROUP) or keys > max(
            _KEYS, len(text) // _BYTES_PER_KEY
        ):
            raise UnfitError("it has more values than deepbots writes")
        msgspec.json.decode(text, type=shape.checked)
        kept = msgspec.json.decode(text, type=shape.kept)
    except UnfitError:
        raise
    except msgspec.ValidationError as error:
        raise UnfitError(_reason(error)) from None
    except (ValueError, RecursionError) as error:
        raise UnfitError("it is not valid JSON") from error
    parts = ((name, getattr(kept, name)) for name in kept.__struct_fields__)
    return b"{%b}" % b",".join(b'"%b":%b' % (name.encode(), part) for name, part in parts if part)


def _reason(error: Exception) -> str:
    """Return the field that does not fit, and the reason."""
    match = _AT.fullmatch(str(error))
    text, field = (str(error), "") if match is None else (match[1], match[2] or "")
    reason = text.replace(" | null`", "`")
    name = re.search(r"(?:unknown|required) field `(.*)`", reason, re.DOTALL)
    if name is not None:
        field = f"{field}.{name[1][:40]}".lstrip(".")
        reason = "Field required" if "required" in reason else "deepbots writes no such key here"
    return f"'{field[-120:]}': {reason}" if field else reason


def _with_visible_letters(match: re.Match[str]) -> str:
    raw = match[0]
    if raw in ('\\"', "\\\\", "\\/"):
        return raw
    letters = json.loads(f'"{raw}"')
    return raw if letters.isprintable() else printable(letters).replace("\\", "\\\\")


@cache
def _shape_of(model: type[BaseModel]) -> _Shape:
    import msgspec

    names = [field.alias or name for name, field in model.model_fields.items()]
    kept = msgspec.defstruct("Kept", [(name, msgspec.Raw, msgspec.Raw()) for name in names])
    return _Shape(_struct(model), kept)


_Entry = tuple[str, Any, bool]
"""A key of an object, the type of its value, and whether it must be there."""


@cache
def _struct(*models: type[Any]) -> Any:
    """Return the struct for the objects of a model or a dataclass; of several, for those of any of them."""
    import msgspec

    all_entries = [_entries(model) for model in models]
    unread = {name for model in models for name in _skipped(model) or ()}
    types: dict[str, Any] = {}
    for name, kind, _ in (entry for entries in all_entries for entry in entries):
        types[name] = kind if types.get(name, kind) == kind else msgspec.Raw
    required = [name for name, _, needed in all_entries[0] if needed and len(models) == 1]
    return msgspec.defstruct(
        models[0].__name__,
        [
            *((name, types[name]) for name in required),
            *((name, kind, None) for name, kind in types.items() if name not in required),
            *((name, msgspec.Raw, None) for name in sorted(unread)),
        ],
        forbid_unknown_fields=all(_skipped(model) is not None for model in models),
        kw_only=True,
    )


def _skipped(model: type[Any]) -> Sequence[str] | None:
    """Return the further keys that a model does not read, or None for all."""
    extra = model.model_config.get("json_schema_extra") if issubclass(model, BaseModel) else None
    return extra.get(SKIPPED, ()) if isinstance(extra, dict) else ()  # type: ignore[return-value]


def _entries(model: type[Any]) -> list[_Entry]:
    if issubclass(model, BaseModel):
        fields: list[_Entry] = [
            (field.alias or name, _type(field.annotation, field.metadata, model), field.is_required())
            for name, field in model.model_fields.items()
        ]
    else:
        hints = get_type_hints(model, include_extras=True)
        fields = [
            (field.name, _type(hints[field.name], (), model), _is_required(field))
            for field in dataclasses.fields(model)
        ]
    # pydantic checks whether a value may be null: before that, a model may take another one for it.
    raw = _type(Any)
    return [(name, kind if kind is raw else kind | None, needed) for name, kind, needed in fields]


def _is_required(field: dataclasses.Field[Any]) -> bool:
    return field.default is dataclasses.MISSING and field.default_factory is dataclasses.MISSING


def _type(kind: Any, metadata: Sequence[Any] = (), within: type[Any] | None = None) -> Any:
    """Return the type of msgspec for a type of pydantic; any value fits a type that is not known here, and an
    object of the class `within` in an object of this class."""
    import msgspec

    origin, parts = get_origin(kind), get_args(kind)
    if origin is Annotated:
        return _type(parts[0], [*metadata, *kind.__metadata__], within)
    if kind is int:
        limits = [part for entry in metadata for part in getattr(entry, "metadata", [entry])]
        has_limits = any(hasattr(entry, "le") or hasattr(entry, "lt") for entry in limits)
        return int if has_limits else Annotated[int, msgspec.Meta(ge=-(2**63), le=2**63 - 1)]
    if kind is float:
        return Annotated[float, msgspec.Meta(ge=-MAX_NUMBER, le=MAX_NUMBER)]
    if kind in (str, bool, None, NoneType) or origin is Literal:
        return kind
    if kind is Path:
        return str
    if origin in (Union, UnionType):
        return _union([_without_metadata(part) for part in parts], within)
    if origin in (dict, Mapping):
        return dict[str, _type(parts[1], (), within)]  # type: ignore[misc]
    if origin is tuple and parts[-1] is not Ellipsis:
        return tuple[tuple(_type(part, (), within) for part in parts)]  # type: ignore[misc]
    if origin in (tuple, list, Sequence):
        item = _type(parts[0], (), within)
        return item if item is msgspec.Raw else list[item]  # type: ignore[valid-type]
    if isinstance(kind, type) and issubclass(kind, tuple) and hasattr(kind, "_fields"):
        hints = get_type_hints(kind, include_extras=True)
        return tuple[tuple(_type(hint) for hint in hints.values())]  # type: ignore[misc]
    return _struct(kind) if _is_object(kind) and kind is not within else msgspec.Raw


def _union(parts: Sequence[Any], within: type[Any] | None) -> Any:
    """Return the type for a union, in which msgspec allows one kind of objects."""
    import msgspec

    models = [part for part in parts if _is_object(part)]
    types = [_type(part, (), within) for part in parts if part not in models]
    types += [_struct(*models)] if models and within not in models else []
    return msgspec.Raw if msgspec.Raw in types or not types else Union[tuple(types)]  # noqa: UP007


def _without_metadata(kind: Any) -> Any:
    is_model = get_origin(kind) is Annotated and _is_object(get_args(kind)[0])
    return get_args(kind)[0] if is_model else kind


def _is_object(kind: Any) -> bool:
    return isinstance(kind, type) and (issubclass(kind, BaseModel) or dataclasses.is_dataclass(kind))
