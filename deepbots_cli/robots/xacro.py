"""xacro to plain URDF: properties, arguments, conditions, macros and includes, without running any code.

A template element is expanded in a `Scope` of properties and macros into elements that keep the place of
their template, so that a finding about the robot names the line that its author wrote. `$(find X)/rest`
becomes `package://X/rest`, so included files, YAML files and meshes are looked up, and refused, in one place.

The order of evaluation is that of the package `xacro` of ROS: properties when they are first used, in the
scope that has them; parameters of macros and conditions at once; macros see the properties of their caller.
"""

from __future__ import annotations

import math
import re
from collections import ChainMap
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

from deepbots_cli.diagnostics import Findings, Label, Source
from deepbots_cli.files import read_at_most
from deepbots_cli.records import dataclass
from deepbots_cli.robots.elements import Element, known_names_help, parse, quoted
from deepbots_cli.robots.packages import ResolveMesh, UnusableMesh
from deepbots_cli.robots.xacro_expressions import WAY_OUT, Budget, Evaluator, Namespace, XacroError, size

MAX_ELEMENTS = 50_000
MAX_TEXT = 4_000_000  # characters of all attributes
MAX_READ = 8 << 20  # bytes of all included files
MAX_YAML_BYTES, MAX_YAML_SIZE = 128 << 10, 20_000
_MAX_LABELS = 3
_STEPS_OF_CALL = 5  # a call takes as long as so many elements
_MARKS = ("<xacro:", "${", "$(")
_NOT_XML = "[\x00-\x08\x0b\x0c\x0e-\x1f\ud800-\udfff\ufffe\uffff]"
_PIECE = (
    r"(?P<escaped>\$\$+[{(])|\$\{(?P<expression>[^}]*)\}|\$\((?P<command>[^)]*)\)"
    r"|(?P<open>\$[{(])|(?P<text>[^$]+|\$)"
)
# name, whether the property of the caller is the default, and another default; as in xacro, without its
# nested repetition, which takes exponential time
_PARAMETER = (
    r"\s*([^\s:=]+)"
    r"(?:\s*:?=\s*(\^\|?)?(\$\{[^}]*\}|\$\([^)]*\)|(?:'[^']*'|\"[^\"]*\"|[^\s'\"])*))?(?:\s+|$)"
)
_BOOLEANS = {"true": True, "True": True, "false": False, "False": False}
_YAML_UNITS = {
    "degrees": math.pi / 180,
    "foot": 0.3048,
    "inches": 0.0254,
    "meters": 1.0,
    "millimeters": 0.001,
    "radians": 1.0,
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
    """A property that was not used so far."""

    evaluate: Callable[[], Any] | None


@dataclass(frozen=True)
class _Macro:
    template: Element
    parameters: Mapping[str, tuple[str, str]]


class Scope(ChainMap[str, Any]):
    """Properties by name, blocks as `*name` (`**name` for their content alone), macros as `<name>`; what is
    missing is looked up in the scopes above. A namespace has the key `<>`."""

    def __getitem__(self, name: str) -> Any:
        value = super().__getitem__(name)
        if not isinstance(value, _Lazy):
            return value
        if value.evaluate is None:
            raise XacroError("the value of this property refers to itself")
        evaluate, value.evaluate = value.evaluate, None
        evaluated = evaluate()
        next(names for names in self.maps if name in names)[name] = evaluated
        return evaluated

    def __iter__(self) -> Iterator[str]:
        names = dict.fromkeys(name for level in self.maps[:-1] for name in level)
        return (name for name in names if name.isidentifier())

    def inner(self, **names: Any) -> Scope:
        return Scope(names, *self.maps)

    def macro(self, name: str) -> tuple[_Macro, Scope]:
        """Return a macro, and the scope above that of its body: the caller's, or its namespace.

        Raises:
            KeyError: There is none.
        """
        namespace, _, inner = name.partition(".")
        if not inner or not isinstance(self.get(namespace), Scope):
            return self[f"<{name}>"], self
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
    expander = _Expander(root, resolve, arguments, findings)
    try:
        return expander.expanded(root)
    except RecursionError:
        error = XacroError("macros, includes or expressions are nested too deep", code="DB005")
    except XacroError as caught:
        error = caught
        below = next(
            (child for child in root.children if child.attributes.get("name") == error.unknown), None
        )
        if below is not None and below.tag == "xacro:property":
            error.labels.append(Label(below.span, "defined here: move it above its first use"))
    if error.code:  # a fault in the XML of an included file is reported where it is
        span = error.span or root.span
        findings.add(error.code, span, error.headline, error.help, labels=tuple(error.labels))
    return None


def literal(value: Any) -> Any:
    """Return the number, truth value or text in quotes that a text is; else the text, as xacro does."""
    if not isinstance(value, str):
        return value
    if len(value) >= 2 and value[0] == value[-1] == "'":
        return value[1:-1]
    for convert in () if "_" in value else (int, float, _BOOLEANS.__getitem__):
        with suppress(ValueError, KeyError):
            return convert(value)
    return value


class _Expander:
    """Expands one robot file."""

    def __init__(
        self, root: Element, resolve: ResolveMesh, arguments: Mapping[str, str], findings: Findings
    ) -> None:
        self.report, self.findings = root.report, findings
        self.resolve, self.arguments = resolve, dict(arguments)
        self.declared: set[str] = set()
        self.included: dict[Source, Path] = {}
        self.templates: dict[Path, Element] = {}
        self.open: list[Path] = []  # the included files that are being read, innermost last
        self.missing: list[tuple[Element, str, XacroError]] = []  # includes of packages that are nowhere
        self.is_old = False  # has statements without `xacro:`
        self.budget = Budget()
        self.elements = self.characters = self.bytes = 0

    def expanded(self, template: Element) -> Expansion:
        names = {"load_yaml": self.load_yaml, "arg": self.argument, "dotify": dict}
        silent = dict.fromkeys(("message", "warning", "error"), lambda *_: "")
        scope = Scope({}, names | {"xacro": Namespace(names | silent)})
        root = Element(template.tag, {}, self.report, template.start)
        self.children(template, scope, root)
        root.attributes = self.plain_attributes(template, scope)
        for include, _, error in self.missing[:1]:  # of cameras, say, that this robot does not have
            note = f"the robot is read without {', '.join(reference for _, reference, _ in self.missing)}"
            include.warn(error.headline, attribute="filename", help=error.help, notes=(note,))
        return Expansion(root, frozenset(self.declared), self.included)

    # Texts

    def text(self, text: str, scope: Scope) -> Any:
        """Return the value of a text: that of its only expression, else a text."""
        values: list[Any] = []
        with self.budget:
            for piece in re.finditer(_PIECE, text):
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
        self.budget.weigh(*values)
        # `file://$(find X)/...` names the file of a package, too
        return self.budget.bounded("".join(map(str, values)).replace("file://package://", "package://"))

    def command(self, text: str) -> Any:
        """Return the value of `$(text)`."""
        word, *rest = text.split() or [""]
        match word, rest:
            case "eval", _:
                names = {name: literal(value) for name, value in self.arguments.items()}
                names |= _BOOLEANS | {"arg": self.argument}
                return Evaluator(names, self.budget).value(text.strip().removeprefix("eval"))
            case "find", [package]:
                return f"package://{package}"
            case "arg", [name]:
                return self.argument(name, str)
            case "optenv", [_, *default]:  # a robot must not depend on the computer
                return " ".join(default)
            case "dirname", []:
                return str(self.open[-1].parent) if self.open else "."
            case "env", _:
                help = "make the value an argument: <xacro:arg .../> and $(arg ...)"
                raise XacroError("deepbots reads no variables of the environment", help)
        raise XacroError(f"deepbots does not support $({text[:60]})", WAY_OUT)

    def argument(self, name: str, convert: Callable[[str], Any] = literal) -> Any:
        self.declared.add(name)
        if name in self.arguments:
            return convert(self.arguments[name])
        help = (
            f"write `xacro: {{{name}: VALUE}}` beside `urdf:` in the scenario, or add `--xacro-arg"
            f" {name}:=VALUE` to the command"
        )
        raise XacroError(f"the argument {quoted(name)} has no value", help)

    def attribute(self, template: Element, key: str, scope: Scope, default: str | None = None) -> Any:
        """Return the value of an attribute, which is required where there is no default."""
        text = template.attributes.get(key, default)
        if text is None:
            raise XacroError(f"<{template.tag}> without the attribute '{key}'")
        return self.placed(text, template, key, scope) if "$" in text else text

    def placed(self, text: str, template: Element, key: str, scope: Scope) -> Any:
        """Return the value of a text; its place is an attribute of `template`."""
        try:
            value = self.text(text, scope)
            if isinstance(value, str) and (character := re.search(_NOT_XML, value)):
                raise XacroError(f"the value has the character {character[0]!a}, which XML forbids")
            return value
        except XacroError as error:
            error.span = error.span or template.value_span(key)
            raise

    def condition(self, template: Element, key: str, scope: Scope, default: str | None = None) -> bool:
        value = self.attribute(template, key, scope, default)
        number = literal(value)
        if isinstance(value, str) and isinstance(number, str | float):
            raise _error(template, key, f"{quoted(value)} is neither true nor false")
        return bool(number)

    # Elements

    def children(self, template: Element, scope: Scope, into: Element) -> None:
        """Append to `into` what the elements in one of a file, or of an expanded block, stand for."""
        for child in template.children:
            try:
                with self.budget:
                    if (statement := self.statement(child)) is not None:
                        statement(self, child, scope, into)
                    elif child.tag.startswith("xacro:"):
                        self.call(child, child.tag.removeprefix("xacro:"), scope, into)
                    else:
                        self.plain(child, scope, into)
            except XacroError as error:
                error.span = error.span or child.span
                raise

    def statement(self, template: Element) -> Callable[[_Expander, Element, Scope, Element], None] | None:
        """Return the function for a statement of xacro; None for other elements."""
        name = template.tag
        if template.attributes.get(_OLD_STATEMENTS.get(name, "")):
            name = f"xacro:{name}"
            if not self.is_old:
                self.is_old = True
                template.warn(f"<{template.tag}> lacks its prefix", help=f"write <{name}>, as ROS needs it")
        if name in _UNSUPPORTED:
            raise XacroError(f"deepbots does not support <{name}>", WAY_OUT)
        statement, known = _STATEMENTS.get(name, (None, ""))
        for key in template.attributes if known else ():
            if ":" not in key and key not in known.split():
                template.warn(
                    f"<{name}> has no attribute {quoted(key)}, so deepbots ignores it, as ROS does",
                    attribute=key,
                    help=known_names_help(key, known.split(), "attributes"),
                    kind="attribute of a statement of xacro",
                )
        return statement

    def plain(self, template: Element, scope: Scope, into: Element) -> None:
        attributes, source = self.plain_attributes(template, scope), template.source or template.report.source
        element = Element(template.tag, attributes, self.report, template.start, source=source)
        into.children.append(element)
        self.children(template, scope, element)

    def plain_attributes(self, template: Element, scope: Scope) -> dict[str, str]:
        names = [key for key in template.attributes if ":" not in key]  # others are of other tools
        attributes = {key: str(self.attribute(template, key, scope)) for key in names}
        self.elements += 1
        self.characters += sum(map(len, attributes.values()))
        if self.elements > MAX_ELEMENTS or self.characters > MAX_TEXT:
            raise XacroError("the expanded robot is too large", code="DB005")
        return attributes

    def define_property(self, template: Element, scope: Scope, into: Element) -> None:
        name = str(self.attribute(template, "name", scope))
        if not name.isidentifier() or name.startswith("__"):
            raise _error(template, "name", f"{quoted(name)} is not a name for a property")
        if self.condition(template, "remove", scope, "false"):
            for names in scope.maps[:-1]:
                names.pop(name, None)
            return
        key = next((key for key in ("value", "default") if key in template.attributes), None)
        if key == "default" and name in scope:
            return
        where = template.attributes.get("scope")
        target = scope.maps[0] if where != "global" else scope.maps[-2]
        if where == "parent":
            above = scope.maps[1:-1]
            target = next((names for names in above if "<>" in scope.maps[0] or "<>" not in names), target)
        if key is None:
            target["**" + name] = template
            return
        lazy = where is None and self.condition(template, "lazy_eval", scope, "true")
        value = literal(template.attributes[key])
        if lazy and isinstance(value, str):
            target[name] = _Lazy(lambda: literal(self.placed(value, template, key, scope)))
        else:
            target[name] = value if lazy else literal(self.attribute(template, key, scope))

    def define_argument(self, template: Element, scope: Scope, into: Element) -> None:
        name = str(self.attribute(template, "name", scope))
        self.declared.add(name)
        if name not in self.arguments and "default" in template.attributes:
            self.arguments[name] = str(self.attribute(template, "default", scope))

    def define_macro(self, template: Element, scope: Scope, into: Element) -> None:
        name = str(self.attribute(template, "name", scope)).removeprefix("xacro:")
        parameters = re.findall(_PARAMETER, template.attributes.get("params", ""))
        macro = _Macro(template, {parameter: tuple(rest) for parameter, *rest in parameters})
        scope.maps[0][f"<{name}>"] = macro

    def call_by_name(self, template: Element, scope: Scope, into: Element) -> None:
        self.call(template, str(self.attribute(template, "macro", scope)), scope, into)

    def call(self, template: Element, name: str, scope: Scope, into: Element) -> None:
        """Expand a macro."""
        self.budget.spend(_STEPS_OF_CALL)
        try:
            macro, above = scope.macro(name)
        except KeyError:
            self.ignore_call(template, name, scope, into)
            return
        inner, waiting = above.inner(), dict(macro.parameters)
        for key in [key for key in template.attributes if (template.tag, key) != ("xacro:call", "macro")]:
            if waiting.pop(key, None) is None:
                help = known_names_help(key, macro.parameters, "parameters")
                raise _error(template, key, f"the macro {quoted(name)} has no parameter {quoted(key)}", help)
            inner[key] = literal(self.attribute(template, key, scope))
        holder = Element("", {}, self.report, template.start)
        self.children(template, scope, holder)
        blocks = [key for key in waiting if key.startswith("*")]
        if len(blocks) != len(holder.children):
            number = len(holder.children)
            raise XacroError(f"the macro {quoted(name)} takes {len(blocks)} elements, not {number}")
        inner |= dict(zip(blocks, holder.children, strict=True))
        try:
            for key, (forwards, default) in waiting.items():
                if forwards and key in scope:
                    inner[key] = literal(scope[key])
                elif default:
                    inner[key] = literal(self.text(default, scope))
                elif key not in blocks:
                    help = f'write <{template.tag} {key}="..."/>'
                    raise XacroError(f"the macro {quoted(name)} needs a value for {quoted(key)}", help)
            self.children(macro.template, inner, into)
        except XacroError as error:
            if error.span is not None and len(error.labels) < _MAX_LABELS:
                error.labels.append(Label(template.span, "expanded from here"))
            raise

    def ignore_call(self, template: Element, name: str, scope: Scope, into: Element) -> None:
        """Report a macro that is not defined: as a warning where it is a color that remains in a file that
        was expanded. A robot that lacks links is another robot."""
        names = [key[1:-1] for level in scope.maps for key in level if isinstance(level[key], _Macro)]
        if into.tag == "visual" and not (names or template.attributes):
            template.warn(
                f"deepbots ignores the macro {quoted(name)}, because the file defines none",
                kind="macro that is not defined",
            )
        elif self.missing:
            *_, error = self.missing[0]
            error.labels.append(Label(template.span, f"there is no macro {quoted(name)}"))
            raise error
        else:
            raise XacroError(f"there is no macro {quoted(name)}", known_names_help(name, names, "macros"))

    def insert_block(self, template: Element, scope: Scope, into: Element) -> None:
        name = str(self.attribute(template, "name", scope))
        key = next((key for key in ("**" + name, "*" + name) if key in scope), None)
        if key is None:
            raise _error(template, "name", f"there is no block {quoted(name)}")
        block = scope[key]
        holder = block if key.startswith("**") else Element("", {}, self.report, 0, [block])
        self.children(holder, scope, into)

    def choose(self, template: Element, scope: Scope, into: Element) -> None:
        if self.condition(template, "value", scope) == template.tag.endswith("if"):
            self.children(template, scope, into)

    # Files

    def include(self, template: Element, scope: Scope, into: Element) -> None:
        reference = str(self.attribute(template, "filename", scope))
        is_optional = self.condition(template, "optional", scope, "false")
        try:
            path = self.file(reference)
        except XacroError as error:
            if not is_optional:
                error.span = template.value_span("filename")
                if not error.lacks_package:
                    raise
                self.missing.append((template, reference, error))
                return
            template.warn(f"the optional file {quoted(reference)} is not included")
            return
        if path in self.open:
            raise _error(template, "filename", f"{quoted(reference)} includes itself")
        if path not in self.templates:
            root = parse(self.read(path, MAX_READ // 2), self.findings)
            if root is None:
                raise XacroError("", code="")
            self.templates[path] = root
        inner = scope
        if "ns" in template.attributes:
            inner = scope[str(self.attribute(template, "ns", scope))] = scope.inner(**{"<>": None})
        self.open.append(path)
        self.children(self.templates[path], inner, into)
        self.open.pop()

    def file(self, reference: str) -> Path:
        """Return the path of a file that may be read, as the file names it that is being expanded.

        Raises:
            XacroError: It may not be read, or does not exist.
        """
        if "://" not in reference and self.open:
            reference = str(self.open[-1].parent / reference)
        help: str | None = "check the path"
        lacks_package = False
        with suppress(OSError, ValueError):  # ValueError: a null character
            located = self.resolve(reference)
            if isinstance(located, Path) and located.is_file():
                return located
            if isinstance(located, UnusableMesh):
                help, lacks_package = located.help, located.lacks_package
        headline = f"the file {quoted(reference)} cannot be read"
        raise XacroError(headline, help, lacks_package=lacks_package)

    def read(self, path: Path, limit: int) -> Source:
        """Return the text of a file that may be read.

        Raises:
            XacroError: The files are too large, or the system refuses to read it.
        """
        try:
            data = read_at_most(path, limit + 1)
        except OSError as error:
            raise XacroError(f"the file {quoted(str(path))} cannot be read") from error
        self.bytes += len(data)
        if len(data) > limit or self.bytes > MAX_READ:
            raise XacroError("the included files are too large", code="DB005")
        name = path.relative_to(Path.cwd()) if path.is_relative_to(Path.cwd()) else path
        source = Source(str(name), data.decode("utf-8", errors="replace").removeprefix("\ufeff"))
        self.included[source] = path
        return source

    def load_yaml(self, name: str) -> Any:
        """Return the content of a YAML file, without aliases: copies of copies fill a memory."""
        import yaml

        text = self.read(self.file(str(name)), MAX_YAML_BYTES).text
        try:
            if any(isinstance(event, yaml.AliasEvent) for event in yaml.parse(text, _yaml_loader())):
                raise XacroError(f"the YAML file {quoted(name)} has an alias (*NAME)", "write its value out")
            content = yaml.load(text, _yaml_loader())  # a safe loader
        except (yaml.YAMLError, ValueError, RecursionError) as error:
            raise XacroError(f"the YAML file {quoted(name)} cannot be read: {str(error)[:100]}") from error
        if size(content, MAX_YAML_SIZE) > MAX_YAML_SIZE:
            raise XacroError(f"the YAML file {quoted(name)} is too large", code="DB005")
        return content


_STATEMENTS: dict[str, tuple[Callable[[_Expander, Element, Scope, Element], None], str]] = {
    "xacro:property": (_Expander.define_property, "name value default remove scope lazy_eval"),
    "xacro:arg": (_Expander.define_argument, "name default"),
    "xacro:macro": (_Expander.define_macro, "name params"),
    "xacro:include": (_Expander.include, "filename ns optional"),
    "xacro:insert_block": (_Expander.insert_block, "name"),
    "xacro:if": (_Expander.choose, "value"),
    "xacro:unless": (_Expander.choose, "value"),
    "xacro:call": (_Expander.call_by_name, ""),
}
"""The function and the attributes of each statement; a call has those of its macro."""
_UNSUPPORTED = ("xacro:attribute", "xacro:element")


_OLD_STATEMENTS = {
    "property": "name",
    "macro": "name",
    "insert_block": "name",
    "include": "filename",
    "if": "value",
    "unless": "value",
}
"""The statements that files before ROS Noetic write without `xacro:`, with the attribute that tells them from
elements of other tools."""


def _error(template: Element, key: str, headline: str, help: str | None = None) -> XacroError:
    """Return an error whose place is the value of an attribute."""
    error = XacroError(headline, help)
    error.span = template.value_span(key)
    return error


def _yaml_loader() -> Any:
    """Return a safe loader that knows the units of xacro, such as `!degrees 90`."""
    import yaml

    def convert(loader: Any, unit: str, node: Any) -> float:
        return float(Evaluator({}, Budget()).value(str(loader.construct_scalar(node)))) * _YAML_UNITS[unit]

    loader: Any = type("Loader", (getattr(yaml, "CSafeLoader", yaml.SafeLoader),), {})
    loader.add_multi_constructor("!", convert)
    return loader
