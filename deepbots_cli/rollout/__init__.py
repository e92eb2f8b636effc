"""Sources and drivers: the named scenario, episodes as a stream of steps, and experience for a learner.

episode.py            `steps`, an episode of one environment; the result of an episode
source.py             the resolution of a name, path or object to a scenario
drivers.py            drivers: a script, random or zero actions, a list of actions, a person
recordings.py         the episodes in a recording, and in the log of a robot
worlds.py             worlds that run side by side: single worlds, and the worlds of a batch
collector.py          fragments of experience, from worlds in this process and from shards
policies.py           a trained policy as a driver; evaluations in a world, or in a batch of them

Environments are stepped in `episode.steps`, one at a time, and in `worlds.SingleWorlds` and
`worlds.BatchEpisodes`, side by side. Outside of this package, wrappers pass `step` on, and benchmarks time
it.
"""

from deepbots_cli.rollout.episode import (
    Driver,
    Episode,
    EpisodeAccumulator,
    Start,
    Step,
    play,
    result_of,
    steps,
)

__all__ = ["Driver", "Episode", "EpisodeAccumulator", "Start", "Step", "play", "result_of", "steps"]
