"""xacro to plain URDF: properties, arguments, conditions, macros and includes, without running any code.

A template element is expanded in a `Scope` of properties and macros into elements that keep the place of their
template, so that a finding about the robot names the line that its author wrote. `$(find X)/rest` becomes
`package://X/rest`, so included files, YAML files and meshes are looked up, and refused, in one place.

The order of evaluation is that of the package `xacro` of ROS: properties when they are first used, in the scope
that has them; parameters of macros and conditions at once; macros see the properties of their caller.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from xml.sax.saxutils import quoteattr

from deepbots_cli.diagnostics import Findings, Label, Source
from deepbots_cli.files import read_at_most
from deepbots_cli.robots.elements import Element, known_names_help, parse, quoted
from deepbots_cli.robots.meshes import MeshAboveRobot, ResolveMesh, UnusableMesh
from deepbots_cli.robots.xacro_expressions import WAY_OUT, Budget, Evaluator, Namespace, XacroError, size

MAX_ELEMENTS = 50_000
MAX_TEXT = 4_000_000  # characters of all attributes
MAX_READ = 8 << 20  # bytes of all included files
MAX_YAML_BYTES, MAX_YAML_SIZE = 128 << 10, 20_000
_PREFIX = "xacro:"
_MAX_LABELS = 3
_STEPS_OF_CALL = 5  # a call takes as long as so many elements
_MARKS = ("<xacro:", "${", "$(")
_KEPT = ("link", "joint", "material")
_NOT_XML = re.compile("[\x00-\x08\x0b\x0c\x0e-\x1f\ud800-\udfff\ufffe\uffff]")
_XML_NAME = re.compile(r"[A-Za-z_][\w.:-]*")
_PIECE = re.compile(
    r"(?P<escaped>\$\$+[{(])|\$\{(?P<expression>[^}]*)\}|\$\((?P<command>[^)]*)\)|(?P<open>\$[{(])|(?P<text>[^$]+|\$)"
)
# `default_value` of xacro, without its nested repetition
_PARAMETER = re.compile(
    r"\s*([^\s:=]+)\s*:?=\s*(\^\|?)?(\$\{[^}]*\}|\$\([^)]*\)|(?:'[^']*'|\"[^\"]*\"|[^\s'\"])*)(?:\s+|$)"
)
_WORD = re.compile(r"\s*(\S+)\s*")
_BOOLEANS = {"true": True, "True": True, "false": False, "False": False}
# xacro's, of values in YAML files
_UNITS = {
    "radians": 1.0,
    "degrees": math.pi / 180,
    "meters": 1.0,
    "millimeters": 0.001,
    "foot": 0.3048,
    "inches": 0.0254,
}


@dataclass(frozen=True)
class Expansion:
    """An expanded robot: `arguments` has the names that the file declares or uses, and `included` the path of
    each further file that was read."""

    root: Element
    arguments: frozenset[str]
    included: Mapping[Source, Path]


@dataclass
class _Lazy:
    """The text of a property that was not used so far; `template` is where it is defined."""

    text: str
    template: Element
    key: str
    is_open: bool = False


@dataclass(frozen=True)
class _Macro:
    """A macro; `parameters` maps each name to whether the property of the caller is its default, and another
    default."""

    template: Element
    parameters: Mapping[str, tuple[bool, str | None]]


class Scope(Mapping[str, Any]):
    """Properties, blocks (`*name`, or `**name` for their content alone) and macros; what is missing is looked
    up in the scope above."""

    def __init__(
        self,
        evaluate: Callable[[_Lazy, Scope], Any],
        above: Scope | None = None,
        *,
        is_namespace: bool = False,
    ) -> None:
        self.above, self.is_namespace = above, is_namespace
        self.properties: dict[str, Any] = {}
        self.macros: dict[str, _Macro] = {}
        self._evaluate = evaluate

    @property
    def chain(self) -> Iterator[Scope]:
        scope: Scope | None = self
        while scope is not None:
            yield scope
            scope = scope.above

    def __contains__(self, name: object) -> bool:
        return any(name in scope.properties for scope in self.chain)

    def __getitem__(self, name: str) -> Any:
        for scope in self.chain:
            if name in scope.properties:
                value = scope.properties[name]
                if isinstance(value, _Lazy):
                    value = scope.properties[name] = scope._evaluate(value, scope)
                return value
        raise KeyError(name)

    def __iter__(self) -> Iterator[str]:
        names = {name: None for scope in self.chain if scope.above is not None for name in scope.properties}
        return (name for name in names if not name.startswith("*"))

    def __len__(self) -> int:
        return sum(1 for _ in self)

    def macro(self, name: str) -> tuple[_Macro, Scope]:
        """Return a macro, and the scope above that of its body: the caller's, or its namespace.

        Raises:
            KeyError: There is none.
        """
        for scope in self.chain:
            if name in scope.macros:
                return scope.macros[name], self
        namespace, _, inner = name.partition(".")
        if not inner or not isinstance(self[namespace], Scope):
            raise KeyError(name)
        return self[namespace].macro(inner)  # type: ignore[no-any-return]


def is_xacro(text: str) -> bool:
    """Return whether the text of a robot file has something to expand."""
    return any(mark in text for mark in _MARKS)


def expand(
    root: Element, resolve: ResolveMesh, arguments: Mapping[str, str], findings: Findings
) -> Expansion | None:
    """Return the robot below `root` as plain URDF, or None with one finding at the place of the cause.

    Args:
        resolve: From the name of a file, relative to that of the robot, to the path that may be read.
        arguments: The values for `$(arg NAME)`.
    """
    expander = _Expander(root, resolve, dict(arguments), findings)
    try:
        return expander.expanded(root)
    except RecursionError:
        error = XacroError("macros, includes or expressions are nested too deep", code="DB005")
    except XacroError as caught:
        error = caught
    if error.code:  # a fault in the XML of an included file is reported where it is
        findings.add(
            error.code, error.span or root.span, error.headline, error.help, labels=tuple(error.labels)
        )
    return None


def literal(value: Any) -> Any:
    """Return the number, truth value or text in quotes that a text is; else the text, as xacro does."""
    if not isinstance(value, str):
        return value
    if len(value) >= 2 and value[0] == value[-1] == "'":
        return value[1:-1]
    if "_" in value:
        return value
    for convert in (int, float, _BOOLEANS.__getitem__):
        try:
            return convert(value)
        except (ValueError, KeyError):
            continue
    return value


class _Expander:
    """Expands one robot file."""

    def __init__(
        self, root: Element, resolve: ResolveMesh, arguments: dict[str, str], findings: Findings
    ) -> None:
        self.report, self.findings = root.report, findings
        self.resolve, self.arguments = resolve, arguments
        self.declared: set[str] = set()
        self.included: dict[Source, Path] = {}
        self.templates: dict[Path, Element] = {}
        self.open: list[Path] = []  # the included files that are being read, innermost last
        self.budget = Budget()
        self.elements = self.characters = self.bytes = 0
        own: dict[str, Any] = {"load_yaml": self.load_yaml, "arg": self.argument, "dotify": dict}
        self.top = Scope(self._property)
        self.top.properties = own | {
            "xacro": Namespace(own, **dict.fromkeys(("message", "warning", "error"), _silent))
        }

    def expanded(self, template: Element) -> Expansion:
        root = Element(template.tag, {}, self.report, template.start)
        scope = Scope(self._property, self.top)
        self.children(template, scope, root)
        root.attributes |= self.plain_attributes(template, scope)
        return Expansion(root, frozenset(self.declared), self.included)

    # Texts

    def text(self, text: str, scope: Scope) -> Any:
        """Return the value of a text: that of its only expression, else a text."""
        values: list[Any] = []
        with self.budget:
            for piece in _PIECE.finditer(text) if "$" in text else ():
                if piece["expression"] is not None:
                    expression = str(self.text(piece["expression"], scope))
                    values.append(Evaluator(scope, self.budget).value(expression))
                elif piece["command"] is not None:
                    values.append(self.command(str(self.text(piece["command"], scope))))
                elif piece["open"]:
                    raise XacroError(f"{quoted(text)} has {piece['open']} without an end")
                else:
                    values.append(piece["escaped"][1:] if piece["escaped"] else piece["text"])
        if len(values) == 1:
            return values[0]
        if not values:
            return text
        self.budget.weigh(*values)
        # `file://$(find X)/...` names the file of a package, too
        return self.budget.bounded("".join(map(str, values)).replace("file://package://", "package://"))

    def command(self, text: str) -> Any:
        """Return the value of `$(text)`."""
        word, *rest = text.split() or [""]
        if word == "eval":
            names = {name: literal(value) for name, value in self.arguments.items()}
            return Evaluator(_BOOLEANS | names | {"arg": self.argument}, self.budget).value(text.strip()[4:])
        if word == "find" and len(rest) == 1:
            return f"package://{rest[0]}"
        if word == "arg" and len(rest) == 1:
            return self.argument(rest[0], convert=str)
        if word == "optenv" and rest:  # a robot must not depend on the computer
            return " ".join(rest[1:])
        if word == "dirname":
            return str(self.open[-1].parent) if self.open else "."
        if word == "env":
            help = "write the value into the file, or make it an argument: <xacro:arg .../> and $(arg ...)"
            raise XacroError("deepbots reads no variables of the environment", help)
        raise XacroError(f"deepbots does not support $({text[:60]})", WAY_OUT)

    def argument(self, name: str, convert: Callable[[str], Any] = literal) -> Any:
        self.declared.add(name)
        if name not in self.arguments:
            help = (
                f"write `xacro: {{{name}: VALUE}}` beside `urdf:` in the scenario, or add `--xacro-arg"
                f" {name}:=VALUE` to the command"
            )
            raise XacroError(f"the argument {quoted(name)} has no value", help)
        return convert(self.arguments[name])

    def attribute(self, template: Element, key: str, scope: Scope, default: str | None = None) -> Any:
        """Return the value of an attribute, which is required where there is no default."""
        text = template.attributes.get(key, default)
        try:
            if text is None:
                raise XacroError(f"<{template.tag}> without the attribute '{key}'")
            value = self.text(text, scope)
            if isinstance(value, str) and (character := _NOT_XML.search(value)):
                raise XacroError(f"the value has the character {character[0]!a}, which XML forbids")
            return value
        except XacroError as error:
            error.span = error.span or template.value_span(key)
            raise

    def condition(self, template: Element, key: str, scope: Scope, default: str | None = None) -> bool:
        value = self.attribute(template, key, scope, default)
        if not isinstance(value, str):
            return bool(value)
        number = literal(value)
        if isinstance(number, str | float):
            raise _at(template, key, f"{quoted(value)} is neither true nor false")
        return bool(number)

    def _property(self, lazy: _Lazy, scope: Scope) -> Any:
        """Return the value of a property at its first use."""
        try:
            if lazy.is_open:
                raise XacroError("the value of this property refers to itself")
            lazy.is_open = True
            return literal(self.text(lazy.text, scope))
        except XacroError as error:
            error.span = error.span or lazy.template.value_span(lazy.key)
            raise
        finally:
            lazy.is_open = False

    # Elements

    def children(self, template: Element, scope: Scope, into: Element) -> None:
        for child in template.children:
            self.element(child, scope, into)

    def element(self, template: Element, scope: Scope, into: Element) -> None:
        """Append to `into` what an element of a file, or of an expanded block, stands for."""
        with self.budget:
            if not template.tag.startswith(_PREFIX):
                self.plain(template, template.tag, scope, into)
            elif template.tag in _STATEMENTS:
                _STATEMENTS[template.tag](self, template, scope, into)
            else:
                self.call(template, template.tag.removeprefix(_PREFIX), scope, into)

    def plain(self, template: Element, tag: str, scope: Scope, into: Element) -> None:
        self.elements += 1
        if self.elements > MAX_ELEMENTS:
            help = "does a macro call itself without an end?"
            raise XacroError(f"the expanded robot has more than {MAX_ELEMENTS} elements", help, "DB005")
        attributes = self.plain_attributes(template, scope)
        element = Element(tag, attributes, self.report, template.start, source=_source(template))
        into.children.append(element)
        self.children(template, scope, element)

    def plain_attributes(self, template: Element, scope: Scope) -> dict[str, str]:
        attributes = {
            key: str(self.attribute(template, key, scope)) for key in template.attributes if ":" not in key
        }
        self.characters += sum(map(len, attributes.values()))
        if self.characters > MAX_TEXT:
            raise XacroError(f"the expanded robot has more than {MAX_TEXT} characters", code="DB005")
        return attributes

    def define_property(self, template: Element, scope: Scope, into: Element) -> None:
        name = str(self.attribute(template, "name", scope))
        if not name.isidentifier() or name.startswith("__"):
            raise _at(template, "name", f"{quoted(name)} is not a name for a property")
        key = "value" if "value" in template.attributes else "default"
        if key == "default" and key in template.attributes and name in scope:
            return
        target, written = scope, template.attributes.get("scope")
        if written == "global":
            *_, target, _ = scope.chain
        elif written == "parent":
            above = [other for other in scope.chain if other is not self.top][1:]
            target = next((other for other in above if scope.is_namespace or not other.is_namespace), scope)
        if key not in template.attributes:
            target.properties["**" + name] = template
        elif written in ("global", "parent") or not self.condition(template, "lazy_eval", scope, "true"):
            target.properties[name] = literal(self.attribute(template, key, scope))
        else:
            value = literal(template.attributes[key])
            target.properties[name] = _Lazy(value, template, key) if isinstance(value, str) else value

    def define_argument(self, template: Element, scope: Scope, into: Element) -> None:
        name = str(self.attribute(template, "name", scope))
        self.declared.add(name)
        if name not in self.arguments and "default" in template.attributes:
            self.arguments[name] = str(self.attribute(template, "default", scope))

    def define_macro(self, template: Element, scope: Scope, into: Element) -> None:
        name, text = str(self.attribute(template, "name", scope)), template.attributes.get("params", "")
        parameters: dict[str, tuple[bool, str | None]] = {}
        place = 0
        while match := _PARAMETER.match(text, place) or _WORD.match(text, place):
            _, forward, default = match.groups() if match.re is _PARAMETER else (None, None, None)
            parameters[match[1]] = (bool(forward), default or None)
            place = match.end()
        scope.macros[name.removeprefix(_PREFIX)] = _Macro(template, parameters)

    def call_by_name(self, template: Element, scope: Scope, into: Element) -> None:
        self.call(template, str(self.attribute(template, "macro", scope)), scope, into)

    def call(self, template: Element, name: str, scope: Scope, into: Element) -> None:
        """Expand a macro."""
        try:
            macro, above = scope.macro(name)
        except KeyError as error:
            names = {other: None for level in scope.chain for other in level.macros}
            raise _at(
                template, None, f"there is no macro {quoted(name)}", known_names_help(name, names, "macros")
            ) from error
        self.budget.spend(_STEPS_OF_CALL)
        inner = Scope(self._property, above)
        waiting = dict(macro.parameters)
        for key in template.attributes:
            if key == "macro" and template.tag == "xacro:call":
                continue
            if key not in waiting:
                help = known_names_help(key, macro.parameters, "parameters")
                raise _at(template, key, f"the macro {quoted(name)} has no parameter {quoted(key)}", help)
            del waiting[key]
            inner.properties[key] = literal(self.attribute(template, key, scope))
        holder = Element("", {}, self.report, template.start)
        self.children(template, scope, holder)
        blocks = [key for key in waiting if key.startswith("*")]
        if len(blocks) != len(holder.children):
            headline = f"the macro {quoted(name)} takes {len(blocks)} elements, not {len(holder.children)}"
            raise _at(template, None, headline)
        inner.properties |= dict(zip(blocks, holder.children, strict=True))
        for key, (forwards, default) in waiting.items():
            if key.startswith("*"):
                continue
            if forwards and key in scope:
                inner.properties[key] = literal(scope[key])
            elif default is not None:
                inner.properties[key] = literal(self._default(default, macro, scope))
            else:
                help = f'write <{template.tag} {key}="..."/>'
                raise _at(template, None, f"the macro {quoted(name)} needs a value for {quoted(key)}", help)
        try:
            self.children(macro.template, inner, into)
        except XacroError as error:
            if len(error.labels) < _MAX_LABELS:
                error.labels.append(Label(template.span, "expanded from here"))
            raise

    def _default(self, text: str, macro: _Macro, scope: Scope) -> Any:
        try:
            return self.text(text, scope)
        except XacroError as error:
            error.span = error.span or macro.template.value_span("params")
            raise

    def insert_block(self, template: Element, scope: Scope, into: Element) -> None:
        name = str(self.attribute(template, "name", scope))
        if "**" + name in scope:
            self.children(scope["**" + name], scope, into)
        elif "*" + name in scope:
            self.element(scope["*" + name], scope, into)
        else:
            raise _at(template, "name", f"there is no block {quoted(name)}")

    def choose(self, template: Element, scope: Scope, into: Element) -> None:
        if self.condition(template, "value", scope) == (template.tag == "xacro:if"):
            self.children(template, scope, into)

    def named_element(self, template: Element, scope: Scope, into: Element) -> None:
        tag = str(self.attribute(template, "xacro:name", scope))
        if not _XML_NAME.fullmatch(tag):
            raise _at(template, "xacro:name", f"{quoted(tag)} is not a name for an element")
        self.plain(template, tag, scope, into)

    def named_attribute(self, template: Element, scope: Scope, into: Element) -> None:
        name = str(self.attribute(template, "name", scope))
        if not _XML_NAME.fullmatch(name):
            raise _at(template, "name", f"{quoted(name)} is not a name for an attribute")
        into.attributes[name] = str(self.attribute(template, "value", scope))

    # Files

    def include(self, template: Element, scope: Scope, into: Element) -> None:
        reference = str(self.attribute(template, "filename", scope))
        try:
            path = self.file(reference)
            if path in self.open:
                raise XacroError(f"{quoted(reference)} includes itself")
        except XacroError as error:
            if self.condition(template, "optional", scope, "false"):
                template.warn(f"the optional file {quoted(reference)} is not included")
                return
            error.span = error.span or template.value_span("filename")
            raise
        inner = scope
        if "ns" in template.attributes:
            inner = Scope(self._property, scope, is_namespace=True)
            scope.properties[str(self.attribute(template, "ns", scope))] = inner
        self.open.append(path)
        self.children(self.template(path, template), inner, into)
        self.open.pop()

    def file(self, reference: str) -> Path:
        """Return the path of a file that may be read, as the file names it that is being expanded.

        Raises:
            XacroError: It may not be read, or does not exist.
        """
        if "://" not in reference and self.open:
            reference = str(self.open[-1].parent / reference)
        headline = f"the file {quoted(reference)} cannot be read"
        try:
            located = self.resolve(reference)
            path = located.path if isinstance(located, MeshAboveRobot) else located
            if isinstance(path, UnusableMesh):
                raise XacroError(headline, path.help)
            if not path.is_file():
                raise XacroError(headline, f"check the path: deepbots looked for {path}")
        except (OSError, ValueError) as error:  # ValueError: a null character
            raise XacroError(headline, "check the path") from error
        return path

    def read(self, path: Path, limit: int) -> str:
        try:
            data = read_at_most(path, limit + 1)
        except OSError as error:
            raise XacroError(f"the file {quoted(str(path))} cannot be read") from error
        self.bytes += len(data)
        if len(data) > limit or self.bytes > MAX_READ:
            raise XacroError("the included files are too large", code="DB005")
        return data.decode("utf-8", errors="replace").removeprefix("\ufeff")

    def template(self, path: Path, include: Element) -> Element:
        """Return the outermost element of an included file."""
        if path not in self.templates:
            name = str(path.relative_to(Path.cwd()) if path.is_relative_to(Path.cwd()) else path)
            source = Source(name, self.read(path, MAX_READ // 2), include.span)
            self.included[source] = path
            root = parse(source, self.findings)
            if root is None:
                raise XacroError("", code="")
            self.templates[path] = root
        return self.templates[path]

    def load_yaml(self, name: str) -> Any:
        """Return the content of a YAML file, without aliases: copies of copies fill a memory."""
        import yaml

        text = self.read(self.file(str(name)), MAX_YAML_BYTES)
        try:
            if any(isinstance(event, yaml.AliasEvent) for event in yaml.parse(text, _yaml_loader())):
                raise XacroError(f"the YAML file {quoted(name)} has an alias (*NAME)", "write its value out")
            content = yaml.load(text, _yaml_loader())  # a safe loader
        except (yaml.YAMLError, ValueError, RecursionError) as error:
            raise XacroError(f"the YAML file {quoted(name)} cannot be read: {str(error)[:100]}") from error
        if size(content, MAX_YAML_SIZE) > MAX_YAML_SIZE:
            raise XacroError(f"the YAML file {quoted(name)} is too large", code="DB005")
        return content


_STATEMENTS: dict[str, Callable[[_Expander, Element, Scope, Element], None]] = {
    "xacro:property": _Expander.define_property,
    "xacro:arg": _Expander.define_argument,
    "xacro:macro": _Expander.define_macro,
    "xacro:include": _Expander.include,
    "xacro:insert_block": _Expander.insert_block,
    "xacro:if": _Expander.choose,
    "xacro:unless": _Expander.choose,
    "xacro:element": _Expander.named_element,
    "xacro:attribute": _Expander.named_attribute,
    "xacro:call": _Expander.call_by_name,
}


def _source(template: Element) -> Source:
    return template.source or template.report.source


def _silent(*_: Any) -> str:
    return ""


def _at(template: Element, key: str | None, headline: str, help: str | None = None) -> XacroError:
    """Return the error with its place: the value of an attribute, or the start tag."""
    error = XacroError(headline, help)
    error.span = template.value_span(key)
    return error


def _yaml_loader() -> Any:
    """Return a safe loader that knows the units of xacro, such as `!degrees 90`."""
    import yaml

    class Loader(getattr(yaml, "CSafeLoader", yaml.SafeLoader)):  # type: ignore[misc]
        pass

    def convert(loader: Any, unit: str, node: Any) -> Any:
        value = Evaluator({}, Budget()).value(str(loader.construct_scalar(node)))
        return float(value) * _UNITS[unit] if unit in _UNITS else value

    Loader.add_multi_constructor("!", convert)
    return Loader


def plain_text(root: Element) -> tuple[str, dict[tuple[int, int], str]]:
    """Return links, joints and materials of a robot as URDF, and the name of each mesh file by its place."""
    pieces: list[str] = []
    meshes: dict[tuple[int, int], str] = {}
    length = 0

    def write(text: str) -> None:
        nonlocal length
        pieces.append(text)
        length += len(text)

    def write_element(element: Element, depth: int) -> None:
        write(f"{'  ' * depth}<{element.tag}")
        for key, value in element.attributes.items():
            written = quoteattr(value)
            if element.tag == "mesh" and key == "filename":
                start = length + len(key) + 3
                meshes[start, start + len(written) - 2] = value
            write(f" {key}={written}")
        children = [child for child in element.children if depth or child.tag in _KEPT]
        children = [child for child in children if ":" not in child.tag]  # of namespaces of other tools
        write(">\n" if children else "/>\n")
        for child in children:
            write_element(child, depth + 1)
        if children:
            write(f"{'  ' * depth}</{element.tag}>\n")

    write_element(root, 0)
    return "".join(pieces), meshes
