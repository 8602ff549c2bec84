"""Laws of time: numbers as functions of time that drive joints and scale loads; a family a file."""
