"""Published multibody problems, each as a user of `MechanicalSystem` would write it."""
