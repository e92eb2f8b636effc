"""Go to definition: from a name, a reference, an alias or a path to where it is defined, in whichever file that is."""

from __future__ import annotations

import re
from fnmatch import fnmatchcase

from lsprotocol import types

from deepbots_cli.compiler.inventory import definition, names
from deepbots_cli.diagnostics import Span
from deepbots_cli.document import Mapping, descend
from deepbots_cli.document.nodes import follow
from deepbots_cli.lsp.asking import leaves, specs
from deepbots_cli.lsp.desk import View
from deepbots_cli.lsp.diagnosing import Places
from deepbots_cli.lsp.documents import uri_of
from deepbots_cli.lsp.files import located
from deepbots_cli.lsp.pointing import Pointed, piece, pointed
from deepbots_cli.scenario.base import MappingOf
from deepbots_cli.scenario.fields import FieldType, FilePath, Pattern, Reference

_START = types.Range(types.Position(0, 0), types.Position(0, 0))
_ALIAS = re.compile(r"\*([\w-]+)")


def definitions(view: View, open_uris: dict[str, str]) -> list[types.Location]:
    """Where what stands under the cursor is defined; several places for a pattern that several names fit."""
    anchor = _anchor(view)
    if anchor is not None:
        return [anchor]
    found = pointed(view)
    file = _file(view, found, open_uris) if found is not None else None
    if file is not None:
        return [file]
    if view.analysis is None:
        return []
    places = Places(view.analysis, open_uris)
    return [places.location(span) for span in _by_name(view) or (_by_reference(view, found) if found else [])]


def _anchor(view: View) -> types.Location | None:
    """Where the value of an alias stands."""
    text = view.document.plain
    begin = text.rfind("\n", 0, view.offset) + 1
    for alias in _ALIAS.finditer(text, begin, view.offset + 100):
        if alias.start() <= view.offset <= alias.end():
            anchors = list(re.finditer(rf"&{re.escape(alias[1])}(?![\w-])", text[: alias.start()]))
            return types.Location(view.document.uri, view.document.lines.range(*anchors[-1].span())) if anchors else None
    return None


def _file(view: View, found: Pointed, open_uris: dict[str, str]) -> types.Location | None:
    kinds = [leaf.kind for leaf in leaves(found.path, view.data) if isinstance(leaf, FilePath)]
    if found.is_key or not (kinds or found.path[-1:] in (("include",), ("extends",))):
        return None
    path = located(view, found.text, robots="robot file" in kinds)
    return types.Location(open_uris.get(str(path)) or uri_of(path), _START) if path is not None else None


def _by_name(view: View) -> list[Span]:
    """A name in an expression."""
    found = piece(view)
    if found is None or found.name is None or view.analysis is None or view.analysis.checked is None:
        return []
    leads = definition(view.analysis.checked, found.name, found.robot)
    return [leads.span] if leads and leads.span else []


def _by_reference(view: View, found: Pointed) -> list[Span]:
    """A name, or a pattern, where the language takes the name of something."""
    checked = view.analysis.checked if view.analysis else None
    if checked is None or checked.document.root is None:
        return []
    kinds: list[FieldType] = leaves(found.path, view.data)
    if found.is_key:
        kinds = [spec.key for spec in specs(found.path[:-1], view.data) if isinstance(spec, MappingOf)]
    for leaf in kinds:
        if isinstance(leaf, (Reference, Pattern)):
            fitting = [known.span for known in names(checked, leaf.kind, found.path) if fnmatchcase(known.name, found.text) and known.span]
            if fitting:
                return fitting
            if leaf.kind == "setting":
                return _setting(checked.document.root, found.text)
    return []


def _setting(root: Mapping, text: str) -> list[Span]:
    """The key that the dotted path of a setting leads to."""
    steps, _, rest = follow(root, text)
    key = descend(root, steps)[1] if steps and not rest else None
    return [key.span] if key else []
