"""The learner that deepbots chooses for a scenario that names no algorithm, and the search of `tune`.

The choice depends on the structure of the compiled scenario alone, never on the machine: results are a
function of scenario, seed and shards. docs/training.md shows the table.

Each end of a range of the search, and each choice, is checked as if `--set` had set it.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from pydantic_core import PydanticCustomError

from deepbots_cli.diagnostics import Finding, Findings, Label, Source, Span
from deepbots_cli.document import Document, Entry, MappingNode, NodePath, SequenceNode, inline_text
from deepbots_cli.document.load import TESTS, TUNE, apply_assignment, merge, setting_path
from deepbots_cli.document.nodes import ScalarNode, entries_at, without_paths
from deepbots_cli.document.parse import parse
from deepbots_cli.engine_kinds import ENGINES
from deepbots_cli.program import Program, identity
from deepbots_cli.records import dataclass
from deepbots_cli.scenario.search import SearchSpace, read_range, split_choices
from deepbots_cli.words import counted

if TYPE_CHECKING:
    from deepbots_cli.compiler import CheckedScenario


SHORT_EPISODE = 256
"""The number of steps up to which a rollout of 512 steps contains two episodes."""
FEW_NUMBERS = 32
"""The count of numbers in the observation up to which two layers of 64 units are enough."""
LONG_STEP_S = 0.1
"""The time between two actions (s) from which on an off-policy algorithm needs far fewer steps."""
CHOSEN = "train, as chosen"
"""The name of the source of chosen values."""
_SAC: dict[str, Any] = {
    "algorithm": "SAC",
    "total_timesteps": 100_000,
    "batch_size": 256,
    "learning_rate": 1e-3,
    "network": {"hidden": [128, 128], "activation": "relu"},
}
_PPO: dict[str, Any] = {
    "algorithm": "PPO",
    "total_timesteps": 500_000,
    "learning_rate": "1e-3 -> 1e-4",
    "gae_lambda": 0.95,
    "normalize": "reward",
}
_TRAIN = "train"


@dataclass(frozen=True)
class Choice:
    """The keys of `train` that deepbots chooses, as a scenario writes them, and reasons by the keys that they
    are about."""

    settings: Mapping[str, Any]
    reasons: Mapping[str, str]


def choose(program: Program, *, has_teacher: bool = False) -> Choice:
    """Return the learner for a scenario: the first row that fits. With a teacher it is PPO, which imitates in
    the least CPU time."""
    row = _first_row(program, has_teacher=has_teacher)
    settings, reasons = dict(row.settings), dict(row.reasons)
    agent = program.agent
    steps = program.truncation.max_episode_steps(program.period)
    if settings["algorithm"] == "PPO":
        is_masked = any(option.forbidden is not None for part in agent.choices for option in part.options)
        algorithm = "MaskablePPO" if is_masked else "PPO"
        if is_masked:
            why = "some choices are forbidden"
        elif has_teacher:
            why = "it imitates a teacher"
        else:
            why = "it suits any action"
        reasons = {"algorithm": f"{algorithm}: {why}"} | reasons
        settings |= {
            "algorithm": algorithm,
            "network": {"hidden": [64, 64] if _observed_numbers(program) <= FEW_NUMBERS else [128, 128]},
        }
    # The horizon 1 / (1 - gamma) is a quarter of the episode.
    settings["gamma"] = min(max(round(1 - 4 / steps, 2), 0.9), 0.99)
    reasons["gamma"] = (
        f"gamma {settings['gamma']:g}: it looks {1 / (1 - settings['gamma']):.0f} of at most {steps:,} steps"
        " ahead"
    )
    return Choice(settings, reasons)


def _observed_numbers(program: Program) -> int:
    goal = program.agent.goal
    return len(program.agent.seen) + (2 * len(goal.values) if goal is not None else 0)


def _first_row(program: Program, *, has_teacher: bool) -> Choice:
    """Return the first row of the table that fits."""
    agent = program.agent
    steps = program.truncation.max_episode_steps(program.period)
    numbers = _observed_numbers(program)
    copies = 1 if agent.copies is None else agent.copies.count

    def worlds(agents: int) -> dict[str, int]:
        return {"environments": max(1, agents // copies)}

    may_be_off_policy = not agent.choices and not has_teacher
    if may_be_off_policy and agent.goal is not None:
        why = "SAC with hindsight replay: the scenario has a goal"
        return Choice({**_SAC, **worlds(4), "replay": "her", "tau": 0.02}, {"algorithm": why})
    if may_be_off_policy and program.period >= LONG_STEP_S:
        why = f"SAC, which learns from each step many times: a step takes {program.period:g} s"
        return Choice({**_SAC, **worlds(8), "gradient_steps": 4}, {"algorithm": why})
    has_batches = program.engine is not None and ENGINES[program.engine].batch is not None
    if steps <= SHORT_EPISODE and numbers <= FEW_NUMBERS and not agent.images:
        settings: dict[str, Any] = {**worlds(8), "n_steps": 64, "batch_size": 128, "n_epochs": 10}
        update = settings["environments"] * copies * settings["n_steps"]
        why = (
            f"updates every {update:,} steps: an episode has at most {steps:,} steps, and the policy sees"
            f" {counted(numbers, 'number')}"
        )
        settings |= {"learning_rate": 1e-3, "total_timesteps": 200_000}
    elif has_batches and not agent.images and not has_teacher:
        settings = {**worlds(256), "n_steps": 24, "batch_size": 1536, "n_epochs": 5}
        settings |= {"total_timesteps": 3_000_000}
        why = f"{settings['environments']} worlds: the engine {program.engine} steps them as one batch"
    else:
        much = "images" if agent.images else counted(numbers, "number")
        settings = {**worlds(16), "n_steps": 128, "batch_size": 256, "n_epochs": 5}
        update = settings["environments"] * copies * settings["n_steps"]
        why = f"updates every {update:,} steps: an episode has at most {steps:,} steps, and the policy sees"
        why += f" {much}"
        settings |= {"learning_rate": 5e-4} if agent.images else {}
    return Choice(_PPO | settings, {"environments n_steps": why})


def with_learner(document: Document, choice: Choice) -> tuple[Document, tuple[str, ...]]:
    """Return the document with these settings under `train`, as far as it does not give them itself, and the
    reasons for these."""
    text = "".join(f"{key}: {json.dumps(value)}\n" for key, value in choice.settings.items())
    section = parse(Source(CHOSEN, text), document.findings)
    root = document.root
    assert isinstance(section, MappingNode)
    assert root is not None
    train_entry = root.entries.get(
        _TRAIN, Entry(ScalarNode(section.span, _TRAIN, _TRAIN), replace(section, entries={}))
    )
    assert isinstance(train_entry.value, MappingNode)  # the validation has checked it
    hyperparameters = {key: entry for key, entry in train_entry.value.entries.items() if key != "algorithm"}
    section = merge(section, replace(train_entry.value, entries=hyperparameters))
    root = replace(root, entries=root.entries | {_TRAIN: Entry(train_entry.key, section)})
    return replace(document, root=root), tuple(
        reason for keys, reason in choice.reasons.items() if hyperparameters.keys().isdisjoint(keys.split())
    )


# The search of `tune`


MAX_SEARCHED = 32
"""The maximum number of keys of a search; each is compiled with at least three values."""
_FIXED_HELP = {
    **dict.fromkeys(("deepbots", "name", "summary", TUNE, TESTS), "remove it"),
    "evaluation": "remove it: it determines how trials are compared",
    "solved": "remove it: it determines how trials are compared",
    "train.total_timesteps": "remove it: all trials train for the same number of steps, which"
    " `tune.timesteps` or `--timesteps` sets",
}


def compile_search(
    document: Document, program: Program, findings: Findings, check: Callable[[Document], CheckedScenario]
) -> dict[str, SearchSpace]:
    """Return the search space of each key, by its path as it is written; a key that cannot be searched is a
    finding."""
    spaces: dict[str, SearchSpace] = {}
    entries = entries_at(document.root, TUNE, "search")
    if document.root is None or not entries:
        return spaces
    if len(entries) > MAX_SEARCHED:
        findings.add(
            "DB005",
            next(iter(entries.values())).key.span,
            f"a search over {len(entries)} keys",
            f"search over at most {MAX_SEARCHED} keys",
        )
        return spaces
    prober = _Prober(document, program, findings, check)
    for name, entry in entries.items():
        space = prober.space(name.strip(), entry)
        if space is not None:
            spaces[name.strip()] = space
    return spaces


class _Prober:
    """Checks the scenario with one value of one key after the other."""

    def __init__(
        self,
        document: Document,
        program: Program,
        findings: Findings,
        check: Callable[[Document], CheckedScenario],
    ) -> None:
        # The tests would be compiled again for each value.
        root = without_paths(document.root, ((TUNE,), (TESTS,))) if document.root else None
        assert isinstance(root, MappingNode)  # only keys below the root were removed
        self._root = root
        self._document = document
        self._base = program
        self._findings = findings
        self._check = check
        self._known = {finding.sort_key for finding in findings}
        self._searched: dict[NodePath, Entry] = {}

    def space(self, name: str, entry: Entry) -> SearchSpace | None:
        """Return the search space of a key; None after a finding."""
        path = setting_path(self._root, name)
        dotted = ".".join(map(str, path))
        reason = _FIXED_HELP.get(dotted) or _FIXED_HELP.get(str(path[0]))
        if reason is not None:
            self._findings.add("DB407", entry.key.span, f"a search cannot change `{dotted}`", reason)
            return None
        if path in self._searched:
            labels = (Label(self._searched[path].key.span, "first searched here"),)
            self._findings.add(
                "DB202",
                entry.key.span,
                f"`{name}` is already searched",
                "remove one of the two",
                labels=labels,
            )
            return None
        self._searched[path] = entry
        try:
            space = _read(entry)
        except PydanticCustomError:  # the validation has reported it
            return None
        if space.choices:
            return space if all(self._is_sound(name, choice, entry) for choice in space.choices) else None
        if not all(self._is_sound(name, space.text(end), entry) for end in (space.low, space.high)):
            return None
        return self._with_sound_middle(name, space, entry)

    def _with_sound_middle(self, name: str, space: SearchSpace, entry: Entry) -> SearchSpace | None:
        """Return the space if a value with a fraction has no errors either; else the space of the whole
        numbers, if both ends have none."""
        middle = space.middle
        is_whole = space.low.is_integer() and space.high.is_integer() and not space.unit
        if is_whole and not list(self._errors(name, f"{int(middle) + 0.5:.12g}")):
            return space
        if is_whole:
            space = space.model_copy(update={"whole": True})
            middle = int(middle)
        return space if self._is_sound(name, space.text(middle), entry) else None

    def _is_sound(self, name: str, text: str, entry: Entry) -> bool:
        """Return whether the scenario compiles with this value, and the same policy can act in it; else after
        findings at the entry."""
        errors = list(self._errors(name, text))
        for finding in errors:
            source, start, _ = finding.span
            at_key = source.text == f"{name}={text}" and start < len(name)
            elsewhere = (
                () if source.text == f"{name}={text}" else (Label(finding.span, f"with `{name}: {text}`"),)
            )
            span = entry.key.span if at_key else entry.value.span
            self._findings.append(replace(finding, span=span, labels=elsewhere, fix=None))
        return not errors

    def _errors(self, name: str, text: str) -> Iterator[Finding]:
        """Yield the errors that this value adds to the scenario."""
        findings = Findings(self._document.findings.limit)
        root = apply_assignment(self._root, f"{name}={text}", findings)
        if findings.errors:
            yield from findings.errors
            return
        checked = self._check(replace(self._document, root=root, findings=findings))
        yield from (finding for finding in checked.findings.errors if finding.sort_key not in self._known)
        lines = (
            identity.differences(self._base, checked.program, words=("in the scenario", "with this value"))
            if checked.program
            else []
        )
        if lines:
            source = Source("", f"{name}={text}")
            yield Finding(
                "DB613",
                Span(source, len(name), len(source.text)),
                f"`{name}: {text}` changes the interface of the policy",
                "search only over values that leave the observation, the action and the messages as they are",
                notes=tuple(lines[:5]),
            )


def _read(entry: Entry) -> SearchSpace:
    """Return the search space that an entry writes."""
    match entry.value:
        case SequenceNode(items=items):
            return SearchSpace(choices=tuple(dict.fromkeys(map(inline_text, items))))
        case ScalarNode(text=text) if len(choices := split_choices(text)) > 1:
            return SearchSpace(choices=tuple(dict.fromkeys(choices)))
        case value:
            return read_range(inline_text(value))
