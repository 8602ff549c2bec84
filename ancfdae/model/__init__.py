"""Declarations: scenes of bodies, elements, sections, joints, loads, laws and a design.

It knows geometry, material and the formulas of single parts. It knows no equations of motion, no
coordinates of a whole scene and no time step: `assembly` makes a system of it.
"""
