"""The ANCF assembler: where a scene becomes a mechanical system."""
