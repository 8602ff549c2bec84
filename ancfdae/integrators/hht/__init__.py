"""HHT-I3: its discrete equations, Newton's method, derivative passes and step error."""

from ancfdae.integrators.hht.method import HHT

__all__ = ["HHT"]
