"""Report on ladders of models: which one a value and its gradient need."""
