"""The page of the studio in one browser: the text and its findings, the robot, and the tabs below it."""

from __future__ import annotations

from collections.abc import Awaitable, Callable, Iterator
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Any

from nicegui import ui

from deepbots_cli.errors import UsageError
from deepbots_cli.insight.suggestions import Suggestion
from deepbots_cli.studio.dialogs import Kind, StartPage, edit_robot, new_scenario
from deepbots_cli.studio.editor import Editor, FindingList
from deepbots_cli.studio.explain import OfText, show_explanation
from deepbots_cli.studio.files import OpenFile
from deepbots_cli.studio.layout import ICONS, CommandTab, Division, Notices
from deepbots_cli.studio.lesson_tab import LessonTab
from deepbots_cli.studio.robot_pane import DRAWS, KEYS, RobotPane
from deepbots_cli.studio.runs_tab import RunsTab, TrainingTab
from deepbots_cli.studio.session import HAS_ERRORS, TABS, Session, Topic
from deepbots_cli.words import counted

_MAX_FIXES = 3
_STYLE = Path(__file__).with_name("studio.css")
_BROWSER_S = 60.0
"""The time in s within which a browser answers."""
_TOPICS_OF_TABS: tuple[Topic, ...] = ("training", "runs", "task")
_PREFERENCES = """(() => { const kept = (name) => localStorage.getItem(`deepbots-studio-${name}`);
  const dark = kept("dark") ? kept("dark") == "yes" : matchMedia("(prefers-color-scheme: dark)").matches;
  return { dark, text: kept("size-text"), robot: kept("size-robot") }; })()"""
"""A script for the browser: whether the colors are dark, and the sizes of areas that it has kept, if any."""
_NAME_UPLOAD = """document.querySelectorAll(".q-uploader a, .q-uploader input").forEach((one) => {
  one.setAttribute("aria-label", "Choose a robot file");
  if (one.tagName == "A") one.setAttribute("role", "group"); })"""
"""A script for the browser: Quasar gives these controls no name, and puts one button into the other."""


def _section(name: str, label: str) -> ui.element:
    return ui.element("section").classes(f"studio-{name}").props(f'aria-label="{label}"')


def add_style() -> None:
    """Add the style of the page to all pages."""
    ui.add_css(_STYLE.read_text("utf-8"), shared=True)
    ui.add_head_html(KEYS, shared=True)


class StudioPage:
    """The elements of one browser, kept in step with the session."""

    def __init__(self, session: Session) -> None:
        self._session = session
        self._shown = shown = session.shown
        self._file: OpenFile | None = None
        self._banner_key: tuple[object, ...] = ()
        self._dark = ui.dark_mode(value=None)
        self._is_dark = False
        ui.page_title(f"deepbots studio: {session.folder.name}")
        ui.context.client.content.classes("studio-loads")
        self._add_header()
        self._start_page = StartPage(session, self._new, lambda: self._show_areas(starts=False))
        self._main = ui.element("div").classes("studio-main")
        with self._main:  # in the element `main` of NiceGUI
            self._columns = Division("text", "Width of the text", 46)
            with self._columns.splitter.before, _section("text", "Text"):
                self._add_text()
            with self._columns.splitter.after:
                self._rows = Division("robot", "Height of the robot", 50, horizontal=True)
            with self._rows.splitter.before, _section("robot", "Robot"):
                self._robot = RobotPane(session, self._write_values, self._save_file, self._train)
            with self._rows.splitter.after, _section("work", "Training and commands"):
                self._add_work()
        self._parts: dict[str, ui.button] = {}
        with ui.element("nav").classes("studio-jump").props('aria-label="Parts of the page"'):
            for name, label in (("text", "Text"), ("robot", "Robot"), ("work", "Training")):
                self._parts[name] = ui.button(label, on_click=partial(self._show_part, name))
                self._parts[name].props("flat no-caps")
        self._show_part("text")

        self._shows: dict[Topic, tuple[Callable[[], object], ...]] = {
            "text": (
                self._editor.refresh,
                self._show_state,
                self._robot.update_parameters,
                self._training.result.update,
                self._runs.result.update,
                self._lesson.update,
            ),
            "findings": (self._show_findings,),
            "files": (self._show_files,),
            "robot": (self._robot.update,),
            "training": (self._training.update, self._robot.show_offer),
            "runs": (self._runs.update, self._robot.update_sources, self._lesson.update),
            "task": (self._training.update, self._runs.result.update, self._command.update),
            "notice": (lambda: self._notices.show(shown.notice, is_warning=shown.is_warning),),
            "tab": (lambda: self._tabs.set_value(shown.tab),),
        }
        self._show_areas(starts=session.current is None)
        ui.context.client.on_delete(session.listen(self._changed))
        ui.timer(0, self._start, once=True)

    async def _start(self) -> None:
        """Fill the page once the browser is connected."""
        client = ui.context.client
        await client.connected(timeout=_BROWSER_S)
        self._show_files()
        for topic in _TOPICS_OF_TABS:
            self._changed(topic)
        with suppress(TimeoutError):  # of a busy browser; the page works with the defaults
            preferences = await ui.run_javascript(_PREFERENCES, timeout=_BROWSER_S)
            self._set_dark(bool(preferences["dark"]))
            self._columns.restore(preferences)
            self._rows.restore(preferences)
        client.content.classes(remove="studio-loads")
        ui.run_javascript(_NAME_UPLOAD)
        self._robot.begin()
        with suppress(TimeoutError):
            self._robot.adapt(str(await ui.run_javascript(DRAWS, timeout=_BROWSER_S)))

    # Parts

    def _add_header(self) -> None:
        with ui.element("header").classes("studio-header"):
            ui.label("deepbots").classes("studio-name").props('role="heading" aria-level="1"')
            self._files = (
                ui.select([], on_change=lambda event: self._choose(event.value))
                .props('dense outlined aria-label="File"')
                .classes("studio-files")
            )
            self._save = (
                ui.button("Save", on_click=self._save_file)
                .props('dense no-caps unelevated title="Ctrl+S"')
                .classes("studio-save")
            )
            ui.button("New ...", on_click=lambda: self._show_areas(starts=True)).props("dense flat no-caps")
            ui.button("Explain ...", on_click=self._explain_here).props(
                'dense flat no-caps title="the word at the cursor (F1)"'
            )
            self._status = ui.label("").classes("studio-status studio-state").props('role="status"')
            self._of_text = (self._files, self._save, self._status)
            self._notices = Notices()
            self._theme = (
                ui.button("Dark", icon=ICONS["dark"], on_click=self._switch_dark)
                .props("dense flat no-caps")
                .classes("studio-theme")
            )

    def _add_text(self) -> None:
        self._banner = ui.element("div").classes("studio-banner").props('role="alert"')
        self._banner.set_visibility(False)
        self._editor = Editor(self._typed, self._key)
        self._list = FindingList(self._session, self._editor, self._explain)

    def _add_work(self) -> None:
        shown = self._shown
        with ui.tabs(on_change=lambda event: shown.open_tab(event.value)).props(
            "dense no-caps align=left"
        ) as self._tabs:
            lesson, train, runs, command = map(ui.tab, TABS)
        lesson.set_visibility(self._session.has_lesson)
        with (
            ui.tab_panels(self._tabs, value=shown.tab, animated=False)
            .props("keep-alive")
            .classes("studio-panels")
        ):
            with ui.tab_panel(lesson):
                self._lesson = LessonTab(self._session, self._explain)
            with ui.tab_panel(runs):
                self._runs = RunsTab(self._session, self._write_values, self._train)
            with ui.tab_panel(train):
                self._training = TrainingTab(self._session, self._guarded, self._runs)
            with ui.tab_panel(command):
                self._command = CommandTab(self._session)

    # Changes of the session

    def _changed(self, topic: Topic) -> None:
        """Show what has changed."""
        for show in self._shows[topic]:
            show()

    def _show_files(self) -> None:
        session, has_file = self._session, self._file is not None
        if self._file is None or self._file.path not in session.files:
            current = session.files.get(session.current) if session.current else None
            self._show_file(current)
        opened = [path for path in session.files if path != session.current]
        options = {str(path): session.name_of(path) for path in (*session.scenarios(), *opened)}
        for path in session.language.files_of(session.current) if session.current else ():
            options.setdefault(str(path), f"{session.name_of(path)} (read by it)")
        robots = (path for path in sorted(session.folder.glob("*.urdf")) if not path.is_symlink())
        options |= {str(path): f"{path.name} (robot file)" for path in robots}
        self._files.set_options(options, value=str(self._file.path) if self._file else None)
        if has_file != (self._file is not None):
            self._show_areas(starts=self._file is None)
        self._robot.update_sources()

    def _show_part(self, name: str) -> None:
        """Show a part of the page, in a narrow window that has no room for all of them."""
        self._main.props(f'data-part="{name}"')
        for part, button in self._parts.items():
            button.props(f'aria-current="{str(part == name).lower()}"')

    def _show_areas(self, *, starts: bool) -> None:
        """Show what a new scenario begins with, or the areas of a file."""
        self._start_page.show(starts, can_leave=self._file is not None)
        for element in (self._main, *self._of_text):
            element.set_visibility(not starts)

    def _show_file(self, file: OpenFile | None) -> None:
        self._file = file
        if file is not None:
            if str(file.path) in self._files.options:
                self._files.set_value(str(file.path))
            self._editor.show(file, dark=self._is_dark)
            self._show_state()
            self._show_findings()

    def _show_state(self) -> None:
        """Show whether the file is saved, and what happened to it."""
        file = self._file
        if file is None:
            return
        self._save.set_text("Save *" if file.is_modified else "Saved")
        self._save.set_enabled(file.is_modified and not file.read_only)
        self._editor.mark_saved(not file.is_modified)
        key = (file.outside is not None, file.is_gone, file.read_only)
        if self._banner_key == (file.path, *key):
            return
        self._banner_key = (file.path, *key)
        self._banner.clear()
        self._banner.set_visibility(any(key))
        with self._banner:
            if file.outside is not None:
                ui.label(f"Another program has changed {file.path.name}.")
                ui.button("Take its text", on_click=lambda: self._resolve(file.take_outside)).props(
                    "dense flat no-caps"
                )
                ui.button("Keep this text", on_click=lambda: self._resolve(file.keep_own)).props(
                    "dense flat no-caps"
                )
            elif file.is_gone:
                ui.label(f"Another program has removed {file.path.name}. Its text is kept here.")
                ui.button("Write the file again", on_click=self._save_file).props("dense flat no-caps")
                ui.button("Discard the text", on_click=lambda: self._close(file)).props("dense flat no-caps")
            elif file.read_only:
                ui.label("This file is read only: it belongs to deepbots or another project.")

    def _close(self, file: OpenFile) -> None:
        """Forget a file that was removed; without another one, its text stays on the page."""
        if self._session.scenarios() or len(self._session.files) > 1:
            self._guarded(lambda: self._session.close_file(file.path))
        else:
            self._shown.say("write another scenario first: New ...")

    def _resolve(self, act: Callable[[], None]) -> None:
        if self._file is not None:
            act()
            self._session.edited(self._file)

    def _show_findings(self) -> None:
        file = self._file
        if file is None:
            return
        language = self._session.language
        findings = language.findings(file.path)
        if language.checked_revision(file.path) == file.revision:
            self._editor.underline(file.revision, findings)
        errors = sum(finding.severity == "error" for finding in findings)
        numbers = ((errors, "error"), (len(findings) - errors, "warning"))
        text = ", ".join(counted(number, word) for number, word in numbers if number) or "no mistakes found"
        self._status.set_text(text if language.checked_revision(file.path) else "checking ...")
        kind = findings[0].severity if findings else "good"  # errors come first
        if not errors:
            self._shown.withdraw(HAS_ERRORS)
        self._status.classes(replace=f"studio-status studio-state studio-state-{kind}")
        self._list.show(file, findings)

    # What the person does

    def _guarded(self, act: Callable[[], Any]) -> None:
        """Call a function, and show its error as a message."""
        try:
            act()
        except UsageError as error:
            self._shown.say(str(error), is_warning=True)

    def _typed(self, path: Path, revision: int, text: str) -> OpenFile | None:
        file = self._session.files.get(path)
        if file is not None and not file.read_only:
            self._guarded(lambda: self._session.change(file, revision, text))
        return file

    async def _key(self, command: str) -> None:
        if command == "save":
            self._save_file()
        elif command == "explain":
            await self._explain_here()
        elif command == "train":
            self._train()

    def _train(self) -> None:
        self._shown.open_tab("Train")
        self._show_part("work")
        self._training.train()

    def _save_file(self) -> None:
        file = self._file
        if file is not None and file.is_modified:
            self._shown.withdraw()
            self._guarded(lambda: self._session.save(file))

    def _choose(self, path: str | None) -> Awaitable[None] | None:
        """Show the file that was chosen; a scenario of the folder also gets the robot. For a robot file, return
        what edits it.

        A scenario is shown at once: the list also calls this for what `_show_files` writes into it, and two
        choices that wait would undo each other for ever.
        """
        if path is None or (self._file is not None and path == str(self._file.path)):
            return None
        if path.endswith(".urdf"):
            self._files.set_value(str(self._file.path) if self._file is not None else None)
            return edit_robot(self._session, Path(path))

        def choose() -> None:
            self._shown.withdraw()
            file = self._session.open(Path(path))
            self._show_file(file)
            if not file.read_only and self._session.language.is_scenario(file):
                self._show_scenario(file.path)

        self._guarded(choose)
        return None

    def _write_values(self, values: dict[str, str]) -> None:
        """Write values of a diagnosis, or of the running world, into the text."""

        def write() -> None:
            lines = self._session.write_values(values)
            self._shown.say(f"wrote {counted(len(values), 'value')} into the text; save it, or press Train")
            if self._file is not None and self._file.path == self._session.current:
                self._editor.refresh()
                self._editor.mark_lines(lines)

        self._guarded(write)

    def _show_scenario(self, path: Path) -> None:
        """Show the robot and the trainings of a scenario, and close the results of another one."""
        self._session.show(path)
        self._runs.result.close()
        self._training.result.close()

    async def _new(self, kind: Kind, origin: str) -> None:
        path = await new_scenario(self._session, kind, origin)
        if path is not None:
            self._shown.withdraw()
            self._show_areas(starts=False)
            self._guarded(lambda: self._show_scenario(path))
            self._show_file(self._session.files.get(path))
            self._show_files()

    async def _explain_here(self) -> None:
        """Explain the word at the cursor, or what is selected."""
        file, place = self._file, None
        if file is not None:
            with suppress(TimeoutError):
                place = await self._editor.place()
        # At the first character, nobody has moved the cursor.
        if file is None or place is None or (place.line, place.column) == (0, 0):
            self._explain()
            return
        self._explain(
            place.word,
            self._session.language.meaning(file.path, place.text, place.line, place.column),
        )

    def _explain(self, word: str = "", meaning: str = "") -> None:
        """Open the explanation of a word, with what can be written into the text."""
        file, language = self._file, self._session.language

        def fixes(code: str) -> Iterator[tuple[str, Callable[[], object]]]:
            if file is None:
                return
            training, newest = self._shown.training, self._session.commands.newest_training(file.path.stem)
            if training and training.path == newest and code.lower().startswith("why "):
                yield f"Diagnose {newest.name}", partial(self._training.act, self._runs.diagnose)
            for finding in [one for one in language.findings(file.path) if one.code == code][:_MAX_FIXES]:
                for fix in language.fixes(file, finding)[:1]:
                    yield (
                        f"Line {finding.start[0] + 1}: {fix.title}",
                        partial(self._list.fix, file, finding, fix.title),
                    )
            for suggestion in suggestions(code):
                if suggestion.value and not language.has_values(file, {suggestion.path: suggestion.value}):
                    yield (
                        f"Write {suggestion.path.split('.', 2)[-1]}: {suggestion.value}",
                        partial(self._write_values, {suggestion.path: suggestion.value}),
                    )

        def suggestions(phrase: str) -> list[Suggestion]:
            return [] if file is None else language.suggestions(file.path, phrase)

        show_explanation(
            word,
            OfText(
                fixes,
                lambda phrase: language.names_like(file, phrase) if file is not None else [],
                suggestions,
                self._editor.go_to,
            ),
            meaning,
        )

    def _switch_dark(self) -> None:
        """Change the colors, also for the next visits of this browser."""
        self._set_dark(not self._is_dark)
        ui.run_javascript(
            f'localStorage.setItem("deepbots-studio-dark", "{"yes" if self._is_dark else "no"}")'
        )

    def _set_dark(self, dark: bool) -> None:
        # A chosen value: with `None`, the page would follow the system, and editor and robot would not.
        self._dark.set_value(dark)
        if dark == self._is_dark:
            return
        self._is_dark = dark
        self._theme.set_text("Light" if dark else "Dark")
        for part in (self._editor, self._training, self._runs, self._robot):
            part.set_dark(dark)
