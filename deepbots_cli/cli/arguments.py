"""What the arguments of commands name: scenarios, folders of them, run directories, robot files, and the
processes of `--workers` and `--cluster`."""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from deepbots_cli import api
from deepbots_cli.analysis.changes import WrittenScenario
from deepbots_cli.cli import terminal
from deepbots_cli.diagnostics import Finding, Findings
from deepbots_cli.diagnostics.findings import suppress as without_suppressed
from deepbots_cli.diagnostics.nearest import did_you_mean, nearest_word
from deepbots_cli.document import Permissions, files, shipped
from deepbots_cli.document.layout import quoted
from deepbots_cli.document.load import NO_DRAFTS, Drafts
from deepbots_cli.engine_kinds import with_engine
from deepbots_cli.errors import ScenarioError, UsageError
from deepbots_cli.lint.settings import Settings, scenarios_in
from deepbots_cli.processes import available_cores
from deepbots_cli.records import dataclass
from deepbots_cli.robots import packages
from deepbots_cli.robots.reader import RobotFile, read, read_bytes
from deepbots_cli.rollout.source import Source, SourceKind
from deepbots_cli.words import counted, shell_word

if TYPE_CHECKING:
    from deepbots_cli.learning.executor import Executor
    from deepbots_cli.learning.runs.run import ModelName, Run

STDIN = "-"
"""The argument for standard input."""


@dataclass(frozen=True)
class OpenedSource(WrittenScenario):
    """A compiled scenario with its text after includes and settings; `run` is the run that it was trained in,
    if any, and `model` the model of it.

    `learner` has the reasons for the learner, if deepbots chose it. The program and the text contain this
    learner.
    """

    run: Run | None = None
    model: ModelName = "best"
    findings: Sequence[Finding] = ()
    learner: Sequence[str] = ()


def open_source(
    source: str, overrides: Sequence[str], permissions: Permissions, engine: str | None = None
) -> OpenedSource:
    """Open the scenario of a file or of a shipped name, checked for the engine if one is given, or that of a
    run, a model of a run, or a group.

    Raises:
        UsageError: There is no such file or run.
        ScenarioError: The scenario has errors.
    """
    opened = Source.open(
        source, permissions, SourceKind.SCENARIO, SourceKind.RUN, SourceKind.CHECKPOINT, SourceKind.GROUP
    )
    if opened.kind is not SourceKind.SCENARIO and overrides:
        kind = "a group" if opened.kind is SourceKind.GROUP else "a run"
        raise UsageError(
            f"--set works only with a scenario; {source} is {kind}, which cannot be changed after the"
            " training"
        )
    if opened.kind in (SourceKind.RUN, SourceKind.CHECKPOINT):
        from deepbots_cli.learning.runs.run import ModelRef  # `lint` of a file needs no records of runs

        ref = ModelRef.open(opened)
        return OpenedSource(
            ref.run.program, opened.document().root, ref.run, ref.name, learner=ref.run.record.learner
        )
    checked = opened.checked(
        overrides=with_engine(overrides, engine) if opened.kind is SourceKind.SCENARIO else ()
    )
    compiled = api.compile(checked)
    with suppress(ScenarioError):  # no algorithm can act in it
        compiled = api.with_learner(compiled)
    root = compiled.document.root if compiled.document else None
    return OpenedSource(compiled.program, root, findings=compiled.findings, learner=compiled.learner)


def xacro_arguments(words: Sequence[str] | None, *, of_robot: bool = True) -> dict[str, str]:
    """Return the arguments of `--xacro-arg NAME:=VALUE`, or NAME=VALUE, by name.

    Raises:
        UsageError: A word is none, an argument has two values, or they are not of a robot file.
    """
    if words and not of_robot:
        raise UsageError(
            "--xacro-arg goes with a robot file; a scenario has them under `xacro`, beside `urdf`"
        )
    arguments: dict[str, str] = {}
    for word in words or ():
        name, sign, value = word.partition("=")
        name = name.removesuffix(":").strip()
        if not sign or not name:
            raise UsageError(f"--xacro-arg {word}: write NAME:=VALUE")
        if arguments.setdefault(name, value) != value:
            raise UsageError(f"--xacro-arg gives {name} twice")
    return arguments


def is_robot(reference: str) -> bool:
    """Return whether this is a robot file, or the name of a shipped robot and of no scenario."""
    if reference.startswith("package://") or reference.lower().endswith((".urdf", ".xacro")):
        return True
    return (
        shipped.robot_path(reference) is not None
        and shipped.scenario_path(reference) is None
        and not Path(reference).exists()
    )


class RobotError(ScenarioError):
    """The error for a file that cannot be read as a robot; `allow` has the folders that have its meshes, and
    that the user did not allow."""

    def __init__(self, findings: Sequence[Finding], allow: Sequence[Path] = ()) -> None:
        super().__init__(findings)
        self.allow = tuple(allow)


def open_robot(
    reference: str, allowed: Sequence[str | Path] = (), arguments: Mapping[str, str] | None = None
) -> tuple[RobotFile, list[Finding]]:
    """Open a robot file, with the warnings about it. Its meshes are in its folder, the current one, an
    `allowed` one, or below them. `arguments` are those of a xacro file.

    Raises:
        UsageError: There is no such file.
        RobotError: The file cannot be read as a robot.
    """
    file, findings, places = _read_robot(reference, allowed, arguments)
    if file is None or findings.errors:
        raise RobotError(list(findings), list(places.suggested))
    return file, list(findings)


def robot_findings(
    reference: str,
    allowed: Sequence[str | Path] = (),
    arguments: Mapping[str, str] | None = None,
    drafts: Drafts = NO_DRAFTS,
) -> list[Finding]:
    """Return the findings of a robot file alone, or of its draft, that no comment suppresses. Those of a file
    that it includes have no fix: linting that file fixes it. A comment may serve a scenario with the robot.

    Raises:
        UsageError: There is no such file.
    """
    name = files.display_path(robot_path(reference, allowed).resolve())
    file, findings, _ = _read_robot(reference, allowed, arguments, drafts)
    remaining, _ = without_suppressed(findings, file.sources if file else (), quoted)
    return [
        finding if finding.span.source.name == name else replace(finding, fix=None) for finding in remaining
    ]


def robot_path(reference: str, allowed: Sequence[str | Path] = ()) -> Path:
    """Return the robot file of a path, or else of a shipped name, or of `package://`.

    Raises:
        UsageError: There is no such file.
    """
    if reference.startswith("package://"):
        path = packages.locate_file(reference, Path.cwd(), (Path.cwd(), *map(Path, allowed)))
    else:
        own = Path(reference)
        path = own if own.is_file() else shipped.robot_path(reference) or own
    if path is None or not path.is_file():
        names = shipped.robot_names()
        suggestion = packages.library_reference(reference) or nearest_word(reference, names)
        hint = f" (did you mean {suggestion}?)" if suggestion else ""
        raise UsageError(f"there is no robot file {reference}{hint}; shipped robots are: {', '.join(names)}")
    return path


def _read_robot(
    reference: str,
    allowed: Sequence[str | Path],
    arguments: Mapping[str, str] | None = None,
    drafts: Drafts = NO_DRAFTS,
) -> tuple[RobotFile | None, Findings, packages.Places]:
    path = robot_path(reference, allowed)
    findings = Findings()
    places = packages.Places(
        path.absolute().parent,
        (Path.cwd(), *map(Path, allowed), *packages.package_folders(reference)),
        suggests=True,
    )
    display = files.display_path(path.resolve())
    draft, resolve = drafts.get(path.resolve()), places.resolve
    if draft is None:
        file = read(path, display, findings, resolve_mesh=resolve, arguments=arguments)
    else:
        file = read_bytes(draft, display, findings, resolve_mesh=resolve, arguments=arguments)
    declared = sorted(file.xacro.arguments) if file and file.xacro else []
    for argument in arguments or () if file else ():
        if argument not in declared:
            raise UsageError(
                f"{reference} has no xacro argument {argument}{did_you_mean(argument, declared)}; it has:"
                f" {', '.join(declared) or 'none'}"
            )
    return file, findings, places


def run_to_export(run: Run, agent: str | None) -> Run:
    """Return the run as that of the agent whose policy is exported.

    Raises:
        UsageError: The run trained several agents and none is named, or it trained one.
    """
    names = list(run.program.members)
    if agent is None and not names:
        return run
    if agent in names:
        return run.of_agent(agent)
    if not names:
        raise UsageError(f"{run.path} has the policy of one agent; leave out --agent")
    raise UsageError(
        f"{run.path} has the policies of {', '.join(names)}; name one of them: deepbots export"
        f" {shell_word(run.path)} --agent {names[0]}"
    )


def scenario_names(arguments: Iterable[str], project: Settings) -> list[str]:
    """Return the scenarios that the arguments name, each once. Files in folders that the project excludes are
    left out.

    Raises:
        UsageError: A scenario does not exist, or a folder has no scenario.
    """
    names: dict[str, str] = {}
    for argument in arguments:
        is_folder = argument != STDIN and Path(argument).is_dir()
        for name in map(str, scenarios_in(Path(argument), project)) if is_folder else [argument]:
            names.setdefault(os.path.abspath(name), name)  # `a.yaml` is `./a.yaml`
    for name in names.values():
        if name != STDIN and not is_robot(name):
            Source.open(name, Permissions(), SourceKind.SCENARIO)
    return list(names.values())


def check_dividable(workers: int | None, address: str | None, count: int, reason: str) -> None:
    """Check that there are several parts for the workers.

    Raises:
        UsageError: There are workers for `count` parts, fewer than two; `reason` is the cause.
    """
    if count < 2 and (workers, address) != (None, None):
        option = "--cluster" if workers is None else "--workers"
        raise UsageError(f"{option} has nothing to divide, since {reason}")


@contextmanager
def executor(
    workers: int | None, address: str | None, count: int | None = None, *, quiet: bool = False
) -> Iterator[Executor]:
    """Context with the executor of at most `count` calls or shards: this process, unless an option names
    workers, which end with the block.

    Raises:
        UsageError: The cluster does not answer.
    """
    if workers is None and address is None:
        from deepbots_cli.learning.executor import SERIAL

        yield SERIAL
        return
    from deepbots_cli.cluster import Cluster

    if workers is not None:
        workers = workers if count is None else min(workers, count)
        if workers > (cores := available_cores()) and not quiet:
            terminal.note(
                f"{workers} workers share {counted(cores, 'core')}; more workers than cores are not faster"
            )
    with ExitStack() as stack:
        with terminal.transient_line("" if quiet or address is None else f"joining {address} ..."):
            cluster = stack.enter_context(Cluster(workers=workers, address=address))
        yield cluster
