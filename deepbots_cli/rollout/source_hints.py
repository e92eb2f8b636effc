"""The ends of messages about a path that is not a scenario: what was probably meant, or what exists."""

from __future__ import annotations

import os
import re
from collections.abc import Callable
from itertools import islice
from pathlib import Path

from deepbots_cli.diagnostics.nearest import is_typo, nearest_word
from deepbots_cli.document import files, shipped

_MAX_ABOVE = 4
_MAX_LISTED = 8
_MAX_RUNS = 500
"""The largest number of folders that are searched for runs."""


def scenario_name_for(path: Path) -> str:
    """Return the name of a new scenario for a robot file."""
    return re.sub(r"[^A-Za-z0-9_-]+", "_", path.stem) or "mine"


def missing_path_hint(path: Path, folder_kind: Callable[[Path], object]) -> str:
    """Return the end of the message for a path that does not exist: what was probably meant, or what exists.

    `folder_kind` returns None for a folder that is not a run, a group or a study.
    """
    inside = Path("runs") / path
    beside = [path.with_name(path.name + ending) for ending in (".yaml", ".yml")]
    candidate = next((str(file) for file in (*beside, inside) if file.exists()), None)
    if candidate is not None:
        return f"did you mean {candidate}?"
    folder = Path.cwd()
    if elsewhere := _elsewhere(path, folder):
        return f"did you mean {elsewhere}? The current folder is {folder}"
    names = shipped.scenario_names()
    if path.stem in names and len(path.parts) == 1:  # for example, `cartpole.yaml`
        return (
            f"the shipped scenario is called `{path.stem}`; `deepbots new {path.stem} --from {path.stem}`"
            f" copies it to {path.stem}.yaml"
        )
    if _is_path_of_run(path):
        return f"the current folder is {folder}; {_runs_there(folder, folder_kind)}"
    candidate = nearest_word(path.stem, names)
    is_shipped = candidate is not None and is_typo(path.stem, candidate) and len(path.parts) == 1
    if path.suffix in (".yaml", ".yml") and not is_shipped:
        return f"the current folder is {folder}{_scenario_files(folder, path)}"
    return (
        f"did you mean {candidate}? (`deepbots scenarios` shows all)"
        if candidate
        else f"the shipped scenarios are: {', '.join(names)}"
    )


def _runs_there(parent: Path, folder_kind: Callable[[Path], object]) -> str:
    """Return the runs in the folder `runs` of a folder, the newest first."""
    try:
        folders = [
            Path(entry.path) for entry in islice(os.scandir(parent / "runs"), _MAX_RUNS) if entry.is_dir()
        ]
        newest = sorted(
            (folder for folder in folders if folder_kind(folder)), key=os.path.getmtime, reverse=True
        )
    except OSError:
        newest = []
    if not newest:
        return "it has no runs: train one with `deepbots train SCENARIO`"
    more = ", and `deepbots runs` lists all" if len(newest) > _MAX_LISTED else ""
    return (
        "its runs, the newest first, are"
        f" {', '.join(str(run.relative_to(parent)) for run in newest[:_MAX_LISTED])}{more}"
    )


def _is_path_of_run(path: Path) -> bool:
    return (
        path.parts[:1] == ("runs",)
        or re.search(r"-\d+-\d+$|-seeds-\d+$|-tune-\d+$", path.name) is not None
        or path.suffix == ".zip"
    )


def _elsewhere(path: Path, folder: Path) -> str | None:
    """Return the path of the named file in a folder above, or below this one."""
    if path.is_absolute() or not (path.suffix or _is_path_of_run(path)):
        return None
    with_runs = Path("runs") / path
    for above in (*folder.parents,)[:_MAX_ABOVE]:
        for name in (path, with_runs):
            if (above / name).exists():
                return os.path.relpath(above / name, folder)
    # A path such as `hw/mine.yaml` in the folder hw.
    inside = path.relative_to(folder.name) if path.parts[0] == folder.name and len(path.parts) > 1 else None
    if inside is not None and inside.exists():
        return str(inside)
    match = None if _is_path_of_run(path) else files.find_in(folder, path.name, depth=1)
    return os.path.relpath(match, folder) if match else None


def _scenario_files(folder: Path, path: Path) -> str:
    """Return the scenario files of a folder, the nearest in name first."""
    names = sorted(file.name for file in folder.glob("*.y*ml") if file.suffix in (".yaml", ".yml"))
    by_stem = {Path(name).stem: name for name in names}
    suggestion = nearest_word(path.stem, by_stem)
    if suggestion:
        return f"; did you mean {by_stem[suggestion]}?"
    return (
        f", whose .yaml files are {', '.join(names[:_MAX_LISTED])}" if names else ", which has no .yaml file"
    )
