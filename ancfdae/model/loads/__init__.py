"""Loads: forces and moments on points of bodies, contact, controllers; a family a file."""
