"""`--set path=value`: a value from the command line, as a node with a place of its own.

The text of the assignment is its source, so a finding in it is shown like one in a file. Settings that stand in a file
(`set: {reset.layout: paper}`) are made in the same way, by `place`.
"""

from __future__ import annotations

import re

from deepbots_cli.diagnostics import Findings, Fix, Source, Span
from deepbots_cli.diagnostics.nearest import nearest
from deepbots_cli.document import files
from deepbots_cli.document.merge import follow, replace
from deepbots_cli.document.nodes import Entry, Mapping, Node, Path, Scalar, descend
from deepbots_cli.document.parse import MAX_DEPTH, Budget, parse

_NOTHING = re.compile(r"\s*(?:#.*)?")


def apply(root: Mapping, assignment: str, findings: Findings, budget: Budget | None = None) -> Mapping:
    """`root` with one assignment made; unchanged, with a finding, where it cannot be.

    A bare name is a parameter if there is one of that name, else a key of the scenario. The value replaces
    what was there; mappings are not merged. A section that the file leaves out is begun.
    """
    source = Source(f"--set {assignment.partition('=')[0].strip() or assignment}", assignment)
    if not files.check(source, findings):
        return root
    path, equals, text = assignment.partition("=")
    whole = Span(source, 0, len(assignment))
    if not path.strip():
        findings.add("DB102", whole, "there is no path before the `=`", help="write --set path=value")
    elif not equals or _NOTHING.fullmatch(text):
        help = "put a value that starts with `#` in quotes" if "#" in text else "write --set path=value"
        findings.add("DB107", whole, f"`{path}` is set to nothing", help=help)
    else:
        value = parse(source, findings, budget, text=" " * (len(path) + 1) + text)
        key = Scalar(Span(source, 0, len(path)), path, path)
        return _set(root, key, value, whole, findings)
    return root


def place(root: Mapping, setting: Entry, findings: Findings) -> Mapping:
    """The same for a setting whose path and value stand in a file."""
    return _set(root, setting.key, setting.value, setting.key.span, findings)


def under(root: Mapping, path: Path) -> Mapping:
    """`root` under the settings at `path`: those of a case of the evaluation, or of a stage of the curriculum."""
    settings, _, reached = descend(root, (*path, "set"))
    if reached > len(path) and isinstance(settings, Mapping):
        for entry in settings.entries.values():
            root = place(root, entry, Findings())
    return root


def _set(root: Mapping, path: Scalar, value: Node | None, whole: Span, findings: Findings) -> Mapping:
    target = _target(root, path, findings)
    if target is None or value is None:
        return root
    steps, key, inner = target
    for step in reversed(inner):
        value = Mapping(whole, {step.text: Entry(step, value)})
    return _placed(root, steps, key, value, findings)


def _target(root: Mapping, path: Scalar, findings: Findings) -> tuple[Path, Scalar, list[Scalar]] | None:
    """The path to replace, its last key as written, and the keys of a section that is begun below it.

    A key may be new, the mapping around it may not, unless it is a whole section of the scenario.
    """
    dotted = path.text.strip()
    start = path.text.index(dotted)
    end = start + len(dotted)
    if dotted.count(".") >= MAX_DEPTH:
        help = "name a value of the scenario, such as `world.timestep`"
        findings.add("DB005", path.part(start, end), f"a path of more than {MAX_DEPTH} steps", help=help)
        return None
    parameters = root.get("parameters")
    if isinstance(parameters, Mapping) and "." not in dotted:
        if dotted in parameters.entries:
            return ("parameters", dotted), _key(path, start, end), []
        if dotted not in root.entries and (near := nearest(dotted, parameters.entries, 0.75)):
            help = f"did you mean `{near}`?"
            place = path.part(start, end)
            fix = Fix.replacing(place, dotted, near, safe=False)
            findings.add("DB201", place, f"there is no parameter `{dotted}`", help=help, fix=fix)
            return None
    steps, reached, rest = follow(root, dotted)
    at = start + len(dotted) - len(rest)
    if not rest:
        return steps, _key(path, start, end), []
    name = rest.split(".")[0]
    here = path.part(at, at + max(1, len(name)))
    inside = f" in `{dotted[: at - start - 1]}`" if at > start else ""
    if not isinstance(reached, Mapping):
        findings.add("DB201", here, f"there is no `{name}`{inside}, which holds no keys", help="set the whole value instead")
    elif not steps and all(rest.split(".")) and not nearest(name, reached.entries, 0.75):
        first, *inner = _keys(path, at, end)
        return (first.text,), first, inner
    elif name != rest or not name:
        near = nearest(name, reached.entries, 0.75)
        help = f"did you mean `{near}`?" if near else f"there are: {', '.join(list(reached.entries)[:20])}"
        findings.add("DB201", here, f"there is no `{name}`{inside}", help=help)
    else:
        return (*steps, name), _key(path, at, end), []
    return None


def _placed(root: Mapping, path: Path, key: Scalar, value: Node, findings: Findings) -> Mapping:
    if isinstance(value, Scalar) and value.value is None:
        findings.add("DB107", key.span, f"`{key.text}` is set to nothing", help="there is no null; write a value")
        return root
    changed = replace(root, path, Entry(key, value))
    return changed if isinstance(changed, Mapping) else root


def _keys(path: Scalar, start: int, end: int) -> list[Scalar]:
    """The steps of a piece of a dotted path, each at its place."""
    keys = []
    for step in path.text[start:end].split("."):
        keys.append(_key(path, start, start + len(step)))
        start += len(step) + 1
    return keys


def _key(path: Scalar, start: int, end: int) -> Scalar:
    text = path.text[start:end]
    return Scalar(path.part(start, end), text, text)
