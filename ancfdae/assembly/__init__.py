"""Assembly of a scene into a mechanical system with its design derivatives."""
