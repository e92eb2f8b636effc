"""Runs: the directory of a training, and what follows from its files, without torch and without a world.

run.py          the run directory, written atomically and checked when read: `run.json`, models of runs
evaluations.py  an evaluation: its scores, circumstances and episodes; the effect of drawn values
directories.py  directories of runs, groups and studies: names, locks, files written whole, records read
episodes.py     results of episodes: log, statistics, solved, summaries with intervals
curriculum.py   the stages of a training, and the levels of worlds
statistics.py   intervals, gates that may stop early, comparisons of groups, confirmations of a solved task
origin.py       the commits, packages and processor of a training
order.py        the order of policies, and the best models of a training
verdict.py      the quoted evaluation of a run; whether it is solved, got worse; what it changed

    run = Run.open("runs/cartpole-0-1")
    print(run_verdict(run.path, run.record).text)
"""
