"""The run directory: the inputs and the results of one training.

    runs/cartpole-0-1/
    ├── run.json             command, seeds, digests, versions, status, result
    ├── inputs/              a copy of every file that the scenario was read from, meshes too; a copied robot
    │                        file names the copies of its meshes
    ├── resolved.yaml        the scenario after includes and overrides, with paths to the copies; the run is
    │                        loaded from it
    ├── environment.py       the generated code, to read; it is never run from here
    ├── demonstrations.mcap  a copy of the recording that teaches the policy
    ├── teacher/             the policy that teaches, with its scenario
    ├── monitor.csv          a line per episode
    ├── tensorboard/
    ├── models/agent/        best.zip, last.zip: models of the learner; candidate-000000020000.zip of the best
    │                        evaluations;
    │                        step-000020000.zip with --keep-checkpoints; earlier-1.zip was the best before
    │                        `eval --keep`
    ├── evaluations/         training.jsonl, and a file for each later evaluation, with its episodes
    ├── logs/                the output of callbacks and loggers
    └── checkpoints/         the state from which a resumed training continues

A directory is made once and never overwritten. All files are replaced whole, so a killed process leaves a
usable run.
"""

from __future__ import annotations

import io
import json
import re
import shutil
import zipfile
from collections.abc import Mapping
from functools import cached_property
from pathlib import Path
from typing import Any

import deepbots_cli
from deepbots_cli import api, engine_kinds
from deepbots_cli.api import Compiled
from deepbots_cli.compiler.inputs import INPUTS_FOLDER, RESOLVED_NAME, write_copies
from deepbots_cli.document import Permissions
from deepbots_cli.errors import DeepbotsError, RunError, StorageError, UsageError
from deepbots_cli.files import unwritable_message
from deepbots_cli.learning.runs.directories import write_numbered, write_text
from deepbots_cli.learning.runs.evaluations import MAX_EVALUATION_BYTES, EvaluationResult
from deepbots_cli.learning.runs.records import RunRecord, is_installed, timestamp, write_record
from deepbots_cli.program import Member, Program, identity
from deepbots_cli.program.task import ONLY_AGENT
from deepbots_cli.records import dataclass
from deepbots_cli.rollout.source import MODELS_FOLDER, RECORD_NAME, Source, SourceKind

DATA = "data"
_MAX_DATA_BYTES = 8_000_000


def opened_archive(source: Path | io.BytesIO, size: int) -> zipfile.ZipFile:
    """Open an archive whose members are no larger than the file itself.

    Raises:
        Exception: The archive is damaged, in one of a dozen ways, or it was not written by deepbots.
    """
    archive = zipfile.ZipFile(source)
    members = archive.infolist()
    if len({item.filename for item in members}) < len(members):
        raise ValueError("two of its members have one name")
    if any(
        item.compress_type != zipfile.ZIP_STORED or item.compress_size != item.file_size for item in members
    ):
        raise ValueError("it is compressed, but models of deepbots are not")
    if sum(item.file_size for item in members) > size:
        raise ValueError("its members overlap")
    return archive


def data_of(path: Path) -> dict[str, Any]:
    """Read the member `data` of a model.

    Raises:
        RunError: The file is missing, damaged, or no model.
    """
    try:
        with zipfile.ZipFile(path) as archive, archive.open(DATA) as member:
            data = json.loads(member.read(_MAX_DATA_BYTES))
    except Exception as error:  # reading a damaged file raises a dozen kinds of exceptions
        raise _damaged(path) from error
    if not isinstance(data, dict):
        raise _damaged(path)
    return data


def steps_of(path: Path) -> int:
    """Read the number of steps after which a model was saved.

    Raises:
        RunError: The file is missing, damaged, or no model.
    """
    data = data_of(path)
    try:
        return int(data["num_timesteps"])
    except (KeyError, OverflowError, TypeError, ValueError) as error:  # infinite steps overflow
        raise _damaged(path) from error


def _damaged(path: Path) -> RunError:
    return RunError(f"{path} is damaged, or was not written by deepbots")


DEMONSTRATIONS_NAME = "demonstrations.mcap"
TEACHER_FOLDER = "teacher"

ModelName = str
"""The name of a file in `models/agent` of a run, without its suffix: `best`, `last`,
`candidate-000000020000`, `step-000020000`."""
_FILES = (RECORD_NAME, RESOLVED_NAME, "monitor.csv", ".lock")
_FOLDERS = (
    INPUTS_FOLDER,
    "tensorboard",
    "models",
    "evaluations",
    "logs",
    "checkpoints",
    "failures",
    TEACHER_FOLDER,
)


@dataclass
class Run:
    """A run on disk. `record` is its `run.json`, and `compiled` its scenario as it compiles now."""

    path: Path
    record: RunRecord
    compiled: Compiled

    def __post_init__(self) -> None:
        self.program = self.compiled.program
        self.monitor = self.path / "monitor.csv"
        self.tensorboard = self.path / "tensorboard"
        self.demonstrations = self.path / DEMONSTRATIONS_NAME
        self.teacher = self.path / TEACHER_FOLDER
        self.evaluations = self.path / "evaluations"
        self.checkpoints = self.path / "checkpoints"

    @cached_property
    def digest(self) -> str:
        return self.compiled.digest

    @property
    def resolved(self) -> str:
        """The scenario as its file in the run, with the agent that it is about."""
        text = (self.path / RESOLVED_NAME).read_text(encoding="utf-8")
        others = self.program.others
        role = "\nrole:"
        return (
            text if others is None or role in text else f"{text.rstrip()}{role} {{agent: {others.agent}}}\n"
        )

    def member(self, agent: str) -> Member:
        """Return one of the several agents that the run trained.

        Raises:
            UsageError: There is no such agent.
        """
        members = self.program.members
        if agent not in members:
            names = f"; its agents are {', '.join(members)}" if members else ", which trained one agent"
            raise UsageError(f"there is no agent '{agent}' in {self.path}{names}")
        return members[agent]

    def of_agent(self, agent: str, *, beside_policies: bool = False) -> Run:
        """Return the run of all agents as that of one of them. The others act by their first scripts, or by
        the policies of the best model of the run (`beside_policies`)."""
        # JSON is valid YAML, and quotes a path with any characters.
        model = json.dumps(str(self.model("best").absolute()))
        policies = [f"{name}: {model}" for name in self.program.members if beside_policies and name != agent]
        source = Source.kept(self.path, Permissions(folders=(self.path,)))
        compiled = api.compile(
            source, overrides=[f"role={{agent: {agent}, others: {{{', '.join(policies)}}}}}"]
        )
        is_changed = self.digest != self.record.digest
        record = self.record if is_changed else self.record.model_copy(update={"digest": compiled.digest})
        return Run(self.path, record, compiled)

    def model(self, name: ModelName, agent: str = ONLY_AGENT) -> Path:
        return self.path / MODELS_FOLDER / agent / f"{name}.zip"

    @staticmethod
    def model_below(folder: Path) -> Path:
        """Return the place of the best model in the folder of a run."""
        return folder / MODELS_FOLDER / ONLY_AGENT / "best.zip"

    @property
    def evaluation_seed(self) -> int:
        """The root seed of an evaluation by default: that of the evaluation after the best model was kept, or
        of the confirmation which ended the training, so that it is repeated; or else that of the training."""
        result = self.record.result
        if result is not None and result.best is not None and result.best.evaluation_seed is not None:
            return result.best.evaluation_seed
        return self.record.seed if result is None or result.confirmed_seed is None else result.confirmed_seed

    def engine_for(self, program: Program) -> str:
        """Return the engine to evaluate in: that of `program` if it names another than the run's scenario,
        else the engine of the training."""
        has_other_engine = program.engine is not None and program.engine != self.program.engine
        return program.engine if has_other_engine and program.engine else self.record.engine

    def update(self, **changes: Any) -> None:
        """Change entries of the record, here and on disk."""
        self.record = self.record.model_copy(update={"updated": timestamp(), **changes})
        write_record(self.path, self.record)

    def write_evaluation(self, content: Mapping[str, Any]) -> Path:
        """Write an evaluation under the next free number, and quote it in the record if it is preferred to
        the one there (`RunRecord.with_evaluation`).

        Args:
            content: The JSON of an `EvaluationResult`, and further entries.

        Raises:
            RunError: The run cannot be written to, its disk is full, or the evaluation has too many episodes.
        """
        entries = {"evaluated": timestamp(), **content}
        text = json.dumps(entries, indent=1, allow_nan=False) + "\n"
        if len(text) > MAX_EVALUATION_BYTES:
            raise RunError(f"it has {len(text):,} bytes, and the limit is {MAX_EVALUATION_BYTES:,}")
        path = write_numbered(self.evaluations, text)
        record = RunRecord.read(self.path)  # another process may have changed it
        # A training writes its record at its end, and evaluations until then are of older models.
        if record.status != "running":
            record = record.with_evaluation(int(path.stem), EvaluationResult.model_validate(entries))
            write_record(self.path, record)
            self.record = self.record.model_copy(update={"quoted": record.quoted})
        return path

    def notes_on_physics(self) -> list[str]:
        """Return a sentence if the run was trained with another version of the physics; else nothing."""
        physics = self.record.physics
        if physics == engine_kinds.PHYSICS:
            return []
        return [
            f"{self.path} was trained with physics {physics} of deepbots, and this version simulates physics"
            f" {engine_kinds.PHYSICS}, in which the same actions may move the robot differently"
        ]

    def notes(self) -> list[str]:
        """Notes on the use of this run, one sentence each."""
        version = deepbots_cli.__version__
        trained_version = self.record.deepbots
        stages = [stage.name for stage in self.program.curriculum]
        texts = (
            []
            if trained_version == version
            else [f"{self.path} was trained by deepbots {trained_version}, but this is deepbots {version}"]
        )
        texts += self.notes_on_physics()
        if self.digest != self.record.digest:
            cause = "with this version of deepbots" if texts else "because it was changed after the training"
            texts.append(
                f"the scenario in {self.path} compiles to a different program {cause}; the policy still fits"
                " its interface"
            )
        stage = self.record.result.stage if self.record.result else None
        if stage in stages[:-1]:
            texts.append(
                f"the training ended in stage {stage}, number {stages.index(stage) + 1} of {len(stages)}"
            )
        return texts

    @staticmethod
    def create(path: Path, record: RunRecord, compiled: Compiled) -> Run:
        """Fill a new, empty directory (see `new_directory`). If this fails, the directory is removed.

        Raises:
            RunError: The copies in the directory do not compile to the same program.
        """
        try:
            for folder in (
                f"models/{compiled.program.agent.name}",
                "tensorboard",
                "evaluations",
                "checkpoints",
            ):
                (path / folder).mkdir(parents=True)
            write_copies(path, compiled.resolved, compiled.inputs)
            if _compiled(Source.kept(path), record).digest != compiled.digest:
                raise RunError(
                    f"a file of the scenario has changed since it was compiled; train {path} again"
                )
            write_text(path / "environment.py", compiled.code)
            write_record(path, record)
            return Run(path, record, compiled)
        except BaseException as error:
            # This includes Ctrl-C. Half a directory is not a run, and would block the next one.
            shutil.rmtree(path, ignore_errors=True)
            if isinstance(error, OSError):
                raise StorageError(unwritable_message(path, error)) from error
            raise

    @staticmethod
    def open(path: str | Path | Source) -> Run:
        """Open a run. Its scenario is compiled again, and only files of the run, shipped files and installed
        packages are read.

        Raises:
            RunError: The folder is not a run, is damaged or has another format, or its policy does not match
                its scenario; the message then lists the differences by field.
        """
        source = Source.open(path, Permissions(), SourceKind.RUN)
        path = source.path
        record = RunRecord.read(path)
        _check_plain(path)
        if not (path / RESOLVED_NAME).is_file():
            raise RunError(f"{path / RESOLVED_NAME} is missing")
        compiled = _compiled(source, record)
        differences = identity.compare_interfaces(
            record.interface, identity.interface(compiled.program), words=("trained", "now")
        )
        if differences:
            lines = "\n  ".join(differences)
            raise RunError(
                f"{path} was trained with other observations, actions or messages than its scenario defines"
                f" now:\n  {lines}"
            )
        return Run(path, record, compiled)


def _compiled(source: Source, record: RunRecord) -> Compiled:
    """Compile the scenario of a run from its copies.

    Raises:
        RunError: It does not compile.
    """
    try:
        # The functions of Python that it names are not called before a world is built, which asks again
        # whether they may.
        return api.compile(source)
    except DeepbotsError as error:
        missing = [f"{name} {version}" for name, version in record.plugins.items() if not is_installed(name)]
        needed = f"; its training used {', '.join(missing)}, so install that" if missing else ""
        raise RunError(
            f"{source.path} cannot be used, since its scenario does not compile:"
            f" {' '.join(str(error).split())[:500]}{needed}"
        ) from error


def has_model(run: Path, name: str) -> bool:
    """Return whether a run has a model of this name, which may come from a file."""
    return (
        re.fullmatch(r"[a-z]+(-[0-9]+)?", name) is not None
        and (run / MODELS_FOLDER / ONLY_AGENT / f"{name}.zip").is_file()
    )


@dataclass(frozen=True)
class ModelRef:
    """A model of a run, as the argument of everything that acts with the policy of a run.

    It is named by the folder of its run (`runs/cartpole-0-1`: the best model), or by its file
    (`runs/cartpole-0-1/models/agent/last.zip`). The file is checked when it is loaded.

    Attributes:
        run: The run.
        name: The name of the model.
        is_named: Whether the file of the model was named, and not its run.
    """

    run: Run
    name: ModelName = "best"
    is_named: bool = False

    @classmethod
    def open(
        cls,
        source: ModelRef | Run | str | Path | Source,
        permissions: Permissions = Permissions(),
        *,
        model: ModelName = "best",
    ) -> ModelRef:
        """Open the model that `source` names; of a run, the one called `model`.

        Raises:
            RunError: It is neither a run nor a model of a run, or the run cannot be used.
            UsageError: It is a model, and `model` names another one.
        """
        if isinstance(source, Run):
            return cls(source, model)
        if isinstance(source, ModelRef):
            label = str(source.path)
            ref = source
        else:
            opened = Source.open(source, permissions, SourceKind.RUN, SourceKind.CHECKPOINT)
            label = opened.name
            run = Run.open(Source.kept(opened.path, opened.permissions))
            ref = cls(run, model if opened.model is None else opened.model, opened.model is not None)
        if ref.is_named and model != "best":
            raise UsageError(
                f"--{model} chooses a model of a run, but {label} is already a model; leave it out"
            )
        return ref

    @property
    def path(self) -> Path:
        """The file of the model."""
        return self.run.model(self.name)

    @property
    def label(self) -> str:
        """The label, such as `cartpole-0-1` for the best model, and `cartpole-0-1 (last)` for another one."""
        return self.run.path.name if self.name == "best" else f"{self.run.path.name} ({self.name})"

    @property
    def shown_path(self) -> Path:
        """The path that names the model: that of the run for the best model, else that of the file."""
        return self.run.path if self.name == "best" else self.path


def _check_plain(run: Path) -> None:
    """Refuse links and pipes: a run may come from someone else, resuming writes, and opening a pipe waits for
    ever."""
    members = [run / name for name in (*_FILES, *_FOLDERS)]
    for folder in _FOLDERS:
        members += (run / folder).rglob("*") if not (run / folder).is_symlink() else ()
    for member in members:
        if member.is_symlink():
            raise RunError(f"{member} is a symbolic link; deepbots does not write symbolic links into a run")
        if member.exists() and not (member.is_file() or member.is_dir()):
            raise RunError(f"{member} is neither a file nor a directory, so deepbots did not write it")


def remove_incomplete(folder: Path) -> None:
    """Remove the files that a killed process has left of a new run directory: folders and files of a run
    without a record."""
    removable = {*_FOLDERS, *_FILES, "environment.py"}
    if folder.is_dir() and not folder.is_symlink():
        names = {path.name for path in folder.iterdir()}
        if RECORD_NAME not in names and all(
            name in removable or name.startswith(".deepbots-") for name in names
        ):
            shutil.rmtree(folder)
