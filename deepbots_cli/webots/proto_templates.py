"""PROTOs whose bodies are templates of JavaScript: `%< statement >%` and `%<= expression >%`.

V8 (the package `mini-racer`) runs a template without files, network and other programs, for a limited time
and with limited memory. The modules that it imports, such as `wbrandom.js`, are those of a copy of Webots.
"""

from __future__ import annotations

import json
import re
import time
from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Any

from deepbots_cli.errors import DeepbotsError
from deepbots_cli.webots.nodes import parameters, value_of
from deepbots_cli.webots.syntax import MAX_BYTES, Node

if TYPE_CHECKING:
    from deepbots_cli.webots.project import Files
    from deepbots_cli.webots.syntax import Item, Parameter, Proto, Value

MAX_SECONDS = 30.0
"""The time in which V8 runs the templates of a world."""
MAX_MEMORY = 256 * 2**20
MAX_MODULES = 20
MAX_DEPTH = 20
"""The memory of one template, its modules, and the depth of the nodes in its fields."""
_STATEMENT = re.compile(r"%<(=?)(.*?)>%", re.DOTALL)
_COMMENT = re.compile(r"^[ \t]*#.*$", re.MULTILINE)
_IMPORT = re.compile(
    r"""^[ \t]*import\s+(\*\s+as\s+(\w+)|\{[\w\s,]*\})\s+from\s+['"]([\w-]+\.js)['"][ \t]*;?""", re.MULTILINE
)
_EXPORT = re.compile(r"^[ \t]*export\s+(?=(?:function|class|const|let)\s+(\w+))", re.MULTILINE)
_KEYS = {"Vec2f": "xy", "Vec3f": "xyz", "Rotation": "xyza", "Color": "rgb"}
_SCRIPT = """'use strict';
// V8 limits the memory of its heap, which buffers, WebAssembly, Intl and Temporal do not use.
for (const name of Object.getOwnPropertyNames(globalThis)) {{
  if (/.Array$|Buffer$|^(Atomics|DataView|Intl|Temporal|WebAssembly)$/.test(name)) delete globalThis[name];
}}
(() => {{
const nothing = () => {{}};
const console = {{log: nothing, warn: nothing, debug: nothing, error: nothing}};
const read = text => JSON.parse(text, (key, value) => value === null ? undefined : value);
let text;
try {{
  // The body of a function cannot end this script early.
  text = new Function('fields', 'context', 'console', {body})(read({fields}), read({context}), console);
}} catch (error) {{
  try {{ text = `${{error}}`; }} catch {{ text = 'its error has no text'; }}
  return '!fails: ' + (text.length > {limit} ? 'its error has a long text' : text);
}}
if (typeof text !== 'string') return '!returns before its end';
return text.length > {limit} ? '!makes more than {limit_text}' : '=' + text;
}})()"""


class TemplateError(DeepbotsError):
    """A template cannot be run, or fails; the message says why."""


class Templates:
    """Runs the templates of one world."""

    def __init__(self, files: Files) -> None:
        self._files = files
        self._end: float | None = None

    def render(self, proto: Proto, node: Node) -> str:
        """Return the body of a PROTO for a node.

        Raises:
            TemplateError: V8 is not installed, a module is missing, or the template fails.
        """
        try:
            from py_mini_racer import JSEvalException, JSTimeoutException, MiniRacer
        except ModuleNotFoundError as error:
            raise TemplateError(
                "needs the package mini-racer: pip install 'deepbots-cli[webots-js]'"
            ) from error
        if self._end is None:
            self._end = time.monotonic() + MAX_SECONDS
        left = self._end - time.monotonic()
        if left <= 0:
            raise TemplateError(f"is left out: the templates before it took {MAX_SECONDS:g} s")
        script = self._script(proto, node)
        try:
            with MiniRacer() as context:
                try:
                    rendered = context.eval(script, timeout_sec=left, max_memory=MAX_MEMORY)
                except JSTimeoutException:
                    # V8 reports the end of the stopped script after `eval` has raised. mini-racer 0.14 writes
                    # a traceback if the context was closed before (4 of 400 times). Another script runs
                    # after the report.
                    context.eval("0")
                    raise
        except JSEvalException as error:
            raise TemplateError(_reason(f"fails: {error}")) from error
        if not isinstance(rendered, str) or rendered[:1] != "=":
            raise TemplateError(_reason(str(rendered)[1:]))
        return rendered[1:]

    def _script(self, proto: Proto, node: Node) -> str:
        modules: dict[str, str] = {}
        body = self._imported(_translated(proto.template), modules)
        context = {
            "world": "",
            "proto": proto.source.name if proto.source else "",
            "project_path": "",
            "webots_home": "",
            "temporary_files_path": "",
            "os": "linux",
            "id": "0",
            "coordinate_system": "ENU",
            "webots_version": {"major": "R2025a", "revision": "0"},
        }
        lines = ("'use strict';", *modules.values(), "let template_ = '';", body, "return template_;")
        return _SCRIPT.format(
            body=json.dumps("\n".join(lines)),
            fields=_literal(_fields(proto.interface, node, 0)),
            context=_literal(context),
            limit=MAX_BYTES,
            limit_text=f"{MAX_BYTES >> 20} MiB",
        )

    def _imported(self, text: str, modules: dict[str, str]) -> str:
        """Return a text with constants in place of its imports, whose modules are added before."""

        def constant(match: re.Match[str]) -> str:
            names, alias, file = match.groups()
            self._add_module(file, modules)
            return f"const {alias or names.replace(' as ', ': ')} = {_variable(file)};"

        return _IMPORT.sub(constant, text)

    def _add_module(self, file: str, modules: dict[str, str]) -> None:
        if file in modules:
            return
        path = self._files.module(file)
        if len(modules) >= MAX_MODULES:
            raise TemplateError(f"imports more than {MAX_MODULES} modules")
        if path is None:
            raise TemplateError(
                f"imports {file}, which is not available; name a copy of Webots by --protos DIR"
            )
        modules[file] = ""  # until it is read, so that modules that import each other end
        text = self._imported(self._files.read(path).text, modules)
        exported = ", ".join(_EXPORT.findall(text))
        del modules[file]  # it follows the modules that it imports
        modules[file] = (
            f"const {_variable(file)} = (() => {{ {_EXPORT.sub('', text)}\nreturn {{{exported}}}; }})();"
        )


def _variable(file: str) -> str:
    return f"module_{re.sub(r'[^a-zA-Z0-9]', '_', file)}"


def _translated(template: str) -> str:
    """Return the JavaScript that writes the text of a template."""
    return "\n".join(_parts(_COMMENT.sub("", template)))


def _parts(template: str) -> Iterator[str]:
    end = 0
    for match in _STATEMENT.finditer(template):
        yield f"template_ += {json.dumps(template[end : match.start()])};"
        is_expression, code = match.groups()
        # The line break ends a comment at the end of the expression.
        yield f"template_ += ({code.strip().rstrip(';')}\n);" if is_expression else code
        end = match.end()
    yield f"template_ += {json.dumps(template[end:])};"


def _literal(value: object) -> str:
    """Return a value as a literal of JavaScript: a text in JSON, written as a text."""
    return json.dumps(json.dumps(value))


def _plain(entry: Parameter, value: Value, depth: int) -> Any:
    """Return a value of a field as it is in templates."""
    base = entry.type[2:]
    items: list[Any] = [
        _node(item, depth + 1) if isinstance(item, Node) else _whole(item, base) for item in value.items
    ]
    if keys := _KEYS.get(base):
        size = len(keys)
        items = [
            dict(zip(keys, items[at : at + size], strict=True))
            for at in range(0, len(items) - size + 1, size)
        ]
    return items if entry.type.startswith("M") else next(iter(items), None)


def _whole(item: Item, base: str) -> Any:
    return int(item) if base == "Int32" and isinstance(item, float) else item


def _node(node: Node, depth: int) -> Any:
    if depth > MAX_DEPTH:
        raise TemplateError(f"has nodes in its fields that are deeper than {MAX_DEPTH}")
    return {"node_name": node.type, "fields": _fields(parameters(node), node, depth)}


def _fields(interface: Mapping[str, Parameter], node: Node, depth: int) -> dict[str, Any]:
    return {
        name: {
            "value": _plain(entry, value_of(node, name), depth),
            "defaultValue": _plain(entry, entry.default, depth),
        }
        for name, entry in interface.items()
    }


def _reason(message: str) -> str:
    """Return the first line of a message of a script, as printable text."""
    line = next(iter(message.strip().splitlines()), "")
    return "".join(letter if letter.isprintable() else "?" for letter in line)[:120]
