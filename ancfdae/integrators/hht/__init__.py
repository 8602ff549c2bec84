"""The integrator HHT-I3: its discrete equations, Newton's method, derivative passes, step error."""
