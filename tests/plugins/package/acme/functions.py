"""A function of the expression language."""

from deepbots_cli.expressions.functions import Family, Function, Param

FUNCTIONS = [Function("halved", Family.PURE, (Param("x"),), "Half of x.", "halved(gas)", python="x / 2")]
