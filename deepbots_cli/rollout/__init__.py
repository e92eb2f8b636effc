"""What is run and who acts: the source that is named, episodes as a stream of steps, and experience for a learner.

episode.py    `steps`, an episode of one environment; the result of an episode
source.py     which scenario is meant: the one place that answers it
drivers.py    who acts: a script, random or zero actions, a list of actions, a person
worlds.py     worlds that go on side by side, single ones or a batch
collector.py  fragments of experience, by shards of worlds
policies.py   episodes of a policy, in several worlds at a time

Outside of this package only benchmarks step an environment.
"""

from deepbots_cli.rollout.episode import Driver, Episode, EpisodeAccumulator, Start, Step, play, result_of, steps

__all__ = ["Driver", "Episode", "EpisodeAccumulator", "Start", "Step", "play", "result_of", "steps"]
