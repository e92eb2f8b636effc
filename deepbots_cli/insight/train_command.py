"""The command that trains the scenario of a run again."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import pairwise

from deepbots_cli import engine_kinds
from deepbots_cli.insight.linted import named_source
from deepbots_cli.learning.runs.records import changed_settings
from deepbots_cli.learning.runs.run import Run

_KEPT_OPTIONS = (
    *("--agent", "--against", "--initialize-from", "--keep-checkpoints"),
    *("--callback", "--logger", "--allow-path"),
)
"""The options of `train` whose values only the command line of a run has as they were written."""


def training_command(run: Run, assignments: Sequence[str]) -> list[str]:
    """Return the command that trains the scenario of a run again, with its seed, options and `--set`, and
    further assignments."""
    record, settings = run.record, dict[str, str]()
    for text in (*changed_settings(record.command), *assignments):
        path, _, value = text.partition("=")
        settings.pop(path, None)
        settings[path] = value
    options = {word.partition("=")[0] for word in record.command}
    words = ["deepbots", "train", named_source(record.source), "--seed", str(record.seed)]
    training = run.program.agent.training
    if (
        training is not None
        and record.total_timesteps != training.total_timesteps
        and "train.total_timesteps" not in settings
    ):
        words += ["--timesteps", str(record.total_timesteps)]
    teacher = training.teacher if training is not None and "--teacher" in options else None
    if teacher is not None and "train.teacher" not in settings:
        words += ["--teacher", teacher.script]
    if run.demonstrations.exists():
        words += ["--teacher", str(run.demonstrations)]
    if run.teacher.exists():
        words += ["--teacher", str(run.teacher)]
    for path, value in settings.items():
        words += ["--set", f"{path}={value}"]
    if "--engine" in options or record.engine != engine_kinds.chosen(run.program.engine):
        words += ["--engine", record.engine]
    if training is not None and "--shards" in options:
        words += ["--shards", str(training.shards)]  # `auto` of earlier versions chose them
    if record.first_stage is not None:
        words += ["--stage", record.first_stage]
    if not record.stop_when_solved:
        words.append("--full")
    words += _kept_options(record.command)
    if "--allow-code" in options:
        words.append("--allow-code")
    return words


def _kept_options(command: Sequence[str]) -> Iterator[str]:
    """Yield the options of a command line that are kept as they are, with their values."""
    for word, following in pairwise((*command, "")):
        name, has_value, value = word.partition("=")
        if name in _KEPT_OPTIONS:
            yield from (name, value if has_value else following)
