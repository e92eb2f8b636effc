"""Files that a scenario may name from where it stands: those of its project, and shipped robots by their names."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from lsprotocol.types import CompletionItemKind

from deepbots_cli.document import shipped
from deepbots_cli.document.files import project_root, resolve
from deepbots_cli.lsp.desk import View
from deepbots_cli.lsp.expressing import Choice
from deepbots_cli.robots import meshes

_MOST = 300


def files(view: View, suffixes: tuple[str, ...], *, robots: bool = False) -> Iterator[Choice]:
    """What may follow the path that is begun at the place, in the folder that it has come to."""
    folder, slash, _ = view.place.text.rpartition("/")
    if robots and not slash:
        yield from (Choice(name, CompletionItemKind.Module, "a robot that comes with deepbots") for name in shipped.robot_names())
    for path in _listed(view, f"{folder}{slash}"):
        name = f"{folder}{slash}{path.name}"
        if path.suffix in suffixes and path != view.document.path:
            yield Choice(name, CompletionItemKind.File, "a file")
        elif path.is_dir() and not path.name.startswith("."):
            yield Choice(f"{name}/", CompletionItemKind.Folder, "a folder")


def located(view: View, reference: str, *, robots: bool = False) -> Path | None:
    """The file that a reference in the document stands for; None where there is none, or it may not be read."""
    if reference.startswith("package://"):
        return meshes.in_package(reference)
    found = resolve(reference, view.document.path.parent, _roots(view))
    if isinstance(found, Path):
        return found
    return shipped.robot_path(reference) if robots else None


def _listed(view: View, folder: str) -> list[Path]:
    """What lies in a folder, if a scenario may read there."""
    try:
        path = (view.document.path.parent / folder.replace("\0", "")).resolve()
        if any(path.is_relative_to(root) for root in _roots(view)):
            return sorted(path.iterdir())[:_MOST]
    except (OSError, RuntimeError, ValueError):
        pass
    return []


def _roots(view: View) -> tuple[Path, ...]:
    if view.analysis is not None and view.analysis.checked is not None:
        return view.analysis.checked.document.roots
    return (project_root(view.document.path.parent),)
