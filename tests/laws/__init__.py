"""Laws: what must hold for every scenario, tried on scenarios that chance draws.

expressions.py  strategies for literals and expressions, from the table of functions
fields.py       strategies for single values, one for each class of `scenario/fields`
scenarios.py    strategies for whole scenarios, from the models of the language
law.py          what a law is, and how it is tried
episodes.py     laws of episodes
writing.py      laws of writing
"""

from tests.laws import episodes, writing
from tests.laws.law import LAWS

__all__ = ["LAWS", "episodes", "writing"]
