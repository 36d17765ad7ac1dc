"""Trees that join the pins of a net."""
