"""The scan of a JSON record, which compares the text with the schema of its model before pydantic parses it.

A run may come from someone else. pydantic parses the whole text before it looks at a key, and keeps an error
of 0.9 kB for each value, or a copy of the whole object for each missing key: files of 2 MB took 0.4 to 2.6 GB.
The scan is linear, takes no memory, and ends at the first value that does not fit. Most of its time is that of
one expression per bracket in the keys that are skipped.
"""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from functools import cache
from typing import Any, NoReturn

from pydantic import BaseModel

from deepbots_cli.words import printable

SKIPPED = "skipped"
"""The key of a JSON schema with the keys of an object that a model does not read, or None for all further
keys; see `model_config`."""
MAX_NUMBER = 1e100
"""The limit of all numbers, whose squares are still finite. Integers without limits of their own are from 0 to
2**63."""
_MAX_DEPTH = 40
# Bytes in the tree and the model, measured: 48 for a value, 195 with its key, 124 to 220 for a list or an object.
# An evaluation takes 8 to 10 times its size, and a state 9 times.
_VALUE_COST, _GROUP_COST, _KEY_COST = 50, 200, 150
_MAX_COST_PER_BYTE = 16
_MIN_COST_LIMIT = 40_000_000

_SPACE = r"[ \t\r\n]*+"
_STRING = r'"(?:[^"\\]++|\\.)*+"'
_TOKEN = re.compile(
    rf"{_SPACE}(?:(?P<string>{_STRING})|(?P<number>-?[0-9]++(?:\.[0-9]++|(?=[eE]))(?:[eE][-+]?[0-9]++)?)"
    r"|(?P<integer>-?[0-9]++)|(?P<sign>[{}\[\],:]|true|false|null))",
    re.DOTALL,
)
_NEXT_BRACKET = re.compile(rf'(?:[^"{{}}\[\]]++|{_STRING})*+([{{}}\[\]])', re.DOTALL)
_ESCAPED = re.compile(r"\\(?:[^u]|u[0-9a-fA-F]{4}(?:\\u[0-9a-fA-F]{4})*)|[^\x00-\x7e]", re.DOTALL)
_WORDS = {"true": "boolean", "false": "boolean", "null": "null", "{": "object", "[": "array"}


class UnfitError(ValueError):
    """The text is not that of the model; the message has the field and the reason."""


Schema = dict[str, Any]
Choices = Mapping[str, list[Schema]]
"""The schemas of a value by the type of JSON, without references and unions; empty where all is allowed."""


@cache
def _schema(model: type[BaseModel]) -> tuple[Schema, dict[int, Choices]]:
    """Return the JSON schema of a model, and the choices of its parts, which are filled in later."""
    return model.model_json_schema(), {}


def fitting_text(content: bytes, model: type[BaseModel]) -> bytes:
    """Return the JSON object of a record with those keys alone that `model` reads. Its strings are lines:
    control characters and invisible ones become escapes that can be read.

    Raises:
        UnfitError: It is not JSON, has other keys or types, lacks a key, or has a number beyond the limits.
    """
    try:
        text = content.decode()
        if "\\" in text or "\x7f" in text or not text.isascii():
            text = _ESCAPED.sub(_with_visible_letters, text)
    except ValueError as error:  # not UTF-8, or no escape of JSON
        raise UnfitError("it is not valid JSON") from error
    scanner = _Scanner(text, *_schema(model))
    scanner.value(scanner.schema)
    if text[scanner.at :].strip(" \t\r\n"):
        scanner.refuse("it is not valid JSON")
    return f"{{{','.join(scanner.kept)}}}".encode()


def _with_visible_letters(match: re.Match[str]) -> str:
    raw = match[0]
    if raw in ('\\"', "\\\\", "\\/"):
        return raw
    letters = json.loads(f'"{raw}"')
    return raw if letters.isprintable() else printable(letters).replace("\\", "\\\\")


class _Scanner:
    """Reads a text from its start to its end."""

    def __init__(self, text: str, schema: Schema, choices: dict[int, Choices]) -> None:
        self.text = text
        self.schema = schema
        self.at = 0
        self.kept: list[str] = []
        self._cost = 0
        self._max_cost = max(_MIN_COST_LIMIT, _MAX_COST_PER_BYTE * len(text))
        self._path: list[str] = []
        self._choices = choices

    def refuse(self, reason: str) -> NoReturn:
        field = ".".join(self._path)
        raise UnfitError(f"'{field}': {reason}" if field else reason)

    def _next(self) -> tuple[str, str]:
        """Read the next token; return it with the type of JSON that begins with it, empty for a sign."""
        match = _TOKEN.match(self.text, self.at)
        if match is None:
            self._path = []
            self.refuse("it is not valid JSON")
        self.at = match.end()
        group = match.lastgroup or ""
        token = match[group]
        return token, _WORDS.get(token, "") if group == "sign" else group

    def _sign(self, *expected: str) -> str:
        token, _ = self._next()
        if token not in expected:
            self._path = []
            self.refuse("it is not valid JSON")
        return token

    def _pay(self, cost: int) -> None:
        self._cost += cost
        if self._cost > self._max_cost:
            self._path = []
            self.refuse("it has more values than deepbots writes")

    def _choices_of(self, schema: Schema) -> Choices:
        """Return the choices of a value."""
        waiting, plain = [schema], list[Schema]()
        while waiting:
            part = waiting.pop()
            if "$ref" in part:
                waiting.append(self.schema["$defs"][part["$ref"].rpartition("/")[2]])
            elif "anyOf" in part:
                waiting += part["anyOf"]
            else:
                plain.append(part)
        choices: dict[str, list[Schema]] = {}
        if all("type" in part for part in plain):
            for part in plain:
                choices.setdefault(part["type"], []).append(part)
            if "number" in choices:
                choices.setdefault("integer", []).extend(choices["number"])
        self._choices[id(schema)] = choices
        return choices

    def value(self, schema: Schema) -> None:
        """Read a value of a schema."""
        begin = self.at
        token, kind = self._next()
        choices = self._choices.get(id(schema))
        if choices is None:
            choices = self._choices_of(schema)
        if not choices:
            self.at = begin
            self._skip()
            return
        fitting = choices.get(kind)
        if fitting is None:
            self.refuse(f"Input should be a valid {' or '.join(choices)}" if kind else "it is not valid JSON")
        if kind == "object":
            self._object(fitting)
        elif kind == "array" and fitting[0].get("items") != {}:
            self._array(fitting[0])
        elif kind == "array":  # of values of any kind
            self.at = begin
            self._skip()
        else:
            self._cost += _VALUE_COST
            if kind in ("integer", "number") and not any(_has_number(choice, token) for choice in fitting):
                self.refuse(f"{token[:40]} is beyond the limits of this number")
            if kind == "string" and "enum" in fitting[0] and json.loads(token) not in fitting[0]["enum"]:
                self.refuse(f"Input should be {' or '.join(map(repr, fitting[0]['enum']))}")

    def _deeper(self, key: str) -> None:
        self._path.append(key[:40])
        if len(self._path) > _MAX_DEPTH:
            self._path = []
            self.refuse(f"its values are nested more than {_MAX_DEPTH} deep")

    def _object(self, schemas: list[dict[str, Any]]) -> None:
        self._pay(_GROUP_COST)
        properties = {key: value for schema in schemas for key, value in schema.get("properties", {}).items()}
        mapping = next((s["additionalProperties"] for s in schemas if s.get("additionalProperties")), None)
        skipped = schemas[0].get(SKIPPED, ())
        read: set[str] = set()
        begin = self.at
        is_empty = self._next()[0] == "}"
        self.at = self.at if is_empty else begin
        while not is_empty:
            begin = self.at
            key, kind = self._next()
            if kind != "string":
                self._path = []
                self.refuse("it is not valid JSON")
            key = key[1:-1]
            self._sign(":")
            self._pay(_KEY_COST)
            self._deeper(key)
            if key in properties:
                if key in read:
                    self.refuse("it is there twice")
                read.add(key)
                self.value(properties[key])
            elif mapping is not None:
                self.value(mapping if isinstance(mapping, dict) else {})
            elif skipped is None or key in skipped:
                self._skip()
            else:
                self.refuse("deepbots writes no such key here")
            self._path.pop()
            if not self._path and key in properties:
                self.kept.append(self.text[begin : self.at])
            if self._sign(",", "}") == "}":
                break
        missing = [key for key in schemas[0].get("required", ()) if key not in read]
        if missing and len(schemas) == 1:
            self._path.append(missing[0])
            self.refuse("Field required")

    def _array(self, schema: Schema) -> None:
        parts = schema.get("prefixItems", ())
        items = schema.get("items", {})
        limit = schema.get("maxItems", len(self.text))
        count = 0
        begin = self.at
        is_ended = self._next()[0] == "]"
        self.at = self.at if is_ended else begin
        self._pay(_GROUP_COST)
        self._deeper("")
        while not is_ended:
            self._path[-1] = str(count)
            self.value(parts[count] if count < len(parts) else items)
            count += 1
            if count > limit:
                self.refuse("there are more of them than deepbots writes")
            is_ended = self._sign(",", "]") == "]"
        self._path.pop()
        if count < schema.get("minItems", 0):
            self.refuse(f"there are only {count} of them")

    def _skip(self) -> None:
        """Read a value of any kind."""
        kind = self._next()[1]
        if not kind:
            self._path = []
            self.refuse("it is not valid JSON")
        depth = int(kind in ("object", "array"))
        self._pay(_GROUP_COST if depth else _VALUE_COST)
        while depth:
            begin = self.at
            match = _NEXT_BRACKET.match(self.text, begin)
            if match is None:
                self._path = []
                self.refuse("it is not valid JSON")
            self.at = match.end()
            is_begin = match[1] in "[{"
            depth += 1 if is_begin else -1
            self._pay(_GROUP_COST * is_begin + _VALUE_COST * self.text.count(",", begin, self.at))


def _has_number(schema: Schema, token: str) -> bool:
    """Return whether a number is within the limits of a schema."""
    is_whole = schema["type"] == "integer"
    number = int(token) if is_whole and len(token) < 60 else float(token)
    has_limits = not is_whole or "maximum" in schema or "exclusiveMaximum" in schema
    limit = MAX_NUMBER if has_limits else 2**63
    return (
        abs(number) < limit
        and number >= schema.get("minimum", 0 if is_whole else -limit)
        and number <= schema.get("maximum", limit)
        and number > schema.get("exclusiveMinimum", -limit)
        and number < schema.get("exclusiveMaximum", limit)
    )
