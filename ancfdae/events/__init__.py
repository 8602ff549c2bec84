"""Runs with events: phases of smooth motion between impacts, switches and the end of a run."""
