from collections.abc import Callable
from pathlib import Path

import pytest

from deepbots_cli.diagnostics import Finding
from deepbots_cli.document import loads
from deepbots_cli.scenario import Scenario, validate

Check = Callable[[str], tuple[Scenario | None, list[Finding]]]


@pytest.fixture(scope="session")
def check() -> Check:
    """Validates the text of a scenario: its valid part, and the findings."""

    def run(text: str) -> tuple[Scenario | None, list[Finding]]:
        document = loads(text)
        if document.root is None:
            return None, list(document.findings)
        return validate(document.root, document.findings), list(document.findings)

    return run


@pytest.fixture(scope="session")
def cartpole() -> str:
    return Path(__file__).with_name("cartpole.yaml").read_text(encoding="utf-8")
