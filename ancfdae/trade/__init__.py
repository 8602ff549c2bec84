"""What accuracy costs: settings of integrators measured against each other on a user's scene."""

from ancfdae.trade.compare import Setting, TargetNotReached, Tradeoff
from ancfdae.trade.run import tradeoff

__all__ = ["Setting", "TargetNotReached", "Tradeoff", "tradeoff"]
