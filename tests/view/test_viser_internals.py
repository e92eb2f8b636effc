"""viser has the private members that deepbots uses, and one module names them."""

from __future__ import annotations

from contextlib import redirect_stdout
from io import StringIO
from pathlib import Path

import pytest

viser = pytest.importorskip("viser")
from deepbots_cli.view import access, server, viser_internals  # noqa: E402
from tests.private_members import private_members  # noqa: E402

MODULE = Path(viser_internals.__file__)
USERS = [
    path for path in sorted(MODULE.parent.glob("*.py")) if "viser" in path.read_text() and path != MODULE
]


def test_the_library_has_each_private_member() -> None:
    with redirect_stdout(StringIO()):
        page = viser.ViserServer(access.LOOPBACK, 0, verbose=False)
    try:
        box = page.gui.add_checkbox("Box", initial_value=True)
        used = {name for _, name in private_members(MODULE)}
        assert len(used) == 5
        parts = (viser, page.gui, box)
        assert {name for name in used if not any(hasattr(part, name) for part in parts)} == set()
        assert page.gui._gui_input_handle_from_uuid[box._impl.uuid]._impl.value is True
    finally:
        server.stop(page)


@pytest.mark.parametrize("path", USERS, ids=lambda path: path.stem)
def test_no_other_module_names_a_private_member(path: Path) -> None:
    assert [*private_members(path)] == []
