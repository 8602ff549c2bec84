"""Cross-sections of beams; one family a file."""
