"""What is run and who acts: the source that is named, and episodes as a stream of steps.

episode.py   `steps`, the one place that steps an environment outside of training and benchmarks; the result of an episode
source.py    which scenario is meant: the one place that answers it
drivers.py   who acts: a script, random or zero actions, a list of actions, a person
"""

from deepbots_cli.rollout.episode import Driver, Episode, EpisodeAccumulator, Start, Step, play, result_of, steps

__all__ = ["Driver", "Episode", "EpisodeAccumulator", "Start", "Step", "play", "result_of", "steps"]
