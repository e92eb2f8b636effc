"""Laws: what must hold for every scenario, tried on scenarios that chance draws.

expressions.py  strategies for literals and expressions, from the table of functions
fields.py       strategies for single values, one for each class of `scenario/fields`
scenarios.py    strategies for whole scenarios, from the models of the language
law.py          what a law is, and how it is tried
episodes.py     laws of episodes
claims.py       laws of what the analysis and lint state
records.py      laws of trainings and their records
"""

from tests.laws import claims, episodes, records
from tests.laws.law import LAWS

__all__ = ["LAWS", "claims", "episodes", "records"]
