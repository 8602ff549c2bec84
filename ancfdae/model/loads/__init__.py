"""Loads: forces and moments on points of beams; a family a file."""
