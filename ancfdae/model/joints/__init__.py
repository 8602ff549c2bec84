"""Joints: holonomic constraints between points of beams, and to ground; a family a file."""
