"""The areas of the page: what is in view, what moves, and what has the focus."""

from __future__ import annotations

import subprocess
import time
from pathlib import Path

import pytest

pytest.importorskip("nicegui")
from deepbots_cli.processes import python_command, python_environment
from tests.studio.served import ENTER, ESCAPE, TAB, StudioTab, served
from tests.studio.test_studio_page import SCENARIO
from tests.view.browser import CHROMIUM, browser

pytestmark = [pytest.mark.browser, pytest.mark.skipif(CHROMIUM is None, reason="there is no Chromium")]

RUNS = "document.querySelector('.studio-robot .studio-status').innerText == 'driven by random actions'"
RECTANGLE = """(() => { const box = %s.getBoundingClientRect();
    return { left: box.left, right: box.right, top: box.top, bottom: box.bottom, height: box.height }; })()"""
OUTLINES = """(() => { const one = document.activeElement, style = getComputedStyle(one);
    const frame = one.closest('.q-field__control') ?? one.closest('.cm-editor');
    const width = (element) => parseFloat(getComputedStyle(element, '::after').borderTopWidth) || 0;
    const outlined = (style) => style.outlineStyle != 'none' && parseFloat(style.outlineWidth) >= 1;
    return [one.outerHTML.slice(0, 120), outlined(style) || (!!frame && (outlined(getComputedStyle(frame)) ||
        width(frame) >= 2))]; })()"""


@pytest.fixture
def new_tab():
    with browser() as tab:
        yield tab


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "mine.yaml").write_text(SCENARIO, encoding="utf-8")
    return tmp_path


def _rectangle(page: StudioTab, element: str) -> dict[str, float]:
    rectangle: dict[str, float] = page.tab.run(RECTANGLE % element)
    return rectangle


def _click(page: StudioTab, element: str) -> None:
    """Click on the middle of an element with the mouse."""
    box = _rectangle(page, element)
    x, y = (box["left"] + box["right"]) / 2, (box["top"] + box["bottom"]) / 2
    for kind in ("mousePressed", "mouseReleased"):
        page.tab.call("Input.dispatchMouseEvent", type=kind, x=x, y=y, button="left", clickCount=1)


def _train(folder: Path) -> None:
    subprocess.run(
        python_command("deepbots_cli", "train", "mine.yaml", "--run", "runs/mine-1", "--timesteps", "2048"),
        cwd=folder,
        env=python_environment(),
        check=True,
        capture_output=True,
    )


def test_a_curve_and_the_buttons_of_an_output_are_in_view_on_a_small_screen(folder, new_tab):
    _train(folder)
    with served(folder, "mine.yaml") as studio:
        page = StudioTab(new_tab(), studio.address, 1280, 800)
        page.open_tab("Runs")
        page.wait("document.querySelector('table')?.innerText.includes('mine-1')")
        page.tab.run(
            "[...document.querySelectorAll('td')].find(cell => cell.innerText.trim() == 'mine-1').click()"
        )
        page.click("Curve")
        page.wait("document.querySelector('.studio-chart canvas, .studio-chart svg')?.clientHeight >= 220")
        chart = _rectangle(page, "document.querySelector('.studio-chart')")
        assert chart["height"] >= 220
        assert chart["bottom"] <= 800

        # The output scrolls below the buttons; the notice is in the header, and covers no button.
        page.click("Try")
        page.wait("document.querySelector('.studio-result')?.innerText.includes('ended by')", 90)
        page.tab.run("document.querySelector('.studio-details summary').click()")
        page.tab.run("document.querySelector('.studio-scroll').scrollTop = 250")
        button = "[...document.querySelectorAll('button')].find(one => one.innerText.trim() == '{}')"
        work = _rectangle(page, "document.querySelector('.studio-panels')")
        for label in ("Try", "Train", "Stop", "Close"):
            place = _rectangle(page, button.format(label))
            assert work["top"] <= place["top"] < place["bottom"] <= 800, label
        page.wait(
            "document.querySelector('.studio-notice')?.innerText.includes('try: Random actions: 3 episodes')"
        )
        notice = _rectangle(page, "document.querySelector('.studio-notice')")
        header = _rectangle(page, "document.querySelector('.studio-header')")
        assert header["top"] <= notice["top"] < notice["bottom"] <= header["bottom"]
        for label in ("Explain ...", "Dark"):
            place = _rectangle(page, button.format(label))
            assert place["right"] <= notice["left"] or place["left"] >= notice["right"], label
        assert not page.tab.errors


def test_bars_move_by_mouse_and_keys_and_the_sizes_and_options_are_kept(folder, new_tab):
    with served(folder, "mine.yaml") as studio:
        page = StudioTab(new_tab(), studio.address, 1280, 800)
        page.wait(RUNS, 60)
        text = "document.querySelector('.studio-text')"
        before = _rectangle(page, text)["right"]
        bar = _rectangle(page, "document.querySelector('[aria-label=\"Width of the text\"]')")
        y = (bar["top"] + bar["bottom"]) / 2
        # Over the page of the robot, which would take the mouse.
        for kind, x in (
            ("mousePressed", bar["left"]),
            *(("mouseMoved", bar["left"] + 20 * number) for number in range(1, 9)),
            ("mouseReleased", bar["left"] + 160),
        ):
            page.tab.call("Input.dispatchMouseEvent", type=kind, x=x, y=y, button="left", clickCount=1)
        page.wait(f"{text}.getBoundingClientRect().right > {before + 100}")
        page.tab.run("document.querySelector('[aria-label=\"Height of the robot\"]').focus()")
        robot = _rectangle(page, "document.querySelector('.studio-robot')")["height"]
        page.press(("ArrowUp", 38))
        page.wait(f"document.querySelector('.studio-robot').clientHeight < {robot - 5}")
        page.tab.run("document.querySelector('[aria-label=Timesteps]').focus()")
        page.type("512")
        page.wait("localStorage.getItem('deepbots-studio-size-robot') == '48'")
        width = _rectangle(page, text)["right"]

        page.load(studio.address)
        page.wait(f"Math.abs({text}.getBoundingClientRect().right - {width}) < 3")
        page.wait(f"document.querySelector('.studio-robot').clientHeight < {robot - 5}")
        page.wait("document.querySelector('[aria-label=Timesteps]').value == '512'")
        assert not page.tab.errors


def test_an_episode_waits_for_the_person_who_drives_and_the_keys_are_shown(folder, new_tab):
    with served(folder, "mine.yaml") as studio:
        page = StudioTab(new_tab(), studio.address, 1280, 800)
        page.wait(RUNS, 60)
        keys = "document.querySelector('.studio-keys')"
        choose = "[...document.querySelectorAll('[role=option]')].find(one => one.innerText.startsWith('{}'))"

        def drive(name: str) -> None:
            _click(page, "document.querySelector('[aria-label=Driver]').closest('.q-field')")
            page.wait(f"{choose.format(name)} != null")
            page.tab.run(f"{choose.format(name)}.click()")

        assert not page.tab.run(f"!!{keys}.offsetParent")
        drive("you")
        page.wait(f"{keys}.innerText.includes('Press a key to begin')")
        shown = str(page.tab.run(f"{keys}.innerText"))
        assert "forward" in shown
        assert "backward" in shown
        frame = "document.querySelector('.studio-frame').contentDocument"
        button = f"[...{frame}.querySelectorAll('button')].find(one => one.innerText == '{{}}')"
        scene = f"{frame}.body.innerText"
        page.wait(f"{scene}.includes('press a key to begin')")
        page.wait("document.activeElement.tagName == 'IFRAME'")
        for kind in ("keyDown", "keyUp"):
            page.tab.call("Input.dispatchKeyEvent", type=kind, key="w", code="KeyW", windowsVirtualKeyCode=87)
            page.wait(f"{keys}.innerText.includes('You drive')")
        page.wait(f"/last return \\d+, best \\d+/.test({keys}.innerText)", 60)
        box = _rectangle(page, keys)
        scene_box = _rectangle(page, "document.querySelector('.studio-scene')")
        assert box["top"] >= scene_box["bottom"]
        page.tab.run(f"{button.format('pause')}.click()")
        page.wait(f"{keys}.innerText.includes('Paused: press continue')")
        page.wait(f"{button.format('continue')} != null")
        page.tab.run(f"{button.format('continue')}.click()")
        page.wait(f"!{keys}.innerText.includes('Paused')")
        assert _rectangle(page, keys) == box
        drive("random")
        page.wait(f"!{keys}.offsetParent")
        assert not page.tab.errors


@pytest.mark.parametrize("width", [1000, 480])
def test_a_narrow_page_shows_the_robot_and_its_controls(folder, new_tab, width):
    with served(folder, "mine.yaml") as studio:
        page = StudioTab(new_tab(), studio.address, width, 800)
        page.wait(RUNS, 60)
        if width < 960:
            assert not page.tab.run("document.querySelector('.studio-robot').checkVisibility()")
            page.click("Robot")
            page.wait("document.querySelector('.studio-robot').checkVisibility()")
            assert not page.tab.run("document.querySelector('.cm-editor').checkVisibility()")
            assert page.tab.run("document.querySelector('.studio-save').checkVisibility()")
        frame = "document.querySelector('.studio-frame').contentDocument"
        page.wait(f"{frame}?.body?.innerText.includes('pause')", 60)
        page.wait(f"!{frame}.documentElement.classList.contains('waits')")
        assert not page.tab.errors


def test_a_narrow_page_shows_the_fields_of_its_dialogs(folder, new_tab):
    with served(folder, "mine.yaml") as studio:
        page = StudioTab(new_tab(), studio.address, 480, 800)
        page.wait(RUNS, 60)
        for button, field in (("Explain ...", "A word"), ("New ...", "Name")):
            page.click(button)
            if field == "Name":
                page.wait("document.querySelector('.studio-choice')?.checkVisibility()")
                page.tab.run("document.querySelector('.studio-choice').click()")
            shown = f"[...document.querySelectorAll('.q-dialog .q-field')].find(e => e.innerText.includes('{field}'))"
            page.wait(f"{shown}?.checkVisibility()")
            page.press(ESCAPE)
            page.wait("!document.querySelector('.q-dialog')")
        assert not page.tab.errors


def test_what_has_the_keyboard_is_outlined(folder, new_tab):
    with served(folder, "mine.yaml") as studio:
        page = StudioTab(new_tab(), studio.address, 1280, 800)
        page.wait(RUNS, 60)
        plain = []
        for _ in range(40):
            page.press(TAB)
            element, is_outlined = page.tab.run(OUTLINES)
            if not is_outlined:  # the editor notices its focus a moment later, and frames are animated
                time.sleep(0.5)
                element, is_outlined = page.tab.run(OUTLINES)
            if not is_outlined and not element.startswith("<body"):
                plain.append(element)
            if "cm-content" in element:
                page.press(ESCAPE)
        assert not plain


def test_end_and_home_go_to_the_ends_of_a_wrapped_line_in_two_steps(folder, new_tab):
    line = "  alive: 1  # " + "a long comment " * 9 + "with an end"
    (folder / "mine.yaml").write_text(SCENARIO.replace("  alive: 1", line), encoding="utf-8")
    with served(folder, "mine.yaml") as studio:
        page = StudioTab(new_tab(), studio.address, 1280, 800)
        page.click_line("  alive: 1")
        page.press(("End", 35), 4)
        page.type("!")
        page.wait("document.querySelector('.cm-content').innerText.includes('with an end!')")
        page.press(("Home", 36), 5)
        page.type("  # at the begin ")
        page.wait("document.querySelector('.cm-content').innerText.includes('# at the begin   alive: 1')")
        # From the begin of the line, the first End is the end of the first visual line.
        page.press(("Home", 36), 5)
        page.press(("End", 35))
        page.type("?")
        page.wait(
            "/a long comment \\?a long|a long \\?comment|a \\?long/.test(document.querySelector('.cm-content').innerText)"
        )


def test_an_empty_folder_offers_what_to_begin_with(tmp_path, new_tab):
    with served(tmp_path) as studio:
        tab = new_tab()
        tab.call(
            "Emulation.setDeviceMetricsOverride", width=1280, height=800, deviceScaleFactor=1, mobile=False
        )
        tab.call("Page.navigate", url=studio.address)
        choice = "[...document.querySelectorAll('.studio-choice')].find(one => one.innerText.startsWith('wheeled'))"
        tab.wait(f"!!{choice}?.offsetParent", 60)
        assert tab.run("document.querySelector('.studio-start').innerText.includes('balancer')")
        assert not tab.run("!!document.querySelector('.cm-editor').offsetParent")
        tab.run(f"{choice}.click()")
        name = "document.querySelector('.studio-dialog input[aria-label=Name]')"
        tab.wait(f"{name}?.value == 'wheeled'")
        tab.wait(f"document.activeElement == {name}")
        page = StudioTab.__new__(StudioTab)
        page.tab = tab
        page.press(ENTER)
        page.wait("document.querySelectorAll('.cm-line').length > 3", 60)
        assert not tab.run("!!document.querySelector('.studio-start').offsetParent")
        assert "\nname: Wheeled\n" in (tmp_path / "wheeled.yaml").read_text("utf-8")


def test_a_further_scenario_is_chosen_by_its_picture(folder, new_tab):
    with served(folder, "mine.yaml") as studio:
        page = StudioTab(new_tab(), studio.address, 1280, 800)
        start = "!!document.querySelector('.studio-start').offsetParent"
        page.click("New ...")
        page.wait("document.activeElement.innerText == 'Back to the text'")
        page.press(ESCAPE)
        page.wait(f"!({start}) && !!document.querySelector('.cm-editor').offsetParent")
        page.click("New ...")
        page.wait(start)
        page.tab.run("document.querySelector('.studio-choice').click()")
        field = "document.querySelector('.studio-dialog input[aria-label=Name]')"
        page.wait(f"document.activeElement == {field}")
        page.press(("a", 65), modifiers=2)
        page.type("mine")
        page.click("Create")
        message = f"{field}.closest('.q-field').querySelector('[role=alert]')?.innerText"
        page.wait(f"{message} == 'mine.yaml exists already; choose another name'")
        page.tab.run(f"{field}.focus()")
        page.press(("End", 35))
        page.type("s")
        page.wait(f"!({message})")
        page.press(ENTER)
        page.wait(
            "document.querySelector('.studio-files input')?.value == 'mines.yaml'"
            " || document.querySelector('.studio-files').innerText.includes('mines.yaml')",
            60,
        )
        page.wait(f"!({start})")
        assert "\nname: Mines\n" in (folder / "mines.yaml").read_text("utf-8")
        assert not page.tab.errors


def test_the_word_at_the_cursor_is_explained_with_its_places(folder, new_tab):
    with served(folder, "mine.yaml") as studio:
        page = StudioTab(new_tab(), studio.address, 1280, 800)
        page.wait("document.querySelector('.studio-state-good, .studio-state-warning') != null")
        page.click_line("    fallen:")
        page.press(("F1", 112))
        answer = "document.querySelector('.studio-dialog .studio-answer')"
        page.wait(f"{answer}?.innerText.includes('fall_angle in this file')")
        page.tab.run(f"[...{answer}.querySelectorAll('a')].find(one => one.innerText == 'line 4').click()")
        page.wait("!document.querySelector('.studio-dialog')")
        page.wait("document.querySelector('.cm-activeLine').innerText.startsWith('  fall_angle:')")
        page.click("Explain ...")
        page.wait(f"{answer} != null")
        page.tab.run("document.querySelector('.studio-dialog input').select()")
        page.type("pole length")
        page.press(ENTER)
        page.wait(f"{answer}.innerText.includes('pole_angle in line')")
        assert page.tab.run(f"[...{answer}.querySelectorAll('a')].some(one => one.innerText == 'length')")
        assert not page.tab.errors
