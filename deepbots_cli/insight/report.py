"""A report about a run or a group: one HTML file that loads nothing and needs no JavaScript.

Numbers come from the files of the runs: logs, and the evaluation of the best model with the most episodes
(`verdict.py`). Trajectories and clips come from episodes of this evaluation that run again.
"""

from __future__ import annotations

import platform
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import field
from functools import partial
from importlib.metadata import version
from itertools import chain, groupby
from pathlib import Path
from shlex import join
from statistics import fmean
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

import numpy as np

import deepbots_cli
from deepbots_cli.analysis.shown_units import ShownUnits
from deepbots_cli.compiler.inputs import RESOLVED_NAME
from deepbots_cli.diagnostics.findings import Source as Text
from deepbots_cli.document import Permissions
from deepbots_cli.errors import DeepbotsError, EngineError, MissingExtraError, RunError
from deepbots_cli.frames import Frame, Triple
from deepbots_cli.insight import figures
from deepbots_cli.insight.causes import causes_after, causes_of
from deepbots_cli.insight.scenario_facts import LintedScenario, linted_scenario
from deepbots_cli.insight.statements import Statement, render_template
from deepbots_cli.insight.training import read_trainings
from deepbots_cli.learning.campaigns.group import Group
from deepbots_cli.learning.comparison import GroupResult
from deepbots_cli.learning.runs.evaluations import (
    EvaluationResult,
    draw_labels,
    drawn_effects,
    in_parentheses,
)
from deepbots_cli.learning.runs.run import DEMONSTRATIONS_NAME, Run
from deepbots_cli.learning.runs.statistics import Interval
from deepbots_cli.learning.runs.verdict import RunVerdict, quoted_episodes, run_verdict
from deepbots_cli.program import Member
from deepbots_cli.program.world import WorldModel
from deepbots_cli.records import dataclass
from deepbots_cli.rollout import Episode
from deepbots_cli.rollout.source import Source, SourceKind, folder_kind
from deepbots_cli.view import pictures, training_logs
from deepbots_cli.view.episodes import Player, Showing
from deepbots_cli.view.frames import LinkName
from deepbots_cli.view.pictures import Moving, Positions
from deepbots_cli.view.replay import open_player
from deepbots_cli.view.training_logs import TrainingLog
from deepbots_cli.words import counted, number_text, rate_text, shell_word

if TYPE_CHECKING:
    from matplotlib.figure import Figure


FIGURE_NAMES = ("returns", "successes", "teacher", "shares", "endings", "starts", "trajectories")
AGENT_FIGURES = {
    "returns": "Learning curve",
    "successes": "Success",
    "shares": "Reward terms",
    "actions": "Actions",
}
"""The figures of each of several agents, and their titles."""
_MAX_TRACED_EPISODES = 12
_MAX_CLIP_S, _CLIP_FRAME_RATE = 10.0, 10.0
_MEANS_CAPTION = "Moving means over 100 episodes of the training, in which the policy explores."
_SHARES_CAPTION = (
    "Share of each reward term: absolute value of its sum over an episode, relative to all terms."
)
_VIEWPOINT = pictures.Viewpoint(420, 300, samples=1)  # 60 instead of 200 ms a picture
OnEpisode = Callable[[int, int], object]


@dataclass(frozen=True, eq=False)
class ReportRun:
    """A run of a report: its files, its log, and the evaluation that is quoted everywhere."""

    run: Run
    log: TrainingLog
    evaluation: EvaluationResult

    @staticmethod
    def read(path: Path) -> ReportRun:
        """Read a run with a finished episode and an evaluation.

        Raises:
            RunError: It is damaged, or lacks one of the two; the message has the remedy.
        """
        run = Run.open(path)
        quoted = quoted_episodes(run)
        if quoted is None:
            raise RunError(
                f"{path} contains no evaluation of its best model after the training; create one with:"
                f" deepbots eval {shell_word(path)}"
            )
        (log,) = training_logs.read_logs([path])
        return ReportRun(run, log, quoted)

    @property
    def verdict(self) -> RunVerdict:
        """The verdict on whether the run is solved, with this evaluation."""
        return RunVerdict(run_verdict(self.run.path, self.run.record).solved, self.evaluation)

    @property
    def is_unsolved(self) -> bool:
        """Whether the task has a criterion or a success, and the run does not solve it."""
        return self.verdict.is_unsolved(defines_success=self.run.program.defines_success)


@dataclass(eq=False)
class ReportEpisode:
    """An episode of the evaluation of a run, to run again. `positions` are the positions of all links,
    and `end_poses` the poses of all links in its first and in its last frame."""

    shown: ReportRun
    number: int
    label: str = ""
    """The label `best`, `median` or `worst` by return; empty for the others."""
    positions: Positions = field(default_factory=dict)
    actions: list[Any] = field(default_factory=list)
    """The actions of all agents, one for each step."""
    end_poses: Sequence[Mapping[LinkName, Frame]] = ()

    @property
    def outcome(self) -> Episode:
        return self.shown.evaluation.outcomes[self.number]

    @property
    def is_success(self) -> bool:
        """Whether the episode is a success; true if the scenario defines no success."""
        return self.outcome.is_success or not self.shown.evaluation.success_defined

    @property
    def title(self) -> str:
        seed = f"seed {self.shown.run.record.seed}, " if self.label else ""
        return (
            f"{self.label}: {seed}episode {self.number}, return {self.outcome.total_return:z.2f},"
            f" {self.outcome.ended_by}"
        )


@dataclass
class ReportAgent:
    """The part of a report about one of several agents: its log in each run, and the causes why it does not
    succeed."""

    member: Member
    logs: Sequence[TrainingLog]
    causes: Sequence[Statement] = ()

    @property
    def name(self) -> str:
        return self.member.name

    @property
    def result(self) -> str:
        """The evaluation of each run in words."""
        return "; ".join(log.evaluation.text for log in self.logs if log.evaluation is not None)


@dataclass
class Report:
    """The content of a report."""

    path: Path
    runs: Sequence[ReportRun]
    notes: list[str] = field(default_factory=list)
    clips: dict[str, tuple[str, str]] = field(default_factory=dict)
    """The caption, and the MP4 as a data URI, by label."""
    episodes: Sequence[ReportEpisode] = ()
    """The episodes that ran again."""
    moving: Moving = Moving((), ())
    """The parts whose trajectories are drawn."""
    outlines: Sequence[list[Triple]] = ()
    """The outlines of objects that stand still in all of them."""
    causes: Sequence[Statement] = ()
    """The causes why the run `diagnosed` does not solve its task, the most likely first."""
    diagnosed: str = ""
    agents: list[ReportAgent] = field(default_factory=list)

    def __post_init__(self) -> None:
        try:
            self.agents = [
                ReportAgent(
                    member, [training_logs.read_run(entry.run.path, member=member) for entry in self.runs]
                )
                for member in self.runs[0].run.program.members.values()
            ]
        except RunError as error:
            self.notes.append(str(error))

    @staticmethod
    def read(path: Path) -> Report:
        """Read a run or a group from its files; seeds that cannot be read are noted.

        Raises:
            RunError: It cannot be read, or has no evaluation.
        """
        source = Source.open(path, Permissions(), SourceKind.RUN, SourceKind.GROUP)
        if source.kind is SourceKind.RUN:
            shown = ReportRun.read(path)
            is_running = shown.run.record.state(path) == "training"
            return Report(path, [shown], ["the training is still running"] if is_running else [])
        group, shown_runs = Group.open(path), list[ReportRun]()
        notes = ["the training is still running"] if group.state == "training" else []
        for seed in group.record.seeds:
            try:
                shown_runs.append(ReportRun.read(group.run(seed)))
            except DeepbotsError as error:
                notes.append(f"seed {seed} is left out: {' '.join(str(error).split())}")
        if not shown_runs:
            raise RunError(f"{path} contains no run that can be reported; {notes[0]}")
        return Report(path, shown_runs, notes)

    @property
    def stages(self) -> list[tuple[str, ...]]:
        """The stages of a curriculum: run, name, timesteps at their beginning, mean value at their
        end, and their last evaluation."""
        rows: list[tuple[str, ...]] = []
        for shown in self.runs:
            log, result = shown.log, shown.run.record.result
            ends = {stage.name: f"{number_text(stage.value)}" for stage in result.stages} if result else {}
            evaluations = (
                dict(zip(log.evaluation_stages, log.evaluations[1], strict=True)) if log.evaluations else {}
            )
            for start in log.stages:
                last = f"{number_text(evaluations[start.name])}" if start.name in evaluations else ""
                rows.append(
                    (shown.run.path.name, start.name, f"{start.steps:,.0f}", ends.get(start.name, ""), last)
                )
        return rows

    @property
    def result(self) -> str:
        """The result in one line, with its interval."""
        evaluations = [shown.evaluation for shown in self.runs]
        if folder_kind(self.path) is not SourceKind.GROUP:
            return self.runs[0].verdict.text
        group = GroupResult(self.path.name, tuple(evaluations))
        text = "mean return " + _over_seeds(number_text, group.mean_return, group.return_interval)
        if group.success_defined:
            text += ", success rate " + _over_seeds(
                partial(rate_text, decimals=1), group.success_rate, group.success_interval
            )
        answers = [shown.verdict.solved for shown in self.runs]
        solved = f"; {answers.count(True)} solved" if None not in answers else ""
        remarks = in_parentheses(words for evaluation in evaluations for words in evaluation.remarks)
        fewest = min(evaluation.episodes for evaluation in evaluations)
        most = max(evaluation.episodes for evaluation in evaluations)
        counts = f"{most:,}" if fewest == most else f"{fewest:,} to {most:,}"
        seeds = counted(len(evaluations), "seed")
        return f"{text}, over {seeds} with {counts} held-out episodes each{remarks}{solved}"

    @property
    def teacher(self) -> str:
        """The script or recording that teaches the policy, and its score, in sentences; empty without one."""
        logs = [shown.log for shown in self.runs if shown.log.teacher]
        if not logs:
            return ""
        is_recording = logs[0].teacher == DEMONSTRATIONS_NAME
        text = f"The {'recording' if is_recording else 'script'} {logs[0].teacher} taught the policy."
        scores = {
            name: fmean(float(log.lessons[name][1][-1]) for log in logs)
            for name in ("success_rate", "mean_return")
            if all(name in log.lessons for log in logs)
        }
        if "mean_return" not in scores:  # the training is older than this scalar
            return text
        rate = f"success rate {rate_text(scores['success_rate'], 1)}, " if "success_rate" in scores else ""
        stage = ", in the last stage that began" if any(log.stages for log in logs) else ""
        starts = "" if is_recording else f" from the starts of the evaluations during the training{stage}"
        return f"{text} Its own score{starts}: {rate}mean return {number_text(scores['mean_return'])}."

    @property
    def declines(self) -> list[str]:
        """A sentence for each training that fell apart."""
        fallen = [
            (shown.run.record.seed, shown.log.decline) for shown in self.runs if shown.log.decline is not None
        ]
        return [fall.text if len(self.runs) == 1 else f"seed {seed}: {fall.text}" for seed, fall in fallen]

    @property
    def units(self) -> ShownUnits:
        """The units in which the scenario writes its quantities."""
        return self.runs[0].run.compiled.units

    def choose_episodes(self, count: int = _MAX_TRACED_EPISODES) -> list[ReportEpisode]:
        """Choose episodes at equal distances in the order of their returns. The first, the middle and the
        last have a label."""
        episodes = [
            ReportEpisode(shown, number)
            for shown in self.runs
            for number in range(len(shown.evaluation.outcomes))
        ]
        episodes.sort(key=lambda episode: -episode.outcome.total_return)
        indices = {round(index) for index in np.linspace(0, len(episodes) - 1, count)}
        middle = len(episodes) // 2
        if middle not in indices:
            indices.remove(min(indices, key=lambda index: abs(index - middle)))
            indices.add(middle)
        # Of equal numbers the last one counts: a single episode is the best one, and two have no middle.
        labels = dict(zip((middle, len(episodes) - 1, 0), ("median", "worst", "best"), strict=True))
        return [
            ReportEpisode(episodes[index].shown, episodes[index].number, labels.get(index, ""))
            for index in sorted(indices)
        ]

    def repeat_episodes(
        self,
        episodes: Sequence[ReportEpisode],
        on_episode: OnEpisode,
        *,
        clips: bool,
        permissions: Permissions = Permissions(),
    ) -> None:
        """Run episodes of the evaluation again, for their paths and clips."""
        self.episodes = episodes
        ordered = sorted(episodes, key=lambda episode: self.runs.index(episode.shown))
        for shown, group in groupby(ordered, lambda episode: episode.shown):
            showing = Showing(str(shown.run.path), engine=shown.evaluation.engine, permissions=permissions)
            with closing(open_player(showing.open())) as player:
                for episode in group:
                    frames = player.episode(shown.evaluation.seed, episode.number)
                    first = next(frames)
                    episode.positions = pictures.read_positions(
                        player.reader.layout,
                        chain((first,), _recording_actions(player, frames, episode.actions)),
                    )
                    episode.end_poses = (first.links, player.frame.links)
                    again = fmean(agent.episode_return for agent in player.frame.agents.values())
                    if abs(again - episode.outcome.total_return) > 1e-6 * max(1.0, abs(again)):
                        self.notes.append(
                            f"episode {episode.number} of seed {shown.run.record.seed} has the return"
                            f" {number_text(again)} when it is run again, but "
                            f"{number_text(episode.outcome.total_return)} in the evaluation: the versions or"
                            " the"
                            " machine differ; "
                            "the path and the clip show the new episode"
                        )
                    if clips and episode.label:
                        self._film(player, episode)
                    on_episode(ordered.index(episode) + 1, len(episodes))
        self.outlines = _standing(player, episodes)
        self.moving = pictures.find_moving(
            player.program, player.env.world, [episode.positions for episode in episodes]
        )

    def _film(self, player: Player, episode: ReportEpisode) -> None:
        time = player.frame.time
        speed, rate = max(1.0, time / _MAX_CLIP_S), _CLIP_FRAME_RATE
        with TemporaryDirectory() as folder:
            target = Path(folder, "clip.mp4")
            try:
                pictures.check_target(target, (".mp4",), force=True)
                pictures.write_clip(
                    player,
                    target,
                    _VIEWPOINT,
                    seed=episode.shown.evaluation.seed,
                    episode=episode.number,
                    speed=speed,
                    rate=rate,
                )
            except (EngineError, MissingExtraError) as error:
                self.notes = list(dict.fromkeys([*self.notes, f"there are no clips: {error}"]))
                return
            fast = f", {speed:.1f} times as fast" if speed > 1.05 else ""
            self.clips[episode.label] = (
                f"{episode.title} after {time:.1f} s{fast}",
                figures.data_uri("video/mp4", target.read_bytes()),
            )

    def find_causes(self, permissions: Permissions = Permissions()) -> None:
        """Find out why the run does not solve its task, or the worst unsolved seed of a group."""
        if self.agents:
            self._find_causes_of_agents(permissions)
            return
        unsolved = [shown for shown in self.runs if shown.is_unsolved]
        if not unsolved:
            return
        worst = min(
            unsolved,
            key=lambda shown: (shown.evaluation.success_rate or 0.0, shown.evaluation.mean_return),
        )
        self.diagnosed = worst.run.path.name
        try:
            self.causes = causes_after(worst.run.path, permissions)
        except DeepbotsError as error:
            self.notes.append(f"there are no causes: {error}")

    def _find_causes_of_agents(self, permissions: Permissions) -> None:
        """Find out why each agent does not succeed in the first run."""
        self.diagnosed = self.runs[0].run.path.name
        try:
            for agent, training in zip(self.agents, read_trainings(self.runs[0].run), strict=True):
                agent.causes = causes_of(training, permissions)
        except DeepbotsError as error:
            self.notes.append(f"there are no causes: {error}")

    # Figures

    def agent_figures(self, agent: ReportAgent, theme: str) -> Iterator[tuple[str, str, Figure | None]]:
        """Yield name, caption and figure of each figure of an agent, as `figures` does."""
        yield "returns", _MEANS_CAPTION, figures.scores(agent.logs, theme, "mean_return")
        yield "successes", _MEANS_CAPTION, figures.scores(agent.logs, theme, "success_rate")
        yield "shares", _SHARES_CAPTION, figures.shares(agent.logs, theme)
        actions = [action for episode in self.episodes for action in episode.actions]
        caption = f"What the policy does in {len(self.episodes)} evaluation episodes; numbers from -1 to 1."
        yield "actions", caption, figures.actions(agent.member, actions, theme)

    def figures(self, theme: str) -> Iterator[tuple[str, str, Figure | None]]:
        """Yield name, caption and figure; the figure is None if there is nothing to draw."""
        logs = [shown.log for shown in self.runs]
        outcomes = [e for shown in self.runs for e in shown.evaluation.outcomes]
        defined = self.runs[0].evaluation.success_defined
        seeds = (
            ""
            if len(logs) == 1
            else f" The line is the mean of {len(logs)} seeds, the band reaches from the lowest to the"
            " highest."
        )
        mean = _MEANS_CAPTION
        if any("driven_worlds" in log.lessons for log in logs):
            mean += " The script that teaches the policy drives at first."
        if any(log.stages for log in logs):
            mean += " Each stage of the curriculum is averaged by itself."
        diamond = (
            " A diamond is the evaluation of the best model of a seed, at its step."
            if any(log.evaluation for log in logs)
            else ""
        )
        yield "returns", f"{mean}{seeds}{diamond}", figures.scores(logs, theme, "mean_return")
        yield (
            "successes",
            f"{mean}{seeds}{diamond if defined else ''}",
            figures.scores(logs, theme, "success_rate"),
        )
        lessons = (
            "While the policy only imitates, the imitation loss has the weight 1; then the weight falls to 0."
        )
        if any("agreement" in log.lessons for log in logs):
            lessons += (
                " Agreement is the share of the states in which the policy does what the script would do."
            )
        if any("driven_worlds" in log.lessons for log in logs):
            lessons += " Driven worlds are the share that the script drives."
        yield "teacher", lessons + seeds, figures.lessons(logs, theme)
        yield "shares", _SHARES_CAPTION, figures.shares(logs, theme)
        yield "endings", f"How episodes of the training end. {mean}", figures.endings(logs, theme)
        colors = "green: success, orange: no success; " if defined else ""
        effects = drawn_effects(outcomes, draw_labels(self.runs[0].run.program, self.units))
        conclusion = f"{effects.conclusion[:1].upper()}{effects.conclusion[1:]}."
        caption = (
            f"{conclusion} Each point is an evaluation episode ({colors}{len(outcomes):,} in all). "
            "Bars are means over parts of the range, with 95 % intervals."
        )
        yield "starts", caption, figures.starts(outcomes, effects, theme, success_defined=defined)
        if self.episodes:
            world = self.runs[0].run.program.world
            figure = figures.trajectories(self.episodes, self.moving, world, self.outlines, theme)
            yield "trajectories", self._trajectories_caption(world), figure

    def _trajectories_caption(self, world: WorldModel) -> str:
        names, targets = (
            list(dict.fromkeys(pictures.describe(world, part) for part in parts))
            for parts in (self.moving.parts, self.moving.targets)
        )
        others = f"; dotted: {', '.join(names[1:])}" if names[1:] else ""
        marks = "disc: success, cross: none" if self.runs[0].evaluation.success_defined else "disc: end"
        stars = f", star: {', '.join(targets)}" if targets else ""
        return f"{len(self.episodes)} evaluation episodes: {names[0]}{others}. Ring: start, {marks}{stars}."

    def write_figures(self, folder: Path) -> list[Path]:
        """Write every figure as PNG.

        Raises:
            UsageError: A file cannot be written.
        """
        of_all = ((name, figure) for name, _, figure in self.figures("light"))
        of_agents = (
            (f"{agent.name}-{name}", figure)
            for agent in self.agents
            for name, _, figure in self.agent_figures(agent, "light")
        )
        return figures.write_figure_files(
            folder, ((name, figure) for name, figure in chain(of_all, of_agents) if figure is not None)
        )

    @property
    def figure_names(self) -> tuple[str, ...]:
        """The names of all figures, without those that there may not be."""
        return (*FIGURE_NAMES, *(f"{agent.name}-{name}" for agent in self.agents for name in AGENT_FIGURES))

    def html(self) -> str:
        """Return the page."""
        drawn = _drawn(self.figures)
        run = self.runs[0].run
        linted = linted_scenario(run)
        clips = {label: self.clips[label] for label in ("best", "median", "worst") if label in self.clips}
        notes = [*self.notes, *self.declines, *(note for shown in self.runs for note in shown.run.notes())]
        return render_template(
            "report.html.j2",
            html=True,
            report=self,
            program=run.program,
            record=run.record,
            figures=drawn,
            agents=[(agent, _drawn(partial(self.agent_figures, agent))) for agent in self.agents],
            agent_titles=AGENT_FIGURES,
            clips=clips,
            findings=[
                (f"{_name(run, finding.span.source)}:{finding.span.start_position.line}", finding)
                for finding in linted.findings
            ],
            listings=_listings(run, linted),
            rows=[(shown.run.path.name, shown.run.record, shown.verdict.text) for shown in self.runs],
            command=join(run.record.command) or "(from Python)",
            version=deepbots_cli.__version__,
            python=platform.python_version(),
            matplotlib=version("matplotlib"),
            notes=dict.fromkeys(notes),
        )


def _recording_actions(player: Player, played: Iterable[Any], actions: list[Any]) -> Iterator[Any]:
    """Yield the frames after the first one, and record the action before each."""
    for frame in played:
        actions.append(player.action)
        yield frame


def _drawn(draw: Callable[[str], Iterable[tuple[str, str, Figure | None]]]) -> list[dict[str, str]]:
    """Return figures for the page, each for a light and a dark background."""
    dark = {name: figure for name, _, figure in draw("dark")}
    return [
        {
            "name": name,
            "caption": caption,
            "light": figures.svg_uri(figure),
            "dark": figures.svg_uri(dark[name]),
        }
        for name, caption, figure in draw("light")
        if figure is not None
    ]


@dataclass(frozen=True)
class Listing:
    """A file of the scenario, with the lines (from 1) that findings name."""

    name: str
    lines: Sequence[str]
    marked: frozenset[int]


def _listings(run: Run, linted: LintedScenario) -> list[Listing]:
    """Return the files that the findings name, the scenario first; `resolved.yaml` too if the scenario is
    more than its file."""
    spans = [finding.span for finding in linted.findings]
    texts = dict.fromkeys([*([linted.text] if linted.text else []), *(span.source for span in spans)])
    listings = [
        Listing(
            _name(run, text),
            text.text.splitlines(),
            frozenset(span.start_position.line for span in spans if span.source is text),
        )
        for text in texts
    ]
    resolved = (run.path / RESOLVED_NAME).read_text("utf-8")
    if not linted.is_whole and all(text.text != resolved for text in texts):
        listings.append(Listing(RESOLVED_NAME, resolved.splitlines(), frozenset()))
    return listings


def _name(run: Run, text: Text) -> str:
    """Return the name of a file. The name of a copy begins in the folder of the run."""
    path = Path(text.name)
    return str(path.relative_to(run.path)) if path.is_relative_to(run.path) else text.name


def _over_seeds(form: Callable[[float], str], mean: float, interval: Interval | None) -> str:
    low, high = map(form, interval or (mean, mean))
    return form(mean) + (f" (95 % interval over seeds {low} .. {high})" if interval else "")


def _standing(player: Player, episodes: Sequence[ReportEpisode]) -> list[list[Triple]]:
    """Return the outlines of objects that have one form, and one pose in all these episodes."""
    outlines = []
    for body in player.env.world.objects:
        poses = {links.get((body.name, body.name)) for episode in episodes for links in episode.end_poses}
        pose = poses.pop() if len(poses) == 1 else None
        if pose is not None and not body.variants:
            outlines.append(figures.outline(body.shape, pose))
    return outlines
