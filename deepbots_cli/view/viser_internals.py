"""The private members of viser that deepbots uses. No other module names one.

viser applies any value of any attribute that a client sends, and has no public place to check it. A test
looks for each member in the library.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import viser


def check_updates(server: viser.ViserServer, is_offered: Callable[[object, Any], bool]) -> None:
    """Let a client change the value of a control only, to one that the control offers.

    Args:
        server: The server of the page.
        is_offered: Takes a value and the state of a control, which has its present `value` and `props`.
    """
    from viser._messages import GuiUpdateMessage

    gui: Any = server.gui
    original = gui._handle_gui_updates

    async def checked(client: int, message: Any) -> None:
        handle = gui._gui_input_handle_from_uuid.get(message.uuid)
        is_value = handle is not None and list(message.updates) == ["value"]
        if is_value and is_offered(message.updates["value"], handle._impl):
            await original(client, message)

    gui._websock_interface.unregister_handler(GuiUpdateMessage, original)
    gui._websock_interface.register_handler(GuiUpdateMessage, checked)
