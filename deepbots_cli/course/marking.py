"""The marks of one step: the teacher's task, with the parts of the student in it, against the checks.

World, endings, `solved`, tests, engine and seeds are those of the teacher. A check that a text fails names
its place; a test that fails says what was expected and measured.
"""

from __future__ import annotations

import json
import re
import shutil
import zipfile
from collections.abc import Iterator, Sequence
from dataclasses import field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from deepbots_cli import api
from deepbots_cli.course.hand_ins import HandInError, read_step, write_parts
from deepbots_cli.course.lessons import (
    ANSWERS_NAME,
    CHECKS,
    HANDED_IN,
    START,
    Check,
    Lesson,
    Step,
    rate_or_return,
    read_mapping,
)
from deepbots_cli.document import ScalarNode, to_data
from deepbots_cli.engine_kinds import chosen
from deepbots_cli.errors import DeepbotsError, ScenarioError
from deepbots_cli.expressions import parser, syntax
from deepbots_cli.expressions.dimensions import NUMBER, Dimension
from deepbots_cli.records import dataclass
from deepbots_cli.words import beside, number_text, rate_text

if TYPE_CHECKING:
    from deepbots_cli.api import Compiled
    from deepbots_cli.diagnostics import Finding
    from deepbots_cli.learning.runs.run import Run
    from deepbots_cli.program.task import ScenarioTest

UNCHANGED = "not changed yet"
_MAX_REASON = 400
_YES_OR_NO = {"true": "yes", "false": "no"}
_MISSING_TEST = "the task has no such test; tell your teacher"
_Quantity = tuple[float, Dimension]
"""A number in SI units, and its dimension."""
_WEIGHTS = "policy.pth"
"""The file of a model of Stable-Baselines3 with its weights."""


@dataclass(frozen=True)
class CheckMark:
    """The points for one check, of `of`; `reason` says why some are missing, or what was measured."""

    says: str
    points: int
    of: int
    reason: str = ""


@dataclass(frozen=True)
class StepMark:
    """The marks of a step.

    Attributes:
        step: The name of the step.
        checks: A mark for each check.
        remarks: What the marker saw beside the checks, such as changed sections that have no effect.
        weights: The digest of the policy that was handed in; empty without one.
        parts: The digest of the parts that were handed in; empty if they cannot be read.
    """

    step: str
    checks: tuple[CheckMark, ...]
    remarks: tuple[str, ...] = ()
    weights: str = ""
    parts: str = ""

    @property
    def points(self) -> int:
        return sum(check.points for check in self.checks)

    @property
    def of(self) -> int:
        return sum(check.of for check in self.checks)


def nothing(name: str, step: Step, reason: str, remarks: Sequence[str] = ()) -> StepMark:
    """Return the marks of a step that cannot be marked."""
    short = " ".join(reason.split())[:_MAX_REASON]
    return StepMark(
        name, tuple(CheckMark(check.says, 0, check.points, short) for check in step.checks), tuple(remarks)
    )


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
    """

    lesson: Lesson
    folder: Path
    work: Path
    seed: int = 0
    train: bool = False
    takes_unchanged: bool = False
    remarks: list[str] = field(default_factory=list)

    def mark(self, name: str) -> StepMark:
        """Return the marks of a step. Mistakes of the student are reasons, not errors."""
        step = self.lesson.steps[name]
        self.remarks = []
        answers = self._answers()
        reason = ""
        if step.parts:
            try:
                return self._marked(name, step, answers)
            except HandInError as error:
                reason = str(error)
            except ScenarioError as error:
                errors = [finding for finding in error.findings if finding.severity == "error"]
                own = [error for error in errors if HANDED_IN in Path(error.span.source.name).parts]
                reason = self._finding(name, (own or errors)[0])
        marks = zip(nothing(name, step, reason).checks, step.checks, strict=True)
        checks = (self._answered(check, answers) if check.kind == "answer" else mark for mark, check in marks)
        return StepMark(name, tuple(checks), tuple(self.remarks))

    def _marked(self, name: str, step: Step, answers: dict[str, Any]) -> StepMark:
        """Return the marks of the teacher's task with the parts of the student.

        Raises:
            HandInError: The file of the step is missing, unchanged, broken, or has what no part may have.
            ScenarioError: The task has errors with these parts.
        """
        written = read_step(self.folder, name, step, self.lesson.folder / START)
        self.remarks += written.remarks
        if not written.is_changed and not self.takes_unchanged:
            raise HandInError(UNCHANGED)
        project = self.work / name
        for folder in (START, CHECKS):
            shutil.copytree(self.lesson.folder / folder, project / folder)
        (project / "deepbots.toml").touch()  # one project, so that a task may extend the world of `start`
        write_parts(written, step, self.folder, project / CHECKS)
        task = project / CHECKS / f"{name}.yaml"
        compiled = api.compile(_with_tests(task, ()))
        tests = self._tests(name, task, step)
        policy = _Policy(self, name, compiled)
        marks = []
        for check in step.checks:
            try:
                match check.kind:
                    case "test":
                        marks.append(self._tested(check, compiled, tests[check.test or ""]))
                    case "without":
                        marks.append(self._linted(name, check, compiled.findings))
                    case "answer":
                        marks.append(self._answered(check, answers))
                    case "policy":
                        marks.append(policy.mark(check))
            except DeepbotsError as error:
                reason = str(error).replace(f"{self.folder}/", "").replace(f"{self.work}/", "")
                marks.append(CheckMark(check.says, 0, check.points, " ".join(reason.split())[:_MAX_REASON]))
        return StepMark(name, _guarded(step, marks), tuple(self.remarks), policy.weights, written.digest)

    def _finding(self, name: str, finding: Finding) -> str:
        position = finding.span.start_position
        is_of_student = HANDED_IN in Path(finding.span.source.name).parts
        place = f":{position.line}:{position.column}" if is_of_student else " lacks what the test needs"
        help = f"; {finding.help}" if finding.help else ""
        return f"{name}.yaml{place}: {finding.headline} ({finding.code}){help}"

    def _tests(self, name: str, task: Path, step: Step) -> dict[str, ScenarioTest | str]:
        """Return the tests of the step. For one that cannot be compiled with the parts of the student, because
        it names what they lack, return the reason."""
        tests: dict[str, ScenarioTest | str] = {}
        for one in (check.test for check in step.checks if check.test is not None):
            checked = api.load(_with_tests(task, (one,)), tests=True)
            errors = [finding for finding in checked.findings if finding.severity == "error"]
            tests[one] = (
                self._finding(name, errors[0]) if errors else next(iter(checked.tests), _MISSING_TEST)
            )
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

    def _answers(self) -> dict[str, Any]:
        path = self.folder / ANSWERS_NAME
        if path.is_symlink() or not path.is_file():
            return {}
        node, _ = read_mapping(path, ANSWERS_NAME)
        entries = {} if node is None else node.entries
        return {key: entry.value for key, entry in entries.items()}

    def _answered(self, check: Check, answers: dict[str, Any]) -> CheckMark:
        node = answers.get(check.answer or "")
        if not isinstance(node, ScalarNode) or node.value is None or not node.text.strip():
            reason = f"there is no answer in {ANSWERS_NAME}: write it after `{check.answer}:` and a space"
            return CheckMark(check.says, 0, check.points, reason)
        if any(is_right(node.text, expected) for expected in check.right):
            return CheckMark(check.says, check.points, check.points)
        number = _quantity(_tree(node.text))
        most = [most for _, most in map(_ends, check.right) if most is not None]
        lacks_unit = number is not None and any(dimension != number[1] for _, dimension in most)
        help = "; does it have the right unit?" if lacks_unit else ""
        reason = f"`{node.text[:60]}` is not right ({node.span.location}){help}"
        return CheckMark(check.says, 0, check.points, reason)


def _guarded(step: Step, marks: Sequence[CheckMark]) -> tuple[CheckMark, ...]:
    """Return the marks of a step, in which guards count only together with another check of the task."""
    pairs = [*zip(step.checks, marks, strict=True)]
    if any(mark.points and not check.guard and check.kind != "answer" for check, mark in pairs):
        return tuple(marks)
    reason = "it counts only together with another check of this step"
    return tuple(
        replace(mark, points=0, reason=mark.reason or reason) if check.guard else mark
        for check, mark in pairs
    )


def _with_tests(task: Path, names: Sequence[str]) -> Path:
    """Write a task with only these of its tests beside it; JSON is YAML. Returns its path."""
    node, _ = read_mapping(task)
    data: Any = {} if node is None else to_data(node)
    tests = {name: test for name, test in (data.pop("tests", None) or {}).items() if name in names}
    path = task.with_name("-".join((task.stem, "only", *names)) + ".yaml")
    path.write_text(json.dumps(data | ({"tests": tests} if tests else {})), encoding="utf-8")
    return path


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


@dataclass
class _Policy:
    """The policy of a step: that of the newest run with the name of the step, or one that is trained here."""

    marker: Marker
    name: str
    compiled: Compiled
    weights: str = ""
    run: Run | None = None

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
        if is_rate:
            low, high = result.success_interval
            text = (
                f"{beside(100 * measured, 100 * next_bar, 3)[0]} % of {result.episodes} episodes succeed"
                f" (95 % interval {rate_text(low)} .. {rate_text(high)})"
            )
        else:
            text = f"the mean return of {result.episodes} episodes is {beside(measured, next_bar)[0]}"
        if reached < len(bars):
            text += f"; the next points are for {rate_text(next_bar) if is_rate else number_text(next_bar)}"
        self._compare_claim(measured, is_rate=is_rate, case=check.case)
        return CheckMark(check.says, points, check.points, text)

    def _handed_in(self) -> Run:
        from deepbots_cli.learning.runs.run import Run

        folders = [path for path in (self.marker.folder / "runs").glob(f"{self.name}-*") if path.is_dir()]
        numbered = sorted(
            folders, key=lambda path: [int(number) for number in re.findall(r"\d{1,9}", path.name)]
        )
        if not numbered:
            raise HandInError(
                f"there is no run of it in the folder runs: train it with `deepbots train {self.name}.yaml`"
            )
        try:
            run = Run.open(numbered[-1])
        except DeepbotsError:
            self.marker.remarks.append(
                f"{numbered[-1].name} is not a run that this version of deepbots wrote"
            )
            raise
        if not run.record.is_finished:
            self.marker.remarks.append(
                f"the training of {numbered[-1].name} is not finished: its best policy so far is judged"
            )
        self.weights = weights_digest(run.model("best"))
        from deepbots_cli.program.identity import task_digest

        if task_digest(run.program) != task_digest(self.compiled.program):
            self.marker.remarks.append(
                f"{numbered[-1].name} was trained in another task than that of the lesson,"
                " in which it is judged"
            )
        return run

    def _trained(self) -> Run:
        from deepbots_cli.learning import train
        from deepbots_cli.learning.runs.run import Run

        compiled = api.with_learner(self.compiled)
        folder = self.marker.work / "runs" / self.name
        train(compiled, run=folder, seed=self.marker.seed)
        return Run.open(folder)

    def _compare_claim(self, measured: float, *, is_rate: bool, case: str | None) -> None:
        """Remark a record that claims far more than was measured: it was edited, or made in an easier task."""
        quoted = None if self.run is None or self.marker.train else self.run.record.quoted
        claimed = getattr(quoted, "success_rate", None)
        if is_rate and case is None and isinstance(claimed, float) and claimed > measured + 0.3:
            self.marker.remarks.append(
                f"the record of the run claims {rate_text(claimed)} of success,"
                f" and {rate_text(measured)} was measured"
            )


def weights_digest(model: Path) -> str:
    """Return the digest of the weights in a model, which is the same for copies under other names."""
    try:
        with zipfile.ZipFile(model) as archive:
            weights = archive.getinfo(_WEIGHTS)
            return f"{weights.CRC:08x}-{weights.file_size}"
    except (OSError, KeyError, zipfile.BadZipFile):
        return ""


def as_data(mark: StepMark) -> dict[str, Any]:
    """Return marks as JSON; `from_data` reads it."""
    return {
        "step": mark.step,
        "points": mark.points,
        "of": mark.of,
        "checks": [vars(check) for check in mark.checks],
        "remarks": list(mark.remarks),
        "weights": mark.weights,
        "parts": mark.parts,
    }


def from_data(data: dict[str, Any]) -> StepMark:
    return StepMark(
        data["step"],
        tuple(CheckMark(**check) for check in data["checks"]),
        tuple(data["remarks"]),
        data["weights"],
        data["parts"],
    )


def without_policy(mark: StepMark, step: Step, reason: str) -> StepMark:
    """Return marks in which the policy earns nothing."""
    checks: Iterator[CheckMark] = (
        replace(earned, points=0, reason=reason) if check.kind == "policy" else earned
        for earned, check in zip(mark.checks, step.checks, strict=True)
    )
    return replace(mark, checks=tuple(checks))
