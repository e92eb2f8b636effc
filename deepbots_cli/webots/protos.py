"""PROTO nodes: where their definitions are, and the nodes that they stand for.

A PROTO node keeps its type and its fields, because a supervisor reads them; `body` is the node that its
definition makes of them. A definition is looked for in the world, in the files that it names by EXTERNPROTO,
in `library.py`, and in folders of the user.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

from deepbots_cli.diagnostics import Source
from deepbots_cli.diagnostics.nearest import nearest_word
from deepbots_cli.webots import library
from deepbots_cli.webots.nodes import node_types, type_problem
from deepbots_cli.webots.proto_templates import TemplateError, Templates
from deepbots_cli.webots.syntax import (
    Node,
    Parameter,
    Proto,
    Value,
    WorldSyntaxError,
    parse,
)

if TYPE_CHECKING:
    from deepbots_cli.webots.findings import WorldFindings
    from deepbots_cli.webots.project import Files
    from deepbots_cli.webots.syntax import Document, Extern, Item

MAX_NESTED_PROTOS = 20
"""The maximum depth of PROTO nodes in the bodies of others."""
MAX_NODES = 100_000
"""The maximum number of nodes of a world."""

_HEADER = "#VRML_SIM R2025a utf8\n"


@dataclass(frozen=True)
class Scope:
    """The definitions and addresses of the file that a node is written in."""

    protos: Mapping[str, Proto]
    externs: Mapping[str, Extern]
    source: Source

    @classmethod
    def of_document(cls, document: Document) -> Scope:
        return cls(document.protos, {extern.name: extern for extern in document.externs}, document.source)

    @classmethod
    def of_proto(cls, proto: Proto) -> Scope:
        return cls(
            proto.neighbors,
            {extern.name: extern for extern in proto.externs},
            proto.source or proto.span.source,
        )


class Expander:
    """Gives each PROTO node of a world its body."""

    def __init__(self, files: Files, findings: WorldFindings, *, allow_code: bool = False) -> None:
        self.files, self.findings = files, findings
        self._templates = Templates(files) if allow_code else None
        self._count = 0
        self._read: dict[str, Proto | None] = {}
        self._expanded_ids: set[int] = set()

    def expand(self, nodes: list[Node], scope: Scope) -> None:
        """Expand nodes in place.

        Raises:
            WorldSyntaxError: The world has too many nodes.
        """
        for node in nodes:
            self._expand(node, scope, "", 0)

    def _expand(self, node: Node, scope: Scope, slot: str, nested: int) -> None:
        if id(node) in self._expanded_ids:
            return
        self._expanded_ids.add(id(node))
        self._count += 1
        if self._count > MAX_NODES:
            raise WorldSyntaxError(node.span, f"the world has more than {MAX_NODES:,} nodes")
        for name, value in node.fields.items():
            for item in value.items:
                if isinstance(item, Node):
                    self._expand(item, scope, name, nested)
        if node.type in node_types() and node.type not in scope.protos:
            return
        proto = self._proto(node, scope, slot)
        if proto is None:
            return
        if nested >= MAX_NESTED_PROTOS:
            self.findings.error(node.span, f"PROTO {node.type} contains itself")
            _empty(node)
            return
        self._check_fields(node, proto)
        node.interface = proto.interface
        body = self._body(node, proto)
        if body is None:
            return
        node.body = body
        self._expand(body, Scope.of_proto(proto) if proto.source else scope, slot, nested + 1)

    def _proto(self, node: Node, scope: Scope, slot: str) -> Proto | None:
        """Return the definition of a node; a finding names one that is missing."""
        proto = scope.protos.get(node.type) or self._find(node.type, scope.externs.get(node.type), scope)
        if proto is not None:
            return proto
        if slot.lower().endswith("appearance"):
            self.findings.warning(
                node.span, f"the appearance {node.type} is not available", "a plain one takes its place"
            )
            node.type = "PBRAppearance"
            node.fields.clear()
        elif node.type in scope.externs:
            self.findings.error(
                node.span,
                f"PROTO {node.type} is not available",
                f"name a copy of Webots, or a folder with {node.type}.proto, by --protos DIR; deepbots reads"
                " nothing from the network",
            )
            _empty(node)
        return None

    def _find(self, name: str, extern: Extern | None, scope: Scope) -> Proto | None:
        key = extern.address if extern else name
        if key not in self._read:
            self._read[key] = None  # until it is read, so that a file that names itself ends
            self._read[key] = self._load(name, extern, scope)
        return self._read[key]

    def _load(self, name: str, extern: Extern | None, scope: Scope) -> Proto | None:
        path = self.files.proto(name, extern.address if extern else "", scope.source.name)
        entry = library.LIBRARY.get(name)
        if entry is not None and (path is None or not self.files.is_own(path)):
            return library.definition(name, entry)
        if path is None:
            return None
        source = self.files.read(path)
        document = parse(source, is_proto=True)
        proto = document.protos.get(name)
        if proto is None:
            first_proto = next(iter(document.protos.values()))
            self.findings.error(first_proto.span, f"PROTO {first_proto.name} in a file for {name}")
        return proto

    def _check_fields(self, node: Node, proto: Proto) -> None:
        for name, value in list(node.fields.items()):  # a copy: fields are deleted on the way
            entry = proto.interface.get(name)
            if entry is None:
                near = nearest_word(name, proto.interface)
                hint = f"did you mean '{near}'?" if near else "it is ignored"
                if not name.rpartition("_")[2].isdigit():  # hidden fields of the saved state of a joint
                    self.findings.warning(value.span, f"{node.type} has no field '{name[:60]}'", hint)
                del node.fields[name]
            elif value.alias == "" and (problem := type_problem(entry.type, value)):
                self.findings.error(value.span, f"{node.type}.{name} is {problem}")
                del node.fields[name]

    def _body(self, node: Node, proto: Proto) -> Node | None:
        if isinstance(proto, library.LibraryProto):
            text = proto.build(node)
            source = Source(f"{proto.name}.proto", f"{_HEADER}PROTO {proto.name} [ ] {{ {text} }}")
            root = parse(source, is_proto=True).protos[proto.name].body[0]
        elif proto.template:
            rendered = self._rendered(proto, node)
            if rendered is None:
                _empty(node)
                return None
            root = rendered
        else:
            root = proto.body[0]
        return self._clone(root, node, proto.interface, {})

    def _rendered(self, proto: Proto, node: Node) -> Node | None:
        """Return the body that a template makes; None with a finding if it makes none."""
        is_lua = "%<" not in proto.template
        if is_lua or self._templates is None:
            reason = "which deepbots cannot run" if is_lua else "which deepbots webots runs with --allow-code"
            self.findings.error(
                node.span,
                f"PROTO {proto.name} is a template of {'Lua' if is_lua else 'JavaScript'}, {reason}",
                "write it without a template; of Webots' library, deepbots has:"
                f" {', '.join(library.LIBRARY)}",
            )
            return None
        try:
            text = self._templates.render(proto, node)
        except TemplateError as error:
            self.findings.error(node.span, f"the template of PROTO {proto.name} {error}")
            return None
        source = Source(f"{proto.name}.proto", f"{_HEADER}PROTO {proto.name} [ ] {text}")
        body = parse(source, is_proto=True).protos[proto.name].body
        if body:
            return body[0]
        self.findings.error(node.span, f"the template of PROTO {proto.name} makes another template")
        return None

    def _clone(
        self, node: Node, instance: Node, interface: Mapping[str, Parameter], memo: dict[int, Node]
    ) -> Node:
        """Return a copy of a node of a body, with the values of the PROTO node where the body says IS."""
        # A node that the body repeats by USE stays a single node in the copy.
        if id(node) in memo:
            return memo[id(node)]
        copy = Node(node.type, node.span, node.name, is_internal=True)
        memo[id(node)] = copy
        self._count += 1
        if self._count > MAX_NODES:
            raise WorldSyntaxError(instance.span, f"the world has more than {MAX_NODES:,} nodes")
        for name, value in node.fields.items():
            if not value.alias:
                copy.fields[name] = self._clone_value(value, instance, interface, memo)
            elif value.alias not in interface:
                self.findings.error(value.span, f"the PROTO has no field '{value.alias[:60]}'")
            elif value.alias in instance.fields:
                copy.fields[name] = instance.fields[value.alias]
            else:
                copy.fields[name] = self._clone_value(interface[value.alias].default, instance, interface, {})
        return copy

    def _clone_value(
        self, value: Value, instance: Node, interface: Mapping[str, Parameter], memo: dict[int, Node]
    ) -> Value:
        items: list[Item] = [
            self._clone(item, instance, interface, memo) if isinstance(item, Node) else item
            for item in value.items
        ]
        return Value(value.span, items, value.in_brackets)


def _empty(node: Node) -> None:
    """Let an empty group take the place of a node that has a finding."""
    node.type, node.interface = "Group", {}
    node.fields.clear()
