"""The studio in a real browser: written, seen, trained.

The areas of the page: what is in view, what moves, and what has the focus.

The page of the studio without a mouse.
"""

from __future__ import annotations

import shutil
import subprocess
import time
from pathlib import Path

import pytest

pytest.importorskip("nicegui")

from deepbots_cli.document.shipped import robot_path
from deepbots_cli.processes import python_command, python_environment
from tests.studio.served import BACKSPACE, ENTER, ESCAPE, TAB, Served, StudioTab, served
from tests.view.browser import CHROMIUM, browser

pytestmark = [pytest.mark.browser, pytest.mark.skipif(CHROMIUM is None, reason="there is no Chromium")]

SCENARIO = """deepbots: 1
name: Mine
parameters:
  fall_angle: 15 deg  # the largest lean
world: {timestep: 32 ms, substeps: 4}
robots:
  cart:
    urdf: cartpole
    sensors:
      pole_angle: {type: joint_position, joint: pole_hinge}
    actuators:
      wheels: {type: velocity_motor, joints: [wheel_*], max_torque: 10 N*m}
    apply: {wheels: drive * 5 rad/s}
action:
  drive: {choices: {forward: 1, backward: -1}}
observation:
  cart.pole_angle: -20 .. 20 deg
reward:
  alive: 1
termination:
  failure:
    fallen: abs(cart.pole_angle) > fall_angle
truncation: {max_steps: 100}
train:
  algorithm: PPO
  total_timesteps: 4096
  environments: 4
  n_steps: 128
"""


@pytest.fixture
def new_tab():
    # A browser of its own: tabs of earlier tests would draw on, and take the cores.
    with browser() as tab:
        yield tab


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "mine.yaml").write_text(SCENARIO, encoding="utf-8")
    return tmp_path


@pytest.fixture
def studio(folder):
    with served(folder, "mine.yaml") as running:
        yield running


def test_a_person_writes_sees_and_trains(studio: Served, folder, new_tab):
    page = StudioTab(new_tab(), studio.address)
    page.wait(
        "document.querySelector('.studio-robot .studio-status').innerText == 'driven by random actions'", 60
    )

    # A mistake is underlined and explained; the finding goes with it.
    page.click_line("  fall_angle:")
    page.press(("Home", 36))
    page.click_line("  alive: 1")
    page.type("0 parsec", then="document.querySelectorAll('.studio-error').length > 0")
    assert any("parsec" in finding for finding in page.findings())
    page.press(BACKSPACE, len("0 parsec"))
    page.wait("document.querySelectorAll('.studio-row-error').length == 0")

    # Keys and expressions are completed.
    page.click_line("  alive: 1")
    page.press(ENTER)
    page.type(
        "upright: ab",
        then="[...document.querySelectorAll('.cm-tooltip-autocomplete li')].some(li => li.innerText.startsWith('abs'))",
    )
    page.press(ESCAPE)
    page.type("s(cart.pole_angle) / 1 rad", then="document.querySelectorAll('.studio-row-error').length == 0")

    # Saving restarts the robot with the new text.
    page.save()
    page.wait("[...document.querySelectorAll('button')].some(b => b.innerText.trim() == 'Saved')")
    assert "  upright: abs(cart.pole_angle) / 1 rad\n" in (folder / "mine.yaml").read_text("utf-8")

    # The curve follows the training, which ends with a result in the list of runs.
    page.click(
        "Train",
        then="document.querySelector('.studio-work').textContent.includes('deepbots train mine.yaml')",
    )
    page.wait(
        "/mine-1: (training|finished), [0-9,]+/.test(document.querySelector('.studio-work').innerText)", 60
    )
    page.wait("/mine-1: finished/.test(document.querySelector('.studio-work').innerText)", 120)
    page.open_tab("Runs")
    page.wait("document.querySelector('table')?.innerText.includes('mine-1')")
    assert not page.tab.errors


def test_both_tabs_show_what_one_of_them_writes(studio: Served, new_tab):
    first, second = StudioTab(new_tab(), studio.address), StudioTab(new_tab(), studio.address)
    first.click_line("name: Mine")
    first.type("craft")
    second.wait("document.querySelector('.cm-content').innerText.includes('name: Minecraft')")
    second.click_line("truncation")
    second.type("  # a note")
    first.wait("document.querySelector('.cm-content').innerText.includes('# a note')")
    assert "name: Minecraft" in first.text
    # Both change one place before either hears of the other.
    editor = "getElement(Number(document.querySelector('.studio-editor').id.slice(1)))"
    for page, text in ((first, "One"), (second, "Two")):
        page.tab.run(f"{editor}.waiting = true")  # it sends nothing
        page.click_line("name: Minecraft")
        page.type(text)
    first.tab.run(f"{editor}.waiting = false; {editor}.schedule()")
    first.wait(f"{editor}.base.includes('One')")
    second.tab.run(f"{editor}.waiting = false; {editor}.schedule()")
    second.wait("document.querySelector('.studio-editor .studio-banner').innerText.includes('also changed')")
    assert "name: MinecraftTwo" in second.text
    second.click("Keep what I typed")
    first.wait("document.querySelector('.cm-content').innerText.includes('name: MinecraftTwo')")


def test_a_file_changed_outside_is_taken_or_kept(studio: Served, folder, new_tab):
    page = StudioTab(new_tab(), studio.address)
    (folder / "mine.yaml").write_text(SCENARIO.replace("name: Mine", "name: Theirs"), encoding="utf-8")
    page.wait("document.querySelector('.cm-content').innerText.includes('name: Theirs')")
    page.click_line("name: Theirs")
    page.type(
        " and mine", then="[...document.querySelectorAll('button')].some(b => b.innerText.trim() == 'Save *')"
    )
    (folder / "mine.yaml").write_text(SCENARIO.replace("name: Mine", "name: Others"), encoding="utf-8")
    page.click("Keep this text")
    assert "name: Theirs and mine" in page.text


def test_a_finding_is_corrected_by_a_click_and_explained_with_links(studio: Served, new_tab):
    page = StudioTab(new_tab(), studio.address)
    page.click_line("    fallen:")
    page.press(BACKSPACE, len("fall_angle"))
    page.type("fal_angle")
    page.click(
        "Replace `fal_angle` with `fall_angle` (check it)",
        then="document.querySelectorAll('.studio-row').length == 0",
    )
    assert "> fall_angle" in page.text

    page.click("Explain ...", then="document.activeElement.tagName == 'INPUT'")
    page.type("reward")
    page.press(ENTER)
    answer = "document.querySelector('.studio-dialog .studio-answer')"
    page.wait(f"{answer}.innerText.includes('a key of a scenario')")
    page.tab.run(f"[...{answer}.querySelectorAll('a')].find(one => one.innerText == 'return').click()")
    page.wait(f"{answer}.innerText.startsWith('return: a concept')")
    page.click("Back", then=f"{answer}.innerText.startsWith('reward: a concept')")
    assert not page.tab.errors


def test_the_result_of_a_command_is_shown_where_it_was_started(studio: Served, new_tab):
    page = StudioTab(new_tab(), studio.address)
    page.click(
        "Try", then="document.body.innerText.includes('A few episodes of mine.yaml: finished')", seconds=60
    )
    sentence = "document.querySelector('.studio-sentence')?.innerText"
    page.wait(f"/^Random actions: 3 episodes, mean return .*, all ended by /.test({sentence})", 60)
    # The output is behind the sentence.
    assert not page.tab.run("document.querySelector('.studio-details').open")
    page.tab.run("document.querySelector('.studio-details summary').click()")
    page.wait("document.querySelector('.studio-result').innerText.includes('summary of 3 episodes')")
    assert page.tab.run("document.querySelector('[role=tab][aria-selected=true]').innerText") == "Train"
    page.click("Close", then="!document.querySelector('.studio-result')?.offsetParent")


def test_two_runs_are_drawn_over_each_other_and_a_change_is_set_back(folder, new_tab):
    solved = f"{SCENARIO}solved: mean_return >= 40 over 20 episodes\n"
    missed = solved.replace("max_steps: 100", "max_steps: 30").replace(
        "urdf: cartpole\n", "urdf: cartpole\n    links: {pole: {scale: 1 1 2}}\n"
    )
    for name, text in (("mine-1", solved), ("mine-2", missed)):
        (folder / "mine.yaml").write_text(text, encoding="utf-8")
        _train(folder, name)
    with served(folder, "mine.yaml") as studio:
        page = StudioTab(new_tab(), studio.address)
        cause = "document.querySelector('.studio-result')?.innerText.includes('Changed since runs/mine-1')"
        page.open_tab("Runs")
        select = "[...document.querySelectorAll('td')].find(cell => cell.innerText.trim() == '{}').click()"
        page.wait("document.querySelector('table')?.innerText.includes('mine-2')")
        page.tab.run(select.format("mine-2"))
        page.click("Evaluate", then="!!document.querySelector('.studio-runs')?.offsetParent")
        page.click(
            "Curve", then="document.querySelector('.studio-unsolved')?.innerText.includes('not solved')"
        )
        page.click("Why is it not solved?", then=cause, seconds=90)
        # The ring of the evaluation that was begun before does not turn beside the finished diagnosis.
        assert not page.tab.run("!!document.querySelector('.studio-runs')?.offsetParent")
        page.click("Set truncation.max_steps back to 100")
        page.click(
            "Remove robots.cart.links.pole",
            then="document.querySelector('.cm-content').innerText.includes('truncation: {max_steps: 100}')",
        )
        page.wait("!document.querySelector('.cm-content').innerText.includes('scale')")
        # The diagnosis is of the other run.
        page.tab.run(select.format("mine-1"))
        page.wait("!document.querySelector('.studio-result').offsetParent")
        page.tab.run("document.querySelectorAll('tbody .q-checkbox')[0].click()")
        page.click("Compare")
        result = "document.querySelector('.studio-result').innerText"
        page.wait(f"/mine-1: solved after .*; mine-2: not solved after .*/.test({result})")
        assert page.tab.run(f"/mine-2 differs from mine-1 in .*100.→.30/.test({result})")
        page.wait("document.querySelector('.studio-compared canvas, .studio-compared svg') != null")
        page.wait(f"/mine-2 and mine-1 cannot be compared/.test({result})", 120)
        picture = "document.querySelector('.studio-compared canvas').toDataURL()"
        page.tab.run(f"window.light = {picture}; 1")
        page.click("Dark", then=f"{picture} != window.light")
        page.click("Back to the runs")
        page.tab.run(select.format("mine-1"))
        page.click(
            "Curve",
            then="document.querySelector('.studio-status.studio-solved')?.innerText.includes('solved after')",
        )
        assert not page.tab.errors
        page.click(
            "Watch",
            then="document.querySelector('[aria-label=\"Robot of\"]').closest('.q-field').innerText.includes('mine-1')",
        )


def test_text_typed_without_a_server_is_kept_and_offered(folder, new_tab):
    tab = new_tab()
    with served(folder, "mine.yaml") as first:
        page, port = StudioTab(tab, first.address), first.port
        page.click_line("name: Mine")
        first.stop(9)
        page.wait(
            "document.querySelector('.studio-editor .studio-banner').innerText.includes('does not answer')"
        )
        page.type("craft")
        time.sleep(0.5)
    with served(folder, "mine.yaml", "--port", str(port)) as second:
        page = StudioTab(tab, second.address)
        assert "name: Minecraft" not in page.text
        page.click(
            "Use it", then="document.querySelector('.cm-content').innerText.includes('name: Minecraft')"
        )
        page.save()
        page.wait("[...document.querySelectorAll('button')].some(b => b.innerText.trim() == 'Saved')")
    assert "name: Minecraft\n" in (folder / "mine.yaml").read_text("utf-8")


def test_names_are_shown_as_text(folder, new_tab):
    hostile = "<img src=x onerror=window.hacked=1>"
    text = SCENARIO.replace("name: Mine", f'name: "{hostile}"').replace("alive: 1", f"'{hostile}': 1")
    (folder / "mine.yaml").write_text(text, encoding="utf-8")
    shutil.copy(folder / "mine.yaml", folder / f"{hostile.replace(' ', '')}.yaml")
    with served(folder, "mine.yaml") as running:
        page = StudioTab(new_tab(), running.address)
        page.wait("document.querySelectorAll('.studio-row').length > 0")
        page.tab.run("document.querySelector('.studio-row summary').click()")
        time.sleep(2)
        assert page.tab.run("window.hacked ?? 0") == 0


RUNS = "document.querySelector('.studio-robot .studio-status').innerText == 'driven by random actions'"
RECTANGLE = """(() => { const box = %s.getBoundingClientRect();
    return { left: box.left, right: box.right, top: box.top, bottom: box.bottom, height: box.height }; })()"""
OUTLINES = """(() => { const one = document.activeElement, style = getComputedStyle(one);
    const frame = one.closest('.q-field__control') ?? one.closest('.cm-editor');
    const width = (element) => parseFloat(getComputedStyle(element, '::after').borderTopWidth) || 0;
    const outlined = (style) => style.outlineStyle != 'none' && parseFloat(style.outlineWidth) >= 1;
    return [one.outerHTML.slice(0, 120), outlined(style) || (!!frame && (outlined(getComputedStyle(frame)) ||
        width(frame) >= 2))]; })()"""


def _rectangle(page: StudioTab, element: str) -> dict[str, float]:
    rectangle: dict[str, float] = page.tab.run(RECTANGLE % element)
    return rectangle


def _click(page: StudioTab, element: str) -> None:
    """Click on the middle of an element with the mouse."""
    box = _rectangle(page, element)
    x, y = (box["left"] + box["right"]) / 2, (box["top"] + box["bottom"]) / 2
    for kind in ("mousePressed", "mouseReleased"):
        page.tab.call("Input.dispatchMouseEvent", type=kind, x=x, y=y, button="left", clickCount=1)


def _train(folder: Path, name: str = "mine-1") -> None:
    subprocess.run(
        python_command("deepbots_cli", "train", "mine.yaml", "--run", f"runs/{name}", "--timesteps", "2048"),
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
        page.click(
            "Curve",
            then="document.querySelector('.studio-chart canvas, .studio-chart svg')?.clientHeight >= 200",
        )
        chart = _rectangle(page, "document.querySelector('.studio-chart')")
        assert chart["height"] >= 200
        assert chart["bottom"] <= 800

        # The output scrolls below the buttons; the notice is in the header, and covers no button.
        page.click(
            "Try", then="document.querySelector('.studio-result')?.innerText.includes('ended by')", seconds=90
        )
        page.tab.run("document.querySelector('.studio-details summary').click()")
        page.tab.run("document.querySelector('.studio-scroll').scrollTop = 250")
        button = "[...document.querySelectorAll('button')].find(one => one.innerText.trim() == '{}')"
        work = _rectangle(page, "document.querySelector('.studio-panels')")
        for label in ("Try", "Train", "Stop", "Close"):
            place = _rectangle(page, button.format(label))
            assert work["top"] <= place["top"] < place["bottom"] <= 800, label
        page.wait(
            "document.querySelector('.studio-notice')?.innerText.includes('A few episodes of mine.yaml: finished')"
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
        page.type("512", then="localStorage.getItem('deepbots-studio-size-robot') == '48'")
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
        page.wait(f"{frame}.body.innerText.includes('press a key to begin')")
        page.wait("document.activeElement.tagName == 'IFRAME'")
        for kind in ("keyDown", "keyUp"):
            page.tab.call("Input.dispatchKeyEvent", type=kind, key="w", code="KeyW", windowsVirtualKeyCode=87)
            page.wait(f"{keys}.innerText.includes('You drive')")
        page.wait(f"/last return \\d+, best \\d+/.test({keys}.innerText)", 60)
        box = _rectangle(page, keys)
        assert box["top"] >= _rectangle(page, "document.querySelector('.studio-scene')")["bottom"]
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
            page.click("Robot", then="document.querySelector('.studio-robot').checkVisibility()")
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
        page.type("!", then="document.querySelector('.cm-content').innerText.includes('with an end!')")
        page.press(("Home", 36), 5)
        page.type(
            "  # at the begin ",
            then="document.querySelector('.cm-content').innerText.includes('# at the begin   alive: 1')",
        )
        # From the begin of the line, the first End is the end of the first visual line.
        page.press(("Home", 36), 5)
        page.press(("End", 35))
        page.type(
            "?",
            then="/a long comment \\?a long|a long \\?comment|a \\?long/.test(document.querySelector('.cm-content').innerText)",
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


def drop(page: StudioTab, path: Path) -> None:
    root = page.tab.call("DOM.getDocument")["root"]["nodeId"]
    node = page.tab.call("DOM.querySelector", nodeId=root, selector=".q-uploader__input")["nodeId"]
    page.tab.call("DOM.setFileInputFiles", files=[str(path)], nodeId=node)


def test_a_robot_file_is_corrected_before_it_is_written_and_its_task_is_chosen(folder, new_tab):
    good = robot_path("balancer").read_text("utf-8")
    outside = folder.with_name("outside")
    outside.mkdir()
    dropped = outside / "buggy.urdf"
    dropped.write_text(good.replace("<parent ", "<parnt ", 1), encoding="utf-8")
    with served(folder, "mine.yaml") as studio:
        page = StudioTab(new_tab(), studio.address, 1280, 800)
        page.click("New ...", then="!!document.querySelector('.studio-start').offsetParent")
        drop(page, dropped)
        page.wait("!!document.querySelector('.studio-dialog .cm-line')")
        assert "without <parent>" in page.tab.run("document.querySelector('.studio-dialog').innerText")
        # The line of the error is in view, and no line number covers another one.
        page.wait(
            """(() => { const editor = document.querySelector('.studio-dialog .cm-scroller');
            const { top, bottom } = editor.getBoundingClientRect();
            const numbers = [...editor.querySelectorAll('.cm-lineNumbers .cm-gutterElement')];
            const places = numbers.map(one => one.getBoundingClientRect().top).slice(1);
            const error = numbers.find(one => one.innerText == '59')?.getBoundingClientRect();
            return error?.top >= top && error?.bottom <= bottom && new Set(places).size == places.length; })()"""
        )
        page.click("Correct line 60")
        task = (
            "[...document.querySelectorAll('.q-radio')].find(one => /drives to a mark/.test(one.innerText))"
        )
        page.wait(f"!!{task}")
        assert (folder / "buggy.urdf").read_text("utf-8") == good
        page.tab.run(f"{task}.click()")
        page.click(
            "Create",
            then="document.querySelector('.studio-files').innerText.includes('buggy.yaml')",
            seconds=60,
        )
        assert "summary: A robot on wheels drives to a mark." in (folder / "buggy.yaml").read_text("utf-8")

        heavier = good.replace('<mass value="1"/>', '<mass value="2"/>')
        dropped.write_text(heavier, encoding="utf-8")
        page.click("New ...")
        drop(page, dropped)
        page.click(
            "Replace it",
            then="!!document.querySelector('.studio-dialog input[aria-label=Name]')"
            " && document.querySelectorAll('.q-dialog').length == 1",
        )
        assert (folder / "buggy.urdf").read_text("utf-8") == heavier

        # The list of files opens a robot file again.
        page.click("Cancel")
        page.click(
            "Back to the text",
            then="!document.querySelector('.q-dialog') && !!document.querySelector('.studio-files').offsetParent",
        )
        _click(page, "document.querySelector('.studio-files')")
        page.click("buggy.urdf (robot file)", ".q-item")
        page.wait("!!document.querySelector('.studio-dialog .cm-line')")
        page.click(
            "Use this text",
            then="document.querySelector('.studio-notices').innerText.includes('saved buggy.urdf')",
        )
        assert not page.tab.errors


def test_a_browser_without_webgl_gets_a_new_picture_after_a_save(folder, new_tab):
    with served(folder, "mine.yaml") as studio:
        tab = new_tab()
        without = "HTMLCanvasElement.prototype.getContext = () => null"
        tab.call("Page.addScriptToEvaluateOnNewDocument", source=without)
        page = StudioTab(tab, studio.address, 1280, 720)
        source = "document.querySelector('.studio-picture')?.getAttribute('src')"
        first = page.wait(source, 60)
        assert "which is drawn again" in tab.run("document.body.innerText")
        page.click_line("  alive: 1")
        page.type("0")
        page.save()
        page.wait(f"{source} != '{first}'", 60)


def test_a_further_scenario_is_chosen_by_its_picture(folder, new_tab):
    with served(folder, "mine.yaml") as studio:
        page = StudioTab(new_tab(), studio.address, 1280, 800)
        start = "!!document.querySelector('.studio-start').offsetParent"
        page.click("New ...", then="document.activeElement.innerText == 'Back to the text'")
        page.press(ESCAPE)
        page.wait(f"!({start}) && !!document.querySelector('.cm-editor').offsetParent")
        page.click("New ...", then=start)
        page.tab.run("document.querySelector('.studio-choice').click()")
        field = "document.querySelector('.studio-dialog input[aria-label=Name]')"
        page.wait(f"document.activeElement == {field}")
        page.press(("a", 65), modifiers=2)
        page.type("mine")
        page.click("Create")
        message = f"{field}.closest('.q-field').querySelector('[role=alert]')?.innerText"
        page.wait(f"{message} == 'a file of this name exists already; choose another name'")
        page.tab.run(f"{field}.focus()")
        page.press(("End", 35))
        page.type("s", then=f"!({message})")
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
        page.click("Explain ...", then=f"{answer} != null")
        page.tab.run("document.querySelector('.studio-dialog input').select()")
        page.type("pole length")
        page.press(ENTER)
        page.wait(f"{answer}.innerText.includes('pole_angle in line')")
        assert page.tab.run(f"[...{answer}.querySelectorAll('a')].some(one => one.innerText == 'length')")
        assert not page.tab.errors


FOCUS = """(() => { const one = document.activeElement;
    return one.tagName + ' ' + (one.getAttribute('aria-label') || one.innerText || one.title || ''); })()"""


def _tab_to(page: StudioTab, wanted: str, most: int = 60) -> list[str]:
    """Press Tab until an element is focused; returns what was passed."""
    passed = []
    for _ in range(most):
        page.press(TAB)
        passed.append(str(page.tab.run(FOCUS)))
        if wanted in passed[-1]:
            return passed
    raise AssertionError(passed)


def test_a_scenario_is_written_saved_and_trained_by_the_keyboard(tmp_path):
    (tmp_path / "mine.yaml").write_text(SCENARIO, encoding="utf-8")
    with served(tmp_path, "mine.yaml") as studio, browser() as new_tab:
        page = StudioTab(new_tab(), studio.address)
        page.wait(
            "document.querySelector('.studio-robot .studio-status').innerText == 'driven by random actions'",
            60,
        )
        passed = _tab_to(page, "text of the scenario")
        assert any("New ..." in each for each in passed)
        page.press(("End", 35), modifiers=2)
        page.type("# by the keyboard")
        page.save()
        end = time.monotonic() + 20
        while not (tmp_path / "mine.yaml").read_text("utf-8").endswith("n_steps: 128\n# by the keyboard"):
            assert time.monotonic() < end
            time.sleep(0.1)
        # Saving loads the page of the robot anew: it has nothing to focus before it shows its controls.
        page.wait(
            "document.querySelector('iframe').contentDocument.querySelector('button, input') != null", 60
        )
        # Tab leaves the text, and passes over the controls of the robot.
        _tab_to(page, "Keyboard into the page of the robot")
        page.press(("Enter", 13))
        page.wait("document.activeElement.tagName == 'IFRAME'")
        page.press(TAB)
        page.wait("document.querySelector('iframe').contentDocument.activeElement.tagName != 'BODY'")
        page.press(ESCAPE)
        page.wait("document.activeElement.className.includes('studio-enter')")
        passed = _tab_to(page, "Train")
        assert not any("IFRAME" in each for each in passed)
        _tab_to(page, "BUTTON Try")
        _tab_to(page, "BUTTON Train")
        page.press(("Enter", 13))
        page.wait("/mine-1: (training|finished)/.test(document.querySelector('.studio-work').innerText)", 90)
        assert not page.tab.errors


def test_the_keys_of_the_editor_work_after_a_click_on_a_button_and_in_the_robot(tmp_path):
    (tmp_path / "mine.yaml").write_text(SCENARIO, encoding="utf-8")

    def has_saved(begin: str) -> None:
        end = time.monotonic() + 20
        while not (tmp_path / "mine.yaml").read_text("utf-8").startswith(begin):
            assert time.monotonic() < end
            time.sleep(0.1)

    focus = "[...document.querySelectorAll('button')].find(one => one.innerText.trim() == '{}').focus()"
    with served(tmp_path, "mine.yaml") as studio, browser() as new_tab:
        page = StudioTab(new_tab(), studio.address)
        page.click_line("deepbots: 1")
        page.type("  # one")
        page.tab.run(focus.format("Try"))
        page.save()
        has_saved("deepbots: 1  # one\n")
        page.tab.run(focus.format("Try"))
        page.press(("z", 90), modifiers=2)
        page.wait("document.querySelector('.cm-line').innerText == 'deepbots: 1'")
        page.tab.run(focus.format("Try"))
        page.press(("y", 89), modifiers=2)
        page.wait("document.querySelector('.cm-line').innerText == 'deepbots: 1  # one'")

        # In another text field, the key is that of the field.
        page.tab.run("document.querySelector('[aria-label=Timesteps]').focus()")
        page.type("512")
        page.press(("z", 90), modifiers=2)
        time.sleep(0.5)
        assert page.tab.run("document.querySelector('.cm-line').innerText") == "deepbots: 1  # one"

        # Ctrl+Enter trains, and does not press the button that has the focus.
        page.wait(
            "document.querySelector('iframe').contentDocument?.querySelector('button, input') != null", 60
        )
        page.tab.run(focus.format("Try"))
        page.press(("Enter", 13), modifiers=2)
        page.wait("document.querySelector('.studio-work').textContent.includes('deepbots train mine.yaml')")
        assert not page.tab.run("document.body.innerText.includes('deepbots try')")
        page.click_line("deepbots: 1")
        page.type(", two")
        page.tab.run("document.querySelector('iframe').contentWindow.focus()")
        page.save()
        has_saved("deepbots: 1  # one, two\n")
        assert not page.tab.errors
