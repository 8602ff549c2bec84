"""Report on events: impacts, locks, ends of runs, and free end times."""
