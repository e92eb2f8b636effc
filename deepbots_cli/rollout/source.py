"""The one place that resolves a name, path or object to a scenario: `Source.open`; and hints about a path
that is not one.

    cartpole, cartpole.yaml, a `Scenario`    a scenario
    runs/cartpole-0-1                        a run: a folder with run.json
    runs/cartpole-seeds-1                    a group of runs: a folder with group.json
    runs/cartpole-tune-1                     a study of `deepbots tune`, with a group for each trial: a folder
                                             with study.json
    runs/cartpole-0-1/models/agent/best.zip  a checkpoint: a model in the folder of a run
    cartpole-0-0.mcap                        a recording

A run, a group, a study and an open recording keep their scenario as `resolved.yaml` in a folder with all
files that it reads.
"""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import replace
from enum import Enum
from itertools import islice
from pathlib import Path

from deepbots_cli.compiler import CheckedScenario, check
from deepbots_cli.compiler.inputs import RESOLVED_NAME
from deepbots_cli.diagnostics.nearest import is_typo, nearest_word
from deepbots_cli.document import Document, Permissions, files, load, loads, shipped
from deepbots_cli.document.load import NO_DRAFTS, TESTS, TUNE, Drafts
from deepbots_cli.errors import RunError, UsageError
from deepbots_cli.records import dataclass
from deepbots_cli.scenario import Scenario
from deepbots_cli.words import shell_word

_MAX_ABOVE = 4
_MAX_LISTED = 8
_MAX_RUNS = 500
"""The largest number of folders that are searched for runs."""


def scenario_name_for(path: Path) -> str:
    """Return the name of a new scenario for a robot file; it begins with a letter."""
    return re.sub(r"[^A-Za-z0-9_-]+", "_", path.stem).lstrip("0123456789_-")[:64] or "mine"


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
    """Return the runs in the folder `runs` of a folder, or in the folder itself, the newest first."""
    newest: list[Path] = []
    for holder in (parent / "runs", parent):
        with suppress(OSError):
            folders = [Path(entry.path) for entry in islice(os.scandir(holder), _MAX_RUNS) if entry.is_dir()]
            newest = newest or sorted(filter(folder_kind, folders), key=os.path.getmtime, reverse=True)
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


RECORD_NAME = "run.json"
GROUP_RECORD_NAME = "group.json"
STUDY_RECORD_NAME = "study.json"
MODELS_FOLDER = "models"
RECORDING_SUFFIX = ".mcap"


class SourceKind(Enum):
    """The kind of a source; the value is its name in messages."""

    SCENARIO = "a scenario"
    RUN = "a run"
    GROUP = "a group of runs"
    STUDY = "a study of `deepbots tune`"
    CHECKPOINT = "a model of a run"
    RECORDING = "a recording"


@dataclass(frozen=True, eq=False)
class Source:
    """A scenario, run, group, study, checkpoint or recording, identified but not yet read.

    Attributes:
        kind: The kind of source.
        name: The name for messages.
        path: The file, or the folder of a run or a group; that of its run for a checkpoint.
        scenario: The file of its scenario, or the scenario itself; None for a recording, whose scenario is in
            it.
        permissions: The permissions of its scenario.
        project: The folder that its scenario may read from; None for the nearest one above it that looks like
            a project.
        model: The name of the model, of a checkpoint.
    """

    kind: SourceKind
    name: str
    path: Path
    scenario: Path | Scenario | None
    permissions: Permissions = Permissions()
    project: Path | None = None
    model: str | None = None

    @classmethod
    def open(
        cls,
        source: str | Path | Scenario | Source,
        permissions: Permissions = Permissions(),
        *kinds: SourceKind,
    ) -> Source:
        """Resolve `source`, which must be one of `kinds` if any are given. `permissions` are those of a
        scenario that is named.

        Raises:
            UsageError: `source` is none of these. It is a RunError if `kinds` has no scenario.
        """
        error = UsageError if not kinds or SourceKind.SCENARIO in kinds else RunError
        if isinstance(source, Scenario):
            opened = cls(SourceKind.SCENARIO, f"<Scenario {source.name}>", Path(), source, permissions)
        elif isinstance(source, Source):
            opened = source
        else:
            opened = cls._named(Path(source), str(source), permissions, error)
        if kinds and opened.kind not in kinds:
            *first_kinds, final = (kind.value for kind in kinds)
            expected = f"{', '.join(first_kinds)} or {final}" if first_kinds else final
            description = (
                "a file"
                if opened.kind is SourceKind.SCENARIO
                and isinstance(opened.scenario, Path)
                and opened.path.suffix not in (".yaml", ".yml")
                else opened.kind.value
            )
            hint = ""
            if opened.kind in (SourceKind.STUDY, SourceKind.GROUP):
                inner = _first_inside(opened.path, kinds)
                noun = "trials" if SourceKind.GROUP in kinds else "runs"
                resume = f"; `deepbots resume {shell_word(opened.name)}` continues it"
                hint = f"; name one of its {noun}, such as {shell_word(inner)}" if inner else resume
            elif (
                SourceKind.RUN in kinds
                and opened.kind is SourceKind.SCENARIO
                and opened.path.suffix in (".yaml", ".yml")
            ):
                is_shipped = shipped.scenario_path(opened.path.stem) == opened.path
                name = opened.path.stem if is_shipped else opened.name
                hint = (
                    f"; train it first with `deepbots train {shell_word(name)}`, or name one of its runs,"
                    " which `deepbots runs` lists"
                )
            elif opened.kind is SourceKind.RUN and SourceKind.SCENARIO in kinds:
                name = shell_word(opened.name)
                hint = (
                    f"; its scenario is {opened.scenario}; `deepbots resume {name}` continues its training, and"
                    f" `deepbots repeat {name}` trains it again"
                )
            elif SourceKind.RUN in kinds and opened.kind is SourceKind.CHECKPOINT:
                hint = f"; name the run: {opened.path}"
            raise error(f"{opened.name} is {description}, and not {expected}{hint}")
        return opened

    @classmethod
    def _named(cls, path: Path, name: str, permissions: Permissions, error: type[UsageError]) -> Source:
        if not name:
            raise error("the name is empty; name a scenario or a run")
        try:
            kind = folder_kind(path)
            if kind is not None:
                return cls.kept(path, permissions, kind)
            if path.exists() and path.suffix.lower() in (".urdf", ".xacro"):
                words = shell_word(name)
                raise error(
                    f"{name} is a robot file, not a scenario; `deepbots inspect {words}` describes it,"
                    f" `deepbots new {scenario_name_for(path)} --urdf {words}` writes a scenario for it"
                )
            # A folder that is named like a shipped scenario must not hide it.
            shipped_path = None if path.is_file() else shipped.scenario_path(name)
            if shipped_path is not None:
                return cls(SourceKind.SCENARIO, shipped_path.name, shipped_path, shipped_path, permissions)
            if path.is_dir():
                any(path.iterdir())  # this fails for a folder that may not be entered
                raise error(
                    f"{name} is not a run, a group or a scenario: it is a folder without {RECORD_NAME} or"
                    f" {GROUP_RECORD_NAME}"
                )
            if not path.exists():
                hint = missing_path_hint(path, folder_kind)
                raise error(f"no file, folder or shipped scenario is called '{name}'; {hint}")
        except (OSError, ValueError, RuntimeError) as failed:
            reason = failed.strerror if isinstance(failed, OSError) else None
            raise error(f"{name} cannot be read: {(reason or 'not a usable file name').lower()}") from None
        if path.suffix == RECORDING_SUFFIX:
            return cls(SourceKind.RECORDING, name, path, None, permissions)
        run = path.parent.parent.parent
        if (
            path.suffix == ".zip"
            and path.parent.parent.name == MODELS_FOLDER
            and folder_kind(run) is SourceKind.RUN
        ):
            return replace(cls.kept(run, permissions, SourceKind.CHECKPOINT), name=name, model=path.stem)
        return cls(SourceKind.SCENARIO, name, path, path, permissions)

    @classmethod
    def kept(
        cls, folder: Path, permissions: Permissions = Permissions(), kind: SourceKind = SourceKind.RUN
    ) -> Source:
        """Open a folder that has a scenario with all its files, and is the project of this scenario.

        Python functions that the scenario names are not run before a world is made, which checks
        `permissions.code`.
        """
        return cls(kind, str(folder), folder, folder / RESOLVED_NAME, permissions, folder)

    def document(
        self, *, overrides: Sequence[str] = (), drafts: Drafts = NO_DRAFTS, tests: bool = False
    ) -> Document:
        """Read the text of the scenario.

        Args:
            overrides: Assignments `path=value`, as for `--set`.
            drafts: Texts to read instead of files, by their absolute paths.
            tests: Whether to read `tests` and `tune` also with `overrides`, which may change what these
                sections name.

        Raises:
            UsageError: The file cannot be read.
        """
        permissions = self.permissions if self.project is None else replace(self.permissions, code=True)
        if isinstance(self.scenario, Scenario):
            document = loads(self.scenario.to_yaml(), self.name, overrides=overrides, permissions=permissions)
        else:
            path = self.scenario or self.path
            display = self.name if path == self.path else str(path)
            document = load(
                path, overrides, display=display, permissions=permissions, drafts=drafts, project=self.project
            )
        root = document.root
        if overrides and not tests and root is not None:
            root = replace(
                root, entries={key: entry for key, entry in root.entries.items() if key not in (TESTS, TUNE)}
            )
        return replace(document, root=root)

    def checked(
        self, *, overrides: Sequence[str] = (), drafts: Drafts = NO_DRAFTS, tests: bool = False
    ) -> CheckedScenario:
        """Read and check the scenario; arguments and errors are those of `document`."""
        return check(self.document(overrides=overrides, drafts=drafts, tests=tests))


def _first_inside(folder: Path, kinds: Sequence[SourceKind]) -> Path | None:
    """Return the first run or group of these kinds in a group or a study."""
    for inner in sorted(folder.iterdir()):
        kind = folder_kind(inner)
        if kind in kinds:
            return inner
        if kind is not None and (deeper := _first_inside(inner, kinds)):
            return deeper
    return None


def folder_kind(path: Path) -> SourceKind | None:
    """Return whether a folder is that of a run, of a group or of a study; None for any other path."""
    names = (
        (GROUP_RECORD_NAME, SourceKind.GROUP),
        (RECORD_NAME, SourceKind.RUN),
        (STUDY_RECORD_NAME, SourceKind.STUDY),
    )
    for name, kind in names:
        if os.path.isfile(path / name):  # unlike `Path.is_file`, False for a folder that may not be entered
            return kind
    return None
