"""The base of the field types, and their errors."""

from __future__ import annotations

from typing import Any

from pydantic import GetCoreSchemaHandler, GetJsonSchemaHandler, ValidationError, ValidationInfo
from pydantic_core import CoreSchema, InitErrorDetails, PydanticCustomError, core_schema

from deepbots_cli.diagnostics.nearest import Replacement

Scalar = str | int | float
JsonSchema = dict[str, object]

_JSON_TYPES = {
    str: "string",
    int: "integer",
    float: "number",
    bool: "boolean",
    dict: "object",
    list: "array",
    tuple: "array",
}


# Errors


def error(
    code: str,
    headline: str,
    help: str | None = None,
    *,
    missing: tuple[str, ...] = (),
    replacement: Replacement | None = None,
    rival: str = "",
) -> PydanticCustomError:
    """Return an error with the parts of a finding: `missing` keys, a `replacement` of the whole value, and
    the `rival` key beside it that it cannot be combined with."""
    context = {
        "headline": headline,
        "help": help,
        "missing": missing,
        "replacement": replacement,
        "rival": rival,
    }
    return PydanticCustomError(code, "{headline}; {help}" if help else "{headline}", context)


def mismatch(
    expected: str, help: str | None = None, replacement: Replacement | None = None, *, value: object
) -> PydanticCustomError:
    """Return an error about a value of the wrong type; `validate` shows how it is written in the file."""
    headline = f"expected {expected}, found {str(value)[:60]!r}"
    problem = error("DB103", headline, help, replacement=replacement)
    problem.context["expected"] = expected  # type: ignore[index]
    return problem


def error_at(step: str | int, problem: PydanticCustomError) -> ValidationError:
    """Return the error with its path one step further down."""
    return ValidationError.from_exception_data("", [InitErrorDetails(type=problem, loc=(step,), input=None)])


def with_article(noun: str) -> str:
    return f"{'an' if noun[0] in 'aeiou' else 'a'} {noun}"


# Field types


class FieldType:
    """The type of a single value."""

    @property
    def noun(self) -> str:
        """The noun in findings, with its article."""
        return "a value"

    @property
    def example(self) -> str | None:
        """An example of a value."""
        return None

    @property
    def plural(self) -> str:
        """The noun for the items of a list."""
        noun, preposition, rest = self.noun.split(" ", 1)[1].partition(" with ")
        return f"{noun}s{preposition}{rest}"

    @property
    def accepted_types(self) -> tuple[type, ...]:
        """The types of a value of the right form."""
        return (str,)

    def has_form(self, value: object) -> bool:
        """Return whether `value` has the right form at all; `check` looks at its content."""
        return isinstance(value, self.accepted_types) and (
            bool in self.accepted_types or not isinstance(value, bool)
        )

    def check(self, value: Any) -> None:
        """Raise an `error` if a value of the right form cannot be meant."""

    def check_text(self, text: str) -> None:
        """Raise an `error` if the content of a text is wrong, whatever the scenario around it."""

    def help_for(self, value: object) -> str | None:
        """Return the help for a value of the wrong form."""
        return f"write it like `{self.example}`" if self.example else None

    def replacement_for(self, value: object) -> Replacement | None:
        """Return the only possible meaning of a value of the wrong form."""
        return None

    def json_schema(self) -> JsonSchema:
        types = list(
            dict.fromkeys(
                _JSON_TYPES[accepted_type]
                for accepted_type in self.accepted_types
                if accepted_type is not int or float not in self.accepted_types
            )
        )
        return {"type": types if len(types) > 1 else types[0]}

    def validate(self, value: object) -> object:
        if not self.has_form(value):
            raise mismatch(self.noun, self.help_for(value), self.replacement_for(value), value=value)
        if isinstance(value, str) and not value.strip():
            raise error("DB107", "is empty", self.help_for(value))
        self.check(value)
        return value

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        return core_schema.with_info_plain_validator_function(self._validate)

    def _validate(self, value: object, info: ValidationInfo) -> object:
        """Validate a value. Validation of a file has a context, in which the compiler checks the content of
        texts, and marks the exact place."""
        checked = self.validate(value)
        if info.context is None and isinstance(value, str):
            self.check_text(value)
        return checked

    def __get_pydantic_json_schema__(self, schema: CoreSchema, handler: GetJsonSchemaHandler) -> JsonSchema:
        return self.json_schema()

    def _matching(self, pattern: str) -> JsonSchema:
        """Return the schema of a text that matches `pattern`."""
        message = f"expected {self.noun}" + (f", such as `{self.example}`" if self.example else "")
        return {"type": "string", "pattern": pattern, "patternErrorMessage": message}
