"""Directories of runs, groups and studies: their names and locks, files that are written whole, and records
that are read as models.

A run may come from someone else. pydantic parses the whole text of a record before it looks at a key, and
keeps an error of 0.9 kB for each value: files of 2 MB took 0.4 to 2.6 GB. Therefore msgspec compares the text
with the shape of the model first, and ends at the first value that does not fit. What fits takes 8 to 10
times its size in pydantic.
"""

from __future__ import annotations

import dataclasses
import json
import os
import re
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from types import NoneType, UnionType
from typing import Annotated, Any, Literal, TypeVar, Union, get_args, get_origin, get_type_hints

from pydantic import BaseModel, ConfigDict, Field, ValidationError

import deepbots_cli
from deepbots_cli.errors import RunError, StorageError, UsageError
from deepbots_cli.files import atomic_write, read_at_most, unwritable_message
from deepbots_cli.rollout.source import RECORD_NAME, SourceKind, folder_kind
from deepbots_cli.words import printable

SKIPPED = "skipped"
"""The key of `json_schema_extra` of a model with the keys of its object that it does not read, or None for
all further keys."""
MAX_NUMBER = 1e100
"""The limit of all floats, whose squares are still finite. Integers without limits of their own have 64
bits."""
_GROUPS, _BYTES_PER_GROUP = 200_000, 40
_KEYS, _BYTES_PER_KEY = 150_000, 12
"""The limits of lists and objects, and of keys: so many, or one in so many bytes of a longer text. Each takes
200 bytes in pydantic. An episode of CartPole has 4 groups and 15 keys in 285 bytes."""
_ESCAPED = re.compile(r"\\(?:[^u]|u[0-9a-fA-F]{4}(?:\\u[0-9a-fA-F]{4})*)|[^\x00-\x7e]", re.DOTALL)


class UnfitError(ValueError):
    """The text is not that of the model; the message has the field and the reason."""


def fitting_text(content: bytes, model: type[BaseModel]) -> str:
    """Return the JSON text of a record. Its strings are lines: control characters and invisible ones become
    escapes that can be read.

    Raises:
        UnfitError: It is not JSON, has other keys or types, lacks a key, or has a number beyond the limits.
    """
    import msgspec  # of the extra `sim`, without which there are no runs

    try:
        text = content.decode()
        if "\\" in text or "\x7f" in text or not text.isascii():
            text = _ESCAPED.sub(_with_visible_letters, text)
        groups, keys = text.count("[") + text.count("{"), text.count(":")
        if groups > max(_GROUPS, len(text) // _BYTES_PER_GROUP) or keys > max(
            _KEYS, len(text) // _BYTES_PER_KEY
        ):
            raise UnfitError("it has more values than deepbots writes")
        msgspec.json.decode(text, type=_struct(model))
    except UnfitError:
        raise
    except msgspec.ValidationError as error:
        reason, _, place = str(error).replace(" | null`", "`").partition(" - at ")
        field = place.strip("`").removeprefix("$.")
        raise UnfitError(f"'{field[-120:]}': {reason}" if field else reason) from None
    except (ValueError, RecursionError) as error:
        raise UnfitError("it is not valid JSON") from error
    return text


def _with_visible_letters(match: re.Match[str]) -> str:
    raw = match[0]
    if raw in ('\\"', "\\\\", "\\/"):
        return raw
    letters = json.loads(f'"{raw}"')
    return raw if letters.isprintable() else json.dumps(printable(letters))[1:-1]


_Entry = tuple[str, Any, bool]
"""A key of an object, the type of its value, and whether it must be there."""


@cache
def _struct(model: type[Any]) -> Any:
    """Return the struct for the objects of a model or a dataclass."""
    import msgspec

    entries, unread = _entries(model), _skipped(model)
    return msgspec.defstruct(
        model.__name__,
        [
            *((name, kind) if needed else (name, kind, None) for name, kind, needed in entries),
            *((name, msgspec.Raw, None) for name in unread or ()),
        ],
        forbid_unknown_fields=unread is not None,
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
        return _union(parts, within)
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

    models = [
        part for part in parts if _is_object(get_args(part)[0] if get_origin(part) is Annotated else part)
    ]
    types = [_type(part, (), within) for part in parts]
    is_any = len(models) > 1 or msgspec.Raw in types
    return msgspec.Raw if is_any else Union[tuple(types)]  # noqa: UP007


def _is_object(kind: Any) -> bool:
    return isinstance(kind, type) and (issubclass(kind, BaseModel) or dataclasses.is_dataclass(kind))


M = TypeVar("M", bound=BaseModel)

WORKERS_FOLDER = "workers"
"""The folder for the output of workers, in the folder of a run, a group or a study."""
_END_TIMEOUT_S = 60.0
"""The time to wait for the end of a training whose worker was lost, in s. A process ends some time after its
node was lost."""
_LOCK_WAIT_S = 1.0
"""The time to wait for a lock, in s, because `is_training` takes it for a moment."""


class RecordFormat(BaseModel, strict=True):
    """The entries of a record that say which version of deepbots can read the rest."""

    model_config = ConfigDict(json_schema_extra={SKIPPED: None})

    format: int = Field(ge=0, lt=2**31)
    deepbots: str = Field(default="", pattern=r"^[\w.+-]{0,40}$")


def read_record(path: Path, model: type[M], noun: str, number: int, limit: int) -> M:
    """Read the record of a run, a group or a study (`noun`) of format `number`.

    Raises:
        RunError: The record has another format, or as for `read_json`.
    """
    written = read_json(path, RecordFormat, limit)
    if written.format != number:
        same = "the state of " * (written.deepbots == deepbots_cli.__version__)
        version = f"{same}deepbots {written.deepbots}" if written.deepbots else "the version of deepbots"
        raise RunError(
            f"{path.parent} is a {noun} of format {written.format}, but this version of deepbots reads format"
            f" {number}; use {version} that wrote it"
        )
    try:
        return read_json(path, model, limit)
    except RunError as error:
        if "missing required field" in str(error):
            error.add_note(
                f"an earlier checkout of deepbots {written.deepbots}, which had no such entry, may have written it;"
                " that checkout reads it"
            )
        raise


def read_json(path: Path, model: type[M], limit: int) -> M:
    """Read a file of at most `limit` bytes as a model. Each of its texts is one line (see `fitting_text`).

    Raises:
        RunError: The file is missing, not a regular file, unreadable, too large, or does not fit the model.
    """
    if not path.is_file():
        raise RunError(f"{path} is missing")
    try:
        content = read_at_most(path, limit + 1)
    except OSError as error:
        raise RunError(f"{path} cannot be read: {error.strerror}") from error
    if len(content) > limit:
        raise RunError(f"{path} is larger than {limit} bytes, so deepbots did not write it")
    try:
        return model.model_validate_json(fitting_text(content, model))
    except UnfitError as error:
        reason = str(error)
    except ValidationError as error:
        reason = validation_text(error)
    raise RunError(f"{path} is damaged: {' '.join(reason.split())[:200]}")


def validation_text(error: ValidationError) -> str:
    """Return the first field that does not fit a model, and the reason, in one line."""
    first = error.errors(include_url=False, include_context=False, include_input=False)[0]
    field = ".".join(str(part)[:40] for part in first["loc"])
    reason = f"'{field}': {first['msg']}" if field else first["msg"]
    return " ".join(reason.split())[:200]


def refuse_link(folder: Path) -> None:
    """Refuse the folder of a run or a campaign that is a link: it leads to the run of someone else, which
    would be judged, and written to. A link above it is that of the person who names the folder.

    Raises:
        RunError: It is a symbolic link.
    """
    if folder.is_symlink():
        raise RunError(
            f"{folder} is a symbolic link; name the folder that it leads to: {os.path.realpath(folder)}"
        )


def write_text(path: Path, text: str) -> None:
    with atomic_write(path, StorageError) as draft:
        draft.write_bytes(text.encode())


def numbered_files(folder: Path) -> list[tuple[int, Path]]:
    """Return the files `0001.json`, `0002.json` ... of a folder, by number. An empty one has not been
    written yet, or its writer was killed; it is left out, as is a link that leads nowhere."""
    return sorted(
        (int(path.stem), path)
        for path in folder.glob("*.json")
        if re.fullmatch("[0-9]{4,9}", path.stem) and path.is_file() and path.stat().st_size
    )


def write_numbered(folder: Path, text: str) -> Path:
    """Write a text as the file with the next free number. The folder is created if it is missing.

    Raises:
        RunError: It cannot be written.
    """
    path = folder / "0001.json"
    try:
        folder.mkdir(exist_ok=True)
        number = 1 + max((number for number, _ in numbered_files(folder)), default=0)
        while True:
            try:
                path = folder / f"{number:04d}.json"
                path.touch(exist_ok=False)
                break
            except FileExistsError:
                number += 1  # another process was faster
    except OSError as error:
        raise StorageError(unwritable_message(path, error)) from error
    try:
        write_text(path, text)
    except RunError:
        path.unlink()
        raise
    return path


def new_directory(folder: str | Path | None, parent: str | Path, scenario: str, seed: int | str) -> Path:
    """Create the directory of a new run: `folder`, or else the next free `parent/<scenario>-<seed>-<n>`.
    `seed` is `seeds` for a group.

    Raises:
        UsageError: `folder` exists, or the directory cannot be made.
    """
    folder = None if folder is None else Path(folder)
    parent = Path(parent)
    if folder is None:
        try:
            parent.mkdir(parents=True, exist_ok=True)
        except OSError as error:  # it may be a file
            raise UsageError(unwritable_message(parent, error)) from error
    try:
        if folder is not None:
            folder.mkdir(parents=True)
            return folder
        stem = f"{re.sub(r'[^a-z0-9]+', '_', scenario.lower()).strip('_') or 'run'}-{seed}-"
        number = 1 + max((_number(path.name, stem) for path in parent.iterdir()), default=0)
        while True:
            try:
                path = parent / f"{stem}{number}"
                path.mkdir()
                return path
            except FileExistsError:
                number += 1  # another process was faster
    except FileExistsError as error:
        raise UsageError(
            f"{error.filename} already exists; choose another directory, because runs are not overwritten"
        ) from error
    except OSError as error:
        raise UsageError(unwritable_message(folder or parent, error)) from error


def _number(name: str, stem: str) -> int:
    tail = name.removeprefix(stem)
    return int(tail) if name != tail and tail.isdecimal() and tail.isascii() and len(tail) < 10 else 0


def run_folders(runs: Sequence[str | Path]) -> list[Path]:
    """Return the run directories, each once. Those in a folder, and of the groups in it, come in the order of
    their names."""
    folders: dict[Path, None] = {}
    for path in map(Path, runs):
        inner: list[Path] = []
        if os.path.isdir(path) and folder_kind(path) is not SourceKind.RUN:
            groups = sorted(each for each in path.glob("*") if folder_kind(each) is SourceKind.GROUP)
            for outer in (path, *groups):
                inner += sorted(file.parent for file in outer.glob(f"*/{RECORD_NAME}"))
        folders |= dict.fromkeys(inner or [path])
    return list(folders)


@contextmanager
def run_lock(folder: Path, name: str = ".lock", wait_s: float = _LOCK_WAIT_S) -> Iterator[None]:
    """Context in which nobody else trains in the run directory `folder`. The lock ends with the process, even
    if the process is killed.

    `name` is the name of another lock in the folder, and `wait_s` the time to wait for it in s.

    Raises:
        UsageError: Another training is at work there, or the directory cannot be written to.
        RunError: The lock is a symbolic link.
    """
    from filelock import FileLock, Timeout  # needs the extra `train`

    path = folder / name
    # A run may come from someone else, and older releases of filelock open the target of a link.
    if path.is_symlink():
        raise RunError(f"{path} is a symbolic link; deepbots does not write symbolic links into a run")
    try:
        lock = FileLock(path, timeout=wait_s).acquire()
    except Timeout:
        raise UsageError(
            f"another process writes to {folder}, such as a training; wait until it finishes, or stop it"
        ) from None
    except OSError as error:
        raise UsageError(unwritable_message(folder, error)) from error
    with lock:
        yield


def is_training(folder: Path, name: str = ".lock") -> bool:
    """Return whether a training is at work in the directory of a run or a group; `name` is that of its
    lock."""
    path = folder / name
    if path.is_symlink() or not path.is_file():
        return False
    from filelock import FileLock, Timeout  # needs the extra `train`

    try:
        with FileLock(path, timeout=0):
            return False
    except Timeout:
        return True
    except OSError:  # the lock belongs to another user and cannot be written to
        return False


def has_ended(folder: Path) -> bool:
    """Return whether no training is at work in the directory any more. Waits a while for a training whose
    worker was lost."""
    deadline = time.monotonic() + _END_TIMEOUT_S
    while is_training(folder):
        if time.monotonic() > deadline:
            return False
        time.sleep(0.5)
    return True
