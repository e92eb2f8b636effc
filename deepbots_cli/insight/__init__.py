"""Explanations of episodes and trainings, comparisons of worlds, reports, and exported policies.

conditions.py      the endings of a scenario as comparisons whose values an episode keeps
trace.py           an episode that runs again, with the observation, action and reward of each step
statements.py      sentences with their evidence: the form of every row in the two tables
episode.py         the table that explains an episode
training.py        the evidence about a training: its logs, and a few short episodes
scenario_facts.py  the facts of a scenario, and the units of its file
linted.py          the findings of lint about the scenario of a run
diagnosis.py       the table of causes why a training does not learn, with those of the learner
rewards.py         causes in the reward
observations.py    causes in the observation
stages.py          causes in stages, in starts, and rare success
teachers.py        causes in scripts and teachers
missed.py          the condition that episodes without success miss
ends.py            causes at the end of a training
collapse.py        the causes of a training that falls apart
robot_log.py       the log of a robot beside the simulation: values with another distribution
transfer.py        the differences between two worlds of a scenario, such as two engines, and their causes
inspection.py      the tables of `deepbots inspect`: a scenario, a run or a robot file
speed.py           steps per second of engines and of batches, and the share of each part of the time
retry.py           trainings that follow one another with the values that the diagnosis advises
report.py          one HTML file about a run or a group: result, curves, episodes, scenario
figures.py         the figures of a report
study.py           one HTML file about a study of `deepbots tune`: history, importance, slices
templates.py       the templates of pages and of READMEs
export/            a policy for a robot, as a folder that runs without deepbots
robot.py           the simulation as a robot, which sends its sensors and follows commands
real_robot.py      episodes on a robot at the other end of a link, scored by its measurements
"""
