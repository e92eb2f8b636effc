"""A report about a run or a group: one HTML file that loads nothing and needs no scripts.

Numbers come from the files of the runs: logs, and the last evaluation of the best model in the scenario of the training. Trajectories and
clips come from episodes of this evaluation that run again.
"""

from __future__ import annotations

import base64
import io
import platform
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, field
from importlib.metadata import version
from pathlib import Path
from shlex import join, quote
from statistics import fmean
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

import numpy as np

import deepbots_cli
from deepbots_cli.compiler.inputs import RESOLVED
from deepbots_cli.errors import DeepbotsError, EngineError, MissingExtraError, RunError, UsageError
from deepbots_cli.files import atomic, unwritable
from deepbots_cli.frames import Frame
from deepbots_cli.insight import figures
from deepbots_cli.insight.card import result_text
from deepbots_cli.insight.trace import KeptEpisodes, last_evaluation
from deepbots_cli.insight.training import findings
from deepbots_cli.learning.episodes import Episode
from deepbots_cli.learning.group import Group, is_group
from deepbots_cli.learning.run import Record, Run, is_training
from deepbots_cli.view import pictures, plots
from deepbots_cli.view.episodes import Player, Source
from deepbots_cli.view.frames import LinkName
from deepbots_cli.view.plots import Log

if TYPE_CHECKING:
    from matplotlib.figure import Figure


LABELS = ("best", "median", "worst")
_TRACED = 12
_CLIP_SECONDS, _CLIP_RATE = 10.0, 10.0
_SHOT = pictures.Shot(420, 300, samples=1)  # 60 instead of 200 ms a picture
Trace = list[Mapping[LinkName, Frame]]
"""The poses of all links, step by step."""
OnEpisode = Callable[[int, int], object]


@dataclass(frozen=True, eq=False)
class Member:
    """A run of a report: its files, its log, and its last evaluation."""

    run: Run
    log: Log
    evaluation: KeptEpisodes

    @staticmethod
    def read(path: Path, window: int) -> Member:
        """A run with a finished episode and an evaluation.

        Raises:
            RunError: It is damaged, or lacks one of the two; says what to do.
        """
        run = Run.open(path)
        found = last_evaluation(run)
        if found is None:
            raise RunError(f"{path} holds no evaluation of its best model since its training ended; next: deepbots eval {quote(str(path))}")
        (log,) = plots.read([path], window)
        return Member(run, log, found[1])


@dataclass(frozen=True, eq=False)
class Shown:
    """An episode of the evaluation of a member, chosen to be run again."""

    member: Member
    number: int
    label: str = ""
    """`best`, `median` or `worst` by return; empty for the others."""

    @property
    def outcome(self) -> Episode:
        return self.member.evaluation.outcomes[self.number]

    @property
    def is_success(self) -> bool:
        """Also where the scenario defines no success."""
        return self.outcome.is_success or not self.member.evaluation.success_defined

    @property
    def title(self) -> str:
        seed = f"seed {self.member.run.record.seed}, " if self.label else ""
        return f"{self.label}: {seed}episode {self.number}, return {self.outcome.total_return:.2f}, {self.outcome.ended_by}"


@dataclass
class Report:
    """What a report shows."""

    path: Path
    members: Sequence[Member]
    notes: list[str] = field(default_factory=list)
    clips: dict[str, tuple[str, bytes]] = field(default_factory=dict)
    """Caption and MP4, by label."""
    paths: Sequence[figures.Path] = ()
    link: str = ""
    fixed: dict[str, list[Any]] = field(default_factory=dict)

    @staticmethod
    def read(path: Path, window: int = 100) -> Report:
        """A run or a group from its files; seeds that cannot be read are noted.

        Raises:
            RunError: It cannot be read, or holds no evaluation.
        """
        if not is_group(path):
            return Report(path, [Member.read(path, window)], ["the training goes on"] if is_training(path) else [])
        group, members, notes = Group.open(path), list[Member](), list[str]()
        for seed in group.record.seeds:
            try:
                members.append(Member.read(group.run(seed), window))
            except DeepbotsError as error:
                notes.append(f"seed {seed} is left out: {' '.join(str(error).split())}")
        if not members:
            raise RunError(f"{path} holds no run that can be reported; {notes[0]}")
        return Report(path, members, notes)

    @property
    def record(self) -> Record:
        return self.members[0].run.record

    @property
    def result(self) -> str:
        """The result in one line, with its interval."""
        from deepbots_cli.learning.statistics import mean_interval

        found = [member.evaluation for member in self.members]
        if not is_group(self.path):
            return result_text(found[0])
        text = f"mean return {_over([each.mean_return for each in found], mean_interval, '{:.4g}')}"
        if all(each.success_defined for each in found):
            text += f", success rate {_over([each.success_rate for each in found], mean_interval, '{:.1%}', top=1.0)}"
        solved = f"; {sum(bool(each.solved) for each in found)} solved" if None not in [each.solved for each in found] else ""
        fewest, most = min(each.episodes for each in found), max(each.episodes for each in found)
        counts = f"{most:,}" if fewest == most else f"{fewest:,} to {most:,}"
        return f"{text}, over {len(found)} seed{'s' * (len(found) > 1)} with {counts} held-out episodes each{solved}"

    def chosen(self, count: int = _TRACED) -> list[Shown]:
        """Episodes at equal distances in the order of their returns, of which the first, the middle and the last have a label."""
        every = [Shown(member, number) for member in self.members for number in range(len(member.evaluation.outcomes))]
        every.sort(key=lambda shown: -shown.outcome.total_return)
        places, middle = {round(place) for place in np.linspace(0, len(every) - 1, count)}, len(every) // 2
        if middle not in places:
            places.remove(min(places, key=lambda place: abs(place - middle)))
            places.add(middle)
        labels = dict(zip((len(every) - 1, middle, 0), reversed(LABELS), strict=True))
        return [Shown(every[place].member, every[place].number, labels.get(place, "")) for place in sorted(places)]

    def run_again(self, shown: Sequence[Shown], on_episode: OnEpisode, *, clips: bool = True, allow_code: bool = False) -> None:
        """Run episodes of the evaluation again, for their paths and clips."""
        total, done = len(shown), 0
        traces: dict[Shown, Trace] = {}
        for member in self.members:
            mine = [each for each in shown if each.member is member]
            if not mine:
                continue
            source = Source(str(member.run.path), engine=member.evaluation.engine, allow_code=allow_code)
            with closing(source.open().player()) as player:
                for each in mine:
                    traces[each] = [frame.links for frame in player.episode(member.evaluation.seed, each.number)]
                    again = fmean(agent.episode_return for agent in player.frame.agents.values())
                    if abs(again - each.outcome.total_return) > 1e-6 * max(1.0, abs(again)):
                        self.notes.append(
                            f"episode {each.number} of seed {member.run.record.seed} has the return {again:.4g} when it is run again, and "
                            f"{each.outcome.total_return:.4g} in the evaluation: versions or machine differ; path and clip are those of now"
                        )
                    if clips and each.label:
                        self._film(player, each)
                    done += 1
                    on_episode(done, total)
        self.fixed = _standing(player, traces)
        self.link = _traced_link(player, next(iter(traces.values())))
        body, _, link = self.link.partition("/")
        self.paths = [
            figures.Path(each.title, [links[body, link][0] for links in traces[each]], each.is_success, bool(each.label)) for each in shown
        ]

    def _film(self, player: Player, shown: Shown) -> None:
        time = player.frame.time
        speed, rate = max(1.0, time / _CLIP_SECONDS), _CLIP_RATE
        with TemporaryDirectory() as folder:
            target = Path(folder, "clip.mp4")
            try:
                pictures.check_target(target, (".mp4",))
                pictures.clip(player, target, _SHOT, seed=shown.member.evaluation.seed, episode=shown.number, speed=speed, rate=rate)
            except (EngineError, MissingExtraError) as error:
                self.notes = list(dict.fromkeys([*self.notes, f"there are no clips: {error}"]))
                return
            fast = f", {speed:.1f} times as fast" if speed > 1 else ""
            self.clips[shown.label] = (f"{shown.title} after {time:.1f} s{fast}", target.read_bytes())

    # Figures

    def figures(self, theme: str) -> Iterator[tuple[str, str, Figure | None]]:
        """Name, caption and figure; None where there is nothing to draw."""
        logs, outcomes = [member.log for member in self.members], [e for member in self.members for e in member.evaluation.outcomes]
        defined = self.members[0].evaluation.success_defined
        seeds = "" if len(logs) == 1 else f" The line is the mean of {len(logs)} seeds, the band reaches from the lowest to the highest."
        mean = "Moving means over 100 episodes of the training, in which the policy explores."
        yield "returns", f"{mean}{seeds}", figures.returns(logs, theme)
        yield "successes", f"{mean}{seeds}", figures.successes(logs, theme)
        yield "shares", "The absolute sum of each term over an episode, as a share of all.", figures.shares(logs, theme)
        yield "endings", "How episodes of the training end, in 40 equal parts of it.", figures.endings(logs, theme)
        colours = "green: success, orange: no success; " if defined else ""
        caption = (
            f"Each point is an evaluation episode ({colours}{len(outcomes):,} in all). Bars are means over parts of the range, with 95 % "
            "intervals. Values in SI units, those with the largest effect first."
        )
        yield "starts", caption, figures.starts(outcomes, theme, success_defined=defined)
        if self.paths:
            marks = "disc: success, cross: none" if defined else "disc: end"
            title = f"{len(self.paths)} evaluation episodes from above: {self.link}. Ring: start, {marks}."
            world = self.members[0].run.program.world
            yield "trajectories", title, figures.trajectories(self.paths, world, self.fixed, theme)

    def write_figures(self, folder: Path) -> list[Path]:
        """Every figure as PNG.

        Raises:
            UsageError: A file cannot be written.
        """
        written = []
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise UsageError(unwritable(folder, error)) from error
        for name, _, figure in self.figures("light"):
            if figure is not None:
                written.append(folder / f"{name}.png")
                with atomic(written[-1]) as draft:
                    figure.savefig(draft, dpi=150)
        return written

    # The page

    def html(self) -> str:
        """The page."""
        from jinja2 import Environment, PackageLoader, StrictUndefined

        loader = PackageLoader("deepbots_cli.insight", ".")
        environment = Environment(loader=loader, undefined=StrictUndefined, autoescape=True, trim_blocks=True, lstrip_blocks=True)
        dark = {name: figure for name, _, figure in self.figures("dark")}
        drawn = [
            {"name": name, "caption": caption, "light": _svg(figure), "dark": _svg(dark[name])}
            for name, caption, figure in self.figures("light")
            if figure is not None
        ]
        run = self.members[0].run
        lines = (run.path / RESOLVED).read_text("utf-8").splitlines()
        found = findings(run)
        here = {finding.span.begin.line for finding in found if finding.span.source.name.endswith(RESOLVED)}
        ordered = ((label, self.clips[label]) for label in LABELS if label in self.clips)
        clips = {label: (caption, _uri("video/mp4", data)) for label, (caption, data) in ordered}
        return environment.get_template("report.html.j2").render(
            report=self, program=run.program, record=run.record, figures=drawn, lines=lines, marked=here,
            findings=found, clips=clips,
            rows=[(member.run.path.name, member.run.record, result_text(member.evaluation)) for member in self.members],
            command=join(run.record.command) or "(from Python)", version=deepbots_cli.__version__, python=platform.python_version(),
            matplotlib=version("matplotlib"), notes=dict.fromkeys([*self.notes, *(note for m in self.members for note in m.run.notes())]),
        )  # fmt: skip


def _over(values: Sequence[float], interval: Callable[[Sequence[float]], Any], form: str, top: float | None = None) -> str:
    """A mean over seeds with its interval; shares stay between 0 and `top`."""
    found = interval(values)
    if found is None:
        return form.format(fmean(values))
    low, high = found if top is None else (max(0.0, found[0]), min(top, found[1]))
    return f"{form.format(fmean(values))} (95 % interval over seeds {form.format(low)} .. {form.format(high)})"


def _traced_link(player: Player, trace: Trace) -> str:
    """The root link of the first robot; of a robot that stands still, the link that goes furthest."""
    robot = player.env.world.robots[0]

    def way(link: str) -> float:
        points = np.array([links[robot.name, link][0] for links in trace])
        return float(np.linalg.norm(np.diff(points, axis=0), axis=1).sum())

    links = [link.name for link in robot.model.links]
    return f"{robot.name}/{robot.model.root if way(robot.model.root) > 0.01 else max(links, key=way)}"


def _standing(player: Player, traces: dict[Shown, Trace]) -> dict[str, list[Any]]:
    """The outlines of objects that have one form, and one place in all these episodes."""
    moments = [links for trace in traces.values() for links in (trace[0], trace[-1])]
    found = {}
    for thing in player.env.world.objects:
        poses = {links.get((thing.name, thing.name)) for links in moments}
        pose = poses.pop() if len(poses) == 1 else None
        if pose is not None and not thing.variants:
            found[thing.name] = figures.outline(thing.shape, pose)
    return found


def _svg(figure: Any) -> str:
    import matplotlib

    stream = io.BytesIO()
    with matplotlib.rc_context({"svg.hashsalt": "deepbots"}):  # the same names of clip paths each time
        figure.savefig(stream, format="svg", metadata={"Date": None, "Creator": None})
    return _uri("image/svg+xml", stream.getvalue())


def _uri(kind: str, data: bytes) -> str:
    return f"data:{kind};base64,{base64.b64encode(data).decode()}"
