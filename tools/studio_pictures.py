"""The pictures of docs/studio.md: `python -m tools.studio_pictures` needs Chromium and takes a minute."""

from __future__ import annotations

import subprocess
import tempfile
import time
from pathlib import Path

from deepbots_cli.processes import python_command, python_environment
from tests.studio.served import ENTER, ESCAPE, StudioTab, served
from tests.view.browser import browser

IMAGES = Path(__file__).parents[1] / "docs" / "images"
_WITHOUT_NOTICE = (
    "document.querySelector('iframe').contentDocument.head.insertAdjacentHTML('beforeend',"
    " '<style>.mantine-Notifications-root {display: none}</style>')"
)
_PLAYS = "/step [1-9]\\d/.test(document.querySelector('iframe').contentDocument.body.innerText)"
_HAS_ENDED = "/mine-1: solved/.test(document.querySelector('.studio-work').innerText)"


def main() -> None:
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        with served(folder) as studio, browser() as new_tab:
            first = new_tab()
            size = {"width": 1440, "height": 860, "deviceScaleFactor": 1, "mobile": False}
            first.call("Emulation.setDeviceMetricsOverride", **size)
            first.call("Page.navigate", url=studio.address)
            first.wait("document.querySelectorAll('.studio-choice img').length > 5", 60)
            time.sleep(2)
            first.see(str(IMAGES / "studio_first.png"))
        words = ("new", "mine", "--template", "cartpole")
        subprocess.run(
            python_command("deepbots_cli", *words), cwd=folder, env=python_environment(), check=True
        )
        # Another browser, because the robot of a page behind another one waits.
        with served(folder, "mine.yaml") as studio, browser() as new_tab:
            page = StudioTab(new_tab(), studio.address, 1440, 860)
            page.click("Train")
            page.wait(_HAS_ENDED, 300)
            page.wait("!!document.querySelector('.studio-notice')", 120)
            page.wait(
                "!document.querySelector('.studio-notice')?.checkVisibility({visibilityProperty: true})"
            )
            page.tab.run(_WITHOUT_NOTICE)
            page.wait(_PLAYS, 60)
            time.sleep(1)
            page.tab.see(str(IMAGES / "studio.png"))

            page.click_line("  alive: 1")
            page.press(ENTER)
            for letter in "upright: 1 - cart.pole_angle":
                page.type(letter)
            page.press(ESCAPE)
            page.wait("document.querySelectorAll('.studio-row').length > 0")
            page.click("Dark")  # the robot's page is loaded again, and takes the focus
            page.tab.run("document.querySelector('.studio-row summary').click()")
            page.wait("document.querySelector('.studio-explanation').innerText.length > 40")
            time.sleep(6)
            page.tab.run(_WITHOUT_NOTICE)
            time.sleep(1)
            page.tab.see(str(IMAGES / "studio_finding.png"))

            narrow = StudioTab(new_tab(), studio.address, 420, 820)
            narrow.click("Training")
            narrow.open_tab("Runs")
            narrow.wait("document.querySelector('table')?.innerText.includes('mine-1')")
            time.sleep(3)
            narrow.tab.see(str(IMAGES / "studio_narrow.png"))


if __name__ == "__main__":
    main()
