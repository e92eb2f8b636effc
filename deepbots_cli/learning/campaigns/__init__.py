"""Campaigns: several trainings of one scenario in one folder.

campaign.py   the base of groups and studies
group.py      groups: a folder with a run per seed, trained one after the other or on workers
study.py      studies: searches over values of a scenario, a group for each trial
trials.py     how a process takes, trains, scores and prunes trials
listing.py    the state of runs, groups and studies from their files, even while they train
"""
