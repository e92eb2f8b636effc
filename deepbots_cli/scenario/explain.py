"""The wording of findings that need to know the language: unknown keys, missing keys, what was found instead."""

from __future__ import annotations

import re
from collections.abc import Iterable

from deepbots_cli.diagnostics.nearest import Meant, meant, nearest
from deepbots_cli.document.hints import GIVE_A_VALUE
from deepbots_cli.document.nodes import Mapping, Node, Path, Scalar, Sequence
from deepbots_cli.scenario.examples import example_of
from deepbots_cli.scenario.fields import Leaf
from deepbots_cli.scenario.hyperparameters import ELSEWHERE
from deepbots_cli.scenario.part import Alternatives, Kinds, Mapped, Part, Spec, fields, noun_of
from deepbots_cli.scenario.scenario import Scenario
from deepbots_cli.scenario.training import Training
from deepbots_cli.scenario.walk import homes, spec_at

_SHOWN = 40
_EXEMPLARY = 120
_RESERVED = {"agents": "competing agents are kept for a later version of the language"}


def describe(node: Node) -> str:
    """What stands there, for `expected ..., found ...`."""
    match node:
        case Sequence():
            return "a list"
        case Mapping():
            return "a mapping"
        case Scalar(value=bool()):
            return f"the truth value `{node.text}`"
        case Scalar(value=int() | float()):
            return f"the number `{_shortened(node.text)}`"
        case Scalar():
            return f"the text `{_shortened(node.text)}`"


def _shortened(text: str) -> str:
    line = " ".join(text.split())
    return line if len(line) <= _SHOWN else f"{line[: _SHOWN - 3]}..."


def place(path: Path) -> str:
    """Where a key stands, for a headline."""
    if not path:
        return "at the top level"
    *_, last = path
    if isinstance(last, int):
        return f"in entry {last + 1} of `{name_of(path)}`"
    return f"in `{name_of(path)}`"


def name_of(path: Path) -> str:
    """The innermost key of a path, short enough for a headline."""
    return _shortened(next((step for step in reversed(path) if isinstance(step, str)), ""))


def expected_at(data: object, path: Path) -> str:
    spec = spec_at(Scenario, data, path)
    return "another type" if spec is None else noun_of(spec)


def keys_of(spec: Spec | None) -> str | None:
    """The keys of a part, as a sentence."""
    if isinstance(spec, type) and issubclass(spec, Part):
        return f"its keys are {_listed(fields(spec))}"
    return None


def help_for_unknown(data: object, parent: Path, key: str) -> str | None:
    """Where an unknown key belongs, what was probably meant, or at least what there is."""
    spec = spec_at(Scenario, data, parent)
    if not (isinstance(spec, type) and issubclass(spec, Part)):
        return None
    if not parent and key in _RESERVED:
        return _RESERVED[key]
    known = keys_of(spec)
    if issubclass(spec, Training) and key in ELSEWHERE:
        return ELSEWHERE[key]
    others = _kinds_with(spec_at(Scenario, data, parent, settled=False), key)
    if others:
        return f"it is a key of {_listed(others)}; here the keys are {_listed(fields(spec))}"
    british = key.replace("color", "colour")
    if british != key and british in fields(spec):
        return f"write `{british}`: keys are in British English"
    near = nearest(key, tuple(fields(spec)))
    belongs = _home_near(parent, key)
    if belongs is not None and (near is None or near.replace("_", "") != key.lower().replace("_", "")):
        return f"it belongs {belongs}; here the keys are {_listed(fields(spec))}"
    return f"did you mean `{near}`? {known}" if near else known


def _kinds_with(spec: Spec | None, key: str) -> list[str]:
    """The kinds beside the one given that know the key."""
    return [name for name in spec.names if key in fields(spec.model(name))] if isinstance(spec, Kinds) else []


def _home_near(parent: Path, key: str) -> str | None:
    """The place of the language that knows this key and is nearest to where it stands, unless there are many."""
    here = tuple(step for step in parent if isinstance(step, str))

    def shared(home: tuple[str, ...]) -> int:
        pairs = list(zip(home, here, strict=False))
        return next((i for i, (known, written) in enumerate(pairs) if known not in ("*", written)), len(pairs))

    found = sorted(homes(Scenario).get(key, ()), key=lambda home: (-shared(home), len(home), home))
    if not found or len(found) > 6:
        return None
    best = found[0]
    return f"under `{'.'.join('<name>' if step == '*' else step for step in best)}`" if best else "at the top level"


def meant_by(data: object, path: Path) -> Meant | None:
    """The key that was probably meant by an unknown one; not certain where the language knows that one elsewhere."""
    spec = spec_at(Scenario, data, path[:-1])
    if not (isinstance(spec, type) and issubclass(spec, Part)):
        return None
    key = str(path[-1])
    near = meant(key, tuple(fields(spec)), ours=True)
    return near and near._replace(safe=near.safe and key not in homes(Scenario))


def about(data: object, path: Path) -> str | None:
    """What the innermost known key of a path is for."""
    for depth in range(len(path), 0, -1):
        spec, key = spec_at(Scenario, data, path[: depth - 1]), path[depth - 1]
        if isinstance(spec, type) and issubclass(spec, Part) and isinstance(key, str) and key in spec.declared:
            text = spec.declared[key].description.rstrip(".")
            return f"`{key}`: {text[:1].lower()}{text[1:]}{_as_in(spec, key)}"
        if isinstance(key, str):
            return None
    return None


def _as_in(part: type[Part], key: str) -> str:
    """The example of a key, unless it is a long one, or the sentence about the key has one."""
    example = None if re.search("such as `|`{", part.declared[key].description) else example_of(part, key)
    return f", as in `{key}: {example.text}`" if example and "\n" not in example.text and len(example.text) <= _EXEMPLARY else ""


def _form(spec: Spec) -> str:
    """How a value is written, `: write it like ...`; empty where that is not known."""
    match spec:
        case Leaf():
            hint = spec.help_for(None)
        case Kinds():
            hint = f"write it like `{{{spec.key}: {spec.names[0]}}}`"
        case Alternatives():
            hint = spec.complaint().help
        case _:
            hint = keys_of(spec)
    return f": {hint}" if hint else ""


def wanted(data: object, path: Path) -> str:
    """What to write behind a key that has no value."""
    told = about(data, path)
    if told is not None and told.startswith(f"`{path[-1]}`"):
        return told
    kinds = spec_at(Scenario, data, path[:-1], settled=False)
    if isinstance(kinds, Kinds) and path[-1] == kinds.key:
        return f"it is one of {_listed(kinds.names)}"
    holder = spec_at(Scenario, data, path[:-1])
    if not isinstance(holder, Mapped):
        return GIVE_A_VALUE
    return f"give it {noun_of(holder.value)}{_form(holder.value)}"


def _listed(words: Iterable[str]) -> str:
    return ", ".join(f"`{word}`" for word in words)
