"""Campaigns: several trainings of one scenario in one folder.

group.py      the base of campaigns; groups: a folder with a run per seed, trained in turn or on workers
study.py      studies: searches over values of a scenario, a group for each trial
trials.py     how a process takes, trains, scores and prunes trials
listing.py    the state of runs, groups and studies from their files, even while they train
changes.py    what each run changed against the one before it
"""
