"""`deepbots export --to webots`."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from deepbots_cli.cli import terminal
from deepbots_cli.cli.arguments import run_to_export
from deepbots_cli.cli.written_files import check_new_folder, refuse_links_within, write_new
from deepbots_cli.document import Permissions
from deepbots_cli.errors import UsageError
from deepbots_cli.learning.runs.run import ModelRef
from deepbots_cli.rollout.source import Source, SourceKind
from deepbots_cli.words import shell_word
from deepbots_webots.export import files


def export(
    source: Path,
    out: Path | None,
    overrides: Sequence[str],
    permissions: Permissions,
    agent: str | None,
    last: bool,
    force: bool,
    as_json: bool,
) -> None:
    """Write a scenario, or a run with its policy, as a project of Webots; list first what differs there."""
    opened = Source.open(source, permissions, SourceKind.SCENARIO, SourceKind.RUN, SourceKind.CHECKPOINT)
    is_run = opened.kind is not SourceKind.SCENARIO
    if not is_run and (agent is not None or last):
        raise UsageError("--agent and --last name a policy of a run; leave them out for a scenario")
    if is_run and overrides:
        raise UsageError("a run is always exported as it was trained; leave out --set")
    folder = out or Path(f"{opened.path.resolve().name.removesuffix('.yaml')}-webots")
    check_new_folder(folder, force=force)
    refuse_links_within(folder)
    policy = None
    if is_run:
        ref = ModelRef.open(opened, model="last" if last else "best")
        run = run_to_export(ref.run, agent)
        prepared = files.prepare(Source.open(run.path, permissions, SourceKind.RUN))
        files.note_training(prepared, run.program)
    else:
        prepared = files.prepare(opened, overrides)
    if not as_json:
        for sentence in prepared.gaps.differs:
            terminal.note(f"differs in Webots: {sentence}")
    if is_run:
        policy = files.policy_of_run(run, ref.name)
    contents = files.project_files(prepared, policy)
    write_new(contents, folder, force=force)
    world = next(path for path in contents if path.suffix == ".wbt")
    terminal.show(
        {"folder": folder, "differs": prepared.gaps.differs, "files": [str(path) for path in contents]},
        f"{folder}: {len(contents)} files; open {world} in Webots",
        as_json=as_json,
        next_commands=[f"deepbots webots {shell_word(folder / world)} --allow-code"],
    )
