"""A scenario file with all that it extends and includes, as one tree of nodes.

A file is read in this order: its own text, the `include`s in it, what it `extends` laid beneath, `remove`. The
assignments of the command line come last, upon the whole.
"""

from __future__ import annotations

from collections.abc import Iterable
from collections.abc import Mapping as Table
from collections.abc import Sequence as Texts
from dataclasses import dataclass, replace
from operator import is_
from pathlib import Path

from deepbots_cli.diagnostics import MOST_FINDINGS, Findings, Label, Source, Span, TooManyFindings
from deepbots_cli.document import files, merge, overrides, roots, shipped
from deepbots_cli.document.nodes import Entry, Mapping, Node, Scalar, Sequence, descend
from deepbots_cli.document.nodes import Path as NodePath
from deepbots_cli.document.parse import MAX_DEPTH, MAX_EXPANDED, Budget, parse
from deepbots_cli.errors import UsageError

MAX_CHAIN = 32

Drafts = Table[Path, bytes]
"""What files shall come to hold, by their absolute paths."""
NO_DRAFTS: Drafts = {}


@dataclass(frozen=True)
class Document:
    """What was read: the merged tree, every file that it came from, and what is wrong with them.

    `root` is None where a finding at error level left nothing to go on with. `files` maps the absolute path of each
    file to its text, the main file first; `roots` are the folders that the scenario may read from,
    and `allow_code` says whether it may name functions of Python.
    """

    root: Mapping | None
    source: Source
    files: dict[Path, Source]
    findings: Findings
    roots: tuple[Path, ...]
    base: Path
    allow_code: bool = False

    @property
    def sources(self) -> tuple[Source, ...]:
        """Every text that was read, the main one first."""
        return (self.source, *(source for source in self.files.values() if source is not self.source))

    @property
    def path(self) -> Path:
        """The main file; for a text that was no file, where it would lie."""
        return next(iter(self.files), self.base / self.source.name)

    def directory_of(self, span: Span) -> Path:
        """The folder that a relative path written at `span` starts from."""
        for path, source in self.files.items():
            if source is span.source:
                return path.parent
        return self.base


def load(
    path: Path | str,
    sets: Texts[str] = (),
    *,
    display: str | None = None,
    allow_paths: Iterable[str | Path] = (),
    drafts: Drafts = NO_DRAFTS,
    project: Path | None = None,
) -> Document:
    """Read the scenario at `path`, with the assignments `sets` (`path=value`) made.

    Problems in the files are findings of the document; `display` is the name they are reported under. What stands
    in `drafts` is read in the place of the file of that absolute path. `project` is the folder that the scenario may read
    from; by default it is found by its markers.

    Raises:
        UsageError: If there is no such file, or it cannot be read.
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
    except (OSError, ValueError, RuntimeError) as error:
        reason = error.strerror if isinstance(error, OSError) else None
        raise UsageError(f"{name} cannot be read: {(reason or 'not a usable file name').lower()}") from None
    reader = _Reader(_roots(file.parent, sets, allow_paths, project), drafts)
    source, readable = files.decode(data, name, reader.findings)
    reader.files[file] = source
    return reader.document(source, Path.cwd(), sets, file.parent, (file,), readable=readable)


def loads(
    text: str,
    name: str = "<text>",
    base: str | Path | None = None,
    sets: Texts[str] = (),
    *,
    allow_paths: Iterable[str | Path] = (),
) -> Document:
    """The same for a text; paths in it are relative to `base`, by default the working directory."""
    base = Path(base or Path.cwd()).resolve()
    reader = _Reader(_roots(base, sets, allow_paths))
    source, readable = files.decode(text.encode("utf-8", "surrogatepass"), name, reader.findings)
    return reader.document(source, base, sets, base, (), readable=readable)


def _roots(folder: Path, sets: Texts[str], allowed: Iterable[str | Path], project: Path | None = None) -> tuple[Path, ...]:
    # A path typed on the command line is the user's own, and relative to where they stand.
    own = [project.resolve() if project else roots.project_root(folder), *([roots.project_root(Path.cwd())] if sets else [])]
    return tuple(dict.fromkeys((*own, *shipped.data_roots(), *allowed_folders(allowed))))


def allowed_folders(paths: Iterable[str | Path]) -> tuple[Path, ...]:
    """What `--allow-path` names, links followed.

    Raises:
        UsageError: One of them is no folder.
    """
    folders = [Path(path) for path in ((paths,) if isinstance(paths, (str, Path)) else paths)]
    for folder in folders:
        if not folder.is_dir():
            raise UsageError(f"there is no folder {folder} that could be read from; --allow-path names a folder outside the project")
    return tuple(folder.resolve() for folder in folders)


class _Reader:
    """Reads each file once, within one budget for all of them."""

    def __init__(self, roots: tuple[Path, ...], drafts: Drafts = NO_DRAFTS) -> None:
        self.roots = roots
        self.drafts = drafts
        self.findings = Findings(MOST_FINDINGS)
        self.budget = Budget()
        self.files: dict[Path, Source] = {}
        self.read: dict[Path, Mapping | None] = {}
        self.size = 0  # bytes that were included so far

    def document(self, source: Source, base: Path, sets: Texts[str], folder: Path, chain: tuple[Path, ...], *, readable: bool) -> Document:
        """The whole of the scenario in `source`, which lies in `folder`."""
        root = None
        try:
            root = self.scenario(source, folder, chain) if readable else None
            for assignment in sets:
                if root is not None:
                    root = overrides.apply(root, assignment, self.findings, self.budget)
        except TooManyFindings as too_many:
            root = None
            self.findings.give_up(too_many)
        return Document(root, source, self.files, self.findings, self.roots, base)

    def scenario(self, source: Source, folder: Path, chain: tuple[Path, ...]) -> Mapping | None:
        """The tree of one file; None, with findings, if the file or one that it extends cannot be used."""
        root = parse(source, self.findings, self.budget)
        if root is None:
            return None
        if not isinstance(root, Mapping):
            self.findings.add("DB103", root.span, "the file is no mapping", help="write keys with values, such as `name: CartPole`")
            return None
        tree = self.expanded(root, folder, chain, 1)
        if not isinstance(tree, Mapping):
            return None
        entries = dict(tree.entries)
        extends, remove = entries.pop("extends", None), entries.pop("remove", None)
        tree = own = replace(tree, entries=entries)
        if extends is not None:
            base = self.referenced(extends, folder, chain)
            if base is None:
                return None
            tree = merge.merge(base, tree)
        return self.pruned(tree, remove.value, own) if remove else tree

    def expanded(self, node: Node, folder: Path, chain: tuple[Path, ...], depth: int) -> Node:
        """`node`, a tree in a file of `folder`, with the files that it includes in their places."""
        match node:
            case Scalar():
                return node
            case Sequence():
                items = tuple(self.expanded(item, folder, chain, depth + 1) for item in node.items)
                return node if all(map(is_, items, node.items)) else Sequence(node.span, items)
            case Mapping():
                include = node.entries.get("include")
                others = {key: entry for key, entry in node.entries.items() if key != "include"}
                values = {key: self.expanded(entry.value, folder, chain, depth + 1) for key, entry in others.items()}
                if include is None and all(values[key] is entry.value for key, entry in others.items()):
                    return node  # as most are
                entries = {key: Entry(entry.key, values[key]) for key, entry in others.items()}
                siblings = replace(node, entries=entries)
                if include is None:
                    return siblings
                included = self.referenced(include, folder, chain)
                if included is None or not self.affordable(included, include, depth):
                    return Mapping(node.span, entries, partial=True)
                return merge.merge(included, siblings)

    def affordable(self, included: Mapping, entry: Entry, depth: int) -> bool:
        size, height = merge.measure(included)
        self.budget.expanded -= size
        if self.budget.expanded < 0:
            headline = f"included files expand to more than {MAX_EXPANDED:_} values"
        elif depth - 1 + height > MAX_DEPTH:
            headline = f"included values are nested more than {MAX_DEPTH} deep"
        else:
            return True
        self.findings.add("DB005", entry.value.span, headline, help="simplify the files; scenarios are far below this limit")
        return False

    def referenced(self, entry: Entry, folder: Path, chain: tuple[Path, ...]) -> Mapping | None:
        """The tree of the file that the value of `extends` or `include` names."""
        word, value = entry.key.text, entry.value
        if not isinstance(value, Scalar) or not isinstance(value.value, str):
            self.findings.add("DB103", value.span, f"`{word}` takes the path of one file", help=f"write `{word}: file.yaml`")
            return None
        path = roots.resolve(value.text, folder, self.roots)
        if isinstance(path, roots.Refused):
            found = shipped.scenario_path(value.text) if word == "extends" else None
            copied = f"`deepbots copy {value.text}` puts a copy beside this file, to be named as `{value.text}.yaml`"
            self.findings.add("DB204", value.span, path.headline, help=copied if found else path.help)
            return None
        if path in chain:
            circle = " -> ".join(step.name for step in (*chain[chain.index(path) :], path))
            help = "take one of them out of the circle"
            self.findings.add("DB204", value.span, f"`{value.text}` leads back to itself", help=help, notes=(circle,))
            return None
        if len(chain) >= MAX_CHAIN:
            self.findings.add("DB204", value.span, f"files name each other more than {MAX_CHAIN} deep", help="join some of them")
            return None
        if path not in self.read:
            self.read[path] = self.opened(path, value.span, chain)
        return self.read[path]

    def opened(self, path: Path, by: Span, chain: tuple[Path, ...]) -> Mapping | None:
        try:
            data = self.drafts[path] if path in self.drafts else files.read(path)
        except OSError as error:
            self.findings.add(
                "DB204", by, f"`{path.name}` cannot be read", help=f"the system says: {(error.strerror or 'no reason').lower()}"
            )
            return None
        self.size += len(data)
        if self.size > files.MAX_TOTAL_BYTES:
            headline = f"the files of the scenario are larger than {files.MAX_TOTAL_BYTES >> 20} MiB together"
            self.findings.add("DB005", by, headline, help="check that all of them are parts of a scenario")
            return None
        source, readable = files.decode(data, roots.display(path), self.findings, included_from=by)
        self.files[path] = source
        return self.scenario(source, path.parent, (*chain, path)) if readable else None

    def pruned(self, tree: Mapping, remove: Node, own: Mapping) -> Mapping:
        """The tree without the paths listed under `remove`; one that stands in the same text, which is in `own`, is taken out too."""
        if not isinstance(remove, Sequence):
            self.findings.add("DB103", remove.span, "`remove` takes a list of paths", help="write `remove: [observation.speed]`")
            return tree
        paths: list[NodePath] = []
        for item in remove.items:
            if not isinstance(item, Scalar) or not isinstance(item.value, str):
                self.findings.add("DB103", item.span, "a path to remove must be text", help="write `remove: [observation.speed]`")
                continue
            steps, reached, rest = merge.follow(tree, item.text)
            if not rest and steps:
                paths.append(steps)
                self.warn_of_lost(own, steps, item, reached)
            else:
                here = item.part(len(item.text) - len(rest), len(item.text))
                names = (
                    f"there are: {', '.join(list(reached.entries)[:20])}" if isinstance(reached, Mapping) else "remove a path that exists"
                )
                self.findings.add("DB201", here, f"there is no `{item.text}` to remove", help=names)
        pruned = merge.without(tree, paths)
        return pruned if isinstance(pruned, Mapping) else tree

    def warn_of_lost(self, own: Mapping, path: NodePath, remove: Scalar, removed: Node) -> None:
        """DB205 where `remove` takes out what the same file writes; `removed` is the node as merged with the extended file."""
        node, key, reached = descend(own, path)
        if reached == len(path) and key is not None and key.span.source is remove.span.source:
            name = ".".join(map(str, path))
            headline = f"`{name}` is written here, and taken out by `remove`"
            help = "take one of the two out; what is written anew needs no `remove`"
            if isinstance(node, Mapping) and isinstance(removed, Mapping):
                extended = [f"{name}.{entry}" for entry in removed.entries if entry not in node.entries]
                if extended:
                    help = f"to replace what the extended file has in `{name}`, remove it by name: `remove: [{', '.join(extended[:10])}]`"
            self.findings.add("DB205", key.span, headline, help=help, also=(Label(remove.span, "taken out here"),))
