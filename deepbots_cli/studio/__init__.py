"""The studio: the text of a scenario, its running robot and its trainings on one page of the browser.

server.py         the web server: its checks, the application, and the page of the robot behind its address
session.py        the state of the studio, free of the page: files, robot, tasks, runs; what the page shows
files.py          the open files: revisions, and changes outside
language.py       findings, completion, hover and fixes of the open files; what a word of the text means
robot.py          the process that simulates and shows the robot
robot_process.py  what runs in that process
commands.py       the commands that the studio runs, as processes that survive the server
trainings.py      what files say about trainings: curves and their charts, the time left, results, and what
                  each run changed against the run before it
page.py           the page: the text, and the parts around it
layout.py         the areas of the page, the bars between them, the notices, and the outputs of commands
dialogs.py        what a folder without a scenario can begin with, and the dialog for it
editor.py         the text editor of the page, with `editor.js`, and the findings below it
explain.py        explanations of words and findings, with links
robot_pane.py     the robot on the page
lesson_tab.py     the tab of a lesson that was started in the folder: its text, its checks, its points
runs_tab.py       the tabs for training, with the learning curve, and with the runs, and their diagnosis

Nothing imports this package but the command `deepbots studio`. NiceGUI is in the extra `studio`.

```python
from pathlib import Path

from deepbots_cli.studio.files import OpenFile

file = OpenFile(Path("mine.yaml"), "a: 1\\n")
file.change(file.revision, "a: 2\\n")
assert file.is_modified
```
"""
