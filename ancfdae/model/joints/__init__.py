"""Joints: constraints between points of bodies, and to ground; one family a file."""
