"""Numbers to a tolerance: methods and settings chosen by pilot runs, with bars."""
