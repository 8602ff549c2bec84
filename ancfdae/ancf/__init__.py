"""The ANCF assembler: where a scene becomes a mechanical system."""

from ancfdae.ancf.system import AncfSystem, assemble

__all__ = ["AncfSystem", "assemble"]
