"""Cross-sections, one family a file."""
