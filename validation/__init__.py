"""Reports that hold `ancfdae` against its source paper, other methods and the clock.

``python -m validation list`` names them, ``python -m validation run NAME`` makes one.
"""
