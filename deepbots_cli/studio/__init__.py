"""The studio: the text of a scenario, its running robot and its trainings on one page of the browser.

files.py          the open files: revisions, merged changes, drafts of unsaved text, changes outside
language.py       findings, completion, hover and fixes of the open files
robot.py          the process that simulates and shows the robot
robot_process.py  what runs in that process
shown.py          what the page shows: whose robot, which tab, which curve, which notice, what starts
commands.py       the commands that the studio runs
tasks.py          processes of commands, which survive the server
task_process.py   what runs in such a process
trainings.py      the learning curve and the time left of a training, from its files
changes.py        what each run changed against the run before it
session.py        the state of the studio, free of the page: files, robot, tasks, runs
gate.py           the checks in front of the server, and the page of the robot behind its address
page.py           the page: the text, and the parts around it
layout.py         the areas of the page, the bars between them, and the notices
start.py          what a folder without a scenario can begin with
finding_list.py   the findings below the text, with explanations and fixes
robot_pane.py     the robot on the page
training_tab.py   the tab for training, with the learning curve
runs_tab.py       the tab with the runs, and their diagnosis
outputs.py        the outputs of commands, and the tab with all of them
charts.py         the charts of learning curves
dialogs.py        the dialogs for a new scenario and for two versions of a file
explain.py        explanations of words and findings, with links
meanings.py       what a word of the text means, where it is defined, and what uses it
editor.py         the text editor of the page, with `editor.js`
application.py    the application of the web server
server.py         the web server

Nothing imports this package but the command `deepbots studio`. NiceGUI is in the extra `studio`.

```python
from pathlib import Path

from deepbots_cli.studio.files import OpenFile

file = OpenFile(Path("mine.yaml"), "a: 1\\n")
file.change(file.revision, "a: 2\\n")
assert file.is_modified
```
"""
