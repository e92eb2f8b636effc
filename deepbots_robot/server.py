"""The loop that acts for a robot: it checks messages, calls the policy once per step, limits its commands,
and reacts to silence.

A step happens when every input has a new value, and no more often than the bundle's rate. If a value is
missing, the step uses the last one while it is young enough. Otherwise the robot gets the safe posture in
every step until all inputs have valid values again. Silence and faulty messages are both reasons.
"""

from __future__ import annotations

import time
from collections import Counter, deque
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from deepbots_robot.intake import RESTART, Input, Intake, Refusal
from deepbots_robot.link import Array, Link
from deepbots_robot.model import printable
from deepbots_robot.topics import ACTION, Field

EARLY = 0.25
"""The share of a period by which a step may come before its time, since messages do not arrive evenly."""
LATE = 0.5
"""The share of a period after which a step no longer waits for new values."""
_LONGEST_WAIT = 0.1  # s; a longer wait would delay the reaction to a signal
_LOOK = 1.0
"""The time in s between two checks of the other end."""
QUIET = 5.0
"""The time in s without a value in lockstep, or without a first step, after which the server prints a
remark."""
_MOST_REMARKS = 100
_MOST_ANSWERS = 100_000
"""The number of kept answer times, so that the memory of the server does not grow with its running time."""


@dataclass(frozen=True)
class Output:
    """The command of one actuator.

    Attributes:
        field: Its name, shape and unit.
        low: Smallest command, -inf without a limit.
        high: Largest command, inf without a limit.
        max_rate: The largest change per s, inf without a limit.
        safe: The command of the safe posture; NaN keeps the last command.
    """

    field: Field
    low: Array
    high: Array
    max_rate: Array
    safe: Array


class Policy(Protocol):
    """The interface of a policy; `deepbots_robot.Policy` has it."""

    def step(self, values: Mapping[str, Any]) -> Mapping[str, Array] | None:
        """Return the commands for these values; None for the safe posture, while no episode runs."""

    def reset(self) -> None: ...


class Log(Protocol):
    """The interface of a log; see `log.py`."""

    def step(
        self,
        stamp: float,
        values: Mapping[str, Array],
        commands: Mapping[str, Array],
        answer: float,
        posture: str,
        ages: Mapping[str, float] = {},
    ) -> None: ...

    def event(self, stamp: float, kind: str, text: str) -> None: ...


class Commands:
    """Keeps commands finite, within their limits, and no faster than actuators may change."""

    def __init__(self, outputs: Sequence[Output]) -> None:
        self._outputs = outputs
        self._last: dict[str, Array] = {}
        self.limited = 0

    def limit(self, commands: Mapping[str, Array], elapsed: float) -> dict[str, Array] | None:
        """Return the commands that may be sent `elapsed` s after the last ones; None if one is missing, of
        another shape, or not finite."""
        limited: dict[str, Array] = {}
        changed = False
        for output in self._outputs:
            command = commands.get(output.field.name)
            if command is None or np.shape(command) != output.field.shape or not np.isfinite(command).all():
                return None
            wanted = np.asarray(command, float)
            value = np.clip(wanted, output.low, output.high)
            last = self._last.get(output.field.name)
            if last is not None:
                reach = output.max_rate * elapsed
                # The range is applied last.
                value = np.clip(np.clip(value, last - reach, last + reach), output.low, output.high)
            changed |= bool((value != wanted).any())
            limited[output.field.name] = value
        self._last = limited
        self.limited += changed
        return limited

    def safe(self) -> dict[str, Array]:
        """Return the safe posture. A component without a safe command keeps its last command, or is left out
        if there was none."""
        safe = {}
        for output in self._outputs:
            last = self._last.get(output.field.name)
            held = np.full(output.field.shape, np.nan) if last is None else last
            value = np.where(np.isnan(output.safe), held, output.safe)
            if np.isfinite(value).all():
                safe[output.field.name] = value
        self._last = {**self._last, **safe}
        return safe


class Server:
    """A policy that acts for one robot over a link."""

    def __init__(
        self,
        policy: Policy,
        inputs: Sequence[Input],
        outputs: Sequence[Output],
        link: Link,
        rate: float,
        *,
        speed: float = 1.0,
        lockstep: bool = False,
        log: Log | None = None,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        """Create a server. `rate` is the number of steps per second of robot time. `speed` is robot time per
        wall time.

        With `lockstep` the robot waits for each answer: a step happens whenever all inputs have new values,
        and silence is not a fault.
        """
        self.intake = Intake(inputs, None if lockstep else speed)
        self.commands = Commands(outputs)
        self.link = link
        self.answers: deque[float] = deque(maxlen=_MOST_ANSWERS)
        """The newest times from values to commands, in s."""
        self.steps = self.safe_steps = self.held_steps = self.episodes = 0
        self.faults: Counter[str] = Counter()
        """The number of changes to the safe posture, by kind of reason."""
        self._policy, self._lockstep, self._log, self._clock = policy, lockstep, log, clock
        self._speed, self._step_time = speed, 1.0 / rate
        self._period = self._step_time / speed
        self._due = -np.inf
        self._begun_at = np.inf
        self._fault = ""  # the kind of reason for the safe posture in this episode
        self._is_safe = False  # whether the last command was that of the safe posture
        self._last_sent: Mapping[str, Array] = {}
        self._sent_at = self._looked_at = clock()
        # The time of the last arrival; inf without one, or once its absence was reported.
        self._heard_at = np.inf
        self.remarks: list[str] = []
        """The remarks about the other end."""

    def run(self, stopped: Callable[[], bool] = lambda: False) -> None:
        """Serve until `stopped`; the safe posture is the last command."""
        try:
            while not stopped():
                self.link.wait(self._patience())
                self.turn()
                if self._clock() > self._looked_at + _LOOK:
                    self._look()
        finally:
            if self.steps:
                with suppress(OSError):
                    self._send_safe("end", "the server ends")

    def _look(self) -> None:
        """Report misfits of the other end, each sentence once."""
        self._looked_at = self._clock()
        for text in (printable(remark.text) for remark in self.link.remarks()):
            if text not in self.remarks and len(self.remarks) < _MOST_REMARKS:
                self.remarks.append(text)
                self._event("remark", text)

    def _patience(self) -> float:
        """Return the time in s in which nothing has to be done."""
        if self._lockstep or not np.isfinite(self._due):
            return _LONGEST_WAIT
        if self._fault:  # the deadline has passed
            until = self._due
        else:
            until = min(
                self._due + (0.0 if self.intake.complete() else LATE * self._period), self.intake.deadline()
            )
        return float(min(max(0.0, until - self._clock()), _LONGEST_WAIT))

    def turn(self) -> None:
        """Take the messages that have arrived, and act if it is time."""
        wrong: Refusal | None = None
        again = False
        for arrival in self.link.take():
            now = self._heard_at = self._clock()
            if arrival.kind == "reset" and not arrival.problem:
                self._begin(arrival.number, arrival.stamp)
                continue
            refusal = self.intake.take(arrival, now)
            if refusal is not None and not refusal.is_harmless:
                wrong = refusal
                self._event("refused", f"{arrival.source}: {refusal.text}")
            again |= refusal is not None and refusal.is_harmless
        now = self._clock()
        if self._lockstep:
            self._answer(wrong, again)
            if now - self._heard_at > QUIET:
                self._heard_at = np.inf
                self._event("quiet", f"no values for {QUIET:g} s: does the robot still run?", after=QUIET)
        elif wrong is not None and (not self._fault or now >= self._due - EARLY * self._period):
            self._send_safe(wrong.kind, wrong.text)
        elif np.isfinite(self._due) or self.intake.complete() or now - self._begun_at > RESTART:
            self._keep_time(now)

    def _answer(self, wrong: Refusal | None, again: bool) -> None:
        """Answer in lockstep: once for each complete set of inputs. A set that arrives again gets the same
        answer."""
        if self.intake.complete():
            self._step()
        elif wrong is not None:
            self._send_safe(wrong.kind, wrong.text)
        elif again and self._last_sent:
            self.link.send(self._last_sent, self._stamp())

    def _keep_time(self, now: float) -> None:
        stale = self.intake.stale(now)
        if stale:
            if not self._fault or now >= self._due:
                silent = self.intake.stale(now + self._period)  # the other inputs follow within a period
                names = "any input" if len(silent) == len(self.intake.inputs) else ", ".join(silent[:3])
                self._send_safe("silence", f"no new value of {names}")
        elif self.intake.complete() and (self._fault or now >= self._due - EARLY * self._period):
            self._step()
        elif now >= self._due + LATE * self._period:
            self.held_steps += 1
            self._step(held=True)

    def _step(self, *, held: bool = False) -> None:
        """Call the policy. With `held`, a value is missing, so the command answers no new value."""
        received = self.intake.newest()[1]
        values = self.intake.values()
        try:
            found = self._policy.step(values)
        except Exception as error:  # noqa: BLE001  whatever a graph raises, the robot gets a command
            self._send_safe("policy", f"the policy fails: {' '.join(str(error).split())[:120]}")
            return
        if found is None:
            self._send_safe("pause", "no episode runs")
            return
        now = self._clock()
        passed = 0.0 if self._lockstep else (now - self._sent_at) * self._speed
        # A step is sooner only after a reset, which does not extend the reach.
        if self._lockstep or passed >= (1.0 - EARLY) * self._step_time:
            passed = max(passed, self._step_time)
        commands = self.commands.limit(found, passed)
        if commands is None:
            self._send_safe("policy", "the policy computes a command that is not finite")
            return
        if self._is_safe:
            self._event("resumed", "all inputs are there again")
        self._is_safe, self._fault = False, ""
        self._send({ACTION: np.atleast_1d(found[ACTION]), **commands} if ACTION in found else commands)
        answer = 0.0 if held else self._clock() - received
        self.steps += 1
        if not held:
            self.answers.append(answer)
        self._pace(now)
        if self._log is not None:
            self._log.step(self._stamp(), values, commands, answer, "policy", self.intake.ages(now))

    def _send_safe(self, kind: str, reason: str) -> None:
        now = self._clock()
        commands = self.commands.safe()
        if kind != self._fault:
            self._event("safe", reason)
            self.faults[kind] += 1
        self._is_safe, self._fault = True, kind
        self.safe_steps += 1
        self._send(commands)
        self._pace(now)
        if self._log is not None:
            self._log.step(self._stamp(), {}, commands, 0.0, "safe", self.intake.ages(now))

    def _send(self, commands: Mapping[str, Array]) -> None:
        self._last_sent, self._sent_at = commands, self._clock()
        if commands:
            self.link.send(commands, self._stamp())

    def _pace(self, now: float) -> None:
        """Set the time of the next step: after one period, without catching up steps that were missed."""
        first = not np.isfinite(self._due)
        self._due = (
            now + self._period if first else max(self._due + self._period, now + self._period * (1.0 - EARLY))
        )

    def _stamp(self) -> float:
        """Return the time of a command: now, or in lockstep that of the values that it answers."""
        newest = self.intake.newest()[0] if self._lockstep else None
        return time.time() if newest is None else newest

    def _begin(self, number: int, stamp: float | None) -> None:
        self.episodes += 1
        self._policy.reset()
        self.intake.begin(stamp)
        self._last_sent = {}
        self._due, self._begun_at = -np.inf, self._clock()
        self._fault = ""
        self._event("episode", str(number))

    def _event(self, kind: str, text: str, after: float = 0.0) -> None:
        if self._log is not None:
            self._log.event(self._stamp() + after, kind, printable(text))

    def report(self) -> dict[str, Any]:
        """Return the report: times in s, counts of messages, and why messages were refused."""
        answers = np.array(self.answers or [np.nan])
        middle, most = (float(np.quantile(answers, share)) if self.answers else None for share in (0.5, 0.99))
        return {
            "link": self.link.name,
            "steps": self.steps,
            "episodes": self.episodes,
            "answer_median": middle,
            "answer_p99": most,
            "answer_max": float(answers.max()) if self.answers else None,
            "held_steps": self.held_steps,
            "limited_steps": self.commands.limited,
            "safe_steps": self.safe_steps,
            "safe_because": dict(self.faults),
            "remarks": self.remarks,
            "missing": self.intake.missing(),
            "messages": self.intake.received,
            "refused": {
                kind: {"count": count, "first": self.intake.examples[kind]}
                for kind, count in self.intake.refused.items()
            },
        }


def report_lines(report: Mapping[str, Any]) -> list[str]:
    """Return the lines of a report for people."""
    times = [report[name] for name in ("answer_median", "answer_p99", "answer_max")]
    shown = ["none" if each is None else f"{each * 1e3:.2f} ms" for each in times]
    lines = [
        report["link"],
        f"  steps        {report['steps']:,} in {report['episodes']:,} episodes; an input had no new value"
        f" in {report['held_steps']:,},"
        f" a command was limited in {report['limited_steps']:,}",
        f"  answer       median {shown[0]}, 99th percentile {shown[1]}, longest {shown[2]}",
        f"  safe posture {report['safe_steps']:,} commands",
        *(
            f"    {count:,} time{'s' * (count != 1)} because of: {reason}"
            for reason, count in report["safe_because"].items()
        ),
        f"  messages     {report['messages']:,} received,"
        f" {sum(entry['count'] for entry in report['refused'].values()):,} refused",
    ]
    return lines + [
        f"    {entry['count']:,} {kind}, the first: {entry['first']}"
        for kind, entry in report["refused"].items()
    ]
