"""Explanations of episodes and trainings, reports, and exported policies.

trace.py       an episode that runs again, with what each step saw, did, earned and measured, and its endings
               as comparisons
statements.py  sentences with their evidence: the form of every row in the two tables; templates of pages
episode.py     the table that explains an episode
training.py    the evidence about a training: its logs and evaluations, and its short episodes
scenario_facts.py  what a scenario has already, what lint says of it, and the command that trains it again
causes.py      why a training does not learn: `CAUSES`, the table of all causes, with the numbers of faults,
               the observation, teachers, other agents and the end of the training; the causes of a training
               in their order, each with the next command
rewards.py     the numbers of causes in the reward
stages.py      those in stages, starts and missing success
learner.py     those in the learner, and the settings of a training that fell apart
robot_log.py   the log of a robot beside the simulation: values with another distribution
transfer.py    a policy in another world: what differs, and which changes explain it; recorded_worlds.py the
               values of both worlds, and the changes
inspection.py  the tables of `deepbots inspect`: a scenario, a run or a robot file, and ages of values
speed.py       steps per second of engines and of batches, and where the time goes
report.py      one HTML file about a run or a group: result, curves, episodes, scenario; figures.py its
               figures
suggestions.py  changes of a scenario for a phrase such as `make the pole longer`
export/        a policy for a robot, as a folder that runs without deepbots
robot.py       the simulation as a robot, which sends its sensors and obeys commands
real_robot.py  episodes on a robot at the other end of a link, scored by what is measured
"""
