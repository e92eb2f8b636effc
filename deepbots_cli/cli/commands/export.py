"""`deepbots export`: a policy for a robot, and whether it fits a scenario."""

from __future__ import annotations

from collections.abc import Mapping
from enum import StrEnum
from pathlib import Path, PurePosixPath
from shlex import quote
from typing import Annotated

import typer

from deepbots_cli import api
from deepbots_cli.cli import terminal
from deepbots_cli.cli.command import ADVANCED, AllowPaths, Force, Json, Overrides, option
from deepbots_cli.cli.exits import FAILED
from deepbots_cli.cli.new_files import check_new_folder, refuse_links_within, write_new
from deepbots_cli.cli.sources import run_to_export
from deepbots_cli.document import Permissions
from deepbots_cli.errors import MissingExtraError, UsageError
from deepbots_cli.learning.runs.run import ModelName, ModelRef
from deepbots_cli.program import identity
from deepbots_cli.rollout.source import Source, SourceKind


class Form(StrEnum):
    bundle = "bundle"
    isaac_lab = "isaac-lab"
    lerobot = "lerobot"
    webots = "webots"


def command(
    source: Annotated[
        Path | None,
        typer.Argument(
            metavar="RUN|MODEL|BUNDLE|SCENARIO",
            help="A run directory, a model in it, with --check a folder that `export` wrote, or with --to"
            " webots a scenario.",
            show_default=False,
        ),
    ] = None,
    out: Annotated[
        Path | None, option("--output -o FOLDER", "Folder to write; by default RUN-bundle.")
    ] = None,
    to: Annotated[
        Form,
        option(
            "--to",
            "A bundle, the files that runners of Isaac Lab or LeRobot read, or a project of Webots.",
            ADVANCED,
        ),
    ] = Form.bundle,
    force: Force = False,
    agent: Annotated[
        str | None,
        option("--agent NAME", "If a run trained several agents, the one whose policy to export."),
    ] = None,
    last: Annotated[
        bool, option("--last", "Export the last model instead of the best one.", ADVANCED)
    ] = False,
    check: Annotated[
        str | None,
        option("--check SCENARIO", "Compare a bundle with a scenario, item by item; write nothing."),
    ] = None,
    sign: Annotated[
        Path | None, option("--sign KEY", "Sign the bundle with this private key (Ed25519).", ADVANCED)
    ] = None,
    new_key: Annotated[
        Path | None, option("--new-key FILE", "Write a new private key, and FILE.pub beside it.", ADVANCED)
    ] = None,
    overrides: Overrides = None,
    as_json: Json = False,
    allow_paths: AllowPaths = None,
) -> None:
    """Export a policy, sign it, or compare a bundle with a scenario."""
    if new_key is not None:
        _write_key(
            new_key,
            is_alone=source is None and not (out or to is not Form.bundle or last or check or sign),
            as_json=as_json,
        )
        return
    if source is None:
        raise UsageError("write what to export, such as a folder under runs: deepbots export RUN")
    if sign is not None and (check is not None or to is not Form.bundle):
        raise UsageError("--sign signs a bundle; leave it out with --check and --to")
    if check is not None:
        _check(
            source,
            check,
            overrides or (),
            Permissions(allow_paths or (), code=True),
            as_json=as_json,
            writes=out is not None or last or to is not Form.bundle,
        )
        return
    if to is Form.webots:
        _write_webots(
            source, out, overrides or (), Permissions(allow_paths or ()), agent, last, force, as_json
        )
        return
    if overrides or allow_paths:
        raise UsageError(
            "--set and --allow-path need --check SCENARIO; a run is always exported as it was trained"
        )
    model = "last" if last else "best"
    if out is not None:
        check_new_folder(out, force=force)
        refuse_links_within(out)
    opened = Source.open(source, Permissions(), SourceKind.RUN, SourceKind.CHECKPOINT)
    suffix = "".join(f"-{name}" for name in (agent, opened.model) if name is not None)
    folder = out or Path(f"{opened.path.resolve().name}{suffix}-{to.value}")
    check_new_folder(folder, force=force)
    refuse_links_within(folder)
    ref = ModelRef.open(opened, model=model)
    run = run_to_export(ref.run, agent)
    with terminal.transient_line("exporting the policy ..."):
        from deepbots_cli.insight.export import bundle

        files = (
            bundle.bundle_files(run, ref.name, sign)
            if to is Form.bundle
            else bundle.files_for(run, ref.name, to.value)
        )
    if to is not Form.bundle:
        write_new(files, folder, force=force)
        terminal.show({"folder": folder}, f"{folder}: {', '.join(map(str, files))}", as_json=as_json)
        return
    write_new(files, folder, force=force)
    _show_bundle(folder, files, ref.name, source, as_json=as_json)


def _write_webots(
    source: Path,
    out: Path | None,
    overrides: list[str] | tuple[()],
    permissions: Permissions,
    agent: str | None,
    last: bool,
    force: bool,
    as_json: bool,
) -> None:
    """Write a scenario, or a run with its policy, as a project of Webots; list first what differs there."""
    from deepbots_cli.webots.export import files as webots

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
        prepared = webots.prepare(Source.open(run.path, permissions, SourceKind.RUN))
        webots.note_training(prepared, run.program)
    else:
        prepared = webots.prepare(opened, overrides)
    if not as_json:
        for sentence in prepared.gaps.differs:
            terminal.note(f"differs in Webots: {sentence}")
    if is_run:
        policy = webots.policy_of_run(run, ref.name)
    files = webots.project_files(prepared, policy)
    write_new(files, folder, force=force)
    world = next(path for path in files if path.suffix == ".wbt")
    terminal.show(
        {"folder": folder, "differs": prepared.gaps.differs, "files": [str(path) for path in files]},
        f"{folder}: {len(files)} files; open {world} in Webots",
        as_json=as_json,
        next_commands=[f"deepbots webots {quote(str(folder / world))} --allow-code"],
    )


def _show_bundle(
    folder: Path, files: Mapping[PurePosixPath, bytes], model: ModelName, source: Path, *, as_json: bool
) -> None:
    """Print the content of a new bundle, and its gaps; `source` is the run as it was named."""
    from deepbots_cli.insight.export import bundle
    from deepbots_robot.model import plain

    info = bundle.read_bundle(folder)
    sizes = [
        f"{name} ({len(content) / 1000:,.0f} kB)" for name, content in files.items() if len(name.parts) == 1
    ]
    result = (
        "not evaluated since the end of the training" if info.evaluation is None else info.evaluation.text
    )
    lines = [
        f"{folder}: {', '.join(sizes)}, and the robot files of the scenario",
        f"  {info.scenario.name}, {info.training.algorithm}: {result}",
    ]
    missing = [
        entry.name for entry in info.inputs if entry.source == "supervisor" and entry.supplied_by is None
    ]
    if missing and not as_json:
        terminal.note(
            f"no robot measures {', '.join(missing)}; README.md of the bundle says what must supply them"
        )
    if info.evaluation is None and model == "best" and not as_json:
        terminal.note(
            f"evaluate the run first for a result in the bundle: deepbots eval {quote(str(source))}"
        )
    next_commands = [
        f"deepbots serve {quote(str(folder))}",
        f"deepbots export --check SCENARIO {quote(str(folder))}",
    ]
    terminal.show(
        {"bundle": folder, **plain(info)}, "\n".join(lines), as_json=as_json, next_commands=next_commands
    )


def _write_key(file: Path, *, is_alone: bool, as_json: bool) -> None:
    """Write a private and a public key."""
    if not is_alone:
        raise UsageError("--new-key makes a key and exports nothing; give it alone")
    try:
        from deepbots_robot import signature
    except ModuleNotFoundError as error:
        raise MissingExtraError("robot", "making a key") from error
    try:
        public = signature.write_key(file)
    except signature.KeyFileError as error:
        raise UsageError(str(error)) from error
    terminal.show(
        {"private_key": file, "public_key": public},
        f"{file}: the private key, which signs; keep it where you export, and nowhere else",
        f"{public}: the public key, for the computer of the robot",
        as_json=as_json,
        next_commands=[
            f"deepbots export RUN --sign {quote(str(file))}",
            f"deepbots serve BUNDLE --trusted {quote(str(public))}",
        ],
    )


def _check(
    folder: Path,
    scenario: str,
    overrides: list[str] | tuple[()],
    permissions: Permissions,
    *,
    as_json: bool,
    writes: bool,
) -> None:
    from deepbots_cli.insight.export import bundle

    if writes:
        raise UsageError("--check writes nothing; leave out --output, --last and --to")
    contents = bundle.read_bundle(folder)
    compiled = api.compile(scenario, overrides=overrides, permissions=permissions)
    words = ("bundle", "scenario")
    differ = identity.compare_interfaces(
        contents.scenario.interface, identity.interface(compiled.program), words=words
    )
    settings = "".join(f" --set {quote(text)}" for text in overrides)
    remarks = bundle.remarks(
        contents,
        compiled.program,
        f"deepbots diff {quote(str(folder / 'scenario.yaml'))} {quote(scenario)}{settings}",
    )
    verdict = (
        f"the policy in {folder} does not fit {scenario}:"
        if differ
        else f"the policy in {folder} fits {scenario}"
    )
    data = {
        "bundle": folder,
        "scenario": scenario,
        "fits": not differ,
        "differences": differ,
        "remarks": remarks,
    }
    terminal.show(data, verdict, *(f"  {line}" for line in differ), as_json=as_json)
    if not as_json:
        for remark in remarks:
            terminal.note(f"note: {remark}")
    if differ:
        raise typer.Exit(FAILED)
