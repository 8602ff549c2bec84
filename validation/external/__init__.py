"""Mechanisms of other libraries, written as a user would write them, with their numbers."""
