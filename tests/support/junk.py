"""What no argument of a public call should be, and a beam."""

import numpy as np

from ancfdae import Beam, Material
from ancfdae.observables import position
from ancfdae.sections import Rectangle

ROD = Beam("rod", (0.0, 0.0), (1.0, 0.0), 1, Rectangle(0.05, 0.04), Material(1e3, 1e7, 0.3))
TIP = position(ROD.at_end, 0)
NAN, INF = float("nan"), float("inf")
JUNK = [None, "x", "", "a.b", "3", NAN, INF, -2, -0.5, 0, 10**400, 1j, b"x", [], {}, (), [[]]]
JUNK += [(1.0, NAN), (1.0, "x"), np.zeros(3), np.zeros((2, 0)), np.array("x"), object(), int, len]
JUNK += [ROD, ROD.at_end, {"a": 1}, iter([1.0]), ["rod"], 1e308, np.float64(0.5), np.True_]
