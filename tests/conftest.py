"""Settings that all tests share."""

import hypothesis

# Derandomised and without a database: the same examples on every machine and in every run.
hypothesis.settings.register_profile("ancfdae", derandomize=True, database=None, deadline=None)
hypothesis.settings.load_profile("ancfdae")
