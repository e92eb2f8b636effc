"""Explanations of episodes and trainings, reports, and exported policies.

conditions.py  the endings of a scenario as comparisons whose values an episode keeps
trace.py       an episode that runs again, with what each step saw, did, earned and measured
statements.py  sentences with their evidence: the form of every row in the two tables
episode.py     the table that explains an episode
training.py    the evidence about a training: its logs and evaluations; probes.py its short episodes
train_command.py  the command that trains the scenario of a run again
scenario_facts.py  what a scenario has already, and the units of its file
linted.py      what lint says of a scenario
diagnosis.py   the table of causes why a training does not learn, with causes in faults
learner.py     causes in the learner: its rate, horizon and exploration
rewards.py     causes in the reward
observations.py  causes in the observation
stages.py      causes in stages, starts and rare success
teachers.py    causes in scripts
rivals.py      causes in the other agents
missed.py      a condition of the success that is missed
ends.py        causes in the end of episodes
collapse.py    the cause of a training that falls apart
changed.py     what was changed since a run that was solved
robot_log.py   the log of a robot beside the simulation: values with another distribution
transfer.py    the evaluation of a policy in another world; world_comparison.py what differs between two
               worlds of a scenario, such as two engines, and which of the world_changes.py explains it;
               recorded_worlds.py the values of both
inspection.py  the tables of `deepbots inspect`: a scenario, a run or a robot file; timing.py the ages of
               actions and observations
speed.py       steps per second of engines and of batches, and where the time goes
report.py      one HTML file about a run or a group: result, curves, episodes, scenario; figures.py its
               figures
suggestions.py  changes of a scenario for a phrase such as `make the pole longer`
templates.py   the templates of pages and of READMEs
export/        a policy for a robot, as a folder that runs without deepbots
robot.py       the simulation as a robot, which sends its sensors and obeys commands
real_robot.py  episodes on a robot at the other end of a link, scored by what is measured
"""
