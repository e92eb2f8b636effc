"""The files that a scenario may read, and their text.

A scenario may come from anyone, so it can read only the files of its project, the shipped ones, and the
folders of `--allow-path`. The text of a file keeps its line ends, so offsets count characters of the file;
only a byte order mark is dropped.
"""

from __future__ import annotations

import os
import re
from collections.abc import Container, Iterable
from dataclasses import replace
from itertools import islice
from pathlib import Path
from typing import Literal

from deepbots_cli.diagnostics import Findings, Fix, Source, Span
from deepbots_cli.diagnostics.nearest import nearest_word
from deepbots_cli.document import shipped
from deepbots_cli.document.shipped import Library
from deepbots_cli.files import is_file, read_at_most
from deepbots_cli.records import dataclass
from deepbots_cli.words import shell_word

MAX_BYTES = 1 << 20
MAX_TOTAL_BYTES = 8 << 20
"""The maximum size of all files of a scenario together."""

_MAX_LISTED, _MAX_SHOWN = 24, 5
# How far a message looks for a file that is not where it should be.
_MAX_DEPTH, _MAX_FOLDERS, _MAX_ENTRIES = 3, 200, 500
_NOT_SEARCHED = frozenset({"runs", "node_modules", "__pycache__", "venv", "build", "dist"})
_PROJECT_MARKERS = ("deepbots.toml", "pyproject.toml", ".git")
# Outside YAML's printable characters, or a line end that editors and YAML count differently.
FORBIDDEN_CHARACTERS = re.compile(
    "[\x00-\x08\x0b\x0c\x0e-\x1f\x7f-\x9f\u2028\u2029\ud800-\udfff\ufeff\ufffe\uffff]|\r(?!\n)"
)


# Paths


@dataclass(frozen=True)
class UnusableFile:
    """The reason why a file that a scenario names cannot be read; `headline` and `help` make the finding."""

    reason: Literal["missing", "outside", "irregular"]
    reference: str
    path: Path
    roots: tuple[Path, ...] = ()
    through_link: bool = False
    """Whether the file is outside only because a symbolic link leads there."""
    library: Library | None = None
    """The shipped files that could have been named instead of a path."""
    base: Path | None = None
    """The folder of the file that names it."""
    by: Path | None = None
    """The file that names this file."""

    @property
    def problem(self) -> str:
        """The predicate of the headline."""
        outside = (
            "leads outside the project through a symbolic link"
            if self.through_link
            else "lies outside the project"
        )
        return {"missing": "does not exist", "outside": outside, "irregular": "is not a regular file"}[
            self.reason
        ]

    @property
    def headline(self) -> str:
        return f"`{self.reference}` {self.problem}"

    @property
    def help(self) -> str:
        if self.reason == "irregular":
            return "write the path of a file"
        if elsewhere := self._elsewhere():
            return f"did you mean {elsewhere}? Paths are relative to the file that contains them"
        if self.shipped_name:
            return (
                f"write `{self.shipped_name}`: this {self.library.noun if self.library else 'file'} is"
                " shipped with deepbots"
            )
        if shipped.is_shipped_path(self.reference):
            return (
                "`deepbots new NAME --from SCENARIO` copies a shipped scenario with all its files; paths"
                " are relative to the file"
            )
        if self.reason == "outside":
            return self._help_outside()
        if near := self._similar_file():
            return f"did you mean {near}?"
        if self.nearest_name:
            hint = f"did you mean `{self.nearest_name}`, which is shipped with deepbots?"
            return hint if self.is_name else f"{hint} {self.path} does not exist"
        if self.library is shipped.SCENARIOS:
            return self._help_scenario()
        return f"paths are relative to the file that contains them; {self.path} does not exist"

    def _help_scenario(self) -> str:
        """Return what to write instead of a scenario that does not exist."""
        others = [file.name for file in _beside(self.path, (".yaml", ".yml")) if file != self.by][:_MAX_SHOWN]
        suggestion = (
            f" ({', '.join(others)})" if others else ", or the name of a shipped one, such as `cartpole`"
        )
        return (
            f"remove this line if the file has all sections itself, or write the path of a scenario that"
            f" exists{suggestion}; there is no {self.path}"
        )

    def _help_outside(self) -> str:
        project, folder = self.roots[0] if self.roots else None, display_path(self.path.parent)
        ways = [f"add `--allow-path {shell_word(folder)}` to the command"]
        if project is None or self.through_link or project.anchor != self.path.anchor:  # a drive of Windows
            return f"{ways[0]}, or copy the file into {project or 'the project'}"
        if not project.is_relative_to(self.path.parent):
            copied = os.path.relpath(project / self.path.parent.name / self.path.name, self.base)
            ways.append(f"copy {folder} into {display_path(project)} and write `{Path(copied).as_posix()}`")
        above = Path(os.path.commonpath((project, self.path)))
        # The nearest marker counts.
        if above not in (Path(above.anchor), Path.home()) and not _has_marker(project):
            ways.insert(
                0,
                f"create the empty file {display_path(above / _PROJECT_MARKERS[0])}, which makes one project of"
                " all that its folder contains",
            )
        return "; or ".join(ways)

    def _elsewhere(self) -> str | None:
        """Return the path of a file of the same name in the project, as this file would write it."""
        project = self.roots[0] if self.roots else None
        if self.is_name or project is None or self.base is None or not self.path.suffix:
            return None
        candidates = find_in(project, self.path.name)
        return (
            None
            if candidates is None or candidates == self.by
            else Path(os.path.relpath(candidates, self.base)).as_posix()
        )

    def _similar_file(self) -> str | None:
        """Return a file in the folder whose name is similar, of the kind of the library; None where a name of
        a shipped file is."""
        if self.is_name and self.nearest_name:
            return None
        suffixes = {self.path.suffix} if self.path.suffix else {".urdf", ".yaml"}
        suffixes -= {".yaml", ".yml"} if self.library is shipped.ROBOTS else set()
        by_stem = {file.stem: file.name for file in _beside(self.path, suffixes) if file != self.by}
        near = nearest_word(self.path.stem, by_stem)
        return by_stem[near] if near else None

    @property
    def meant(self) -> str | None:
        """What to write instead of the reference, if a file that exists was probably meant."""
        if self.reason == "irregular":
            return None
        if instead := self._elsewhere() or self.shipped_name:
            return instead
        if self.reason == "outside" or shipped.is_shipped_path(self.reference):
            return None
        if near := self._similar_file():
            folder, slash, _ = self.reference.rpartition("/")
            return f"{folder}{slash}{near}"
        return self.nearest_name

    def fix(self, span: Span) -> Fix | None:
        """Return the fix that writes what was meant over the reference at `span`."""
        return Fix.replacing(span, self.reference, self.meant, safe=False) if self.meant else None

    @property
    def shipped_name(self) -> str | None:
        """The shipped file of exactly this name, which needs no path."""
        return (
            self.path.stem
            if self.library and not self.is_name and self.path.stem in self.library.names()
            else None
        )

    @property
    def is_name(self) -> bool:
        return not self.path.suffix and "/" not in self.reference

    @property
    def nearest_name(self) -> str | None:
        """The shipped file that was probably meant."""
        return (
            nearest_word(self.path.stem, self.library.names())
            if self.library and self.reason == "missing"
            else None
        )

    @property
    def notes(self) -> tuple[str, ...]:
        """The shipped files, if a name was written and no path."""
        if self.library is None or not self.is_name:
            return ()
        names = self.library.names()
        more = f" and {len(names) - _MAX_LISTED} more" if len(names) > _MAX_LISTED else ""
        return (f"shipped {self.library.noun}s are {', '.join(names[:_MAX_LISTED])}{more}",)


def _beside(path: Path, suffixes: Container[str]) -> list[Path]:
    """Return the files beside `path` with one of the suffixes, in the order of their names."""
    try:
        return sorted(
            sibling for sibling in islice(path.parent.iterdir(), _MAX_ENTRIES) if sibling.suffix in suffixes
        )
    except OSError:
        return []


def find_in(folder: Path, name: str, depth: int = _MAX_DEPTH) -> Path | None:
    """Return the nearest file or folder called `name` in a folder or below it; hidden folders and the results
    of trainings are left out."""
    waiting, visited = [(folder, 0)], 0
    while waiting and visited < _MAX_FOLDERS:
        directory, level = waiting.pop(0)
        visited += 1
        try:
            if (directory / name).exists():
                return directory / name
            entries = sorted(islice(directory.iterdir(), _MAX_ENTRIES))
            if level < depth:
                below = (
                    entry
                    for entry in entries
                    if not entry.name.startswith(".") and entry.name not in _NOT_SEARCHED
                )
                # Symbolic links may form loops, or lead out of the project.
                waiting += [
                    (entry, level + 1) for entry in below if entry.is_dir() and not entry.is_symlink()
                ]
        except OSError:
            continue
    return None


def resolve_reference(
    reference: str,
    base: Path,
    roots: Iterable[Path],
    library: Library | None = None,
    *,
    by: Path | None = None,
) -> Path | UnusableFile:
    """Return the file for `reference`, written in the file `by` of the folder `base`: a path, or else the
    name of a file of the `library`.

    Symbolic links are followed before the path is compared with the `roots`, whose links are already
    followed.
    """
    path = _file_at(reference, base, tuple(roots))
    if isinstance(path, Path):
        return path
    library_path = library.path(reference) if library else None
    return (
        library_path.resolve() if library_path else replace(path, library=library, base=base.resolve(), by=by)
    )


def _file_at(reference: str, base: Path, roots: tuple[Path, ...]) -> Path | UnusableFile:
    # `resolve` raises ValueError for a null character.
    path = base / reference.replace("\0", "\ufffd")
    try:
        unresolved, path = Path(os.path.normpath(base.resolve() / path)), path.resolve()
        # The answer for a path outside is the same whether or not there is a file.
        if not any(path.is_relative_to(root) for root in roots):
            through_link = any(unresolved.is_relative_to(root) for root in roots)
            return UnusableFile("outside", reference, path, roots, through_link)
        if is_file(path):
            return path
        return UnusableFile("irregular" if path.exists() else "missing", reference, path, roots)
    except (OSError, RuntimeError):
        # The name is too long, links form a loop, or a folder may not be entered.
        return UnusableFile("missing", reference, path, roots)


def project_root(folder: Path) -> Path:
    """Return the nearest folder at or above `folder` that looks like the root of a project, else `folder`
    itself."""
    folder = folder.resolve()
    for candidate in (folder, *folder.parents):
        if _has_marker(candidate):
            return candidate
    return folder


def _has_marker(folder: Path) -> bool:
    return any((folder / marker).exists() for marker in _PROJECT_MARKERS)


def display_path(path: Path) -> str:
    """Return the path as users see it: relative to the working directory if it lies below it."""
    working_directory = Path.cwd()
    return os.path.relpath(path, working_directory) if path.is_relative_to(working_directory) else str(path)


# Text


def read(path: Path) -> bytes:
    """Return the bytes of a file, at most one more than `MAX_BYTES`.

    Raises:
        OSError: The file cannot be read.
    """
    return read_at_most(path, MAX_BYTES + 1)


def decode(
    data: bytes, name: str, findings: Findings, included_from: Span | None = None
) -> tuple[Source, bool]:
    """Return the text of `data`, and whether it can be parsed; a finding gives the reason if not."""
    if len(data) > MAX_BYTES or data.startswith((b"\xff\xfe", b"\xfe\xff")):
        source = Source(name, "", included_from)
        if len(data) > MAX_BYTES:
            findings.add(
                "DB005",
                Span(source, 0, 0),
                f"the file is larger than {MAX_BYTES >> 20} MiB",
                "split it with `include`, or check that it is a scenario",
            )
        else:
            findings.add("DB001", Span(source, 0, 0), "the file is in UTF-16", "save it as UTF-8")
        return source, False
    data = data.removeprefix(b"\xef\xbb\xbf")
    source = Source(name, data.decode("utf-8", "replace"), included_from)
    try:
        data.decode("utf-8")
    except UnicodeDecodeError as error:
        if "\0" not in source.text:
            # `error.start` is in bytes, a span in characters.
            at = len(data[: error.start].decode("utf-8"))
            findings.add("DB001", Span(source, at, at + 1), "the file is not UTF-8 text", "save it as UTF-8")
            return source, False
    return source, check_characters(source, findings)


def check_characters(source: Source, findings: Findings) -> bool:
    """Return whether a scenario may contain every character of the text; a finding names the first forbidden
    one."""
    match = FORBIDDEN_CHARACTERS.search(source.text)
    if match is None:
        return True
    character = match.group()
    number = f"U+{ord(character):04X}"
    if character == "\0":
        headline, help = "the file is binary", "a scenario is a YAML text file"
    elif character in "\r\x85\u2028\u2029":
        headline = f"a line ends in an unusual character ({number})"
        help = "save the file with Unix line endings (LF)"
    else:
        headline = f"the character {number} is not allowed in YAML"
        help = 'remove it, or write it as an escape in double quotes, such as "\\x1b"'
    findings.add("DB001", Span(source, *match.span()), headline, help)
    return False
