"""A joint, a load, a law, a section, an element and an integrator of a reader's own, one a file.

Each file ends with what `test_extending` runs: a scene, the variables that it is differentiated
in, an observable and how the motion is integrated.
"""
