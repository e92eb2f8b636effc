"""Prints the paper's methods: they read what `_advance` left, and change nothing."""

from __future__ import annotations

from deepbots_cli.codegen.text import block, docstring, quoted, sentence_list
from deepbots_cli.codegen.workspace import Workspace


def readings(space: Workspace) -> list[list[str]]:
    scenario = space.scenario
    histories = {entry.name: entry.history for entry in scenario.observation}
    seen = sentence_list([name if many == 1 else f"{name} ({many} in a row)" for name, many in histories.items()])
    seen += f"; {scenario.agent.stack} times in a row" if scenario.agent.stack > 1 else ""
    seen += "; and what is achieved and desired" if scenario.goal is not None else ""
    parts = _parts(space)
    code = parts["observation"] if set(parts) == {"observation"} else _dictionary(parts)
    summands = sentence_list([term.name for term in scenario.reward])
    ends = [f"the task ended ({sentence_list([ending.name for ending in scenario.endings], 'or')})"] if scenario.endings else []
    limits = [name for name in ("max_steps", "max_time") if getattr(scenario.truncation, name) is not None]
    ends.append(f"a limit cut the episode short ({sentence_list(limits, 'or')})")
    terms = ", ".join(f"{quoted(term.name)}: self.term_{term.name}" for term in scenario.reward)
    info = '"is_success": self.is_success, "ended_by": self.ended_by, "endings": self.endings'
    info += ', "action_mask": self.action_mask()' if space.forbids else ""
    return [
        block(
            "def get_observations(self) -> Any:",
            [*docstring(f"What the policy sees, float32 in [-1, 1]: {seen}."), f"return {code}"],
        ),
        block("def get_reward(self) -> float:", [*docstring(f"The sum of {summands}."), "return self.reward"]),
        block(
            "def is_done(self) -> tuple[bool, bool]:",
            [*docstring(f"Whether {', and whether '.join(ends)}."), "return self.terminated, self.truncated"],
        ),
        block(
            "def get_info(self) -> dict[str, Any]:",
            [
                *docstring("How the episode ended, if it has, and the terms of the last reward."),
                f"terms = {{{terms}}}",
                f'return {{{info}, "reward_terms": terms}}',
            ],
        ),
    ]


def _dictionary(parts: dict[str, str]) -> str:
    return f"{{{', '.join(f'{quoted(key)}: {part}' for key, part in parts.items())}}}"


def _parts(space: Workspace) -> dict[str, str]:
    """The code of each part of an observation, under its key."""
    scenario = space.scenario
    parts = {}
    if scenario.numbers or not scenario.images:
        parts["observation"] = "self.frames.take(self.views[self.newest])" if space.remembers else "self.observed.copy()"
    parts |= {pictured.key: f"self.albums[{quoted(pictured.key)}].seen(self.newest)" for pictured in scenario.images}
    if scenario.goal is not None:
        size = len(scenario.goal.low)
        parts |= {"achieved_goal": f"self.goal[:{size}].copy()", "desired_goal": f"self.goal[{size}:].copy()"}
    return parts
