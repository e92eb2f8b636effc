"""The file that a name in a robot file means: a path, `file://`, `package://` or `model://`.

`package://X/rest` is looked for in these places, and the first place where the file exists counts:

1. the installed Python package X, found without importing it
2. the folder of the robot file and those above it, nearest first, that are called X or whose `package.xml`
   names X
3. the folders called X beside them, nearest first, then the packages X up to `_MAX_DEPTH` levels below
4. the entries of ROS_PACKAGE_PATH and AMENT_PREFIX_PATH
5. the folder of the robot file and those above it, whatever they are called

Where none has it, and for an absolute path of another computer, the end of the path counts, from its folder
on: `/ws/src/pkg/meshes/arm.stl` is `pkg/meshes/arm.stl` or `meshes/arm.stl` in one of the folders of 5.

Only the folder of the robot file, the folders that the user allows, and an installed package are looked into.
This module needs no numpy, since lint imports it.
"""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Iterable, Iterator, Sequence
from itertools import islice, product
from pathlib import Path, PurePosixPath, PureWindowsPath
from urllib.parse import unquote

from deepbots_cli.files import is_file, read_at_most
from deepbots_cli.records import dataclass
from deepbots_cli.words import shell_word

_MAX_MANIFEST_BYTES = 1 << 16  # of package.xml; the name is at its beginning
_MAX_DEPTH, _MAX_LISTED, _MAX_FOLDERS, _MAX_ENTRIES = 3, 300, 2000, 500  # of a search of folders
_MAX_PARENTS = 32
_MAX_END = 8
"""The number of parts of the end of a path that is looked for."""
_COMMENT = rb"(?s)<!--.*?-->"
_PACKAGE_NAME = rb"<name>\s*([^<>\s]{1,200})\s*</name>"
_NOT_SEARCHED = frozenset({"runs", "node_modules", "__pycache__", "venv", "build", "dist"})


@dataclass(frozen=True)
class UnusableMesh:
    """The reason why a file is not read, as a headline and the sentence that helps.

    `tried` has the places where the file was looked for; `allow` is a folder that has it and that the user
    has to allow first. `lacks_package` says that no folder is the package of the file, `is_missing` that the
    file is nowhere.
    """

    headline: str
    help: str | None = None
    tried: tuple[str, ...] = ()
    allow: Path | None = None
    lacks_package: bool = False
    is_missing: bool = False


@dataclass(frozen=True)
class MeshElsewhere:
    """A mesh that is not where the robot file says: `reference` is its path from the folder of the robot."""

    path: Path
    reference: str


Located = Path | MeshElsewhere | UnusableMesh
ResolveMesh = Callable[[str], Located]
"""A function from a `filename` as written in the robot file to the real path, if it may be read."""


def mesh_resolver(folder: Path, allowed: Iterable[Path] = ()) -> ResolveMesh:
    """Return a resolver that allows the folder of the robot file, the `allowed` ones, all below them, and the
    installed package that a `package://` names."""
    return Places(folder, allowed).resolve


class Places:
    """The places where the files of one robot may lie. Folders that were searched are kept.

    With `suggests`, a refusal names a folder outside that has the file. Only for a robot file that the user
    names: files of others must not find out what exists outside.
    """

    def __init__(self, folder: Path, allowed: Iterable[Path] = (), *, suggests: bool = False) -> None:
        self._folder = Path(os.path.normpath(folder.absolute()))  # `..` is no folder above
        # The folder of the robot file and those above it, nearest first, also those that are not allowed.
        self._above = [self._folder, *islice(self._folder.parents, _MAX_PARENTS)]
        self._roots = [os.path.realpath(root) for root in (folder, *allowed)]
        self._suggests = suggests
        self.suggested: dict[Path, None] = {}
        """The folders that the user has to allow for files that were refused, in the order of the files."""
        self._names: dict[Path, str | None] = {}
        self._below: list[Path] | None = None
        self._packages: dict[str, list[Path]] = {}

    def resolve(self, reference: str) -> Located:
        """Return the real path of an allowed file, which need not exist where `reference` is a path.

        Raises:
            OSError: A name is too long, or a folder cannot be read.
        """
        scheme, colon, written = reference.partition("://")
        path = unquote(written).replace("\0", "\ufffd")  # no name of a file has a NUL
        if colon and scheme in ("package", "model"):
            return self._in_package(reference, path)
        if colon and scheme != "file":
            return UnusableMesh(
                f"deepbots cannot download a mesh from {scheme[:20]!r}",
                "save the file next to the robot file, and write its path",
            )
        return self._at_path(path if colon else reference, is_plain=not colon)

    def _allows(self, path: Path | str) -> bool:
        return any(Path(path).is_relative_to(root) for root in self._roots)

    def _at_path(self, written: str, *, is_plain: bool) -> Located:
        """Return the file of a path. A plain one may be relative to a folder above, where PyBullet's
        `findExistingMeshFile` looks in the same order."""
        real = Path(os.path.realpath(self._folder / written))
        is_allowed = self._allows(real)
        if is_allowed and real.exists():
            return real
        if is_plain and not Path(written).is_absolute():
            for above in self._folder.parents:
                if (path := self._file(above / written)) is not None:
                    return self._elsewhere(path)
        windows = PureWindowsPath(written)  # knows `/` and the paths of Windows
        if windows.anchor and (path := self._with_end(windows.parts[1:])) is not None:
            return self._elsewhere(path)
        if is_allowed:
            help = self._namesake(written) or f"check the path: deepbots looked for {real}"
            return UnusableMesh("the mesh does not exist", help, is_missing=True)
        allow = self._suggested([written])
        return UnusableMesh("the mesh lies outside the folder of the robot", _outside_help(allow), (), allow)

    def _file(self, place: Path) -> Path | None:
        """Return the real path of a file that may be read; a link may point out of the allowed folders."""
        real = Path(os.path.realpath(place))
        return real if self._allows(real) and is_file(real) else None

    def _elsewhere(self, path: Path) -> MeshElsewhere:
        folder = os.path.realpath(self._folder)
        return MeshElsewhere(path, os.path.relpath(path, folder).replace(os.sep, "/"))

    def _with_end(self, parts: Sequence[str]) -> Path | None:
        """Return the allowed file with the longest end of a path, of a folder and a name at least."""
        for start in range(max(0, len(parts) - _MAX_END), len(parts) - 1):
            for above in self._above:
                if (path := self._file(above.joinpath(*parts[start:]))) is not None:
                    return path
        return None

    # package://

    def _in_package(self, reference: str, path: str) -> Located:
        package, _, inside = path.partition("/")
        inside = inside.lstrip("/")
        if not inside:  # the name of a package is left out
            package, inside = "", package
        home = package_folder(package)
        if home is not None:
            real = Path(os.path.realpath(home / inside))
            if real.is_relative_to(os.path.realpath(home)) and real.exists():
                return real
        tried = [] if home is None else [home / inside]
        for place in self._candidates(package, inside):
            if (file := self._file(place)) is not None:
                return file
            tried.append(place)
        if (file := self._with_end(PurePosixPath(inside).parts)) is not None:
            return self._elsewhere(file)
        allow = self._suggested([f"{package}/{inside}", inside])
        shown = tuple(dict.fromkeys(str(place) for place in tried if self._allows(os.path.realpath(place))))
        if allow is not None or not shown or ".." in PurePosixPath(path).parts:
            help = _outside_help(allow)
            return UnusableMesh("the mesh lies outside the folder of the robot", help, shown, allow)
        help = f"deepbots looked for {inside[-120:]}"
        is_near = any(folder.is_dir() for folder in self._packages.get(package, ()))
        lacks_package = bool(package) and home is None and not is_near
        if lacks_package:
            help += f", and for a package called {package[:60]}"
        help += "; put the file into one of these places, or allow a folder that has it with --allow-path"
        help = self._namesake(inside) or help
        return UnusableMesh("the mesh does not exist", help, shown, None, lacks_package, is_missing=True)

    def _namesake(self, written: str) -> str | None:
        """Return the help that names a file of the same name in a folder nearby."""
        name = PureWindowsPath(written).name
        near = (self._file(folder / name) for folder in self._searched())
        path = next((path for path in near if path is not None), None)
        if path is None:
            return None
        reference = os.path.relpath(path, os.path.realpath(self._folder)).replace(os.sep, "/")
        return f'a file of this name is near: write filename="{reference}" if it is the one'

    def _candidates(self, package: str, inside: str) -> Iterator[Path]:
        """Yield the places for a file of a package, in the order of the docstring of this module."""
        if package:
            yield from (folder / inside for folder in self._named(package))
        yield from (above / inside for above in self._above)

    def _named(self, package: str) -> Iterator[Path]:
        """Yield the folders of packages of this name; far ones are searched only if needed."""
        near = [folder for folder in self._above if self._is_named(folder, package)]
        yield from near
        yield from (above / package for above in self._above)  # also links and others that are not searched
        if package not in self._packages:
            far = [folder for folder in self._searched() if self._is_named(folder, package)]
            self._packages[package] = [*near, *far, *self._in_environment(package)]
        yield from self._packages[package][len(near) :]

    def _is_named(self, folder: Path, package: str) -> bool:
        return folder.name == package or self._name(folder) == package

    def _name(self, folder: Path) -> str | None:
        """Return the name in the `package.xml` of a folder; None without one that may be read."""
        if folder not in self._names:
            self._names[folder] = self._read_name(folder / "package.xml")
        return self._names[folder]

    def _read_name(self, manifest: Path) -> str | None:
        real = Path(os.path.realpath(manifest))
        if not self._allows(real) or not is_file(real):
            return None
        try:
            text = re.sub(_COMMENT, b"", read_at_most(real, _MAX_MANIFEST_BYTES))
        except OSError:
            return None
        match = re.search(_PACKAGE_NAME, text)
        return match[1].decode("utf-8", "replace") if match else None

    def _searched(self) -> list[Path]:
        """Return the allowed folders below those above the robot file: first those beside them, nearest
        first, then deeper ones. Links are not followed."""
        if self._below is not None:
            return self._below
        level = [folder for folder in self._above if self._allows(os.path.realpath(folder))]
        below = dict.fromkeys(level)
        listed = 0
        for _ in range(_MAX_DEPTH):
            children = dict[Path, None]()
            for folder in level[: _MAX_LISTED - listed]:
                children |= dict.fromkeys(child for child in self._children(folder) if child not in below)
            listed += len(level)
            below |= children
            if listed >= _MAX_LISTED or len(below) >= _MAX_FOLDERS:
                break
            level = list(children)
        self._below = list(below)[:_MAX_FOLDERS]
        return self._below

    def _children(self, folder: Path) -> list[Path]:
        try:
            with os.scandir(folder) as entries:
                names = [
                    entry.name
                    for entry in islice(entries, _MAX_ENTRIES)
                    if entry.is_dir(follow_symlinks=False) and not entry.name.startswith(".")
                ]
        except OSError:
            return []
        return [folder / name for name in sorted(names) if name not in _NOT_SEARCHED]

    def _in_environment(self, package: str) -> Iterator[Path]:
        entries = [
            (Path(entry), middle)
            for variable, middle in (("ROS_PACKAGE_PATH", ""), ("AMENT_PREFIX_PATH", "share"))
            for entry in os.environ.get(variable, "").split(os.pathsep)
            if entry
        ]
        for entry, middle in entries:
            if not middle and self._is_named(entry, package):
                yield entry
            yield entry / middle / package

    def _suggested(self, endings: Sequence[str]) -> Path | None:
        """Return the nearest folder, at or above that of the robot file, from which a file would be read if
        the folder were allowed; None where it is not to be looked for."""
        if not self._suggests:
            return None
        for above, ending in product(self._above, endings):
            path = os.path.realpath(above / ending)
            if os.path.isfile(path) and not self._allows(path):
                common = Path(os.path.commonpath((path, os.path.realpath(above))))
                if common != Path(common.anchor):
                    allow = _clone(common) or common
                    self.suggested[allow] = None
                    return allow
        return None


def _clone(folder: Path) -> Path | None:
    """Return the root of the Git repository of a folder, since its other packages are there; None where there
    is none, or the user works in it."""
    root = next((place for place in (folder, *folder.parents) if (place / ".git").exists()), None)
    return None if root is None or Path.cwd().is_relative_to(root) else root


def _outside_help(allow: Path | None) -> str:
    if allow is not None:
        return f"add `--allow-path {shell_word(allow)}` to the command"
    return "move it into the folder of the robot file, or allow its folder with --allow-path"


# Installed packages


def package_folder(name: str) -> Path | None:
    """Return the folder of an installed package, without importing it; None for namespace packages and
    modules."""
    from importlib.util import find_spec

    # `find_spec` imports the parents of a dotted name, and a robot file must run no code.
    if not name.isidentifier():
        return None
    try:
        spec = find_spec(name)
    except (ImportError, ValueError):  # ValueError: already imported, and without a spec, as `__main__` is
        return None
    if spec is None or spec.origin is None or not spec.submodule_search_locations:
        return None
    return Path(spec.submodule_search_locations[0])


def package_folders(reference: str) -> tuple[Path, ...]:
    """Return the folder of the installed package that `package://X/rest` names; none for a path, or if it is
    not installed."""
    if not reference.startswith("package://"):
        return ()
    home = package_folder(reference.removeprefix("package://").partition("/")[0])
    return (home,) if home else ()


def locate_file(reference: str, folder: Path, allowed: Iterable[Path]) -> Path | None:
    """Return the file that `package://X/rest` means in a file of `folder`; None if no allowed folder has
    it."""
    try:
        located = Places(folder, allowed).resolve(reference)
    except (OSError, ValueError):  # a name that is too long, or holds a NUL
        return None
    if isinstance(located, MeshElsewhere):
        return located.path
    return located if isinstance(located, Path) and located.is_file() else None


def package_file(reference: str) -> Path | None:
    """Return the file of an installed package that `package://X/rest` names; None if there is none, or it is
    outside of X."""
    package, _, inside = reference.removeprefix("package://").partition("/")
    home = package_folder(package)
    if home is None:
        return None
    try:
        path = Path(os.path.realpath(home / inside))
        return path if path.is_relative_to(os.path.realpath(home)) and path.is_file() else None
    except (OSError, ValueError):  # a name that is too long, or holds a NUL
        return None


def library_reference(reference: str) -> str | None:
    """Return the `package://` name of a file of pybullet_data whose path there is `reference`; None if the
    package is not installed, or has no such file."""
    inside = reference.removeprefix("pybullet_data/")
    names = (f"package://pybullet_data/{inside}{suffix}" for suffix in ("", ".urdf"))
    return None if "://" in reference else next((name for name in names if package_file(name)), None)
