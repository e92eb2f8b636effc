"""The loop that acts for a robot: it checks messages, calls the policy once per step, limits its commands,
and reacts to silence.

A step happens when every input has a new value, and no more often than the bundle's rate. If a value is
missing, the step uses the last one while it is young enough. Otherwise the robot gets the safe posture in
every step until all inputs have valid values again. Silence and faulty messages are both reasons.

`Intake` checks the layout, finite numbers, range, age and order of messages. A message that fails one of
these checks is not used at all.
"""

from __future__ import annotations

import time
from collections import Counter, deque
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import Any, NamedTuple, Protocol

import numpy as np

from deepbots_robot.link import Array, Arrival, Link
from deepbots_robot.model import printable
from deepbots_robot.topics import ACTION, Field

EARLY = 0.25
"""The share of a period by which a step may come before its time, since messages do not arrive evenly."""
LATE_SHARE = 0.5
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
                # A coarse clock may show no time at all, and inf * 0 is not a number.
                reach = output.max_rate * max(elapsed, np.finfo(float).tiny)
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
                self._due + (0.0 if self.intake.complete() else LATE_SHARE * self._period),
                self.intake.deadline(),
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
        elif now >= self._due + LATE_SHARE * self._period:
            self.held_steps += 1
            self._step(held=True)

    def _step(self, *, held: bool = False) -> None:
        """Call the policy. With `held`, a value is missing, so the command answers no new value."""
        received = self.intake.newest()[1]
        values = self.intake.values()
        try:
            command = self._policy.step(values)
        except Exception as error:  # noqa: BLE001  whatever a graph raises, the robot gets a command
            self._send_safe("policy", f"the policy fails: {' '.join(str(error).split())[:120]}")
            return
        if command is None:
            self._send_safe("pause", "no episode runs")
            return
        now = self._clock()
        passed = 0.0 if self._lockstep else (now - self._sent_at) * self._speed
        # A step is sooner only after a reset, which does not extend the reach.
        if self._lockstep or passed >= (1.0 - EARLY) * self._step_time:
            passed = max(passed, self._step_time)
        commands = self.commands.limit(command, passed)
        if commands is None:
            self._send_safe("policy", "the policy computes a command that is not finite")
            return
        if self._is_safe:
            self._event("resumed", "all inputs are there again")
        self._is_safe, self._fault = False, ""
        self._send({ACTION: np.atleast_1d(command[ACTION]), **commands} if ACTION in command else commands)
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
        f"  steps        {report['steps']:,} in {report['episodes']:,} episode"
        f"{'s' * (report['episodes'] != 1)}; an input had no new value in {report['held_steps']:,},"
        f" a command was limited in {report['limited_steps']:,}",
        f"  answer       median {shown[0]}, 99th percentile {shown[1]}, longest {shown[2]}",
        f"  safe posture {report['safe_steps']:,} command{'s' * (report['safe_steps'] != 1)}",
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


# Messages of a robot


SLACK = 0.01
"""The share of its range by which a value may be beyond it: robot files round limits, and a joint gives way
at its stop."""
MAX_JUMP = 1.0
"""The time in s by which the stamps of a robot may go ahead of the time that has passed here. A larger one is
a clock that jumped."""
RESTART = 1.0
"""The time without a usable message, in s, after which the next one sets the clock anew, as after a restart
of the robot."""


class Refusal(NamedTuple):
    """The reason why a message is not used: a word for counting, and a sentence."""

    kind: str
    text: str

    @property
    def is_harmless(self) -> bool:
        """Whether a network can cause it. Such a message is ignored. The server answers all other refusals
        with the safe posture."""
        return self.kind in (TWICE, ORDER, LATE)


TWICE, ORDER, LATE = "twice", "out of order", "late"


@dataclass(frozen=True)
class Input:
    """A field that the policy reads.

    Attributes:
        field: Its name, shape and unit.
        dtype: The dtype that the policy requires.
        low: Smallest value, -inf without a limit.
        high: Largest value, inf without a limit.
        max_age: The age in s beyond which a value is not used.
        every_step: Whether a new value comes in every step; a slower sensor leaves its last one.
        is_needed: Whether there are no steps without a value.
    """

    field: Field
    dtype: str
    low: Array
    high: Array
    max_age: float
    every_step: bool = True
    is_needed: bool = True


class _State:
    """The state of one field."""

    def __init__(self) -> None:
        self.value: Array | None = None
        self.received = self.arrived = -np.inf
        self.stamp: float | None = None
        self.offset = np.inf
        self.fresh = False


class Intake:
    """The newest value of each input. `speed` is the number of seconds of the robot that pass in one second
    here; None without a clock."""

    def __init__(self, inputs: Sequence[Input], speed: float | None = 1.0) -> None:
        self.inputs = {each.field.name: each for each in inputs}
        self.received = 0
        self.refused: Counter[str] = Counter()
        self.examples: dict[str, str] = {}
        """The first sentence of each kind of refusal."""
        self._speed = speed
        self._states = {name: _State() for name in self.inputs}
        self._begun = -np.inf

    def begin(self, stamp: float | None) -> None:
        """Begin an episode. Values that were measured before `stamp` are not used any more."""
        self._begun = -np.inf if stamp is None else stamp
        for name, state in self._states.items():
            if state.stamp is None or state.stamp < self._begun:
                self._states[name] = _State()

    def take(self, arrival: Arrival, now: float) -> Refusal | None:
        """Use a message, or return why no part of it is used. `now` is a monotonic time in s."""
        self.received += 1
        refusal = Refusal("unreadable", arrival.problem) if arrival.problem else self._refusal(arrival, now)
        if refusal is not None:
            self.refused[refusal.kind] += 1
            self.examples.setdefault(refusal.kind, printable(f"{arrival.source}: {refusal.text}"[:200]))
            return refusal
        for name, value in arrival.fields.items():
            state, declared = self._states[name], self.inputs[name]
            state.value = np.asarray(value, declared.dtype).reshape(declared.field.shape)
            state.fresh, state.received, state.stamp = True, now, arrival.stamp
        return None

    def _refusal(self, arrival: Arrival, now: float) -> Refusal | None:
        unknown = [name for name in arrival.fields if name not in self.inputs]
        if unknown or not arrival.fields:
            return Refusal(
                "unknown field",
                f"this policy has no input '{unknown[0][:40]}'" if unknown else "a message without a field",
            )
        for name, value in arrival.fields.items():
            refusal = _wrong(value, self.inputs[name])
            if refusal is not None:
                return refusal
        stamp = arrival.stamp
        if stamp is None:
            return None
        if not np.isfinite(stamp):
            return Refusal("clock", "its time is not finite")
        if 0.0 < self._begun - stamp <= MAX_JUMP:
            return Refusal(ORDER, "it was sent before the episode began")
        for name in arrival.fields:
            refusal = self._late(self._states[name], self.inputs[name], stamp, now)
            if refusal is not None:
                return refusal
        return None

    def _late(self, state: _State, declared: Input, stamp: float, now: float) -> Refusal | None:
        """Return the fault in the time of a message; None if there is none.

        The clock of the robot may show any time. The smallest difference between it and the clock here, at
        the arrival of a message, represents a message without delay.
        """
        name = declared.field.name
        if self._speed is not None and now - state.received > RESTART:
            state.offset = np.inf
        elif state.stamp is not None and stamp <= state.stamp:
            back = state.stamp - stamp
            if back > MAX_JUMP:
                return Refusal("clock", f"the clock of {name} jumped back by {back:.3g} s")
            return (
                Refusal(ORDER, f"{name} came after a newer value")
                if back
                else Refusal(TWICE, f"{name} came twice")
            )
        if self._speed is None:
            return None
        offset = now * self._speed - stamp
        delay = offset - state.offset
        if np.isfinite(delay) and delay < -MAX_JUMP:
            return Refusal("clock", f"the clock of {name} jumped ahead by {-delay:.3g} s")
        if delay > declared.max_age:
            return Refusal(LATE, f"{name} came {delay:.3g} s late")
        state.offset = min(state.offset, offset)
        return None

    # What the server asks

    def stale(self, now: float) -> list[str]:
        """Return the inputs without a value that is young enough."""
        if self._speed is None:
            return self.missing()
        return [
            name
            for name, each in self.inputs.items()
            # A goal never becomes too old, and may be missing.
            if (each.is_needed and self._states[name].value is None)
            or (now - self._states[name].received) * self._speed > each.max_age
        ]

    def ages(self, now: float) -> dict[str, float]:
        """Return the time in s since the newest value of each input arrived. Inputs that never had a value
        are left out."""
        speed = self._speed or 1.0
        return {
            name: (now - state.received) * speed
            for name, state in self._states.items()
            if state.value is not None
        }

    def missing(self) -> list[str]:
        """Return the inputs that never had a value."""
        return [
            name
            for name, state in self._states.items()
            if state.value is None and self.inputs[name].is_needed
        ]

    def deadline(self) -> float:
        """Return the time at which the first input will be too old."""
        if self._speed is None:
            return np.inf
        return min(
            (self._states[name].received + each.max_age / self._speed for name, each in self.inputs.items()),
            default=np.inf,
        )

    def complete(self) -> bool:
        """Return whether each input that has a new value in every step has got one since the last step."""
        states = self._states
        needed = {name: each for name, each in self.inputs.items() if each.is_needed}
        return all(
            states[name].fresh if each.every_step else states[name].value is not None
            for name, each in needed.items()
        )

    def newest(self) -> tuple[float | None, float]:
        """Return the newest stamp of all inputs, and the time at which the last message arrived."""
        stamps = [state.stamp for state in self._states.values() if state.stamp is not None]
        return max(stamps, default=None), max(
            (state.received for state in self._states.values()), default=-np.inf
        )

    def values(self) -> Mapping[str, Array]:
        """Return the newest value of each input, for one step."""
        for state in self._states.values():
            state.fresh = False
        return {name: state.value for name, state in self._states.items() if state.value is not None}


def _wrong(value: Array, declared: Input) -> Refusal | None:
    """Return the fault in the values of a field; None if there is none."""
    name = declared.field.name
    if value.dtype.kind not in "fiub" or value.shape != declared.field.shape:
        return Refusal("layout", f"{name} has the shape {value.shape}, and not {declared.field.shape}")
    if value.dtype.kind == "f" and not np.isfinite(value).all():
        return Refusal("not finite", f"{name} is not finite")
    slack = SLACK * np.where(np.isfinite(declared.high - declared.low), declared.high - declared.low, 0.0)
    outside = (value < declared.low - slack) | (value > declared.high + slack)
    if outside.any():
        number = float(value.reshape(-1)[int(outside.reshape(-1).argmax())])
        unit = "" if declared.field.unit == "1" else f" {declared.field.unit}"
        return Refusal("out of range", f"{name} is {number:.6g}{unit}, which is beyond its range")
    return None
