"""`deepbots render`: a picture, a video, an offline page or a recording, by the suffix of the file; `report`:
a run or a group as one HTML file; `plot`: learning curves."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import closing
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from deepbots_cli.cli import records, terminal
from deepbots_cli.cli.arguments import is_robot, open_robot, xacro_arguments
from deepbots_cli.cli.command import (
    ADVANCED,
    EPISODES,
    FAILED_EPISODES,
    MAX_SEED,
    AllowCode,
    Case,
    Driver,
    EngineOrRun,
    Force,
    Json,
    Overrides,
    Shown,
    Stage,
    Start,
    XacroArguments,
    check_options,
    episodes_or_failed,
    integer,
    option,
    start_values,
)
from deepbots_cli.cli.tables import Row, write_tables
from deepbots_cli.document import Permissions
from deepbots_cli.engine_kinds import chosen as engine_or_default
from deepbots_cli.errors import MissingExtraError, UsageError
from deepbots_cli.files import atomic_write, check_folder, check_output
from deepbots_cli.frames import add
from deepbots_cli.learning.campaigns.study import JOURNAL_NAME
from deepbots_cli.learning.runs.run import ModelName, ModelRef
from deepbots_cli.learning.runs.statistics import Statistic
from deepbots_cli.program.world import RobotBody, WorldModel
from deepbots_cli.records import dataclass
from deepbots_cli.robots.kinematics import resting_height, robot_bounds
from deepbots_cli.robots.model import Pose
from deepbots_cli.rollout.source import RECORDING_SUFFIX, Source, SourceKind, folder_kind
from deepbots_cli.words import counted, sentence_list, shell_word

if TYPE_CHECKING:
    from deepbots_cli.insight.report import Report
    from deepbots_cli.view.episodes import Player
    from deepbots_cli.view.frames import WorldFrame
    from deepbots_cli.view.pictures import Viewpoint

PICTURE, PAGE = ".png", ".html"
VIDEOS = (".mp4", ".gif")
SUFFIXES = (PICTURE, *VIDEOS, PAGE, RECORDING_SUFFIX)
_DRAWN = (PICTURE, *VIDEOS)
_SUFFIXES_OF: Mapping[str, Sequence[str]] = {
    "--labels": (PICTURE,),
    "--rays": (PICTURE,),
    "--steps": (PICTURE, RECORDING_SUFFIX),
    "--seconds": (*VIDEOS, PAGE),
    "--speed": (*VIDEOS, PAGE),
    "--size": _DRAWN,
    "--from": _DRAWN,
    "--at": _DRAWN,
    "--follow": _DRAWN,
    "--episodes": (*VIDEOS, PAGE, RECORDING_SUFFIX),
    "--start": (*_DRAWN, PAGE),
}
"""The files that an option applies to; other options apply to all."""
MAX_SIDE = 4096
_SIZE = re.compile(r"[0-9]{1,5}[xX][0-9]{1,5}")
MAX_EPISODES = 10_000
MAX_FILMS = 10
"""The largest number of failed episodes of which a film is made."""
_CAMERA = "Camera (.png, .mp4, .gif)"
_PICTURE_ONLY = "Picture (.png)"
_VIDEO_ONLY = "Video (.mp4, .gif, .html)"


def size(text: str) -> tuple[int, int]:
    """Parse `640x480`, the width and height of a picture in pixels."""
    sides = [int(side) for side in re.findall(r"[0-9]+", text)] if _SIZE.fullmatch(text) else []
    if not sides or not all(16 <= side <= MAX_SIDE for side in sides):
        raise typer.BadParameter(
            f"'{text}' is not a size; write width x height in pixels, such as 640x480, from 16 to {MAX_SIDE}"
        )
    return sides[0], sides[1]


def point(text: str) -> tuple[float, float, float]:
    """Parse `x,y,z` in m, world frame."""
    try:
        x, y, z = (float(part) for part in text.split(","))
    except ValueError:
        raise typer.BadParameter(f"'{text}' is not a point; write x,y,z in m, such as 1,-0.5,0.8") from None
    if not all(abs(part) < 1e6 for part in (x, y, z)):
        raise typer.BadParameter(f"'{text}' is farther than 1000 km away, or not a number")
    return x, y, z


def command(
    ctx: typer.Context,
    shown: Shown,
    output: Annotated[
        Path | None,
        option("--output -o FILE", "File to write: .png, .mp4, .gif, .html or .mcap; by default NAME.png."),
    ] = None,
    driver: Driver = None,
    seed: Annotated[
        int | None,
        integer(
            "--seed N",
            "Root seed of the starts; by default that of the run, and 0 for a scenario.",
            0,
            MAX_SEED,
            EPISODES,
        ),
    ] = None,
    episode: Annotated[
        int | None,
        integer(
            "--episode K",
            "Held-out episode of `deepbots eval`, counted from 0; 0 by default.",
            0,
            None,
            EPISODES,
        ),
    ] = None,
    episodes: Annotated[
        Any,
        option(
            "--episodes N|failed",
            "Make N episodes, from --episode on; `failed`: the failed episodes of the last evaluation of a"
            " run. A .mcap contains all of them. Videos and pages are one file per episode, FILE-K.mp4 for"
            " episode K; with `failed`, for the first 10 failed episodes only.",
            EPISODES,
            parser=partial(episodes_or_failed, maximum=MAX_EPISODES),
        ),
    ] = None,
    steps: Annotated[
        int | None,
        integer(
            "--steps N",
            "With .png, take the picture after N steps. With .mcap, record at most N steps of each episode.",
            1,
            None,
            EPISODES,
        ),
    ] = None,
    labels: Annotated[
        bool, option("--labels", "Name the links and joints of the first robot.", _PICTURE_ONLY)
    ] = False,
    rays: Annotated[bool, option("--rays", "Draw the rays of sensors.", _PICTURE_ONLY)] = False,
    seconds: Annotated[
        float | None,
        option(
            "--seconds S", "Simulated seconds; by default the whole episode.", _VIDEO_ONLY, min=0.01, max=3600
        ),
    ] = None,
    speed: Annotated[
        float | None,
        option(
            "--speed X",
            "Playback speed: simulated seconds per second of video; 1 by default.",
            _VIDEO_ONLY,
            min=0.01,
            max=100,
        ),
    ] = None,
    # Any: typer would parse each part of a tuple alone.
    size: Annotated[
        Any,
        option(
            "--size WxH",
            "Width and height in pixels; by default 640x480, and 480x320 for a video.",
            _CAMERA,
            parser=size,
        ),
    ] = None,
    eye: Annotated[
        Any,
        option(
            "--from X,Y,Z", "Camera position in m; by default it sees the whole scene.", _CAMERA, parser=point
        ),
    ] = None,
    target: Annotated[
        Any,
        option(
            "--at X,Y,Z",
            "Point in m that the camera looks at; with --from, by default the first robot.",
            _CAMERA,
            parser=point,
        ),
    ] = None,
    follow: Annotated[
        str | None,
        option("--follow ROBOT", "Move the camera with this robot, and show what is near it.", _CAMERA),
    ] = None,
    overrides: Overrides = None,
    case: Case = None,
    stage: Stage = None,
    start: Start = None,
    engine: EngineOrRun = None,
    xacro: XacroArguments = None,
    as_json: Json = False,
    last: Annotated[
        bool, option("--last", "Let the last model of a run act instead of the best one.", ADVANCED)
    ] = False,
    force: Force = False,
    permissions: Permissions = Permissions(),
    agent: str | None = None,
) -> None:
    """Make a picture, a video, an offline page or a recording."""
    path = Path(shown)
    file = output or Path(f"{path.resolve().name if path.is_dir() else path.stem}{PICTURE}")
    values = {
        "--labels": labels,
        "--rays": rays,
        "--steps": steps,
        "--seconds": seconds,
        "--speed": speed,
        "--size": size,
        "--from": eye,
        "--at": target,
        "--follow": follow,
        "--episodes": episodes,
        "--start": start,
    }
    present = [name for name, value in values.items() if value]
    kind = _checked_kind(file, present)
    from deepbots_cli.view import pictures

    width, height = size or ((640, 480) if kind == PICTURE else (480, 320))
    shot = pictures.Viewpoint(width, height, eye, target, follow)
    if is_robot(shown):
        check_options(ctx, "a robot file")
        if kind != PICTURE:
            raise UsageError(f"{shown} is a robot file, of which `render` makes a picture (.png)")
        pictures.check_target(file, SUFFIXES, force=force)
        _draw_robot(shown, file, shot, xacro_arguments(xacro), engine_or_default(engine), permissions)
        terminal.show({"files": [_made(file)]}, str(file), as_json=as_json)
        return
    xacro_arguments(xacro, of_robot=False)
    from deepbots_cli.view.episodes import Showing
    from deepbots_cli.view.replay import closing_player

    ref = _model(shown, kind, permissions, last=last)
    if episodes == FAILED_EPISODES:
        check_options(ctx, "--episodes failed")
        if ref is None:
            raise UsageError(f"--episodes failed repeats an evaluation of a run, and {shown} is none")
        selection = _Episodes.failed(ref, None if kind == RECORDING_SUFFIX else MAX_FILMS, agent)
    else:
        default = 0 if ref is None else ref.run.record.seed
        selection = _Episodes(
            default if seed is None else seed,
            range(episode or 0, (episode or 0) + (episodes or 1)),
            "best" if ref is None else ref.name,
        )
    source = Showing(
        shown if ref is None else str(ref.run.path),
        overrides or (),
        permissions,
        engine,
        case,
        stage,
        start=start_values(start),
        model=selection.model,
        is_model_named=episodes == FAILED_EPISODES or (ref is not None and ref.is_named),
        deterministic=selection.deterministic,
    )
    drawing = _Drawing(shot, steps, labels, rays, seconds, speed or 1.0)
    files = [] if episodes else _files(file, kind, None, force=force)
    with closing_player(source, driver) as world:
        if world.opened.recording is not None:
            from deepbots_cli.rollout.recordings import consecutive

            if seed is not None:
                raise UsageError(f"{shown} already contains its seeds; leave out --seed")
            selection = _Episodes(0, consecutive(world.opened.recording, episode, episodes or 1))
        files = files or _files(file, kind, selection.numbers, force=force)
        ends = _draw_episodes(world, kind, files, selection, drawing)
        have_rivals = world.program.has_rivals
    rows = records.recorded_rows(zip(selection.numbers, ends, strict=True), have_rivals=have_rivals)
    _show_files(kind, files, rows, as_json=as_json)


def _files(file: Path, kind: str, numbers: Sequence[int] | None, *, force: bool) -> list[Path]:
    """Return the files to write: one for each of several episodes; a recording has all of them.

    Raises:
        UsageError: A file exists, or cannot be written.
    """
    from deepbots_cli.view.pictures import check_target

    files = [file]
    if numbers is not None and kind != RECORDING_SUFFIX:
        files = [file.with_name(f"{file.stem}-{number}{file.suffix}") for number in numbers]
    for path in files:
        check_target(path, SUFFIXES, force=force)
    return files


def _model(reference: str, kind: str, permissions: Permissions, *, last: bool) -> ModelRef | None:
    """Return the model of a run that acts; None for other sources.

    Raises:
        UsageError: There is no such source, it is a recording that would be recorded again, or it has no
            models to choose from.
    """
    from deepbots_cli.view.episodes import SHOWN_KINDS

    opened = Source.open(reference, permissions, *SHOWN_KINDS)
    if kind == RECORDING_SUFFIX and opened.kind is SourceKind.RECORDING:
        raise UsageError(
            f"{reference} is already a recording; `deepbots render {shell_word(reference)} -o video.mp4`"
            " makes a video of it"
        )
    if opened.kind in (SourceKind.RUN, SourceKind.CHECKPOINT):
        ref = ModelRef.open(opened, model="last" if last else "best")
        terminal.note_physics(ref.run)
        return ref
    if last:
        raise UsageError(f"--last chooses a model of a run, but {reference} is not a run")
    return None


@dataclass(frozen=True)
class _Episodes:
    """Held-out episodes from a root seed, and the options for the actions of the policy."""

    seed: int
    numbers: Sequence[int]
    model: ModelName = "best"
    deterministic: bool = True

    @staticmethod
    def failed(ref: ModelRef, maximum: int | None, agent: str | None) -> _Episodes:
        """Choose the first failed episodes of the last evaluation of a run, or of one of its models; with
        `agent`, those that this agent failed.

        Raises:
            UsageError: There is none, or agents compete and none is named.
        """
        if agent is None and ref.run.program.has_rivals:
            raise UsageError(
                "the agents compete, so what one fails another one wins; name the agent that failed:"
                f" --agent {'|'.join(ref.run.program.members)}"
            )
        numbers, evaluation = records.failed_episodes(ref, agent)
        return _Episodes(numbers=numbers[:maximum], **evaluation.replay_options)


@dataclass(frozen=True)
class _Drawing:
    """From where, how long and with which marks an episode is shown.

    Attributes:
        viewpoint: The camera.
        steps: A picture is taken after this number of steps, and a recording has at most as many.
        labels: A picture has the names of links and joints.
        rays: A picture has the rays of sensors.
        seconds: Simulated seconds of a video; None for the whole episode.
        speed: Simulated seconds per second of a video.
    """

    viewpoint: Viewpoint
    steps: int | None
    labels: bool
    rays: bool
    seconds: float | None
    speed: float


def _draw_episodes(
    world: Player, kind: str, files: Sequence[Path], selection: _Episodes, drawing: _Drawing
) -> list[WorldFrame]:
    """Make the files. Returns the last frames of the episodes."""
    from deepbots_cli.view import pictures

    if kind == RECORDING_SUFFIX:
        return _record(world, files[0], selection, drawing.steps)
    if kind == PICTURE:
        *_, last = world.episode(selection.seed, selection.numbers[0], drawing.steps or 0)
        image = pictures.render_picture(world, drawing.viewpoint, labels=drawing.labels, rays=drawing.rays)
        with atomic_write(files[0]) as draft:
            image.save(draft, "PNG")
        return [last]
    with terminal.transient_line("running the episode ...") as show:
        play = partial(
            pictures.write_clip,
            seed=selection.seed,
            seconds=drawing.seconds,
            speed=drawing.speed,
            on_frame=lambda frame: show(f"{frame.time:.1f} s of the episode are drawn ..."),
        )
        numbered = zip(selection.numbers, files, strict=True)
        return [play(world, target, drawing.viewpoint, episode=number) for number, target in numbered]


def _record(world: Player, file: Path, selection: _Episodes, steps: int | None) -> list[WorldFrame]:
    from deepbots_cli.view.recordings import record

    count = len(selection.numbers)
    with terminal.progress(always=False) as show:
        counts = iter(range(1, count + 1))
        return record(
            world, file, selection.seed, selection.numbers, lambda _: show(next(counts), count), steps=steps
        )


def _checked_kind(file: Path, options: Sequence[str]) -> str:
    """Return the suffix of the file.

    Raises:
        UsageError: The suffix is unknown, or an option is for other suffixes.
    """
    kind = file.suffix.lower()
    if kind not in SUFFIXES:
        raise UsageError(f"{file} must end in {sentence_list(SUFFIXES, 'or')}; the suffix says what is made")
    wrong = [name for name in options if kind not in _SUFFIXES_OF[name]]
    if wrong:
        reasons = [f"{name} is for {', '.join(_SUFFIXES_OF[name])}" for name in wrong]
        raise UsageError(
            f"{file}: {'; '.join(reasons)}; leave {'it' if len(wrong) == 1 else 'them'} out, or name another"
            " file"
        )
    return kind


def _show_files(kind: str, files: Sequence[Path], rows: Sequence[Row], *, as_json: bool) -> None:
    """Print the files with their episodes."""
    per_file = [rows] if len(files) == 1 else [[row] for row in rows]
    data = {
        "files": [{**_made(path), "episodes": listed} for path, listed in zip(files, per_file, strict=True)]
    }
    further: list[str] = []
    if kind == RECORDING_SUFFIX:
        file = shell_word(files[0])
        further = [f"deepbots view {file}", f"deepbots replay --verify {file}"]
    terminal.show(data, *_lines(kind, files, rows), as_json=as_json, next_commands=further)


def _made(file: Path) -> dict[str, Any]:
    return {"file": file, "bytes": file.stat().st_size}


def _lines(kind: str, files: Sequence[Path], rows: Sequence[Row]) -> Iterator[str]:
    if kind == RECORDING_SUFFIX:
        yield records.recorded_table(rows)
    for file, row in zip(files, rows, strict=False):
        size = f"{file.stat().st_size / 1000:,.0f} kB"
        end = f"{row['ending'] or 'not ended'} after {row['time_s']:.2f} s"
        if row["return"] is not None:
            end += f", return {row['return']:.2f}"
        if kind == PICTURE:
            yield str(file)
        elif kind == RECORDING_SUFFIX:
            yield f"{file} ({size})"
        else:
            yield f"{file} ({size}; {end})"


def _draw_robot(
    reference: str,
    file: Path,
    shot: Viewpoint,
    xacro: Mapping[str, str],
    engine: str,
    permissions: Permissions,
) -> None:
    """Draw a picture of a robot on a floor, with its joints at 0."""
    import PIL.Image  # needs the extra `view`

    from deepbots_cli import engines
    from deepbots_cli.runtime.overview import view_around

    model = open_robot(reference, permissions.folders, xacro)[0].model
    pose = Pose((0.0, 0.0, resting_height(model)))
    world = WorldModel(0.01, 1, robots=(RobotBody("robot", model, fixed_base=True, pose=pose),))
    low, high = robot_bounds(model)
    view = shot.view(view_around([(add(low, pose.xyz), add(high, pose.xyz))], shot.width, shot.height))
    with closing(engines.create(engine, world)) as opened_engine:
        image = opened_engine.render(view)
    with atomic_write(file) as draft:
        PIL.Image.fromarray(image).save(draft, format="PNG")


def command_report(
    run: Annotated[
        Path,
        typer.Argument(
            metavar="RUN|GROUP",
            help="A run directory of `deepbots train`, or the folder of a group.",
        ),
    ],
    out: Annotated[
        Path | None, option("--output -o FILE", "File to write; by default RUN.html in the current folder.")
    ] = None,
    force: Force = False,
    figures: Annotated[Path | None, option("--figures FOLDER", "Also write every figure as PNG.")] = None,
    episodes: Annotated[
        int, integer("--episodes N", "Evaluation episodes to run again for trajectories.", 3, 1000)
    ] = 12,
    clips: Annotated[
        bool, option("--clips/--no-clips", "Film the best, the median and the worst episode.")
    ] = True,
    as_json: Json = False,
    allow_code: AllowCode = False,
) -> None:
    """Write a report about a run."""
    from deepbots_cli.view.plots import import_matplotlib

    if folder_kind(run) is SourceKind.STUDY:
        raise UsageError(
            f"the report of a study is gone; `deepbots runs {shell_word(run)}` lists the trials of {run}, and"
            f" `optuna-dashboard {shell_word(run / JOURNAL_NAME)}` shows them in the browser (pip install"
            " optuna-dashboard)"
        )
    target = out or Path(f"{run.resolve().name}.html")
    if target.suffix.lower() not in (".html", ".htm"):
        raise UsageError(f"{target} must end in .html")
    check_output(target, force=force)
    if figures is not None:
        check_folder(figures)
    try:
        import_matplotlib()
    except ModuleNotFoundError as error:
        raise MissingExtraError("train", "a report") from error
    from deepbots_cli.insight.report import FIGURE_NAMES, Report

    if figures is not None and figures.is_dir():
        check_output(*(figures / f"{name}.png" for name in FIGURE_NAMES), force=force)
    with terminal.transient_line("reading the run ..."):
        report = Report.read(run)
    if figures is not None and figures.is_dir():
        # Only the run names its agents, and each agent has a figure of its own.
        check_output(*(figures / f"{name}.png" for name in report.figure_names), force=force)
    selection = report.choose_episodes(episodes)
    permissions = Permissions(code=allow_code)
    with terminal.progress("episodes") as show:
        report.repeat_episodes(selection, show, clips=clips, permissions=permissions)
    with terminal.transient_line("looking for the causes ..."):
        report.find_causes(permissions)
    with terminal.transient_line("drawing ..."):
        with atomic_write(target) as draft:
            draft.write_text(report.html(), encoding="utf-8")
        figure_paths = report.write_figures(figures) if figures is not None else []
    for note in report.notes:
        terminal.note(f"note: {note}")
    figures_text = (
        f", {len(figure_paths)} figures in {shell_word(figures)}" if figures and figure_paths else ""
    )
    data = {
        "report": target,
        "result": report.result,
        **_run_data(report),
        "figures": figure_paths,
        "notes": report.notes,
    }
    terminal.show(
        data,
        report.result,
        f"{target} ({target.stat().st_size / 1000:,.0f} kB){figures_text}",
        as_json=as_json,
    )


def _run_data(report: Report) -> dict[str, object]:
    """Return the causes in a run, and the results of each of several agents."""
    of_agents = {
        agent.name: {"result": agent.result, "causes": [cause.as_json() for cause in agent.causes]}
        for agent in report.agents
    }
    return {
        "causes": [cause.as_json() for cause in report.causes],
        **({"agents": of_agents} if of_agents else {}),
    }


def command_plot(
    runs: Annotated[
        list[Path],
        typer.Argument(
            metavar="RUN", help="Run directories, folders of runs, or folders of TensorBoard files."
        ),
    ],
    out: Annotated[
        Path,
        option(
            "--output -o FILE", "File to write: .png, .svg or .pdf, or .csv with the points of the curves."
        ),
    ] = Path("plot.png"),
    statistic: Annotated[
        Statistic | None,
        option(
            "--statistic NAME",
            "Draw the `mean` over seeds or the interquartile mean, `iqm`, of returns and successes, with a 95 %"
            " bootstrap interval; by default the mean, and a band from the lowest to the highest seed.",
        ),
    ] = None,
    window: Annotated[
        int, integer("--window N", "Average returns and successes over this number of episodes.", 1, 100_000)
    ] = 100,
    force: Force = False,
    dark: Annotated[bool, option("--dark", "Light lines on a dark ground.")] = False,
) -> None:
    """Plot the learning curves of runs."""
    from deepbots_cli.view import plots, training_logs
    from deepbots_cli.view.pictures import check_target

    check_target(out, plots.SUFFIXES, force=force)
    with terminal.transient_line("reading the logs ..."):
        logs = training_logs.read_logs(runs, window, by_agent=True)
    if out.suffix.lower() == plots.DATA:
        write_tables(plots.curve_rows(logs, statistic), out, None)
    else:
        plots.save(plots.plot(logs, theme="dark" if dark else "light", statistic=statistic), out)
    for log in logs:
        if log.evaluation is not None and log.evaluation.remarks:
            terminal.note(
                f"note: about the evaluation that the diamond of {log.path} shows:"
                f" {'; '.join(log.evaluation.remarks)}"
            )
    terminal.print_result(f"{out} ({counted(len({log.path for log in logs}), 'run')})")
