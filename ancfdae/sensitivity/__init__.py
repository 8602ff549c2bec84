"""Design sensitivities of whole runs by several independent methods."""
