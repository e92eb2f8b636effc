"""Measures what is missing of a scenario or a part, piece by piece, with the commands that the page shows.

A piece is an entry of a record in tools/results/records. It counts as long as its command line and the digest of its
scenario are what is asked for now. A measurement may be stopped at any time: what is finished is in the
record, and a training goes on from its last checkpoint.
"""

from __future__ import annotations

import hashlib
import json
import math
import os
import platform
import re
import resource
import shlex
import subprocess
import sys
from collections import deque
from collections.abc import Callable, Iterator, Mapping
from dataclasses import MISSING, asdict, dataclass, fields, replace
from datetime import UTC, datetime
from functools import cache, partial
from pathlib import Path
from typing import Any, NamedTuple

import deepbots_cli
from deepbots_cli import api
from deepbots_cli.expressions.scalar import Scalar
from deepbots_cli.learning.runs.directories import write_text
from deepbots_cli.learning.runs.episodes import read_log
from deepbots_cli.learning.runs.run import Run, versions
from deepbots_cli.program import Program, identity
from deepbots_cli.program.task import Evaluation as EvaluationSettings
from tools.results.experiment import Baseline, Crossed, Evaluation, Experiment, Training
from tools.results.parts import Holding, Part

ROOT = Path(__file__).resolve().parents[2]
WATCHED = ("deepbots_cli", "scenarios", "robots", "tests", "tools")
WINDOW, POINTS = 100, 200
"""Episodes of a mean, and points of a curve."""
KEPT = (
    "episodes",
    "mean_return",
    "return_interval",
    "least_return",
    "greatest_return",
    "success_defined",
    "successes",
    "success_rate",
    "success_interval",
    "mean_length",
    "endings",
)
"""What a record keeps of an evaluation."""


@dataclass(frozen=True)
class Places:
    """`records` has a JSON file for each scenario and part, `pictures` the learning curves, and `runs` what
    was trained.
    """

    records: Path = ROOT / "tools" / "results" / "records"
    page: Path = ROOT / "docs" / "results.md"
    pictures: Path = ROOT / "docs" / "images" / "results"
    runs: Path = ROOT / "runs" / "results"

    def record(self, name: str) -> Path:
        return self.records / f"{name}.json"

    def picture(self, name: str) -> Path:
        return self.pictures / f"{name}.svg"


# Records


def read(path: Path) -> dict[str, Any]:
    """A record; empty where nothing was measured yet."""
    return dict(json.loads(path.read_text(encoding="utf-8"))) if path.is_file() else {}


def put(path: Path, value: Mapping[str, Any], *keys: str) -> None:
    """Set the entry under `keys`, and keep all others."""
    path.parent.mkdir(parents=True, exist_ok=True)
    record = inner = read(path)
    for key in keys[:-1]:
        inner = inner.setdefault(key, {})
    inner[keys[-1]] = value
    write_text(path, dumps(record) + "\n")


def dumps(value: Any, indent: str = "") -> str:
    """JSON with an entry in each line, and lists of plain values in one."""
    deeper = indent + "  "
    if isinstance(value, Mapping) and value:
        lines = (f"{deeper}{json.dumps(str(key))}: {dumps(value[key], deeper)}" for key in value)
        return "{\n" + ",\n".join(lines) + f"\n{indent}}}"
    if isinstance(value, list | tuple) and any(isinstance(item, Mapping | list | tuple) for item in value):
        return "[\n" + ",\n".join(deeper + dumps(item, deeper) for item in value) + f"\n{indent}]"
    return json.dumps(value, allow_nan=False)


def circumstances() -> dict[str, Any]:
    """When and on what something is measured."""
    machine = f"{os.cpu_count()} cores of {platform.machine()} under {platform.system()}"
    packages = {"deepbots": deepbots_cli.__version__, **versions()}
    return {"date": datetime.now(UTC).date().isoformat(), "machine": machine, "versions": packages}


# Requests


class Request(NamedTuple):
    """The digest of a scenario or of the sources, and a command as the page has it: with RUN for what a
    training made."""

    digest: str
    command: str

    def is_answered_by(self, entry: Mapping[str, Any] | None) -> bool:
        """Whether an entry of a record answers the request."""
        return bool(entry) and entry is not None and (entry["digest"], entry["command"]) == self


def training_request(scenario: str, training: Training, seed: int | str) -> Request:
    """The request does not depend on the evaluation, so that a new case needs no new training."""
    command = shlex.join(["deepbots", "train", scenario, "--seed", str(seed), *training.options])
    return Request(_training_digest(scenario, training.sets), command)


@cache
def _training_digest(scenario: str, sets: tuple[str, ...]) -> str:
    program = _with(compiled(scenario, sets), {"scripts": ()})
    # To evaluate in cases that came after a training is to name the scenario, which takes no settings.
    return digest(program if sets else _with(program, {}, cases=(), evaluation=EvaluationSettings()))


def evaluation_request(scenario: str, training: Training, evaluation: Evaluation) -> Request:
    """The request does not depend on the training."""
    program = compiled(evaluation.scenario) if evaluation.scenario else compiled(scenario, training.sets)
    program = program if evaluation.case is None else program.case(evaluation.case).program
    program_digest = digest(_with(program, {"scripts": (), "training": None}, curriculum=()))
    return Request(program_digest, shlex.join(["deepbots", "eval", "RUN", *evaluation.options]))


def baseline_request(scenario: str, baseline: Baseline) -> Request:
    program = compiled(scenario)
    program = program if baseline.case is None else program.case(baseline.case).program
    is_scripted = not {script.name for script in program.agent.scripts}.isdisjoint(baseline.options)
    policy = {"scripts": program.agent.scripts if is_scripted else (), "training": None}
    program_digest = digest(_with(program, policy, curriculum=(), cases=(), evaluation=EvaluationSettings()))
    return Request(program_digest, shlex.join(["deepbots", "try", scenario, *baseline.all_options]))


def speeds_request(scenario: str, engines: tuple[str, ...]) -> Request:
    """Steps of the world, with whatever policy; `--quick` takes a few seconds."""
    program_digest = digest(
        _with(
            compiled(scenario),
            {"scripts": (), "training": None},
            curriculum=(),
            cases=(),
            evaluation=EvaluationSettings(),
        )
    )
    return Request(
        program_digest, shlex.join(["deepbots", "bench", scenario, "--engine", ",".join(engines), "--quick"])
    )


@cache
def compiled(scenario: str, sets: tuple[str, ...] = ()) -> Program:
    """A shipped scenario by name, or one by its path from the root of the repository."""
    file = ROOT / scenario
    return api.compile(
        str(file) if file.suffix == ".yaml" and file.is_file() else scenario, overrides=sets
    ).program


def _with(program: Program, policy: Mapping[str, Any], **changes: Any) -> Program:
    """The scenario with other fields, also of its policies, in its cases and stages too."""
    cases = tuple(replace(case, program=_with(case.program, policy, **changes)) for case in program.cases)
    curriculum = tuple(
        replace(stage, program=_with(stage.program, policy, **changes)) for stage in program.curriculum
    )
    return replace(program.with_agent(**policy), **{"cases": cases, "curriculum": curriculum, **changes})


def digest(program: Program) -> str:
    """SHA-256, in hexadecimal, of all that differs from a default; a new feature leaves the figures of
    scenarios without it alone."""
    return hashlib.sha256(
        json.dumps(_plain(_with(program, {}, summary="")), sort_keys=True).encode()
    ).hexdigest()


def _plain(value: object) -> Any:
    inside = identity.record_members(value)
    if inside is not None:
        kind: Any = type(value)  # of any type: to mypy, a class is not hashable
        defaults = _defaults(kind)
        changed = {
            name: _plain(member) for name, member in inside.items() if member != defaults.get(name, MISSING)
        }
        return {"is": kind.__name__} | changed
    if isinstance(value, Mapping):
        return {name: _plain(item) for name, item in value.items()}
    return [_plain(item) for item in value] if isinstance(value, tuple) else value


@cache
def _defaults(kind: type[Any]) -> dict[str, Any]:
    if issubclass(kind, Scalar):
        return kind._field_defaults
    return {
        field.name: field.default if field.default_factory is MISSING else field.default_factory()
        for field in fields(kind)
    }


@cache
def sources() -> str:
    """SHA-256, in hexadecimal, of all that a table of a part depends on."""
    content = hashlib.sha256()
    for folder in WATCHED:
        for path in sorted((ROOT / folder).rglob("*")):
            inside = path.relative_to(ROOT).as_posix()
            if (
                path.is_file()
                and "__pycache__" not in inside
                and not re.match("(tests|tools)/results/|tests/webots/|deepbots_cli/cli/help/", inside)
            ):
                content.update(inside.encode() + b"\0" + path.read_bytes() + b"\0")
    return content.hexdigest()


# Pieces


@dataclass(frozen=True)
class Piece:
    """An entry of a record under `keys`, and how it is measured."""

    words: str
    record: Path
    keys: tuple[str, ...]
    request: Callable[[], Request]
    measure: Callable[[], dict[str, Any]]
    crossings: frozenset[str] = frozenset()

    def missing(self) -> bool:
        entry: Any = read(self.record)
        for key in self.keys:
            entry = entry.get(key, {})
        return not self.request().is_answered_by(entry) or not self.crossings <= set(
            entry.get("crossings", ())
        )

    def complete(self) -> None:
        entry = {**self.request()._asdict(), **circumstances(), **self.measure()}
        put(self.record, entry, *self.keys)


def pieces(subject: Experiment | Part, places: Places) -> Iterator[Piece]:
    """A training with its evaluations for each seed, and the baselines; or the tables of a part."""
    record = places.record(subject.name)
    if isinstance(subject, Part):
        for table in subject.tables:
            request = partial(lambda command: Request(sources(), command), table.command)
            yield Piece(
                f"{subject.name}: {table.name}",
                record,
                ("tables", table.name),
                request,
                partial(_table, table),
            )
        return
    scenario = subject.scenario
    if subject.engines:
        request = partial(speeds_request, scenario, subject.engines)
        yield Piece(
            f"{subject.name}: engines",
            record,
            ("engines",),
            request,
            partial(_speeds, scenario, subject.engines),
        )
    for training in subject.trainings:
        for seed in training.seeds:
            name = f"{subject.name} {seed}" + ("" if training.name == "main" else f" ({training.name})")
            folder = partial(_folder, subject, training, seed, places)
            keys = ("trainings", training.name, str(seed))
            request = partial(training_request, scenario, training, seed)
            crossings = _crossings(subject, training)
            train = partial(_train, scenario, training, seed, folder, crossings)
            yield Piece(
                f"{name}: training",
                record,
                keys,
                request,
                train,
                frozenset(crossed.key for crossed in crossings),
            )
            for evaluation in training.evaluations:
                request = partial(evaluation_request, scenario, training, evaluation)
                measure = partial(_evaluate, scenario, training, seed, folder, evaluation)
                yield Piece(
                    f"{name}: {evaluation.name}",
                    record,
                    (*keys, "evaluations", evaluation.name),
                    request,
                    measure,
                )
    for baseline in subject.baselines:
        request = partial(baseline_request, scenario, baseline)
        measure = partial(_try, scenario, baseline)
        yield Piece(
            f"{subject.name}: {baseline.name}", record, ("baselines", baseline.name), request, measure
        )


class CommandError(Exception):
    """A command has ended in the exit code `code`."""

    def __init__(self, code: int, command: str) -> None:
        super().__init__(f"exit code {code} of: {command}")
        self.code = code


def deepbots(*words: str) -> tuple[Any, float]:
    """What a command prints with --json, and its CPU seconds, user and system.

    Raises:
        CommandError: It fails; it says why on standard error.
    """
    text, code, seconds = _python("deepbots_cli", *words, "--json")
    if code:
        raise CommandError(code, f"deepbots {shlex.join(words)}")
    return json.loads(text), seconds


def _python(*words: str) -> tuple[str, int, float]:
    """`python -m ...` at the root of the repository: what it prints, its exit code and its CPU seconds."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    done = subprocess.run(
        [sys.executable, "-m", *words], cwd=ROOT, stdout=subprocess.PIPE, text=True, check=False
    )
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return done.stdout, done.returncode, after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def _folder(experiment: Experiment, training: Training, seed: int, places: Places) -> Path:
    """The run directory: one of its own for each request."""
    key = hashlib.sha256(
        " ".join(training_request(experiment.scenario, training, seed)).encode()
    ).hexdigest()[:10]
    return places.runs / experiment.name / f"{training.name}-{seed}-{key}"


def _crossings(experiment: Experiment, training: Training) -> list[Crossed]:
    figures = [bar.figure for bar in experiment.bars]
    return [figure for figure in figures if isinstance(figure, Crossed) and figure.training == training.name]


def _trained(scenario: str, training: Training, seed: int, folder: Path) -> tuple[Run, float]:
    """The finished run, trained or gone on with where it is not, and the CPU seconds of this."""
    seconds = 0.0
    if not (folder / "run.json").exists():
        folder.parent.mkdir(parents=True, exist_ok=True)
        seconds = deepbots("train", scenario, "--seed", str(seed), *training.options, "--run", str(folder))[1]
    elif Run.open(folder).record.status != "finished":
        seconds = deepbots("resume", str(folder))[1]
    return Run.open(folder), seconds


def _train(
    scenario: str, training: Training, seed: int, folder: Callable[[], Path], crossings: list[Crossed]
) -> dict[str, Any]:
    run, seconds = _trained(scenario, training, seed, folder())
    result = run.record.result
    assert result is not None  # it is finished
    curve = points(run.monitor)
    last = run.program.curriculum[-1].name if run.program.curriculum else ""
    return {
        "steps": result.steps,
        "episodes": result.episodes,
        "simulated_hours": round(result.simulated_hours, 4),
        # Of a training that was stopped, the process that ended it does not know the time of the others; the
        # run does.
        "cpu_seconds": round(max(seconds, result.cpu_seconds), 1),
        "times_resumed": len(run.record.resumed_at),
        "solved_at": None if result.solved_at is None else asdict(result.solved_at),
        "stage": result.stage,
        "stages": [
            asdict(end) | {"simulated_hours": round(end.steps * run.program.period / 3600, 4)}
            for end in result.stages
        ],
        "crossings": {crossed.key: crossing(curve, crossed, last) for crossed in crossings},
        "curve": thinned(curve),
        "evaluations": {},
    }


def _evaluate(
    scenario: str, training: Training, seed: int, folder: Callable[[], Path], evaluation: Evaluation
) -> dict[str, Any]:
    words = [str(_trained(scenario, training, seed, folder())[0].path), *evaluation.options]
    if evaluation.scenario is None and not training.sets:
        words += ["--scenario", scenario]  # whose cases may have come after the training
    result, seconds = deepbots("eval", *words)
    cases = {case["case"]: {key: case[key] for key in KEPT} for case in result["cases"]}
    return {"cpu_seconds": round(seconds, 1), **{key: result[key] for key in KEPT}, "cases": cases}


def _try(scenario: str, baseline: Baseline) -> dict[str, Any]:
    result, seconds = deepbots("try", scenario, *baseline.all_options)
    return {"cpu_seconds": round(seconds, 1), **{key: result["summary"][key] for key in KEPT}}


def _speeds(scenario: str, engines: tuple[str, ...]) -> dict[str, Any]:
    result, seconds = deepbots(*shlex.split(speeds_request(scenario, engines).command)[1:])
    return {
        "cpu_seconds": round(seconds, 1),
        "step_us": {row["engine"]: round(row["step_us"], 1) for row in result["speeds"]},
    }


def _table(table: Any) -> dict[str, Any]:
    if isinstance(table, Holding):
        chosen = ["-k", table.expression, "-m", table.marker]
        text, code, seconds = _python(
            "pytest",
            table.folder,
            *chosen,
            "-p",
            "no:cacheprovider",
            "-o",
            "addopts=--import-mode=importlib",
            "-q",
        )
        if code not in (0, 1):
            raise CommandError(code, f"{table.command}\n{text}")
        counted = re.findall(r"(\d+) (passed|failed|skipped|error)", text.strip().splitlines()[-1])
        counts = {"passed": 0, "failed": 0} | {word: int(count) for count, word in counted}
        rows: Any = [{"what": table.name, "met": code == 0, **counts}]
    else:
        text, code, seconds = _python(f"tools.benchmarks.{table.name}", "--json")
        if code:
            raise CommandError(code, table.command)
        rows = json.loads(text)
    return {"cpu_seconds": round(seconds, 1), "rows": rows}


# The learning curve


class Point(NamedTuple):
    """Means over the last 100 episodes of the stage, or over as many as there are; `full` says that there are
    as many."""

    episode: int
    steps: int
    simulated_hours: float
    mean_return: float
    success: float
    full: bool
    stage: str


def points(monitor: Path) -> list[Point]:
    """A point for each episode of the stage that the training is in; those that began in an earlier stage are
    left out."""
    recent: deque[tuple[float, bool]] = deque(maxlen=WINDOW)
    begun: list[str] = []
    curve = []
    for row in read_log(monitor):
        if row["stage"] not in begun:
            begun.append(row["stage"])
            recent.clear()
        if row["stage"] == begun[-1]:
            recent.append((float(row["r"]), row["is_success"] == "1"))
            mean, share = (sum(values) / len(recent) for values in zip(*recent, strict=True))
            place = int(row["episode"]), int(row["steps"]), float(row["simulated_hours"])
            curve.append(Point(*place, mean, share, len(recent) == WINDOW, row["stage"]))
    return curve


def thinned(curve: list[Point]) -> dict[str, list[float]]:
    """Return at most `POINTS` points: the last one of each of as many intervals of simulated time.

    The first nine points are left out, because each is a mean of fewer than ten episodes.
    """
    averaged = curve[9:] or curve
    width = averaged[-1].simulated_hours / POINTS if averaged else 0.0
    last_points = {math.ceil(point.simulated_hours / width): point for point in averaged}.values()
    return {
        "simulated_hours": [round(point.simulated_hours, 4) for point in last_points],
        "return": [float(f"{point.mean_return:.4g}") for point in last_points],
        "success": [round(point.success, 3) for point in last_points],
    }


def crossing(curve: list[Point], crossed: Crossed, stage: str = "") -> dict[str, Any] | None:
    """The first mean over 100 episodes of the last `stage` that reaches the threshold; None if there is
    none."""
    for point in curve:
        value = point.mean_return if crossed.metric == "return" else point.success
        if point.full and point.stage == stage and value >= crossed.threshold:
            return {"episode": point.episode, "steps": point.steps, "simulated_hours": point.simulated_hours}
    return None
