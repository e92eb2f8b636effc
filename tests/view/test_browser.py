"""The page in a real browser: seen, driven, changed. WebGL is drawn by software, so pages are small."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from contextlib import closing, contextmanager
from typing import Any

import numpy as np
import pytest

pytest.importorskip("viser")
from deepbots_cli.view.episodes import Showing
from deepbots_cli.view.page import Page
from tests.view.browser import CHROMIUM, browser

pytestmark = [pytest.mark.browser, pytest.mark.skipif(CHROMIUM is None, reason="there is no Chromium")]


@contextmanager
def served(source: str | Showing, **options: Any) -> Iterator[Page]:
    """A page whose loop runs in a thread of its own. An error of the page is raised at the end."""
    pages: list[Page] = []
    errors: list[BaseException] = []
    stop = threading.Event()

    def run() -> None:
        try:
            page = Page(Showing(source) if isinstance(source, str) else source, port=0, **options)
            pages.append(page)
            with closing(page):
                page.run(stop.is_set)
        except BaseException as error:  # noqa: BLE001  # raised in the thread of the test
            errors.append(error)

    thread = threading.Thread(target=run)
    thread.start()
    try:
        while not pages and not errors:
            time.sleep(0.05)
        if pages:
            yield pages[0]
    finally:
        stop.set()
        thread.join(20)
        assert not thread.is_alive()
        if errors:
            raise errors[0]


@pytest.fixture(scope="module")
def new_tab():
    with browser() as tab:
        yield tab


def _world(tab):
    """The pixels of the world, without the panel."""
    return tab.see()[:, :450].astype(int)


def _is_world(image, color, least=100):
    return int((np.abs(image - color).sum(axis=2) < 60).sum()) > least


def test_the_world_is_seen_stands_still_and_moves(new_tab):
    with served("find_ball", driver="around") as page:
        tab = new_tab()
        tab.open(page.address)
        tab.wait("document.body.innerText.includes('reward terms of this step')")
        _soon(lambda: _is_world(_world(tab), (215, 200, 80), 60))  # the ball
        tab.click("pause")
        tab.wait("document.body.innerText.includes('paused')")
        step = page.player.frame.step
        time.sleep(1.0)
        still = _world(tab)
        assert page.player.frame.step == step
        tab.click("reset")
        tab.wait("document.body.innerText.includes('step 0,')")
        tab.click("step")
        tab.wait("document.body.innerText.includes('step 1,')")
        time.sleep(1.0)
        assert (np.abs(_world(tab) - still).sum(axis=2) > 60).sum() > 20
        assert {r.split("/")[2] for r in tab.requests if not r.startswith(("data:", "blob:"))} == {
            page.address.split("/")[2]
        }
        assert tab.errors == []


def _soon(
    holds, seconds=120.0
):  # WebGL in software, beside the tabs of earlier tests, draws a frame in seconds
    end = time.monotonic() + seconds
    while not holds() and time.monotonic() < end:
        time.sleep(0.05)
    assert holds()


def _wheel(page):
    action = page.player.frame.agents["agent"].action
    return action[1] if action else None


def test_keys_buttons_and_tabs_work(new_tab):
    with served("find_ball", playing=True) as page:
        tab = new_tab()
        tab.open(page.address)
        tab.wait("document.body.innerText.includes('played')")
        tab.click("Drive")
        tab.wait("document.body.innerText.includes('Keys:')")
        tab.key("KeyD", down=True)
        _soon(lambda: _wheel(page) == 1.0)
        tab.key("KeyD", down=False)
        _soon(lambda: not _wheel(page))  # 0, or none where the episode has ended meanwhile
        tab.run("navigator.getGamepads = () => [{axes: [0.5, -1, 0, 0]}]; 1")  # stick up and to the right
        _soon(lambda: _wheel(page) == pytest.approx(0.5))
        tab.run("navigator.getGamepads = () => []; 1")
        _soon(lambda: not _wheel(page))
        for name in ("Plots", "Show"):
            tab.click(name)
        tab.click("names")
        _soon(lambda: page.playback.worlds[0].scene.visible_parts["names"])


def test_a_narrow_window_shows_the_whole_world_above_the_panel(new_tab):
    with served("find_ball") as page:
        page.submit(page.playback.step_once)
        tab = new_tab()
        tab.open(page.address, 480, 800)
        tab.wait("document.body.innerText.includes('reward terms of this step')")
        edge = "document.querySelector('canvas').getBoundingClientRect().bottom"
        tab.wait(f"{edge} <= document.querySelector('.mantine-Paper-root').getBoundingClientRect().top + 1")
        _soon(lambda: _is_world(tab.see()[: tab.run(edge)].astype(int), (215, 200, 80), 60))
        tab.click("step")
        tab.wait("document.body.innerText.includes('step 2,')")


def test_two_worlds_are_seen_side_by_side(new_tab):
    with served("find_ball", compare=Showing("find_ball"), driver="around") as page:
        page.submit(page.playback.step_once)
        tab = new_tab()
        tab.open(page.address)
        tab.wait(
            "document.body.innerText.includes('A: find_ball') && document.body.innerText.includes('B:"
            " find_ball')"
        )
        _soon(lambda: _columns(_world(tab), (215, 200, 80)) == 2)
        assert tab.errors == []


def _columns(image, color):
    """How many things of a color stand side by side."""
    there = (np.abs(image - color).sum(axis=2) < 60).any(axis=0)
    return int((np.diff(np.flatnonzero(there)) > 20).sum()) + int(there.any())


def test_an_offline_page_turns_without_a_server(new_tab, tmp_path):
    from deepbots_cli.view.episodes import Player
    from deepbots_cli.view.pictures import Viewpoint, write_clip

    out = tmp_path / "clip.html"
    with closing(Player(Showing("find_ball").open(), "around")) as player:
        write_clip(player, out, Viewpoint(), seed=0, episode=0, seconds=2.0)
    tab = new_tab()
    tab.open(out.as_uri())
    _soon(lambda: _is_world(tab.see().astype(int), (215, 200, 80), 60))
    assert not [address for address in tab.requests if address.startswith(("http", "ws"))]
