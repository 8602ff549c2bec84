"""Scenes, mechanisms, examples of every part, oracles and documents that tests share."""
