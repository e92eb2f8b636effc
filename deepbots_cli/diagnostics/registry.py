"""The rule registry: code, kebab-case name, severity and summary of each rule.

Codes and names are stable. A retired code (`RETIRED`) is never given again.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from typing import Any, Literal

from deepbots_cli.diagnostics.nearest import nearest_word
from deepbots_cli.plugins import PluginTable
from deepbots_cli.records import dataclass

Severity = Literal["error", "warning"]
Versions = Literal["each", "every", "training", "base"]
"""The versions of a scenario that a rule judges: itself and with the settings of each case and each stage
(`each`), the same without the cases, in which nothing trains (`training`), or only itself (`base`). With
`every`, only what is wrong in each of them is a finding."""

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


RULE_CODE = re.compile(r"[A-Z]{2,8}[0-9]{1,4}")


@dataclass(frozen=True)
class Rule:
    """One entry of the catalog.

    A rule in `preview` may still misfire and runs only on request. `deep` is the part of a simulation (`lint
    --deep`) in it: `no`, `only`, or `too` where static analysis finds it as well; `exploits` are found by
    `lint --exploits` only. `deep_preview` puts only the simulated part in preview.
    """

    code: str
    name: str
    severity: Severity
    summary: str
    preview: bool = False
    deep: Literal["no", "too", "only", "exploits"] = "no"
    deep_preview: bool = False
    check: Callable[[Any], Iterator[Any]] | None = None
    """The function of a plug-in that yields findings about a `compiler.CheckedScenario` without errors."""
    versions: Versions = "each"
    """The versions that it judges."""
    about: str = ""
    """The page of a rule of a plug-in: paragraphs with blank lines between."""
    example: str = ""
    """A scenario with the finding, of a rule of a plug-in, to be merged into CartPole; `instead` is what to
    write instead."""
    instead: str = ""

    @property
    def family(self) -> str:
        """The topic of the rules with the same first digit."""
        return FAMILIES.get(self.code[:3], "plug-ins")


_CATALOG = (
    Rule("DB001", "yaml-syntax", "error", "the text is not YAML 1.2"),
    Rule("DB002", "duplicate-key", "error", "the same key twice in one mapping"),
    Rule(
        "DB003",
        "yaml11-boolean",
        "warning",
        "a word that deepbots reads as text, but YAML 1.1 as true or false",
    ),
    Rule(
        "DB004",
        "odd-number",
        "warning",
        "a value that looks like a number but is read as text, or as another number by YAML 1.1",
    ),
    Rule("DB005", "resource-limit", "error", "a file or a world that exceeds a size limit"),
    Rule("DB101", "unknown-key", "error", "a key that does not exist here"),
    Rule("DB102", "missing-key", "error", "a required key is missing"),
    Rule("DB103", "wrong-type", "error", "a value of the wrong type"),
    Rule("DB104", "unknown-kind", "error", "a word that is not allowed here"),
    Rule("DB105", "out-of-range", "error", "a number outside its range"),
    Rule("DB106", "wrong-length", "error", "a list or a vector with too few or too many items"),
    Rule("DB107", "empty-value", "error", "a key without a value"),
    Rule(
        "DB108", "not-yet-supported", "error", "a part of the language that this version does not support yet"
    ),
    Rule("DB109", "place-left", "warning", "a place that is left to the author of the scenario"),
    Rule("DB201", "unknown-reference", "error", "a name that nothing in the scenario defines"),
    Rule("DB202", "duplicate-name", "error", "two definitions share one name"),
    Rule("DB203", "wrong-kind-reference", "error", "a name of the wrong kind"),
    Rule("DB204", "bad-include", "error", "an included file is missing, cyclic or outside the project"),
    Rule("DB205", "unused-definition", "warning", "a definition that nothing uses"),
    Rule("DB206", "empty-match", "error", "a pattern that matches nothing"),
    Rule("DB207", "circular-definition", "error", "definitions that refer to each other in a circle"),
    Rule("DB301", "bad-urdf", "error", "a robot file that an engine could not load safely"),
    Rule("DB302", "unknown-joint", "error", "a joint that the robot does not have"),
    Rule("DB303", "joint-not-actuatable", "error", "a fixed or `<mimic>` joint is driven or set"),
    Rule("DB304", "limit-beyond-urdf", "warning", "a limit wider than the robot file allows"),
    Rule("DB305", "missing-inertial", "warning", "a link without inertia, which has no mass"),
    Rule(
        "DB306",
        "implausible-inertia",
        "warning",
        "an inertia that no rigid body of this mass and size can have",
    ),
    Rule(
        "DB307",
        "missing-joint-limits",
        "warning",
        "a joint without limits, or with limits that have no effect",
    ),
    Rule("DB308", "rate-mismatch", "error", "a period that is not a multiple of the timestep"),
    Rule("DB309", "unstable-simulation", "error", "a world that the engine cannot simulate", deep="only"),
    Rule("DB310", "spawn-overlap", "error", "bodies that overlap when an episode begins", deep="only"),
    Rule("DB311", "odd-urdf", "warning", "a robot file that other programs may refuse"),
    Rule("DB312", "command-cut-off", "warning", "most commands lie beyond the limits of the actuator"),
    Rule("DB313", "joint-driven-twice", "warning", "two actuators drive the same joint", preview=True),
    Rule(
        "DB315", "pose-out-of-reach", "warning", "a command that is out of the reach of the arm", deep="only"
    ),
    Rule(
        "DB316",
        "beyond-engine",
        "error",
        "an engine that is not installed, or does not support a part of the world",
    ),
    Rule(
        "DB317",
        "limits-in-degrees",
        "warning",
        "joint limits that were probably written in degrees instead of radians",
    ),
    Rule(
        "DB318",
        "range-of-other-parts",
        "warning",
        "`auto` for several joints, one of which has much tighter limits",
    ),
    Rule("DB319", "unlimited-motor", "warning", "a motor without a limit of torque or force"),
    Rule(
        "DB321",
        "message-misfit",
        "error",
        "a ROS 2 message that cannot carry the values of a sensor or an actuator",
    ),
    Rule(
        "DB322",
        "robot-stays",
        "warning",
        "a robot that stays in its place although its wheels turn",
        deep="only",
    ),
    Rule("DB323", "falls-without-end", "warning", "a robot with a free base that falls through the ground"),
    Rule(
        "DB324",
        "topples",
        "warning",
        "a robot with a free base that topples while nothing is done",
        deep="only",
    ),
    Rule(
        "DB325",
        "shaking-spring",
        "warning",
        "a spring that is too strong for a light joint and the engine step",
    ),
    Rule("DB401", "expression-syntax", "error", "an expression that cannot be read"),
    Rule("DB402", "unknown-name", "error", "an expression names something that does not exist"),
    Rule("DB403", "boolean-number-mix", "error", "a truth value instead of a number, or the reverse"),
    Rule("DB404", "shape-mismatch", "error", "vectors with different components are combined"),
    Rule("DB405", "possible-zero-division", "warning", "a divisor can be zero"),
    Rule("DB406", "domain-error", "warning", "an argument can leave the domain of its function"),
    Rule("DB407", "not-available-here", "error", "a name or function that cannot be used in this place"),
    Rule("DB409", "foreign-code", "error", "a term that is a Python function, without `--allow-code`"),
    Rule("DB410", "foreign-code-runs", "warning", "a term that is a Python function, with `--allow-code`"),
    Rule(
        "DB411",
        "equality-of-measures",
        "warning",
        "a condition that compares a measured quantity for equality",
    ),
    Rule("DB501", "unknown-unit", "error", "a unit that does not exist"),
    Rule("DB502", "missing-unit", "error", "a number that needs a unit has none"),
    Rule("DB503", "dimension-mismatch", "error", "quantities of different dimension are combined"),
    Rule("DB504", "degrees-as-radians", "warning", "a value in radians that was probably meant in degrees"),
    Rule("DB505", "implausible-magnitude", "warning", "a value far outside the usual range of its field"),
    Rule(
        "DB506",
        "angle-jumps",
        "warning",
        "a heading whose change or difference jumps by a full turn",
        preview=True,
    ),
    Rule("DB507", "odd-scale", "warning", "an object or a robot with an implausible size or mass"),
    Rule(
        "DB601",
        "observation-unbounded",
        "warning",
        "an observation that is neither clipped nor bounded",
        preview=True,
    ),
    Rule("DB602", "bounds-mismatch", "error", "a value that can never lie in its range"),
    Rule(
        "DB603",
        "saturates-before-termination",
        "warning",
        "an observation that saturates long before its value ends the episode",
    ),
    Rule(
        "DB607",
        "observation-outside-space",
        "error",
        "an observation without a value, or outside its space",
        deep="only",
    ),
    Rule("DB608", "constant-observation", "warning", "an observation that never changes", deep="only"),
    Rule(
        "DB609",
        "privileged-observation",
        "error",
        "an observation of a signal or a parameter that is not listed under `augment`",
    ),
    Rule(
        "DB611",
        "observation-saturates",
        "warning",
        "an observation that is often clipped to the end of its range",
        deep="too",
    ),
    Rule(
        "DB612",
        "algorithm-space-mismatch",
        "error",
        "an algorithm or a network that does not suit the spaces of the agent",
    ),
    Rule(
        "DB613",
        "case-changes-interface",
        "error",
        "a case, a stage or a search that changes the interface of the policy",
    ),
    Rule(
        "DB614",
        "goal-in-observation",
        "warning",
        "the policy sees the goal where hindsight replay cannot replace it",
    ),
    Rule(
        "DB615",
        "rays-meet-nothing",
        "warning",
        "a sensor whose rays meet nothing in the world",
        deep="only",
    ),
    Rule(
        "DB616",
        "noise-without-effect",
        "warning",
        "noise on a value that the policy also observes without noise",
    ),
    Rule(
        "DB617",
        "reading-not-supplied",
        "warning",
        "a reading of the world that nothing supplies on a real robot",
    ),
    Rule(
        "DB618",
        "wrong-mirror-image",
        "warning",
        "a mirror image that contradicts the robot file or the names of its numbers",
    ),
    Rule("DB701", "reward-unbounded", "warning", "a reward term that is unbounded"),
    Rule(
        "DB702",
        "term-dominates",
        "warning",
        "a reward term that outweighs the rewards of the endings",
        deep="only",
        deep_preview=True,
    ),
    Rule("DB703", "suspicious-sign", "warning", "a reward term whose sign contradicts the endings"),
    Rule(
        "DB704",
        "inactive-term",
        "warning",
        "a reward term that is always zero",
        deep="too",
        deep_preview=True,
    ),
    Rule("DB705", "rewards-early-death", "warning", "failing at once costs less than continuing"),
    Rule(
        "DB706",
        "hidden-state-reward",
        "warning",
        "a reward that depends on a state that the policy does not observe",
        preview=True,
    ),
    Rule("DB707", "non-finite-reward", "error", "a reward that is not finite", deep="only"),
    Rule("DB708", "hovering-pays", "warning", "avoiding success gives a higher return than reaching it"),
    Rule(
        "DB709",
        "reward-beyond-the-goal",
        "error",
        "a reward that hindsight replay cannot recompute for another goal",
    ),
    Rule("DB710", "pays-towards-failure", "warning", "a reward that grows towards a failure", preview=True),
    Rule("DB711", "nothing-to-learn", "warning", "a reward that is the same for all policies"),
    Rule(
        "DB712",
        "solved-without-success",
        "warning",
        "a driver without success comes near the mean return of `solved`",
        deep="exploits",
    ),
    Rule(
        "DB713",
        "pays-without-success",
        "warning",
        "a driver without success pays more than a success",
        deep="exploits",
    ),
    Rule(
        "DB714",
        "early-end-pays",
        "warning",
        "a driver that fails early pays more than one that goes on",
        deep="exploits",
    ),
    Rule(
        "DB715",
        "repeatable-reward",
        "warning",
        "a reward for progress that can be earned again and again",
        deep="exploits",
    ),
    Rule(
        "DB717",
        "waiting-pays",
        "warning",
        "doing nothing earns at least half of what a success earns",
        deep="exploits",
    ),
    Rule(
        "DB718",
        "nearly-zero-sum",
        "warning",
        "rewards of two agents that look like a zero-sum game and are none",
    ),
    Rule("DB801", "never-true", "warning", "an ending that can never be true"),
    Rule("DB802", "always-true", "error", "an ending that is true in every step"),
    Rule("DB803", "no-time-limit", "error", "the scenario has no time limit"),
    Rule(
        "DB804", "shadowed-limit", "warning", "a limit that is never reached, because another one comes first"
    ),
    Rule("DB805", "timeout-as-termination", "warning", "a time limit written as a termination"),
    Rule(
        "DB806", "ends-at-reset", "error", "an ending that is already true when an episode begins", deep="too"
    ),
    Rule(
        "DB807",
        "unreachable-goal",
        "warning",
        "a success condition that requires bodies to be closer than they can be",
    ),
    Rule("DB808", "breaks-off", "error", "an episode that cannot begin or continue", deep="only"),
    Rule(
        "DB809", "identical-episodes", "warning", "a scenario whose episodes are all identical", preview=True
    ),
    Rule(
        "DB810",
        "return-out-of-reach",
        "warning",
        "a mean return that no policy reaches, or that every policy reaches",
    ),
    Rule(
        "DB811", "after-the-end", "warning", "a push, a reading or a message after the end of every episode"
    ),
    Rule("DB812", "requirement-not-redrawn", "warning", "a reset requirement that drawing again cannot meet"),
    Rule("DB813", "idle-test", "warning", "a test that can only pass, or only fail"),
    Rule("DB901", "unused-suppression", "warning", "a suppression comment that suppresses nothing"),
    Rule(
        "DB902",
        "preview-rule-selected",
        "warning",
        "a selected rule that is in preview or needs a simulation",
    ),
    Rule(
        "DB903",
        "rule-failed",
        "error",
        "a rule or the compiler raised an exception on this file: a bug in deepbots",
    ),
)

RETIRED = {
    **dict.fromkeys(("DB314", "LIMP-AT-START", "DB604", "DB605", "DB606", "DB610"), ""),
    **dict.fromkeys(("DB716", "CYCLE-PAYS"), "`deepbots lint --exploits` finds such rewards by playing"),
}
"""The codes and names of rules that are gone, in capital letters, with what to use instead."""


def _read(_name: str, value: Any) -> Iterator[tuple[str, Rule]]:
    """Yield the rules that an entry point names.

    Raises:
        ValueError: A rule is incomplete, or uses a code or a name of deepbots.
    """
    for rule in [value] if isinstance(value, Rule) else list(value):
        if not isinstance(rule, Rule) or rule.check is None or not rule.about:
            raise ValueError(f"{rule!r} is not a Rule with `check` and `about`")
        if not RULE_CODE.fullmatch(rule.code) or rule.code.startswith("DB"):
            raise ValueError(
                f"the code {rule.code!r} does not consist of capital letters and digits, or begins with DB"
            )
        if rule.name in {entry.name for entry in _CATALOG}:
            raise ValueError(f"the name {rule.name!r} is taken")
        yield rule.code, rule


RULES: PluginTable[Rule] = PluginTable("deepbots.rules", {entry.code: entry for entry in _CATALOG}, _read)


def matching_rules(word: str) -> tuple[Rule, ...]:
    """Return the rule whose code or name is `word`, whatever its case, or all rules whose codes begin with
    it."""
    name = word.strip().lower().replace("_", "-")
    rules = tuple(rule for rule in RULES.values() if name == rule.name)
    return rules or tuple(rule for rule in RULES.values() if rule.code.lower().startswith(name))


def retired_rule_message(word: str) -> str | None:
    """Return the message for the code or name of a rule that is gone; None for another word."""
    instead = RETIRED.get(word.strip().upper().replace("_", "-"))
    if instead is None:
        return None
    return f"the rule {word.strip()} is gone" + (f"; {instead}" if instead else "")


def unknown_rule_message(word: str) -> str:
    """Return the message for a word that fits no rule."""
    if (retired := retired_rule_message(word)) is not None:
        return retired
    is_code = word[:2].upper() == "DB" and word[2:3].isdigit()
    near = nearest_word(word, [rule.code if is_code else rule.name for rule in RULES.values()])
    return f"there is no finding '{word}'" + (
        f"; did you mean {near}?" if near else "; `deepbots explain` lists them"
    )
