"""The scenario under other settings: a case of the evaluation, a stage of the curriculum.

Each is the same file with its `set` made, as `--set` would make it, and checked as a whole. What goes wrong only then is
a finding where it stands in the file. A policy has to fit all of them, so what it sees, does and sends must be the same.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING, Literal

from deepbots_cli import interface
from deepbots_cli.compiler.scoring import NO_SUCCESS
from deepbots_cli.diagnostics import Findings, Label, Span
from deepbots_cli.document import Document, Entry, Mapping, Path, descend
from deepbots_cli.document.load import place
from deepbots_cli.document.nodes import follow, measure, without
from deepbots_cli.program import CurriculumStage, EvaluationCase, Program
from deepbots_cli.program.training import Criterion
from deepbots_cli.scenario.fields import read_until
from deepbots_cli.scenario.scenario import Scenario

if TYPE_CHECKING:
    from deepbots_cli.compiler import Checked

MOST = 64
"""Cases and stages of one scenario; each is compiled."""
MOST_VALUES = 40_000
"""Of all of them together. The largest scenario that comes with deepbots has 500, of which all 64 would take 32 000."""

_FIXED = ("deepbots", "name", "summary", "agent", "action", "observation", "goal", "curriculum", "evaluation", "solved", "train")
_OTHERS: tuple[Path, ...] = (("curriculum",), ("evaluation", "cases"))

Check = Callable[[Document], "Checked"]
Word = Literal["case", "stage"]


def with_cases(
    document: Document, spec: Scenario, program: Program, findings: Findings, check: Check
) -> tuple[tuple[Checked, ...], Program]:
    """Check every case and stage of a scenario that is sound itself: what came of each, and the task with those that are sound too."""
    if document.root is None:
        return (), program
    maker = _Maker(document, document.root, program, findings, check)
    count, size = len(spec.evaluation.cases) + len(spec.curriculum), measure(document.root)[0]
    if count > MOST or count * size > MOST_VALUES:
        many = f"more than {MOST} cases and stages" if count > MOST else f"{count} cases and stages of a scenario with {size:_} values"
        maker.report("DB005", ("curriculum",) if spec.curriculum else ("evaluation", "cases"), many)
        return (), program
    maker.check_order(spec)
    cases = [
        (name, case.episodes or spec.evaluation.episodes, maker.program("case", name, ("evaluation", "cases", name)))
        for name, case in spec.evaluation.cases.items()
    ]
    stages = [(stage, maker.program("stage", stage.name, ("curriculum", index))) for index, stage in enumerate(spec.curriculum)]
    return tuple(maker.checked), replace(
        program,
        cases=tuple(EvaluationCase(name, episodes, made) for name, episodes, made in cases if made is not None),
        curriculum=tuple(CurriculumStage(stage.name, _criterion(stage.until), made) for stage, made in stages if made is not None),
    )


def _criterion(text: str | None) -> Criterion | None:
    found = read_until(text)
    return Criterion(*found) if found else None  # type: ignore[arg-type]  # the pattern allows the metrics only


class _Maker:
    """Checks the scenario under one group of settings after the other."""

    def __init__(self, document: Document, root: Mapping, program: Program, findings: Findings, check: Check) -> None:
        self.checked: list[Checked] = []
        self._document = document
        self._root = root
        self._base = program
        self._known = {found.sort_key for found in findings}
        self._findings = findings
        self._check = check

    def report(self, code: str, path: Path, headline: str, help: str | None = None) -> None:
        node, key, _ = descend(self._root, path)
        self._findings.add(code, key.span if key else node.span, headline, help=help)

    def check_order(self, spec: Scenario) -> None:
        """Every stage but the last says when it ends, and no two are called the same."""
        first: dict[str, Span] = {}
        for index, stage in enumerate(spec.curriculum):
            path: Path = ("curriculum", index)
            here = descend(self._root, (*path, "name"))[0].span
            if stage.name in first:
                also = (Label(first[stage.name], "first defined here"),)
                self._findings.add("DB202", here, f"`{stage.name}` is already a stage", help="choose another name", also=also)
            first.setdefault(stage.name, here)
            last = index == len(spec.curriculum) - 1
            found = read_until(stage.until)
            if found and found[0] == "success_rate" and not (spec.termination.success or spec.goal):
                help = "add a condition under `termination.success`, or ask for a `mean_return`"
                self.report("DB407", (*path, "until"), NO_SUCCESS, help)
            if stage.until is None and not last:
                help = "add `until: success_rate >= 0.7 over 40 episodes`"
                self._findings.add("DB102", here, f"the stage `{stage.name}` never ends, and others follow", help=help)
            elif stage.until is not None and last:
                help = "take it out; `solved` says when the training may end"
                self.report("DB407", (*path, "until"), "nothing follows the last stage", help)

    def program(self, word: Word, name: str, path: Path) -> Program | None:
        """The task under the `set` at `path`; None after a finding."""
        settings = descend(self._root, (*path, "set"))
        entries = settings[0].entries.values() if settings[2] > len(path) and isinstance(settings[0], Mapping) else ()
        if [entry for entry in entries if self._is_fixed(entry, word)]:
            return None
        findings = Findings(self._document.findings.limit)
        root = without(self._root, _OTHERS)
        assert isinstance(root, Mapping)  # as it was
        for entry in entries:
            root = place(root, entry, findings)
        checked = self._check(replace(self._document, root=root, findings=findings))
        self.checked.append(checked)
        here = self._place(word, path)
        written = [Span(entry.key.span.source, entry.key.span.start, entry.value.span.end) for entry in entries]
        for found in checked.findings:
            if found.sort_key not in self._known:
                inside = any(span.source is found.span.source and span.start <= found.span.start <= span.end for span in written)
                also = found.also if inside else (*found.also, Label(here, f"in this {word}"))
                self._findings.append(replace(found, also=also))
        return checked.program if checked.program is not None and self._is_bearable(checked.program, word, name, here) else None

    def _place(self, word: Word, path: Path) -> Span:
        node, key, _ = descend(self._root, path if word == "case" else (*path, "name"))
        return key.span if key and word == "case" else node.span

    def _is_fixed(self, entry: Entry, word: Word) -> bool:
        """Whether a setting speaks of what a policy is made for, after a finding that says so."""
        steps, _, rest = follow(self._root, entry.key.text.strip())
        head = str(steps[0]) if steps else rest.split(".")[0]
        parameters = self._root.get("parameters")
        if head not in _FIXED or (isinstance(parameters, Mapping) and entry.key.text in parameters.entries):
            return False
        help = "it may change the world, the reset, the reward, the endings and the parameters"
        self._findings.add("DB407", entry.key.span, f"a {word} that changes `{head}`", help=help)
        return True

    def _is_bearable(self, program: Program, word: Word, name: str, here: Span) -> bool:
        """Whether a policy for the scenario itself can act in this one, else after a finding."""
        lines = interface.differences(self._base, program, words=("elsewhere", "here"))
        if word == "stage" and program.world.timestep != self._base.world.timestep:
            lines.append(f"timestep: elsewhere {self._base.world.timestep:g} s, here {program.world.timestep:g} s")
        if lines:
            headline = f"in the {word} `{name}` the policy would see, do or send something else"
            help = f"a {word} may change the world; write what spaces and messages are made of as figures that it does not set"
            self._findings.add("DB613", here, headline, help=help, notes=tuple(lines[:5]))
        return not lines
