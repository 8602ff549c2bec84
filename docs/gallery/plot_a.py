"""
1. A hanging beam
=================
"""

print(1)
