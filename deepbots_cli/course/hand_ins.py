"""What a student hands in: a folder, a zip, or the file of a step; and the parts that a lesson takes from it.

Nothing of it is trusted. It is copied into a folder of the grader without links and within limits; the files
are parsed as YAML and never as scenarios; and the teacher's task includes the named parts, not the other way
round.
"""

from __future__ import annotations

import errno
import hashlib
import json
import os
import re
import shutil
import stat
import zipfile
import zlib
from collections.abc import Iterator
from pathlib import Path, PurePosixPath
from typing import Any

from deepbots_cli.course.lessons import (
    ANSWERS_NAME,
    HANDED_IN,
    START,
    Lesson,
    Step,
    data_of,
    read_mapping,
    settings_of,
)
from deepbots_cli.document import MappingNode, Node, ScalarNode, to_data, walk
from deepbots_cli.document.nodes import node_at
from deepbots_cli.errors import StorageError, UsageError
from deepbots_cli.expressions import parser, syntax
from deepbots_cli.files import read_at_most, unwritable_message
from deepbots_cli.records import dataclass

MAX_FILES = 2_000
MAX_BYTES = 200 * 2**20
_STRUCTURE = ("include", "extends", "remove", "deepbots")
"""Keys that would read other files, or take away what the task has."""
_CODE = (".py", ".so", ".dll", ".exe", ".sh", ".pkl", ".pickle", ".ipynb", ".js")
_CHUNK = 2**20
_MAX_LINKS = 3
"""The number of links of a hand-in that are named."""
_MAX_FILE_BYTES = 2**20
_OWN = (ANSWERS_NAME, "README.md", "course.json", "runs", "exploits")
"""What a student has beside the files of the exercise."""


class HandInError(UsageError):
    """A hand-in that cannot be marked; the message is the reason."""


def collect(path: Path, into: Path, lesson: Lesson) -> tuple[Path, tuple[str, ...]]:
    """Copy a hand-in into an empty folder. Returns the folder with its files in it, and remarks about what
    was left out.

    Raises:
        HandInError: It is missing, too large, damaged, or of another kind.
        StorageError: The disk of the grader is full.
    """
    remarks: list[str] = []
    try:
        if path.is_symlink():
            raise HandInError("it is a symbolic link, which may lead to the work of another student")
        if not path.exists():
            raise HandInError("it does not exist")
        path = _zip_inside(path)
        if path.is_dir():
            _copy_folder(path, into, remarks)
        elif path.is_file() and zipfile.is_zipfile(path):
            _extract(path, into, remarks)
        elif path.is_file() and path.suffix in (".yaml", ".yml"):
            _copy(path, into / path.name, 0)
        else:
            raise HandInError("it is neither a folder, nor a zip, nor a YAML file")
    except OSError as error:
        if error.errno in (errno.ENOSPC, errno.EDQUOT):
            raise StorageError(unwritable_message(into, error)) from None
        raise HandInError(f"it cannot be read: {(error.strerror or type(error).__name__).lower()}") from None
    folder = _inner_folder(into, lesson, remarks)
    return folder, (*remarks, *_foreign_files(folder, lesson))


def _zip_inside(path: Path) -> Path:
    """Return the only entry of a folder if it is a zip, as learning platforms store a hand-in, else the path."""
    inside = [entry for entry in path.iterdir() if not entry.name.startswith(".")] if path.is_dir() else []
    is_zip = [entry.suffix.lower() == ".zip" and not entry.is_symlink() for entry in inside] == [True]
    return inside[0] if is_zip else path


def _inner_folder(folder: Path, lesson: Lesson, remarks: list[str]) -> Path:
    """Return the folder with the files of the steps: a zip often has one folder around them."""
    candidates = (folder, *sorted(path for path in folder.glob("*/") if path.is_dir()))
    marked = [path for path in candidates if any((path / name).is_file() for name in lesson.step_files)]
    if marked:
        remarks += (f"{path.name} is not marked, beside {marked[0].name}" for path in marked[1:])
        return marked[0]
    left_out = "".join(f"; {remark}" for remark in remarks)
    if not any(folder.iterdir()):
        raise HandInError(f"it is empty{left_out}")
    raise HandInError(f"it has none of the files of this lesson: {', '.join(lesson.step_files)}{left_out}")


def _foreign_files(folder: Path, lesson: Lesson) -> Iterator[str]:
    """Yield remarks about files that have no effect: those that the exercise does not have, and those of its
    world that were changed."""
    start = lesson.folder / START
    steps = set(lesson.step_files)
    taken = {name for step in lesson.steps.values() for name in step.files}
    expected = {path.name for path in start.iterdir()} | steps | taken | set(_OWN)
    foreign = sorted(
        path.name
        for path in folder.iterdir()
        if path.name not in expected and path.suffix not in (".png", ".svg")
    )
    if foreign:
        yield f"{', '.join(foreign[:5])}: not a part of the exercise, and without effect on the marks"
    for path in sorted(start.iterdir()):
        copy = folder / path.name
        is_world = path.is_file() and path.name not in steps | taken
        if is_world and copy.is_file() and copy.read_bytes() != path.read_bytes():
            yield f"{path.name} was changed, which has no effect on the marks"


def _copy_folder(folder: Path, into: Path, remarks: list[str]) -> None:
    count = total = 0
    for place, folders, names in os.walk(folder):
        folders[:] = sorted(name for name in folders if not (name.startswith(".") or name == "__pycache__"))
        for name in [*folders]:
            if (Path(place) / name).is_symlink():
                folders.remove(name)
                remarks.append(f"{name} is a symbolic link, which is not followed")
        for name in sorted(name for name in names if not name.startswith(".")):
            source = Path(place) / name
            if source.is_symlink():
                remarks.append(f"{name} is a symbolic link, which is not followed")
            elif stat.S_ISREG(source.lstat().st_mode):
                count += 1
                if count > MAX_FILES:
                    raise HandInError(f"it has more than {MAX_FILES:,} files")
                target = into / source.relative_to(folder)
                target.parent.mkdir(parents=True, exist_ok=True)
                total = _copy(source, target, total)
    _shorten(into, remarks)


def _copy(source: Path, target: Path, total: int) -> int:
    total += source.stat().st_size
    if total > MAX_BYTES:
        raise HandInError(f"it is larger than {MAX_BYTES >> 20} MiB")
    shutil.copyfile(source, target, follow_symlinks=False)
    return total


def _extract(path: Path, into: Path, remarks: list[str]) -> None:
    total = 0
    try:
        with zipfile.ZipFile(path) as archive:
            members = archive.infolist()
            if len(members) > MAX_FILES:
                raise HandInError(f"it has more than {MAX_FILES:,} files")
            for member in members:
                name = PurePosixPath(member.filename.replace("\\", "/"))
                if member.is_dir() or any(
                    part.startswith((".", "__")) and part != ".." for part in name.parts
                ):
                    continue
                if name.is_absolute() or ".." in name.parts or re.match("[A-Za-z]:", member.filename):
                    raise HandInError(f"the zip has a file outside of it: {member.filename[:80]}")
                if stat.S_ISLNK(member.external_attr >> 16):
                    remarks.append(f"{name.name} is a symbolic link, which is not followed")
                    continue
                target = into / name
                if target.exists():
                    raise HandInError(f"the zip has two files of the name {name}")
                target.parent.mkdir(parents=True, exist_ok=True)
                with archive.open(member) as source, target.open("wb") as out:
                    while chunk := source.read(_CHUNK):
                        total += len(chunk)
                        if total > MAX_BYTES:
                            raise HandInError(f"it is larger than {MAX_BYTES >> 20} MiB when unpacked")
                        out.write(chunk)
    except (zipfile.BadZipFile, zlib.error, RuntimeError, NotImplementedError, EOFError, ValueError):
        raise HandInError("the zip is damaged or encrypted") from None
    _shorten(into, remarks)


def _shorten(folder: Path, remarks: list[str]) -> None:
    """Keep the first remarks about links, and add one about programs; those in runs are of deepbots."""
    links = len(remarks)
    if links > _MAX_LINKS:
        remarks[_MAX_LINKS:] = [f"{links - _MAX_LINKS} more symbolic links are not followed"]
    files = (path for path in folder.rglob("*") if "runs" not in path.relative_to(folder).parts)
    code = sorted(path.name for path in files if path.name.lower().endswith(_CODE))
    if code:
        remarks.append(f"{', '.join(code[:3])}: programs are not run, so they have no effect")


# The parts of a step


@dataclass(frozen=True)
class StepFile:
    """The file of a step: its parts by their dotted paths, and remarks about the rest of it."""

    parts: dict[str, Node]
    remarks: tuple[str, ...] = ()
    is_changed: bool = True

    @property
    def assignments(self) -> list[str]:
        """The parts that are single values or lists, as assignments `path=value` to the teacher's task."""
        return [
            f"{path}={json.dumps(value)}"
            for path, part in self.parts.items()
            if not isinstance(part, MappingNode) and (value := to_data(part)) is not None
        ]

    @property
    def digest(self) -> str:
        """The digest of the values of the parts."""
        data = {path: to_data(node) for path, node in sorted(self.parts.items())}
        return hashlib.sha256(repr(data).encode("utf-8", "replace")).hexdigest()


def read_step(folder: Path, name: str, step: Step, start: Path) -> StepFile:
    """Return the parts of a step.

    Args:
        folder: The folder of the hand-in.
        name: The name of the step.
        step: The step.
        start: The folder of the files that the student started from.

    Raises:
        HandInError: The file is missing or broken, or a part has what no part may have.
    """
    file = f"{name}.yaml"
    root = _root(folder / file, file)
    parts = _parts_of(root, step)
    started = _root(start / file, file) if (start / file).is_file() else None
    is_changed = StepFile(parts).digest != StepFile(_parts_of(started, step)).digest
    is_changed = is_changed or any(_content(folder / name) != _content(start / name) for name in step.files)
    for path, part in parts.items() if is_changed else ():
        _check_part(path, part, step)
    return StepFile(parts, tuple(_without_effect(file, root, started, step)), is_changed)


def _content(path: Path) -> bytes | None:
    """Return the content of a file that the task takes; None if there is none.

    Raises:
        HandInError: It is too large.
    """
    if path.is_symlink() or not path.is_file():
        return None
    content = read_at_most(path, _MAX_FILE_BYTES + 1)
    if len(content) > _MAX_FILE_BYTES:
        raise HandInError(f"{path.name} is larger than {_MAX_FILE_BYTES >> 20} MiB")
    return content


def _parts_of(root: MappingNode | None, step: Step) -> dict[str, Node]:
    return {path: part for path in step.parts if (part := node_at(root, *path.split("."))) is not None}


def _root(path: Path, file: str) -> MappingNode:
    if path.is_symlink() or not path.is_file():
        raise HandInError(f"there is no {file}")
    try:
        return read_mapping(path, file)
    except UsageError as error:
        raise HandInError(f"{file} cannot be read: {error}") from None


def _check_part(path: str, part: Node, step: Step) -> None:
    for inner, node in walk(part):
        key = next((key for key in inner if key in _STRUCTURE), None)
        if key is not None:
            raise HandInError(f"`{key}` may not stand in `{path}` ({node.span.location})")
        if isinstance(node, ScalarNode):
            texts = (node.text, *map(str, inner))
            words = [word for word in step.forbidden if any(_mentions(text, word) for text in texts)]
            words += [
                word
                for word in (_names(node.text) if step.allowed else ())
                if not {word, word.split(".")[0]} & {*step.allowed}
            ]
            if words:
                raise HandInError(
                    f"`{words[0]}` may not be used in `{path}` ({node.span.location}) in this step"
                )
        if step.only and isinstance(part, MappingNode) and len(inner) == 1 and inner[0] not in step.only:
            raise HandInError(
                f"only {', '.join(f'`{name}`' for name in step.only)} may stand in `{path}`, not `{inner[0]}`"
                f" ({node.span.location})"
            )
        if step.sensors is not None and inner[1:] == ("type",) and path.endswith("sensors"):
            kind = node.text if isinstance(node, ScalarNode) else ""
            if kind not in step.sensors:
                raise HandInError(
                    f"a sensor of type `{kind}` is not allowed ({node.span.location});"
                    f" allowed: {', '.join(step.sensors)}"
                )


def _mentions(text: str, word: str) -> bool:
    """Return whether an expression or a key uses a name, which may have dots."""
    parsed = _names(text)
    unparsed = re.search(rf"(?<!\w)(?<!\w\.){re.escape(word)}(?!\w)", text) is not None
    return any(f"{name}.".startswith(f"{word}.") for name in parsed) if parsed else unparsed


def _names(text: str) -> list[str]:
    """Return the names and functions in an expression; none for another text."""
    tree = parser.parse(text, lambda *_, **__: None) if text.strip() else None
    nodes = [] if tree is None else [tree]
    for node in nodes:  # grows meanwhile
        nodes += syntax.children(node)
    named = (node for node in nodes if isinstance(node, syntax.Name | syntax.Call))
    return [node.dotted if isinstance(node, syntax.Name) else node.function for node in named]


def _without_effect(file: str, root: MappingNode, started: MappingNode | None, step: Step) -> Iterator[str]:
    """Yield a remark for each section that the student changed though the task has its own."""
    if started is None:
        return
    own, before = settings_of(to_data(root)), settings_of(to_data(started))
    paths = sorted(path for path in own.keys() | before.keys() if own.get(path) != before.get(path))
    foreign = [path for path in paths if not is_in_parts(path, step.parts)]
    if foreign:
        more = [f"{len(foreign) - 5} more"] if foreign[5:] else []
        listed = ", ".join([*(f"`{path}`" for path in foreign[:5]), *more])
        yield f"changes of {listed} in {file} have no effect on the marks"


def is_in_parts(path: str, parts: tuple[str, ...]) -> bool:
    """Return whether a dotted path is, contains or is within one of the parts."""
    return any(path == part or path.startswith(f"{part}.") or part.startswith(f"{path}.") for part in parts)


def write_parts(step_file: StepFile, step: Step, own: Path, folder: Path) -> None:
    """Write the parts beside the teacher's task, each in a file of its own, and the files of the student in
    the folder `own` that the task takes.

    A part keeps its lines and columns: what stands before it in the file of the student becomes spaces, so
    that a finding names the place in that file.
    """
    (folder / HANDED_IN).mkdir(parents=True, exist_ok=True)
    for path in step.parts:
        part = step_file.parts.get(path)
        text = "{}"
        if isinstance(part, MappingNode) and part.entries:
            above = re.sub(r"[^\n]", " ", part.span.source.text[: part.span.start])
            # The node of an alias is where its anchor is.
            has_aliases = not all(
                part.span.start <= node.span.start < part.span.end for _, node in walk(part)
            )
            text = above + (json.dumps(to_data(part), ensure_ascii=False) if has_aliases else part.span.text)
        (folder / HANDED_IN / f"{path}.yaml").write_text(text + "\n", encoding="utf-8")
    for name in step.files:
        content = _content(own / name)
        if content is None:
            raise HandInError(f"there is no {name}")
        (folder / HANDED_IN / name).write_bytes(content)


def trained_task(step_file: StepFile, step: Step, start: Path) -> dict[str, Any]:
    """Return the file of the step that the student started from, with the parts that were handed in: the task
    in which a policy is to be trained."""
    data = data_of(start)
    for path in step.parts:
        *above, last = path.split(".")
        section = data
        for key in above:
            section[key] = section.get(key) or {}
            section = section[key]
        section.pop(last, None)
        if path in step_file.parts:
            section[last] = to_data(step_file.parts[path])
    return data
