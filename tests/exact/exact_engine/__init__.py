"""An engine of another package: the exact equations of motion of a rail cart-pole and of free bodies.

It serves to measure PyBullet by, and to run small worlds in microseconds. deepbots finds it by its entry
point, as it finds any engine of another package: `exact_engine-1.0.dist-info` lies beside, and
`tests/conftest.py` puts both on the path.
"""

from exact_engine.engine import ExactEngine

__all__ = ["ExactEngine"]
