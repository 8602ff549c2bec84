"""Figures of report `performance` whose history asv keeps: ``nox -s benchmarks``."""
