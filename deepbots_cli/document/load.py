"""A scenario with the files that it extends and includes, `remove` and `--set`, as one tree of nodes.

A file is read in this order: its own text, its `include`s, the file that it `extends` as the base. `remove`
takes entries from the base and from included files, before the own text is laid upon them. The assignments of
the command line are applied last, to the whole tree.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from collections.abc import Mapping as Table
from collections.abc import Sequence as Texts
from dataclasses import replace
from functools import cache
from pathlib import Path

from deepbots_cli.diagnostics import MAX_FINDINGS, Findings, Fix, Label, Source, Span, TooManyFindings
from deepbots_cli.diagnostics.nearest import nearest_word
from deepbots_cli.document import files, nodes, shipped
from deepbots_cli.document.nodes import (
    Entry,
    MappingNode,
    Node,
    NodePath,
    ScalarNode,
    SequenceNode,
    count_and_depth,
    descend,
    entries_at,
    follow_dotted,
    node_at,
    without_paths,
)
from deepbots_cli.document.parse import MAX_DEPTH, MAX_EXPANDED, Budget, parse
from deepbots_cli.errors import UsageError
from deepbots_cli.records import dataclass

MAX_INCLUSION_DEPTH = 32
TESTS, TUNE = "tests", "tune"
"""Sections that name other parts of the scenario; `extends` does not take over the tests."""
_MAX_LISTED = 20


@dataclass(frozen=True)
class Permissions:
    """The permission of a scenario to use more than shipped files and files of its project.

    Attributes:
        folders: Further folders from which it may read files.
        code: Whether it may call functions of installed Python packages that it names. Set it only for
            packages that you trust.
    """

    folders: Texts[str | Path] = ()
    code: bool = False


Drafts = Table[Path, bytes]
"""Unsaved contents of files, by absolute path."""
NO_DRAFTS: Drafts = {}


@dataclass(frozen=True)
class Document:
    """The merged tree, every file that it came from, and their findings.

    `root` is None if a finding at error level left no tree. `files` maps the absolute path of each file to
    its text, the main file first. The scenario may read from the folders `roots`. `overrides` are the
    assignments of `--set` that were applied. `agent` is the one that the tree is about, if the file has
    several.
    """

    root: MappingNode | None
    source: Source
    files: dict[Path, Source]
    findings: Findings
    roots: tuple[Path, ...]
    base: Path
    permissions: Permissions = Permissions()
    overrides: tuple[str, ...] = ()
    agent: str | None = None

    @property
    def sources(self) -> tuple[Source, ...]:
        """Every text that was read, the main one first."""
        return (self.source, *(source for source in self.files.values() if source is not self.source))

    @property
    def path(self) -> Path:
        """The main file; for a text without a file, the path that it would have."""
        return next(iter(self.files), self.base / self.source.name)

    def directory_of(self, span: Span) -> Path:
        """Return the folder that a relative path written at `span` starts from."""
        for path, source in self.files.items():
            if source is span.source:
                return path.parent
        return self.base


def load(
    path: Path | str,
    overrides: Texts[str] = (),
    *,
    display: str | None = None,
    permissions: Permissions = Permissions(),
    drafts: Drafts = NO_DRAFTS,
    project: Path | None = None,
) -> Document:
    """Read the scenario at `path` and apply the assignments `overrides` (`path=value`).

    Problems in the files are findings of the document, reported under the name `display`. `drafts` replace
    the contents of files. `project` is the folder that the scenario may read from; by default it is found by
    its markers.

    Raises:
        UsageError: The file does not exist or cannot be read.
    """
    name = display or str(path)
    try:
        file = Path(path).resolve()
        if file.is_dir():
            raise UsageError(f"{name} is a folder; name a scenario file in it")
        if file.exists() and not file.is_file():
            raise UsageError(f"{name} is not a regular file")
        data = drafts[file] if file in drafts else files.read(file)
    except FileNotFoundError:
        raise UsageError(f"there is no file {name}") from None
    # `resolve` raises ValueError for a null character, RuntimeError for a loop of symbolic links.
    except (OSError, ValueError, RuntimeError) as error:
        reason = error.strerror if isinstance(error, OSError) else None
        raise UsageError(f"{name} cannot be read: {(reason or 'not a usable file name').lower()}") from None
    reader = _Reader(_roots(file.parent, overrides, permissions, project), permissions, drafts)
    source, readable = files.decode(data, name, reader.findings)
    reader.files[file] = source
    return reader.document(source, Path.cwd(), overrides, file.parent, (file,), readable=readable)


def loads(
    text: str,
    name: str = "<text>",
    base: str | Path | None = None,
    overrides: Texts[str] = (),
    *,
    permissions: Permissions = Permissions(),
) -> Document:
    """Read a scenario from a text; paths in it are relative to `base`, by default the working directory."""
    base = Path(base or Path.cwd()).resolve()
    reader = _Reader(_roots(base, overrides, permissions), permissions)
    source, readable = files.decode(text.encode("utf-8", "surrogatepass"), name, reader.findings)
    return reader.document(source, base, overrides, base, (), readable=readable)


def _roots(
    folder: Path, overrides: Texts[str], permissions: Permissions, project: Path | None = None
) -> tuple[Path, ...]:
    # A path in an assignment is the user's own, and relative to the working directory.
    folders = [
        project.resolve() if project else files.project_root(folder),
        *([files.project_root(Path.cwd())] if overrides else []),
    ]
    # `files.UnusableFile` takes the first root for the project.
    return tuple(dict.fromkeys((*folders, *shipped.data_roots(), *allowed_folders(permissions.folders))))


def allowed_folders(paths: Iterable[str | Path]) -> tuple[Path, ...]:
    """Return the folders of `--allow-path`, links followed.

    Raises:
        UsageError: One of them is not a folder.
    """
    folders = [Path(path) for path in ((paths,) if isinstance(paths, (str, Path)) else paths)]
    for folder in folders:
        if not folder.is_dir():
            raise UsageError(f"{folder} is not a folder; --allow-path needs an existing folder")
    return tuple(folder.resolve() for folder in folders)


def read_alone(path: Path, display: str | None = None) -> tuple[Node | None, Findings]:
    """Return what can be read of a YAML file, without its `include`s, and its mistakes.

    Raises:
        OSError: The file cannot be read.
    """
    findings = Findings()
    source, readable = files.decode(files.read(path), display or str(path), findings)
    return (parse(source, findings) if readable else None), findings


def summary_of(path: Path) -> str:
    """Return the summary of a scenario file on one line; empty without one."""
    return nodes.text_at(read_alone(path)[0], "summary")


@cache
def shipped_summaries(*, variants: bool) -> dict[str, str]:
    """Return the shipped scenarios, each with its summary: the tasks, or the `variants` that extend one."""
    paths = [path for path in map(shipped.scenario_path, shipped.scenario_names()) if path is not None]
    trees = {path.stem: read_alone(path)[0] for path in paths}
    return {
        name: nodes.text_at(root, "summary")
        for name, root in trees.items()
        if ("extends" in entries_at(root)) is variants
    }


class _Reader:
    """Reads each file once, within one budget for all of them."""

    def __init__(self, roots: tuple[Path, ...], permissions: Permissions, drafts: Drafts = NO_DRAFTS) -> None:
        self.roots = roots
        self.permissions = permissions
        self.drafts = drafts
        self.findings = Findings(MAX_FINDINGS)
        self.budget = Budget()
        self.files: dict[Path, Source] = {}
        self.trees: dict[Path, MappingNode | None] = {}
        self.size = 0  # bytes of the files that others name

    def document(
        self,
        source: Source,
        base: Path,
        overrides: Texts[str],
        folder: Path,
        chain: tuple[Path, ...],
        *,
        readable: bool,
    ) -> Document:
        """Return the whole scenario in `source`, which lies in `folder`."""
        root = None
        try:
            root = self.scenario(source, folder, chain) if readable else None
            for assignment in overrides:
                if root is not None:
                    root = apply_assignment(root, assignment, self.findings, self.budget)
        except TooManyFindings as too_many:
            root = None
            self.findings.report_limit(too_many)
        return Document(
            root, source, self.files, self.findings, self.roots, base, self.permissions, tuple(overrides)
        )

    def scenario(self, source: Source, folder: Path, chain: tuple[Path, ...]) -> MappingNode | None:
        """Return the tree of one file; None, with findings, if the file or one that it extends cannot be
        used."""
        root = parse(source, self.findings, self.budget)
        if root is None:
            return None
        if not isinstance(root, MappingNode):
            self.findings.add(
                "DB103",
                root.span,
                "the file is not a mapping",
                "write keys with values, such as `name: CartPole`",
            )
            return None
        has_includes = "include" in source.text or "\\" in source.text  # an escape may spell the key
        tree = self.expanded(root, folder, chain, 1) if has_includes else root
        if not isinstance(tree, MappingNode):
            return None
        entries = dict(tree.entries)
        extends, remove = entries.pop("extends", None), entries.pop("remove", None)
        tree = replace(tree, entries=entries)
        if extends is None:
            return self.without_removed(None, tree, remove.value) if remove else tree
        base = self.referenced(extends, folder, chain)
        if base is None:
            return None
        # A test is about the scenario of its own file: another one moves, scores and ends differently.
        base = replace(base, entries={key: entry for key, entry in base.entries.items() if key != TESTS})
        return self.without_removed(base, tree, remove.value) if remove else merge(base, tree)

    def expanded(self, node: Node, folder: Path, chain: tuple[Path, ...], depth: int, names: int = 0) -> Node:
        """Return `node`, from a file in `folder`, with included files in their places; `names` as in
        `merge`."""
        match node:
            case ScalarNode():
                return node
            case SequenceNode():
                return SequenceNode(
                    node.span, tuple(self.expanded(item, folder, chain, depth + 1) for item in node.items)
                )
            case MappingNode():
                below = {
                    key: Entry(
                        key_node,
                        self.expanded(value, folder, chain, depth + 1, _names_below(names, key)),
                    )
                    for key, (key_node, value) in node.entries.items()
                }
                include = below.pop("include", None)
                if include is None:
                    return replace(node, entries=below)
                included = self.referenced(include, folder, chain)
                if included is None or not self.is_affordable(included, include, depth):
                    return MappingNode(node.span, below, partial=True)
                return merge(included, replace(node, entries=below), names)

    def is_affordable(self, included: MappingNode, entry: Entry, depth: int) -> bool:
        size, height = count_and_depth(included)
        self.budget.expanded -= size
        if self.budget.expanded < 0:
            headline = f"included files expand to more than {MAX_EXPANDED:,} values"
        elif depth - 1 + height > MAX_DEPTH:
            headline = f"included values are nested more than {MAX_DEPTH} deep"
        else:
            return True
        self.findings.add(
            "DB005", entry.value.span, headline, "simplify the files; scenarios are far below this limit"
        )
        return False

    def referenced(self, entry: Entry, folder: Path, chain: tuple[Path, ...]) -> MappingNode | None:
        """Return the tree of the file that `extends` or `include` names."""
        word, value = entry.key.text, entry.value
        if not isinstance(value, ScalarNode) or not isinstance(value.value, str):
            takes, example = (
                ("the path or the name of one scenario", "cartpole")
                if word == "extends"
                else ("the path of one file", "file.yaml")
            )
            self.findings.add("DB103", value.span, f"`{word}` takes {takes}", f"write `{word}: {example}`")
            return None
        library = shipped.SCENARIOS if word == "extends" else None
        path = files.resolve_reference(
            value.text, folder, self.roots, library, by=chain[-1] if chain else None
        )
        if isinstance(path, files.UnusableFile):
            self.findings.add(
                "DB204", value.span, path.headline, path.help, notes=path.notes, fix=path.fix(value.span)
            )
            return None
        if path in chain:
            self.findings.add(
                "DB204",
                value.span,
                f"`{value.text}` includes itself",
                "remove one of these references",
                notes=(" -> ".join(step.name for step in (*chain[chain.index(path) :], path)),),
            )
            return None
        if len(chain) >= MAX_INCLUSION_DEPTH:
            self.findings.add(
                "DB204",
                value.span,
                f"files include each other more than {MAX_INCLUSION_DEPTH} levels deep",
                "merge some of them",
            )
            return None
        # The findings of a file are reported once, however many files include it.
        if path not in self.trees:
            self.trees[path] = self.read(path, value.span, chain)
        return self.trees[path]

    def read(self, path: Path, by: Span, chain: tuple[Path, ...]) -> MappingNode | None:
        try:
            data = self.drafts[path] if path in self.drafts else files.read(path)
        except OSError as error:
            self.findings.add(
                "DB204",
                by,
                f"`{path.name}` cannot be read",
                f"the operating system reports: {(error.strerror or 'no reason').lower()}",
            )
            return None
        self.size += len(data)
        if self.size > files.MAX_TOTAL_BYTES:
            self.findings.add(
                "DB005",
                by,
                f"the files of the scenario are larger than {files.MAX_TOTAL_BYTES >> 20} MiB together",
                "check that every file is part of a scenario",
            )
            return None
        source, readable = files.decode(data, files.display_path(path), self.findings, included_from=by)
        self.files[path] = source
        return self.scenario(source, path.parent, (*chain, path)) if readable else None

    def without_removed(self, base: MappingNode | None, own: MappingNode, remove: Node) -> MappingNode:
        """Lay the tree of a file upon its base, without the paths listed under `remove`. An entry that the
        file itself writes stays; DB205 where it replaces the inherited one anyway."""
        tree = own if base is None else merge(base, own)
        example = "write `remove: [observation.speed]`"
        if not isinstance(remove, SequenceNode):
            self.findings.add("DB103", remove.span, "`remove` takes a list of paths", example)
            return tree
        paths: list[NodePath] = []
        written: list[NodePath] = []
        for item in remove.items:
            if not isinstance(item, ScalarNode) or not isinstance(item.value, str):
                self.findings.add("DB103", item.span, "a path to remove must be text", example)
                continue
            steps, reached, unresolved = follow_dotted(tree, item.text)
            if unresolved or not steps:
                span = item.part(len(item.text) - len(unresolved), len(item.text))
                help = _listed(reached) if isinstance(reached, MappingNode) else "remove a path that exists"
                self.findings.add("DB201", span, f"there is no `{item.text}` to remove", help)
                continue
            paths.append(steps)
            value, key, target = descend(own, steps)
            if target == len(steps) and key is not None and key.span.source is item.span.source:
                written.append(steps)
                if not isinstance(value, MappingNode):
                    headline = f"`{item.text}` is both defined here and listed under `remove`"
                    help = "keep one of the two: a new value replaces the inherited one without `remove`"
                    self.findings.add(
                        "DB205", key.span, headline, help, labels=(Label(item.span, "removed here"),)
                    )
        own = _pruned(own, [path for path in paths if path not in written])
        return own if base is None else merge(_pruned(base, paths), own)


def _pruned(tree: MappingNode, paths: Texts[NodePath]) -> MappingNode:
    pruned = without_paths(tree, paths)
    return pruned if isinstance(pruned, MappingNode) else tree


def _listed(node: MappingNode) -> str:
    return f"there are: {', '.join(list(node.entries)[:_MAX_LISTED])}"


# Merging

_KIND_KEYS = ("type", "shape", "algorithm")
_WHOLES = {"xyz": ("x", "y", "z"), "rpy": ("roll", "pitch", "yaw")}
"""Keys of a pose that replace the keys of its parts."""
LEVELS_OF_NAMES = {"scripts": 3, "choices": 2, "layouts": 2, "poses": 2} | dict.fromkeys(
    (
        *("action", "actuators", "agents", "apply", "augment", "cases", "critic", "disturbances", "driver"),
        *("emit", "endings", "failure", "forbid", "groups", "hear", "joints", "layout", "legend", "lines"),
        *("links", "objects", "observation", "one_of", "others", "parameters", "place", "rays", "receive"),
        *("reward", "robots", "ros", "search", "sensors", "set", "signals", "spin", "success"),
        *("supplied_by", "swap", "tests", "tiles", "walls", "xacro"),
    ),
    1,
)
"""How many levels of mappings below a key have keys that the user chose: a reward term may be called `shape`,
a condition of a script `type`."""


def _names_below(names: int, key: str) -> int:
    return names - 1 if names else LEVELS_OF_NAMES.get(key, 0)


def merge(base: MappingNode, over: MappingNode, names: int = 0) -> MappingNode:
    """Return `over` laid upon `base`, whose keys and those of so many levels are `names` that the user chose.

    Mappings merge by key in the order of `base`; lists and single values replace. In a section, `xyz`
    replaces `x`, `y` and `z`. If its kind changes (`type`, `shape`, `algorithm`), the settings of the old
    kind have no meaning, and `over` replaces `base`.
    """
    if not names and any(_differ(base.get(key), over.get(key)) for key in _KIND_KEYS):
        return over
    replaced = {
        part for whole, parts in _WHOLES.items() if not names and whole in over.entries for part in parts
    }
    entries = {key: entry for key, entry in base.entries.items() if key not in replaced}
    for key, entry in over.entries.items():
        below = base.get(key)
        if isinstance(below, MappingNode) and isinstance(entry.value, MappingNode):
            entry = Entry(entry.key, merge(below, entry.value, _names_below(names, key)))
        entries[key] = entry
    return MappingNode(
        over.span, entries, partial=base.partial or over.partial, keys_without_value=over.keys_without_value
    )


def _differ(base: Node | None, over: Node | None) -> bool:
    return isinstance(base, ScalarNode) and isinstance(over, ScalarNode) and base.text != over.text


# Assignments: `--set path=value`, and settings in a file (`set: {reset.layout: paper}`)

_CUTOFF = 0.75


def apply_assignment(
    root: MappingNode, assignment: str, findings: Findings, budget: Budget | None = None
) -> MappingNode:
    """Return `root` after one assignment `path=value`; unchanged, with a finding, if it cannot be applied.

    A bare name is a parameter if there is one of that name, else a key of the scenario. The value replaces
    the old one; mappings are not merged. A section that the file leaves out is added. The text of the
    assignment is the source of its nodes.
    """
    path, equals, text = assignment.partition("=")
    source = Source(f"--set {path.strip() or assignment}", assignment, assigned=path.strip())
    if not files.check_characters(source, findings):
        return root
    whole = Span(source, 0, len(assignment))
    if not path.strip():
        findings.add("DB102", whole, "there is no path before the `=`", "write --set path=value")
    elif not equals or re.fullmatch(r"\s*(?:#.*)?", text):
        help = "put a value that starts with `#` in quotes" if "#" in text else "write --set path=value"
        if match := re.fullmatch(r"\s*([\w.]+)\s*[: ]\s*(\S.*)", assignment):
            help = f"write an equals sign: --set {match[1]}={match[2]}"
        findings.add("DB107", whole, f"`{path}` is set to nothing", help)
    else:
        # Spaces in place of the path: the offsets of the value are those in the assignment.
        value = parse(source, findings, budget, text=" " * (len(path) + 1) + text)
        return _set(root, ScalarNode(Span(source, 0, len(path)), path, path), value, whole, findings)
    return root


def apply_setting(root: MappingNode, setting: Entry, findings: Findings) -> MappingNode:
    """Return `root` after a setting of a file: its key is the path, its value the new value."""
    return _set(root, setting.key, setting.value, setting.key.span, findings)


def settings_in(root: MappingNode) -> Iterator[NodePath]:
    """Yield the paths of all settings of cases, stages, levels and `tune`; the last step is the setting."""
    stages = node_at(root, "curriculum")
    holders: list[NodePath] = [("curriculum", "set"), ("tune", "search")]
    holders += [("evaluation", "cases", name, "set") for name in entries_at(root, "evaluation", "cases")]
    if isinstance(stages, SequenceNode):
        holders += [("curriculum", number, "set") for number in range(len(stages.items))]
    for holder in holders:
        for setting in entries_at(root, *holder):
            yield (*holder, setting)


def with_settings_at(root: MappingNode, path: NodePath) -> MappingNode:
    """Return `root` after the settings of the evaluation case or curriculum stage at `path`."""
    for entry in entries_at(root, *path, "set").values():
        root = apply_setting(root, entry, Findings())
    return root


def _set(
    root: MappingNode, path: ScalarNode, value: Node | None, whole: Span, findings: Findings
) -> MappingNode:
    target = _target(root, path, findings)
    if target is None or value is None:
        return root
    steps, (key, *inner) = target
    for step in reversed(inner):
        value = MappingNode(whole, {step.text: Entry(step, value)})
    if isinstance(value, ScalarNode) and value.value is None:
        findings.add(
            "DB107", key.span, f"`{key.text}` is set to nothing", "the language has no null; write a value"
        )
        return root
    changed = nodes.with_entry(root, steps, Entry(key, value))
    return changed if isinstance(changed, MappingNode) else root


def setting_path(root: MappingNode, dotted: str) -> NodePath:
    """Return the path of the value that an assignment to `dotted` replaces or adds."""
    if dotted in entries_at(root, "parameters"):
        return ("parameters", dotted)
    steps, _, unresolved = follow_dotted(root, dotted)
    return (*steps, *unresolved.split(".")) if unresolved else steps


def _target(
    root: MappingNode, path: ScalarNode, findings: Findings
) -> tuple[NodePath, list[ScalarNode]] | None:
    """Return the path to replace, and its last key as written, followed by the keys of a section that is
    added below it.

    A key may be new. The mapping around it must exist, unless it is a section of the scenario or of an agent,
    or directly inside one.
    """
    dotted = path.text.strip()
    start = path.text.index(dotted)
    end = start + len(dotted)
    if dotted.count(".") >= MAX_DEPTH:
        help = "name a value of the scenario, such as `world.timestep`"
        findings.add("DB005", path.part(start, end), f"a path of more than {MAX_DEPTH} steps", help)
        return None
    parameters = root.get("parameters")
    if isinstance(parameters, MappingNode) and "." not in dotted:
        if dotted in parameters.entries:
            return ("parameters", dotted), [_key(path, start, end)]
        if dotted not in root.entries and (near := nearest_word(dotted, parameters.entries, _CUTOFF)):
            span = path.part(start, end)
            findings.add(
                "DB201",
                span,
                f"there is no parameter `{dotted}`",
                f"did you mean `{near}`?",
                fix=Fix.replacing(span, dotted, near, safe=False),
            )
            return None
    steps, reached, unresolved = follow_dotted(root, dotted)
    if not unresolved:
        return steps, [_key(path, start, end)]
    at = end - len(unresolved)
    name, *below = unresolved.split(".")
    name_span = path.part(at, at + max(1, len(name)))
    inside = f" in `{dotted[: at - start - 1]}`" if at > start else ""
    if not isinstance(reached, MappingNode):
        findings.add(
            "DB201",
            name_span,
            f"there is no `{name}`{inside}, because it has no keys",
            "set the whole value instead",
        )
        return None
    near = nearest_word(name, reached.entries, _CUTOFF)
    if name and not below:
        return (*steps, name), [_key(path, at, end)]
    is_section = len(steps) <= (2 if steps[:1] == ("agents",) else 1)
    if is_section and name and all(below) and not near:
        keys = []
        for step in (name, *below):
            keys.append(_key(path, at, at + len(step)))
            at += len(step) + 1
        return (*steps, name), keys
    help = f"did you mean `{near}`?" if near else _listed(reached)
    if name and all(below) and not near:
        help += (
            "; to add it, set it whole:"
            f" `{dotted[: at - start]}{name}={{{': {'.join(below)}: ...{'}' * len(below)}`"
        )
    findings.add("DB201", name_span, f"there is no `{name}`{inside}", help)
    return None


def _key(path: ScalarNode, start: int, end: int) -> ScalarNode:
    text = path.text[start:end]
    return ScalarNode(path.part(start, end), text, text)
