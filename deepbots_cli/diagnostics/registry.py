"""The rule registry: code, kebab-case name, severity and summary of each rule.

Codes and names are stable: a retired rule keeps its number.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any, Literal

from deepbots_cli.diagnostics.nearest import nearest
from deepbots_cli.plugins import Table

Severity = Literal["error", "warning"]


@dataclass(frozen=True)
class Rule:
    """One entry of the catalogue.

    A rule in `preview` may still misfire and runs only on request. `deep` says whether a simulation (`lint --deep`) finds
    it: `no`, `only`, or `too` where static analysis finds it as well. `deep_preview` puts only the simulated part in preview.
    """

    code: str
    name: str
    severity: Severity
    summary: str
    preview: bool = False
    deep: Literal["no", "too", "only"] = "no"
    deep_preview: bool = False
    check: Callable[[Any], Iterator[Any]] | None = None
    """Of a plug-in: from a `compiler.Checked` without errors to findings; its docstring is the page of the rule."""

    @property
    def family(self) -> str:
        """The topic of the rules with the same first digit."""
        return FAMILIES.get(self.code[:3], "plug-ins")


@dataclass(frozen=True)
class Retired:
    """A code that is no longer reported, and why."""

    code: str
    name: str
    reason: str


FAMILIES = {
    "DB0": "text",
    "DB1": "shape",
    "DB2": "references",
    "DB3": "robot",
    "DB4": "expressions",
    "DB5": "units",
    "DB6": "observation",
    "DB7": "reward",
    "DB8": "endings",
    "DB9": "linting",
}

_CATALOGUE = (
    Rule("DB001", "yaml-syntax", "error", "the text is not YAML 1.2"),
    Rule("DB002", "duplicate-key", "error", "a mapping holds the same key twice"),
    Rule("DB003", "yaml11-boolean", "warning", "a word that older YAML read as true or false is text here"),
    Rule("DB004", "odd-number", "warning", "a value that looks like a number is text, or would be another number elsewhere"),
    Rule("DB005", "resource-limit", "error", "a file is deeper, larger or expands further than is allowed"),
    Rule("DB101", "unknown-key", "error", "a key that the language does not know"),
    Rule("DB102", "missing-key", "error", "a key that is required here is absent"),
    Rule("DB103", "wrong-type", "error", "a value of the wrong type"),
    Rule("DB104", "unknown-kind", "error", "a word outside the words that are allowed here"),
    Rule("DB105", "out-of-range", "error", "a number outside its range"),
    Rule("DB106", "wrong-length", "error", "a list or a vector with too few or too many items"),
    Rule("DB107", "empty-value", "error", "a key without a value"),
    Rule("DB108", "not-yet-supported", "error", "a part of the language that this version does not run yet"),
    Rule("DB201", "unknown-reference", "error", "a name that nothing in the scenario defines"),
    Rule("DB202", "duplicate-name", "error", "two definitions share one name"),
    Rule("DB203", "wrong-kind-reference", "error", "a name of another kind than is needed here"),
    Rule("DB204", "bad-include", "error", "an included file is missing, cyclic or outside the project"),
    Rule("DB205", "unused-definition", "warning", "a definition that nothing uses"),
    Rule("DB206", "empty-match", "error", "a pattern that matches nothing"),
    Rule("DB207", "circular-definition", "error", "definitions that refer to each other in a circle"),
    Rule("DB301", "bad-urdf", "error", "a robot file that an engine could not load safely"),
    Rule("DB302", "unknown-joint", "error", "a joint that the robot does not have"),
    Rule("DB303", "joint-not-actuatable", "error", "an actuator on a joint that cannot move"),
    Rule("DB304", "limit-beyond-urdf", "warning", "a limit wider than the robot file allows"),
    Rule("DB305", "missing-inertial", "warning", "a link without inertia, which then weighs nothing"),
    Rule("DB306", "implausible-inertia", "warning", "an inertia that no rigid body can have"),
    Rule("DB307", "missing-joint-limits", "warning", "a revolute or prismatic joint without limits"),
    Rule("DB308", "rate-mismatch", "error", "a period that is no multiple of the timestep"),
    Rule("DB309", "unstable-simulation", "error", "a world that the engine cannot simulate", deep="only"),
    Rule("DB310", "spawn-overlap", "error", "bodies that begin within each other", deep="only"),
    Rule("DB311", "odd-urdf", "warning", "a robot file with a harmless oddity"),
    Rule("DB312", "command-cut-off", "warning", "an actuator that cuts off most of what it is asked for", preview=True),
    Rule("DB313", "joint-driven-twice", "warning", "a joint that two actuators hold", preview=True),
    Rule("DB315", "pose-out-of-reach", "warning", "an arm that is commanded to a pose that it cannot reach", deep="only"),
    Rule("DB401", "expression-syntax", "error", "an expression that cannot be read"),
    Rule("DB402", "unknown-name", "error", "an expression names something that does not exist"),
    Rule("DB403", "boolean-number-mix", "error", "a truth value where a number belongs, or the reverse"),
    Rule("DB404", "shape-mismatch", "error", "vectors with different components are combined"),
    Rule("DB405", "possible-zero-division", "warning", "a divisor can be zero"),
    Rule("DB406", "domain-error", "warning", "an argument can leave the domain of its function"),
    Rule("DB407", "not-available-here", "error", "a name or function that cannot be used in this place"),
    Rule("DB409", "foreign-code", "error", "a term that is a function of Python, which is not allowed unless you say so"),
    Rule("DB410", "foreign-code-runs", "warning", "a term that is a function of Python, which you have allowed"),
    Rule("DB411", "equality-of-measures", "warning", "a condition that asks a measure to be equal to a figure"),
    Rule("DB501", "unknown-unit", "error", "a unit that the language does not know"),
    Rule("DB502", "missing-unit", "error", "a number that needs a unit has none"),
    Rule("DB503", "dimension-mismatch", "error", "quantities of different dimension are combined"),
    Rule("DB504", "degrees-as-radians", "warning", "a value in radians that was probably meant in degrees"),
    Rule("DB505", "implausible-magnitude", "warning", "a figure far outside what its field usually holds"),
    Rule("DB506", "angle-jumps", "warning", "a heading whose change or difference jumps by a full turn", preview=True),
    Rule("DB507", "odd-scale", "warning", "an object whose size or mass is out of all proportion"),
    Rule("DB601", "observation-unbounded", "warning", "an observation that is not clipped, and that nothing bounds", preview=True),
    Rule("DB602", "bounds-mismatch", "error", "a value that can never lie in its range"),
    Rule("DB603", "saturates-before-termination", "warning", "the policy sees the same value long before that value ends the episode"),
    Rule("DB607", "observation-outside-space", "error", "an observation without a value, or outside of its space", deep="only"),
    Rule("DB608", "constant-observation", "warning", "an observation that never changes", deep="only"),
    Rule("DB609", "privileged-observation", "warning", "the policy sees what no robot measures, and what `augment` does not grant"),
    Rule(
        "DB611", "observation-saturates", "warning", "a value at the end of its range in ordinary operation", deep="too", deep_preview=True
    ),
    Rule("DB612", "algorithm-space-mismatch", "error", "an algorithm or its network that does not suit what the agent sees and does"),
    Rule("DB613", "case-changes-interface", "error", "a case or stage in which the policy would see, do or send something else"),
    Rule("DB614", "goal-in-observation", "warning", "the policy sees the goal where hindsight cannot replace it"),
    Rule("DB615", "rays-meet-nothing", "warning", "a sensor whose rays pass over everything in the world", deep="too", deep_preview=True),
    Rule("DB616", "noise-without-effect", "warning", "noise on a value that the policy sees exactly elsewhere"),
    Rule("DB701", "reward-unbounded", "warning", "a term of the reward that grows beyond all bounds"),
    Rule("DB702", "term-dominates", "warning", "a term beside which what endings pay cannot be seen", deep="too", deep_preview=True),
    Rule("DB703", "suspicious-sign", "warning", "a reward for the opposite of what the endings ask for"),
    Rule("DB704", "inactive-term", "warning", "a term of the reward that is always zero", deep="too", deep_preview=True),
    Rule("DB705", "rewards-early-death", "warning", "failing at once costs less than going on"),
    Rule("DB706", "hidden-state-reward", "warning", "a reward that depends on what the policy cannot see", preview=True),
    Rule("DB707", "non-finite-reward", "error", "a reward that is not finite", deep="only"),
    Rule("DB708", "hovering-pays", "warning", "staying just short of the goal pays more than reaching it", deep="too", deep_preview=True),
    Rule("DB709", "reward-beyond-the-goal", "error", "a reward that hindsight cannot recompute for another goal"),
    Rule("DB710", "pays-towards-failure", "warning", "a reward that grows towards a failure", preview=True),
    Rule("DB711", "nothing-to-learn", "warning", "a reward that is the same for all policies"),
    Rule("DB801", "never-true", "warning", "an ending that can never hold"),
    Rule("DB802", "always-true", "error", "an ending that holds in every step"),
    Rule("DB803", "no-time-limit", "error", "an episode that nothing is bound to end"),
    Rule("DB804", "shadowed-limit", "warning", "a limit that another one always comes before"),
    Rule("DB805", "timeout-as-termination", "warning", "a time limit that counts as the end of the task"),
    Rule("DB806", "ends-at-reset", "error", "an ending that already holds when an episode begins", deep="too"),
    Rule("DB807", "unreachable-goal", "warning", "a success that asks for more nearness than there can be"),
    Rule("DB808", "breaks-off", "error", "an episode that cannot begin or go on", deep="only"),
    Rule("DB809", "identical-episodes", "warning", "a scenario in which nothing differs between episodes", preview=True),
    Rule("DB810", "return-out-of-reach", "warning", "a mean return that no policy comes to, or that every policy does"),
    Rule("DB811", "after-the-end", "warning", "a push, a reading or a message that comes after every episode has ended"),
    Rule("DB812", "requirement-not-redrawn", "warning", "a requirement that drawing again does not help"),
    Rule("DB901", "unused-suppression", "warning", "a suppression comment that suppresses nothing"),
    Rule(
        "DB902",
        "preview-rule-selected",
        "warning",
        "a rule that does not run, in preview or for want of a simulation, is selected by itself",
    ),
    Rule("DB903", "rule-failed", "error", "a rule or the compiler raised an exception on this file, which is a fault of deepbots"),
)

_RETIRED = (
    Retired("DB314", "limp-at-start", "torque motors exert nothing before their first command, as docs/actuators.md says"),
    Retired(
        "DB604", "action-dims-mismatch", "the space follows from `action`; a command of the wrong length is DB404, a choice left open DB102"
    ),
    Retired("DB605", "action-not-normalised", "the agent acts in [-1, 1] in every scenario; `action` says what that means"),
    Retired(
        "DB606", "message-layout-mismatch", "both ends take their layout from the same `emit` and `receive`; what is not sent is DB407"
    ),
    Retired(
        "DB610", "undeclared-delay", "there is no delay but what `latency`, `delay`, `period` and `timing` say; none comes with the loop"
    ),
)


def _read(_name: str, found: Any) -> Iterator[tuple[str, Rule]]:
    """The rules that an entry point names.

    Raises:
        ValueError: One lacks something, or has a code or a name of ours.
    """
    for rule in [found] if isinstance(found, Rule) else list(found):
        if not isinstance(rule, Rule) or rule.check is None or not rule.check.__doc__:
            raise ValueError(f"{rule!r} is no Rule with a check that has a docstring")
        if not re.fullmatch(r"[A-Z]{2,8}[0-9]{1,4}", rule.code) or rule.code.startswith("DB"):
            raise ValueError(f"the code {rule.code!r} is no capital letters and digits, or begins with DB")
        if rule.name in {entry.name for entry in (*_CATALOGUE, *_RETIRED)}:
            raise ValueError(f"the name {rule.name!r} is taken")
        yield rule.code, rule


RULES: Table[Rule] = Table("deepbots.rules", {entry.code: entry for entry in _CATALOGUE}, _read)
RETIRED = {entry.code: entry for entry in _RETIRED}


def with_prefix(word: str) -> tuple[Rule | Retired, ...]:
    """The entry whose code or name is `word`, whatever its case, or all entries whose codes begin with it; retired ones last."""
    wanted = word.strip().lower().replace("_", "-")
    entries: tuple[Rule | Retired, ...] = (*RULES.values(), *_RETIRED)
    named = tuple(entry for entry in entries if wanted == entry.name)
    return named or tuple(entry for entry in entries if entry.code.lower().startswith(wanted))


def unknown(word: str) -> str:
    """The message for a word that fits no entry."""
    is_code = word[:2].upper() == "DB" and word[2:3].isdigit()
    entries: tuple[Rule | Retired, ...] = (*RULES.values(), *_RETIRED)
    near = nearest(word, [entry.code if is_code else entry.name for entry in entries])
    return f"there is no finding '{word}'" + (f"; did you mean {near}?" if near else "; deepbots explain lists them")
