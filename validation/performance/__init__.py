"""What runs cost: time and memory, one module a subject."""
