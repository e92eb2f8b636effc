"""`deepbots view`, `play` and `studio`: pages of a scene in the browser; `replay`: the content of a
recording."""

from __future__ import annotations

import sys
import webbrowser
from collections.abc import Sequence
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from shlex import join
from typing import TYPE_CHECKING, Annotated, Any

import typer

from deepbots_cli.cli import records, terminal
from deepbots_cli.cli.command import (
    ADVANCED,
    Case,
    EngineOrRun,
    Episode,
    Force,
    Host,
    Json,
    Open,
    Overrides,
    Port,
    Seed,
    Shown,
    Stage,
    Start,
    check_options,
    integer,
    option,
    start_values,
)
from deepbots_cli.cli.exits import FAILED
from deepbots_cli.cli.tables import table
from deepbots_cli.document import Permissions
from deepbots_cli.errors import MissingExtraError, UsageError
from deepbots_cli.rollout.source import RECORDING_SUFFIX
from deepbots_cli.words import counted, shell_word

if TYPE_CHECKING:
    from deepbots_cli.rollout.recordings import Recording
    from deepbots_cli.view.episodes import Showing, ShowingState
    from deepbots_cli.view.recordings import DrivenEpisodes


def command(
    shown: Shown,
    driver: Annotated[
        str | None,
        option(
            "--driver NAME",
            "Who acts, as for `deepbots try`; also `policy` (of a run) and `you` (keys and sliders of the"
            " page).",
        ),
    ] = None,
    seed: Seed = 0,
    episode: Episode = 0,
    start: Start = None,
    watch: Annotated[bool, option("--watch", "Restart with the new files when a file is saved.")] = False,
    compare: Annotated[
        str | None,
        option("--compare OTHER", "Show another run or scenario beside the first one, with the same seeds."),
    ] = None,
    worlds: Annotated[
        int | None,
        integer(
            "--worlds N", "Step a batch of N worlds in MuJoCo, and show one of them.", 1, 4096, group=ADVANCED
        ),
    ] = None,
    world: Annotated[
        int, integer("--world K", "The world to show first, with --worlds.", 0, group=ADVANCED)
    ] = 0,
    frame_rate: Annotated[
        int,
        integer(
            "--fps N",
            "Pictures per second. A browser without a graphics card needs fewer.",
            1,
            60,
            group=ADVANCED,
        ),
    ] = 30,
    overrides: Overrides = None,
    case: Case = None,
    stage: Stage = None,
    engine: EngineOrRun = None,
    host: Host = "127.0.0.1",
    port: Port = None,
    open_: Open = False,
    permissions: Permissions = Permissions(),
) -> None:
    """Watch a policy, a scenario or a recording in the browser."""
    if world >= (worlds or 1):
        reason = f"--worlds {worlds} creates the worlds 0 to {worlds - 1}" if worlds else "add --worlds N"
        raise UsageError(f"there is no world {world}; {reason}")
    from deepbots_cli.view.episodes import Showing

    engine = engine or ("mujoco" if worlds else None)
    source = Showing(
        shown, overrides or (), permissions, engine, case, stage, worlds or 0, start_values(start)
    )
    compared = replace(source, reference=compare) if compare else None
    settings = {
        "driver": driver,
        "seed": seed,
        "episode": episode,
        "world": world,
        "watch": watch,
        "frame_rate": frame_rate,
    }
    _serve(source, open_, compare=compared, host=host, port=port, **settings)


ScenarioOrRun = Annotated[
    str,
    typer.Argument(
        metavar="SCENARIO|RUN|MODEL",
        help="A scenario file, the name of a shipped scenario, a run directory, or a model in it.",
    ),
]


def command_play(
    shown: ScenarioOrRun,
    output: Annotated[
        Path | None,
        option(
            "--output -o FILE",
            "Record the episodes that you drive in this file (.mcap), which `replay` and `view` read.",
        ),
    ] = None,
    seed: Seed = 0,
    episode: Episode = 0,
    overrides: Overrides = None,
    case: Case = None,
    stage: Stage = None,
    engine: EngineOrRun = None,
    host: Host = "127.0.0.1",
    port: Port = None,
    open_: Open = False,
    force: Force = False,
    permissions: Permissions = Permissions(),
) -> None:
    """Drive the robot of a scenario in the browser."""
    from deepbots_cli.view.episodes import Showing
    from deepbots_cli.view.pictures import check_target

    if output is not None:
        check_target(output, (RECORDING_SUFFIX,), force=force)
    source = Showing(shown, overrides or (), permissions, engine, case, stage)
    _serve(source, open_, host=host, port=port, seed=seed, episode=episode, playing=True, output=output)


def _serve(source: Showing, open_: bool, **options: Any) -> None:
    """Serve a page until Ctrl-C; `options` are those of `Page`."""
    from deepbots_cli.view.page import Page

    page = Page(source, **options)
    try:
        terminal.print_result(page.address)
        sys.stdout.flush()  # programs that read the address wait for it
        terminal.note("Ctrl-C ends it")
        if open_:
            webbrowser.open(page.address)
        page.run()
    finally:
        page.close()
        if page.playback.driven is not None:
            _finish(page.playback.driven)


def _finish(driven: DrivenEpisodes) -> None:
    """Print the episodes that a person has driven, and the use of their recording."""
    if driven.is_full:
        terminal.note(driven.note)
    if not driven.ends:
        terminal.note(f"{driven.path} was not written: drive at least one episode from its reset to its end")
        return
    driven.save()
    program = driven.player.program
    rows = records.recorded_rows(enumerate(driven.ends), have_rivals=program.has_rivals)
    count = counted(len(rows), "episode")
    lines = [
        records.recorded_table(rows),
        f"{driven.path} ({count}, {driven.path.stat().st_size / 1000:,.0f} kB)",
    ]
    further = [f"deepbots replay --verify {shell_word(driven.path)}"]
    if not (driven.player.opened.shown.case or program.members or program.agent.copies):
        further.append(join(_training_words(driven.player.opened, driven.path)))
    terminal.show(None, *lines, as_json=False, next_commands=further)


def _training_words(opened: ShowingState, recording: Path) -> list[str]:
    """Return the words of the command that trains the shown scenario with a recording as teacher, and with
    the options of the session."""
    from deepbots_cli.insight.scenario_facts import training_command

    showing = opened.shown
    words = ["deepbots", "train", showing.reference]
    if opened.run is not None:
        words = training_command(opened.run, showing.overrides)
    else:
        words += [word for text in showing.overrides for word in ("--set", text)]
        words += [word for path in showing.permissions.folders for word in ("--allow-path", str(path))]
    teacher = f"./{recording}" if str(recording).startswith("-") else str(recording)
    options = {"--stage": showing.stage, "--engine": showing.engine, "--teacher": teacher}
    for name, value in options.items():
        at = words.index(name) if name in words else len(words)
        if value:
            words[at : at + 2] = [name, value]
    return words if "--allow-code" in words or not showing.permissions.code else [*words, "--allow-code"]


def command_studio(
    source: Annotated[
        Path,
        typer.Argument(
            metavar="SCENARIO|FOLDER", help="A scenario file, or the folder of your scenarios and runs."
        ),
    ] = Path(),
    open_: Annotated[bool, option("--open", "Open the page in the browser.")] = False,
    host: Annotated[
        str,
        option(
            "--host ADDRESS",
            "Address to serve on. Others can reach 0.0.0.0, without encryption; prefer a tunnel:"
            " ssh -L 8750:127.0.0.1:8750 MACHINE.",
            ADVANCED,
        ),
    ] = "127.0.0.1",
    port: Annotated[
        int | None,
        integer(
            "--port N",
            "Port of the page; by default the first free port from 8750.",
            1,
            65535,
            group=ADVANCED,
        ),
    ] = None,
    permissions: Permissions = Permissions(),
) -> None:
    """Write, watch and train a scenario on one page of the browser."""
    try:
        from deepbots_cli.studio.server import studio
    except ModuleNotFoundError as error:
        raise MissingExtraError("studio", "the studio") from error

    prepared = studio(source, permissions=permissions, host=host, port=port)
    terminal.print_result(prepared.address)
    sys.stdout.flush()  # programs that read the address wait for it
    terminal.note("Ctrl-C ends it; trainings go on, and the next studio of this folder shows them")
    if open_:
        webbrowser.open(prepared.address)
    prepared.serve()


def command_replay(
    ctx: typer.Context,
    recording: Annotated[
        str,
        typer.Argument(
            metavar="RECORDING", help="A recording (.mcap) of `deepbots render` or `deepbots play`."
        ),
    ],
    to_verify: Annotated[
        bool, option("--verify", "Run the episodes again, and compare every step bit for bit.")
    ] = False,
    tolerance: Annotated[
        float,
        option(
            "--tolerance X",
            "With --verify, a number may differ by X, or by X times its absolute value if that is larger.",
            min=0.0,
            max=1.0,
        ),
    ] = 0.0,
    as_json: Json = False,
    permissions: Permissions = Permissions(),
) -> None:
    """List the episodes of a recording, or run them again and compare."""
    from deepbots_cli.rollout.recordings import is_robot_log

    log = Path(recording)
    if is_robot_log(log):
        check_options(ctx, "the log of a robot")
        _list_log(log, as_json=as_json)
        return
    from deepbots_cli.view.episodes import Showing
    from deepbots_cli.view.replay import version_changes

    opened = Showing(
        recording.removesuffix(RECORDING_SUFFIX) + RECORDING_SUFFIX, permissions=permissions
    ).open()
    opened_recording = opened.recording
    notes = version_changes(opened.recording)
    if not to_verify:
        _list_episodes(opened, recording, as_json=as_json)
        return
    if opened.checked().digest != opened_recording.metadata.get("digest"):
        notes.append(
            "the scenario in the recording compiles to a different program than when it was recorded: the"
            " file or deepbots has changed"
        )
    for note in notes:
        terminal.note(note)
    _verify(opened_recording, opened, tolerance, notes, as_json=as_json)


def _list_episodes(opened: ShowingState, recording: str, *, as_json: bool) -> None:
    """Print the content of a recording; `recording` is its name as it was written."""
    from deepbots_cli.view.replay import ReplayPlayer

    opened_recording = opened.recording
    with closing(ReplayPlayer(opened)) as player:
        ends = [
            (episode.number, player.begin(0, episode.number), player.seek(len(episode.steps)))
            for episode in opened_recording.episodes
        ]
        have_rivals = player.program.has_rivals
    rows = records.recorded_rows(((number, last) for number, _, last in ends), have_rivals=have_rivals)
    origin = {
        name: opened_recording.metadata.get(name, "?")
        for name in ("scenario", "source", "seed", "driver", "engine")
    }
    about = "{scenario} ({source}), seed {seed}, driven by {driver}, engine {engine}".format(**origin)
    data = {"recording": opened_recording.path, **opened_recording.metadata, "episodes": rows}
    terminal.show(
        data,
        about,
        records.recorded_table(rows),
        as_json=as_json,
        next_commands=[f"deepbots replay --verify {shell_word(recording)}"],
    )


def _verify(
    recording: Recording, showing: ShowingState, tolerance: float, notes: Sequence[str], *, as_json: bool
) -> None:
    """Run a recording again, and exit with 1 if it differs."""
    from deepbots_cli.view.episodes import Player
    from deepbots_cli.view.replay import verify

    # `verify` replaces this driver by the actions of each episode.
    with closing(Player(showing, "zero")) as player, terminal.progress(always=False) as show:
        count = len(recording.episodes)
        difference = verify(recording, player, lambda finished: show(finished, count), tolerance=tolerance)
    steps = sum(len(episode.steps) - 1 for episode in recording.episodes)
    how = f"within {tolerance:g}" if tolerance else "to the bit"
    text = f"{recording.path}: {counted(count, 'episode')} and {steps} steps are the same {how}"
    if difference is not None:
        text = (
            f"{recording.path}: episode {difference.episode}, step {difference.step}: {difference.quantity}"
            " differs\n"
        )
        text += f"  recorded {difference.recorded or 'nothing'}\n  now      {difference.now or 'nothing'}"
    data = {
        "recording": recording.path,
        "same": difference is None,
        "first": difference and difference._asdict(),
        "notes": notes,
    }
    terminal.show(data, text, as_json=as_json)
    if difference is not None:
        raise typer.Exit(FAILED)


def _list_log(path: Path, *, as_json: bool) -> None:
    from deepbots_cli.insight.robot_log import logged_episodes

    episodes = logged_episodes(path, terminal.note)
    rows = [
        {
            "episode": episode.number,
            "begun_s": f"{episode.begun:.1f}",
            "seconds": f"{episode.seconds:.1f}",
            "steps": episode.steps,
            "safe_steps": episode.safe_steps,
            "answer_ms": None if episode.answer is None else f"{episode.answer * 1e3:.2f}",
            "events": len(episode.events),
        }
        for episode in episodes
    ]
    data = {
        "log": path,
        "episodes": [
            {**vars(episode), "events": [event._asdict() for event in episode.events]} for episode in episodes
        ],
    }
    log = shell_word(path)
    after = [
        f"deepbots view {log}",
        f"deepbots diagnose {log} --episode {episodes[0].number}",
        f"deepbots transfer RUN --log {log}",
    ]
    terminal.show(data, f"{path}: the log of a robot", table(rows), as_json=as_json, next_commands=after)
