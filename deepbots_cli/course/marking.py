"""The marks of one step: the teacher's task, with the parts of the student in it, against the checks.

World, endings, `solved`, tests, engine and seeds are those of the teacher. A check that a text fails names
its place; a test that fails says what was expected and measured.
"""

from __future__ import annotations

import json
import re
import shutil
from collections.abc import Callable, Iterator, Sequence
from dataclasses import field, replace
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING

from deepbots_cli import __version__, api
from deepbots_cli.compiler.inputs import RESOLVED_NAME
from deepbots_cli.course.copies import Weights, weights_of
from deepbots_cli.course.hand_ins import (
    HandInError,
    StepFile,
    is_in_parts,
    read_step,
    trained_task,
    write_parts,
)
from deepbots_cli.course.lessons import (
    ANSWERS_NAME,
    CHECKS,
    HANDED_IN,
    START,
    Check,
    Lesson,
    Step,
    data_of,
    rate_or_return,
    read_mapping,
    settings_of,
)
from deepbots_cli.diagnostics import Findings
from deepbots_cli.document import Node, ScalarNode
from deepbots_cli.document.load import read_alone
from deepbots_cli.document.nodes import node_at
from deepbots_cli.engine_kinds import chosen
from deepbots_cli.errors import DeepbotsError, ScenarioError, StorageError
from deepbots_cli.expressions import parser, syntax
from deepbots_cli.expressions.dimensions import NUMBER, Dimension
from deepbots_cli.records import dataclass
from deepbots_cli.words import beside, number_text, rate_text, sentence_list, shell_word

if TYPE_CHECKING:
    from deepbots_cli.api import Compiled
    from deepbots_cli.diagnostics import Finding
    from deepbots_cli.learning.runs.run import Run
    from deepbots_cli.program.task import ScenarioTest

UNCHANGED = "not changed yet"
_MAX_REASON = 400
_NAMES_OF_TESTS = re.compile(r"`test_\w+`, |, `test_\w+`")
"""Names that a teacher's test adds, in a list of the names that can be used."""
_YES_OR_NO = {"true": "yes", "false": "no"}
_Quantity = tuple[float, Dimension]
"""A number in SI units, and its dimension."""
_UNTRAINED = ("deepbots", "evaluation", "name", "role", "scripts", "solved", "summary", "tests", "train")
"""The sections that a student may change without training in another task, unless they are parts of it."""


@dataclass(frozen=True)
class CheckMark:
    """The points for one check, of `of`; `reason` says why some are missing, or what was measured. One that is
    open was not marked, and is to be marked again."""

    says: str
    points: int
    of: int
    reason: str = ""
    is_open: bool = False
    measured: float | None = None
    """The success rate or mean return of a policy."""

    @property
    def score(self) -> str:
        return f"{'?' if self.is_open else self.points}/{self.of}"


@dataclass(frozen=True)
class StepMark:
    """The marks of a step.

    Attributes:
        step: The name of the step.
        checks: A mark for each check.
        remarks: What the marker saw beside the checks, such as changed sections that have no effect.
        policy: The weights of the policy that was handed in; None without one.
        models: The weights of all models that were handed in for the step.
        parts: The digest of the parts that were handed in; empty if they cannot be read.
        engine: The engine of the task; empty if nothing was measured.
    """

    step: str
    checks: tuple[CheckMark, ...]
    remarks: tuple[str, ...] = ()
    policy: Weights | None = None
    models: tuple[Weights, ...] = ()
    parts: str = ""
    engine: str = ""

    @property
    def is_open(self) -> bool:
        return any(check.is_open for check in self.checks)

    @property
    def score(self) -> str:
        return "not marked" if self.is_open else f"{self.points} of {self.of}"

    @property
    def common_reason(self) -> str:
        """The reason of all checks, if it is one."""
        reasons = {check.reason for check in self.checks}
        return reasons.pop() if len(reasons) == 1 else ""

    @property
    def points(self) -> int:
        return sum(check.points for check in self.checks)

    @property
    def of(self) -> int:
        return sum(check.of for check in self.checks)


def unfinished(
    name: str, step: Step, reason: str, finished: Sequence[CheckMark] = (), *, is_open: bool = False
) -> StepMark:
    """Return the marks of a step of which only some checks were finished; `reason` says why the others were
    not. Open ones may be marked again, and the others earn nothing."""
    short = " ".join(reason.split())[:_MAX_REASON]
    rest = [CheckMark(check.says, 0, check.points, short, is_open) for check in step.checks[len(finished) :]]
    return StepMark(name, guarded(step, [*finished, *rest]))


@dataclass
class Marker:
    """Marks the steps of one hand-in.

    Attributes:
        lesson: The lesson.
        folder: The copy of what was handed in.
        work: A folder for the composed tasks.
        seed: The root seed of evaluations, which students do not know.
        train: Whether to train a policy where a check needs one, in place of the one that was handed in.
        takes_unchanged: Whether to mark also what was not changed.
        on_check: Called after each check with the marks of the step so far.
        remarks: What the marker saw beside the checks of the step.
        parts: The parts that were handed in for the step.
    """

    lesson: Lesson
    folder: Path
    work: Path
    seed: int = 0
    train: bool = False
    takes_unchanged: bool = False
    on_check: Callable[[Sequence[CheckMark]], object] = lambda checks: None
    remarks: list[str] = field(default_factory=list)
    parts: dict[str, Node] = field(default_factory=dict)

    def mark(self, name: str) -> StepMark:
        """Return the marks of a step. Mistakes of the student are reasons, not errors.

        Raises:
            OSError, StorageError: The disk of the grader is full.
        """
        step = self.lesson.steps[name]
        self.remarks = []
        reason = ""
        if step.parts:
            try:
                return self._marked(name, step)
            except HandInError as error:
                reason = str(error)
            except ScenarioError as error:
                errors = [finding for finding in error.findings if finding.severity == "error"]
                own = [error for error in errors if _is_handed_in(error)]
                reason = self._finding(name, (own or errors)[0])
        marks = zip(unfinished(name, step, reason).checks, step.checks, strict=True)
        checks = (self._answered(check) if check.kind == "answer" else mark for mark, check in marks)
        return StepMark(name, tuple(checks), tuple(self.remarks))

    def _marked(self, name: str, step: Step) -> StepMark:
        """Return the marks of the teacher's task with the parts of the student.

        Raises:
            HandInError: The file of the step is missing, unchanged, broken, or has what no part may have.
            ScenarioError: The task has errors with these parts.
        """
        written = read_step(self.folder, name, step, self.lesson.folder / START)
        self.remarks += written.remarks
        self.parts = written.parts
        if not written.is_changed and not self.takes_unchanged:
            raise HandInError("; ".join((UNCHANGED, *self._own_errors(name))))
        project = self.work / name
        for folder in (START, CHECKS):
            shutil.copytree(self.lesson.folder / folder, project / folder)
        (project / "deepbots.toml").touch()  # one project, so that a task may extend the world of `start`
        write_parts(written, step, self.folder, project / CHECKS)
        task = project / CHECKS / f"{name}.yaml"
        compiled = api.compile(_with_tests(task, ()), overrides=written.assignments)
        tests = self._tests(name, task, step, written.assignments)
        policy = _Policy(self, name, compiled, written)
        marks = []
        for check in step.checks:
            try:
                match check.kind:
                    case "test":
                        marks.append(self._tested(check, compiled, tests[check.test or ""]))
                    case "without":
                        marks.append(self._linted(name, check, compiled.findings))
                    case "answer":
                        marks.append(self._answered(check))
                    case "policy":
                        marks.append(policy.mark(check))
            except StorageError:
                raise
            except DeepbotsError as error:
                reason = str(error).replace(f"{self.folder}/", "").replace(f"{self.work}/", "")
                marks.append(CheckMark(check.says, 0, check.points, " ".join(reason.split())[:_MAX_REASON]))
            self.on_check(marks)
        checks, remarks = guarded(step, marks), tuple(self.remarks)
        engine = chosen(compiled.program.engine)
        return StepMark(name, checks, remarks, policy.weights, tuple(policy.models), written.digest, engine)

    def _own_errors(self, name: str) -> Iterator[str]:
        """Yield the first error in the file of a step whose parts are as in `start`: a sensor that is indented
        too little is no part. The world that a file extends need not be handed in."""
        own = self.folder / f"{name}.yaml"
        if own.read_bytes() != (self.lesson.folder / START / own.name).read_bytes():
            errors = (finding for finding in api.load(own).findings if finding.severity == "error")
            first = (error for error in islice(errors, 1) if error.code != "DB204")
            yield from (self._finding(name, error, is_of_student=True) for error in first)

    def _finding(
        self, name: str, finding: Finding, test: Node | None = None, *, is_of_student: bool = False
    ) -> str:
        """Return a finding with its place in the file of the student; one of a test, or of what it needs, with
        that in the teacher's task."""
        source = finding.span.source
        value = self.parts.get(source.assigned or "")
        place = f"{name}.yaml"
        if is_of_student or value is not None or _is_handed_in(finding):
            if Path(source.name).name in self.lesson.steps[name].files:
                place = Path(source.name).name
            place += ":{}:{}".format(*(value or finding).span.start_position)
        else:
            span = (test or finding).span
            place += " does not fit a test of the teacher ({}/{}:{})".format(
                *Path(span.source.name).parts[-2:], span.start_position.line
            )
        text = f"{finding.headline} ({finding.code})" + (f"; {finding.help}" if finding.help else "")
        return f"{place}: {_NAMES_OF_TESTS.sub('', text)}"

    def _tests(
        self, name: str, task: Path, step: Step, assignments: Sequence[str]
    ) -> dict[str, ScenarioTest | str]:
        """Return the tests of the step. For one that cannot be compiled with the parts of the student, because
        it names what they lack, return the reason."""
        tests: dict[str, ScenarioTest | str] = {}
        root = read_mapping(task)
        for one in (check.test for check in step.checks if check.test is not None):
            checked = api.load(_with_tests(task, (one,)), overrides=assignments, tests=True)
            errors = [finding for finding in checked.findings if finding.severity == "error"]
            reason = self._finding(name, errors[0], node_at(root, "tests", one)) if errors else ""
            tests[one] = reason or checked.tests[0]
        return tests

    def _tested(self, check: Check, compiled: Compiled, test: ScenarioTest | str) -> CheckMark:
        from deepbots_cli.learning.scenario_tests import run_tests

        if isinstance(test, str):
            return CheckMark(check.says, 0, check.points, test)
        (result,) = run_tests(compiled.program, [test], engine=compiled.program.engine)
        if result.passed:
            return CheckMark(check.says, check.points, check.points)
        unmet = result.unmet[0]
        reason = f"expected {unmet.expected}; measured: {unmet.measured}"
        if unmet.key:
            reason = check.fails.get(unmet.key, reason)
        for text, value in unmet.values.items():
            reason = reason.replace(f"{{{text}}}", value)
        return CheckMark(check.says, 0, check.points, reason)

    def _linted(self, name: str, check: Check, findings: Sequence[Finding]) -> CheckMark:
        finding = next((finding for finding in findings if finding.code == check.without), None)
        if finding is None:
            return CheckMark(check.says, check.points, check.points)
        return CheckMark(check.says, 0, check.points, self._finding(name, finding))

    def _answered(self, check: Check) -> CheckMark:
        path = self.folder / ANSWERS_NAME
        is_file = path.is_file() and not path.is_symlink()
        root, findings = read_alone(path, ANSWERS_NAME) if is_file else (None, Findings())
        errors = (finding for finding in findings if finding.severity == "error")
        # Other answers may be open still (DB107).
        if error := next((error for error in errors if error.code != "DB107"), None):
            return CheckMark(check.says, 0, check.points, f"{error.span.location}: {error.headline}")
        node = node_at(root, check.answer or "")
        if not isinstance(node, ScalarNode) or node.value is None or not node.text.strip():
            reason = (
                f"there is no answer in {ANSWERS_NAME}: write one value after `{check.answer}:` and a space"
            )
            return CheckMark(check.says, 0, check.points, reason)
        if any(is_right(node.text, expected) for expected in check.right):
            return CheckMark(check.says, check.points, check.points)
        number = _quantity(_tree(node.text))
        most = [most for _, most in map(_ends, check.right) if most is not None]
        lacks_unit = number is not None and any(dimension != number[1] for _, dimension in most)
        help = "; does it have the right unit?" if lacks_unit else ""
        reason = f"`{node.text[:60]}` is not right ({node.span.location}){help}"
        return CheckMark(check.says, 0, check.points, reason)


def guarded(step: Step, marks: Sequence[CheckMark]) -> tuple[CheckMark, ...]:
    """Return the marks of a step, in which guards count only together with another check of the task."""
    pairs = [*zip(step.checks, marks, strict=True)]
    if any(mark.points and not check.guard and check.kind != "answer" for check, mark in pairs):
        return tuple(marks)
    reason = "this is right, and counts once another check of this step earns points"
    return tuple(
        replace(mark, points=0, reason=mark.reason or reason) if check.guard else mark
        for check, mark in pairs
    )


def _with_tests(task: Path, names: Sequence[str]) -> Path:
    """Write a scenario that extends a task, with only these of its tests; JSON is YAML. Returns its path."""
    tests = data_of(task)["tests"] if names else {}
    data = {"deepbots": 1, "extends": task.name, "tests": {name: tests[name] for name in names}}
    path = task.with_name("-".join((task.stem, "only", *names)) + ".yaml")
    path.write_text(json.dumps(data), encoding="utf-8")
    return path


def _is_handed_in(finding: Finding) -> bool:
    return HANDED_IN in Path(finding.span.source.name).parts


def is_right(text: str, expected: str | float) -> bool:
    """Return whether an answer is the expected one: the same text but for case and spaces, the same quantity
    in any unit, or one in a range such as `3 .. 4` or `10 .. 20 ms`."""
    text = _YES_OR_NO.get(text.strip().lower(), text)
    expected = _YES_OR_NO.get(str(expected).lower(), str(expected))
    answer = _quantity(_tree(text))
    least, most = _ends(expected)
    if least is None or most is None:
        return " ".join(text.lower().split()) == " ".join(expected.lower().split())
    return answer is not None and answer[1] == most[1] and least[0] <= answer[0] <= most[0]


def _ends(expected: str | float) -> tuple[_Quantity | None, _Quantity | None]:
    """Return the ends of an expected range, or a number twice; None for a text."""
    wanted = _tree(str(expected))
    low, high = (wanted.low, wanted.high) if isinstance(wanted, syntax.Range) else (wanted, wanted)
    return _quantity(low), _quantity(high)


def _tree(text: str) -> syntax.Node | None:
    return parser.parse(text.strip(), lambda *_, **__: None) if text.strip() else None


def _quantity(node: syntax.Node | None) -> _Quantity | None:
    """Return a number; None for another text."""
    if not isinstance(node, syntax.Number):
        return None
    return (node.value, NUMBER) if node.unit is None else (node.unit.to_si(node.value), node.unit.dimension)


def _trained_last(run: Path) -> tuple[str, list[int]]:
    """Return when a run was trained last, and the numbers of its name; without a record, it comes first."""
    from deepbots_cli.learning.runs.run import RunRecord

    numbers = [int(number) for number in re.findall(r"\d{1,9}", run.name)]
    try:
        return RunRecord.read(run).updated, numbers
    except DeepbotsError:
        return "", numbers


@dataclass
class _Policy:
    """The policy of a step: that of the newest run with the name of the step, or one that is trained here."""

    marker: Marker
    name: str
    compiled: Compiled
    written: StepFile
    run: Run | None = None
    weights: Weights | None = None
    models: list[Weights] = field(default_factory=list)

    def mark(self, check: Check) -> CheckMark:
        """Return the marks for a policy: an equal share of the points for each bar that it reaches."""
        from deepbots_cli.learning.evaluation import evaluate

        if self.run is None:
            self.run = self._trained() if self.marker.train else self._handed_in()
        result = evaluate(
            self.run,
            scenario=self.compiled,
            case=check.case,
            engine=chosen(self.compiled.program.engine),
            episodes=check.episodes,
            seed=self.marker.seed,
        )
        is_rate, _ = rate_or_return(check.policy[0])
        measured = result.success_rate if is_rate else result.mean_return
        bars = sorted(rate_or_return(bar)[1] for bar in check.policy)
        reached = sum(measured >= bar for bar in bars)
        points = check.points * reached // len(bars)
        next_bar = next((bar for bar in bars if measured < bar), bars[-1])
        form = rate_text if is_rate else number_text
        if is_rate:
            text = f"{beside(100 * measured, 100 * next_bar, 3)[0]} % of {result.episodes} episodes succeed"
        else:
            text = f"the mean return of {result.episodes} episodes is {beside(measured, next_bar)[0]}"
        text += f"; points from {sentence_list([form(bar) for bar in bars])}"
        interval = result.success_interval if is_rate else result.return_interval
        if interval is not None:
            between = f"{form(interval[0])} .. {form(interval[1])}"
            text += f"; 95 % interval {between}"
            for bar in bars:
                if interval[0] <= bar <= interval[1]:
                    near = f"near the bar of {form(bar)}"
                    text += f", {near}"
                    self.marker.remarks.append(
                        f"{self.name}: {near}: {between}; another seed may give other points"
                    )
        return CheckMark(check.says, points, check.points, text, measured=measured)

    def _handed_in(self) -> Run:
        """Return the newest run of the step.

        Raises:
            HandInError: There is none, or it was trained in another way than the lesson asks for.
        """
        from deepbots_cli.course.evidence import unexplained
        from deepbots_cli.learning.runs.episodes import read_evaluations
        from deepbots_cli.learning.runs.run import Run

        folder = self.marker.folder / "runs"
        folders = [path for path in folder.glob(f"{self.name}-*") if path.is_dir() and not path.is_symlink()]
        folders.sort(key=_trained_last)
        command = f"`deepbots train {self.name}.yaml`"
        if not folders:
            raise HandInError(f"there is no run of it in the folder runs: train it with {command}")
        files = [
            file
            for path in reversed(folders)
            for file in sorted(path.glob("models/*/*.zip"), key=lambda file: file.name != "best.zip")
        ]
        self.models = weights_of(folder, files)
        newest = folders[-1]
        place = f"{newest.name}/best.zip"
        self.weights = next((model for model in self.models if model.place == place), None)
        try:
            run = Run.open(newest)
        except DeepbotsError:
            self.marker.remarks.append(f"{newest.name} is not a run that this version of deepbots wrote")
            raise
        record = run.record
        if record.deepbots == __version__ and record.digest != run.digest:
            raise HandInError(f"the scenario in {newest.name} was changed after the training")
        if changed := self._changed(run):
            listed = ", ".join(f"`{path}`" for path in changed[:5])
            raise HandInError(
                f"{newest.name} was trained in another task than this step:"
                f" {listed} {'differs' if len(changed) == 1 else 'differ'};"
                f" train what you hand in with {command}"
            )
        resolved = data_of(run.path / RESOLVED_NAME).get("train") or {}
        source = record.task.teacher or resolved.get("teacher") or record.initialized_from
        if source is not None and not self.marker.lesson.steps[self.name].teacher:
            raise HandInError(
                f"{newest.name} learned from `{source}`, which this step does not allow; train it with {command}"
            )
        if record.callbacks:
            raise HandInError(f"{newest.name} was trained with a callback; train it with {command}")
        if not read_evaluations(run.path):
            wait = (
                "ended before its first evaluation:"
                if record.is_finished
                else "has had no evaluation yet: wait, or"
            )
            raise HandInError(
                f"the training of {newest.name} {wait} go on with"
                f" `deepbots resume {shell_word(f'runs/{newest.name}')}`"
            )
        if reason := unexplained(run):
            reason = f"the training of {newest.name} does not explain its policy: {reason}"
            self.marker.remarks.append(f"{self.name}: {reason}")
            path = shell_word(f"runs/{newest.name}")
            raise HandInError(f"{reason}; go on with `deepbots resume {path}`, or train again")
        if not record.is_finished:
            self.marker.remarks.append(
                f"the training of {newest.name} is not finished: its best policy so far is judged"
            )
        return run

    def _changed(self, run: Run) -> list[str]:
        """Return the paths in which the scenario of a run differs from the files of the lesson with the parts
        of the student."""
        from deepbots_cli.program.identity import task_digest

        step, project = self.marker.lesson.steps[self.name], self.marker.work / self.name
        start, run_file = project / START / f"{self.name}.yaml", run.path / RESOLVED_NAME
        own, resolved = start.with_name("own.yaml"), start.with_name("resolved.yaml")
        own.write_text(json.dumps(trained_task(self.written, step, start)), encoding="utf-8")
        for name in step.files:
            shutil.copyfile(project / CHECKS / HANDED_IN / name, start.with_name(name))
        expected = api.compile(own)
        resolved.write_text(expected.resolved, encoding="utf-8")
        trained, asked = (settings_of(data_of(path)) for path in (run_file, resolved))
        is_same = task_digest(run.program) == task_digest(expected.program)
        unseen = ("curriculum", *_UNTRAINED)  # by the digest of the task
        return sorted(
            path
            for path in trained.keys() | asked.keys()
            if trained.get(path) != asked.get(path)
            and (path.split(".")[0] not in _UNTRAINED or is_in_parts(path, step.parts))
            and not (is_same and path.split(".")[0] not in unseen)
        )

    def _trained(self) -> Run:
        from deepbots_cli.learning import train
        from deepbots_cli.learning.runs.run import Run

        compiled = api.with_learner(self.compiled)
        folder = self.marker.work / "runs" / self.name
        train(compiled, run=folder, seed=self.marker.seed)
        return Run.open(folder)
