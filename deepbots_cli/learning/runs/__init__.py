"""Runs: the directory of a training, and what follows from its files, without torch and without a world.

run.py                the run directory, written atomically and checked when read; models of runs
records.py            the content of `run.json`
record_shape.py       the shape of a JSON record, compared before it is parsed
evaluations.py        an evaluation: its scores, circumstances and episodes
directories.py        directories of runs, groups and studies: names, locks, files that are written whole
episodes.py           results of episodes: log, statistics, solved, summaries with intervals
generations.py        windows over training episodes, equally many of each world
curriculum.py         the stages of a training, and the levels of worlds
statistics.py         intervals, gates that may stop early, comparisons of groups of runs
confirmation_rule.py  how a confirmation is judged, which may end the training
order.py              the order of policies, and the best models of a training
verdict.py            the evaluation of a run that is quoted, and whether the run is solved
decline.py            whether the last evaluations of a training are worse than earlier ones
draws.py              the effect of drawn values on episodes
changes.py            what a run changed against an earlier one, and the run that was solved before it

    run = Run.open("runs/cartpole-0-1")
    print(run_verdict(run.path, run.record).text)
"""
