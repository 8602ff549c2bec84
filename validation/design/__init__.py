"""Optimisations of mechanisms: one file each, with a page of code to copy."""
