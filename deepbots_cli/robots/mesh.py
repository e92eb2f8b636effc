"""Mesh files: where they are, whether they may be read, what they hold.

Reading them here, before any engine does, is what keeps a mesh from crashing one.
"""

from __future__ import annotations

import hashlib
import os
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import NamedTuple

from deepbots_cli.reading import read_at_most
from deepbots_cli.robots.mesh_format import Measure, fault, measure
from deepbots_cli.robots.model import Mesh, Vector

MAX_BYTES = 32 * 2**20
MAX_TOTAL_BYTES = 256 * 2**20
FORMATS = (".stl", ".obj", ".dae")
_ARCHIVES = (b"PK\x03\x04", b"PK\x05\x06", b"\x1f\x8b", b"BZh", b"\xfd7zXZ\0", b"7z\xbc\xaf", b"Rar!", b"\x28\xb5\x2f\xfd")


@dataclass(frozen=True)
class Refusal:
    """Why a file is not read, as a headline and a remedy."""

    why: str
    help: str | None = None


@dataclass(frozen=True)
class Above:
    """A mesh that lies in a folder above the robot file only, where PyBullet looks too; `reference` names it from the robot's folder."""

    path: Path
    reference: str


class Loaded(NamedTuple):
    """A mesh that may be given to an engine; `reference` is set if the robot file had better name it so."""

    path: Path
    digest: str
    reference: str | None = None


ResolveMesh = Callable[[str], Path | Above | Refusal]
"""From a `filename` as written in the robot file to the real path, where it may be read."""


def locate(reference: str, folder: Path) -> Path | Refusal:
    """The real path that `reference` names in a robot file of `folder`, whether it exists or not.

    `package://X/rest` is looked up in the installed package X (found without importing it), then in a
    folder above called X, then as X/rest beside the robot file, which is what some published robots mean.
    """
    scheme, colon, rest = reference.partition("://")
    if not colon:
        return Path(os.path.realpath(folder / reference))
    if scheme == "file":
        return Path(os.path.realpath(folder / rest))
    if scheme != "package":
        return Refusal(f"a mesh cannot be fetched from {scheme[:20]!r}", "store the file beside the robot and name its path")
    package, _, inside = rest.partition("/")
    home = package_folder(package) or next((above for above in folder.absolute().parents if above.name == package), None)
    return Path(os.path.realpath(home / inside if home else folder / rest))


def package_folder(name: str) -> Path | None:
    """The folder of an installed package, without importing it; None for namespace packages and modules."""
    from importlib.util import find_spec

    if not name.isidentifier():
        return None
    try:
        spec = find_spec(name)
    except (ImportError, ValueError):  # ValueError: already imported, and without a spec, as `__main__` is
        return None
    if spec is None or spec.origin is None or not spec.submodule_search_locations:
        return None
    return Path(spec.submodule_search_locations[0])


def package_of(reference: str) -> tuple[Path, ...]:
    """The folder of the package that `package://X/rest` names; none for a path, or if it is not installed."""
    home = package_folder(reference.removeprefix("package://").partition("/")[0]) if reference.startswith("package://") else None
    return (home,) if home else ()


def in_package(reference: str) -> Path | None:
    """The file of an installed package that `package://X/rest` names; None where there is none, or it lies outside of X."""
    package, _, inside = reference.removeprefix("package://").partition("/")
    home = package_folder(package)
    if home is None:
        return None
    try:
        found = Path(os.path.realpath(home / inside))
        return found if found.is_relative_to(os.path.realpath(home)) and found.is_file() else None
    except (OSError, ValueError):  # a name that is too long, or holds a NUL
        return None


def library_reference(reference: str) -> str | None:
    """How to name a file of pybullet_data that `reference` calls by its path there; None unless it is installed and holds one."""
    inside = reference.removeprefix("pybullet_data/")
    names = (f"package://pybullet_data/{inside}{suffix}" for suffix in ("", ".urdf"))
    return None if "://" in reference else next((name for name in names if in_package(name)), None)


def beside(folder: Path, allowed: Iterable[Path] = ()) -> ResolveMesh:
    """Allows the folder of the robot file, the `allowed` ones, all below them, and the installed package that a `package://` names."""
    roots = [os.path.realpath(root) for root in (folder, *allowed)]

    def resolve(reference: str) -> Path | Above | Refusal:
        path = locate(reference, folder)
        if isinstance(path, Refusal):
            return path
        within = [*roots, *map(os.path.realpath, package_of(reference))]
        if not any(path.is_relative_to(root) for root in within):
            return Refusal("the mesh lies outside the folder of the robot", "move it beside the robot file")
        return path if "://" in reference or path.exists() else _above(reference, folder, roots) or path

    return resolve


def _above(reference: str, folder: Path, roots: list[str]) -> Above | None:
    """The nearest file of that name seen from a folder above; PyBullet's `findExistingMeshFile` looks there in the same order."""
    for above in folder.absolute().parents:
        path = Path(os.path.realpath(above / reference))
        if any(path.is_relative_to(root) for root in roots) and path.is_file():
            return Above(path, os.path.relpath(above / reference, folder).replace(os.sep, "/"))
    return None


def extent(mesh: Mesh) -> tuple[Vector, Vector] | None:
    """The least and the greatest coordinates of a scaled mesh, m; None where the file does not say or has gone."""
    found = _measured(mesh.path, mesh.digest)
    if found is None:
        return None
    ends = [sorted((low * factor, high * factor)) for low, high, factor in zip(found.lower, found.upper, mesh.scale, strict=True)]
    (x, x_end), (y, y_end), (z, z_end) = ends
    return (x, y, z), (x_end, y_end, z_end)


@lru_cache(maxsize=1000)
def _measured(path: str, digest: str) -> Measure | None:
    file = Path(path)
    try:
        if not file.is_file() or file.stat().st_size > MAX_BYTES:
            return None
        data = file.read_bytes()
    except (OSError, ValueError):
        return None
    suffix = file.suffix.lower()
    if hashlib.sha256(data).hexdigest() != digest or fault(suffix, data) is not None:
        return None
    return measure(suffix, data)


class Meshes:
    """Reads each mesh of one robot once: path and sha256 digest, or a refusal."""

    def __init__(self, resolve: ResolveMesh) -> None:
        self._resolve = resolve
        self._known: dict[Path, str | Refusal] = {}
        self._total = 0

    def load(self, reference: str) -> Loaded | Refusal:
        try:
            found = self._resolve(reference)
            if isinstance(found, Refusal):
                return found
            path = found.path if isinstance(found, Above) else found
            if path not in self._known:
                self._known[path] = self._digest(path)
        except OSError as error:
            return Refusal(f"the mesh cannot be read: {error.strerror}")
        digest = self._known[path]
        return digest if isinstance(digest, Refusal) else Loaded(path, digest, found.reference if isinstance(found, Above) else None)

    def _digest(self, path: Path) -> str | Refusal:
        if not str(path).isprintable():
            return Refusal("the path of the mesh holds characters that cannot be printed", "rename the file or its folder")
        if path.suffix.lower() not in FORMATS:
            return Refusal(f"the mesh format {path.suffix[:20]!r} is not read", f"convert it to one of: {', '.join(FORMATS)}")
        if not path.exists():
            return Refusal("the mesh does not exist", f"looked for {path}")
        if not path.is_file():
            return Refusal("the mesh is not a regular file")
        data = read_at_most(path, MAX_BYTES + 1)
        if len(data) > MAX_BYTES:
            return Refusal(f"the mesh is larger than {MAX_BYTES >> 20} MiB", "simplify it")
        self._total += len(data)
        if self._total > MAX_TOTAL_BYTES:
            return Refusal(f"the meshes of this robot are larger than {MAX_TOTAL_BYTES >> 20} MiB together", "simplify them")
        if data.startswith(_ARCHIVES):
            return Refusal("the mesh is an archive", "unpack it")
        wrong = fault(path.suffix.lower(), data)
        return Refusal(wrong) if wrong else hashlib.sha256(data).hexdigest()
